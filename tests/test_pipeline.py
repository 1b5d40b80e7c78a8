"""From a folder to a folder: it opens the sequence alone, and a stopped reconstruction goes on to the same bytes."""

import json
import multiprocessing
import os
import shutil
import signal
import subprocess
import sys
import time
from dataclasses import fields, replace
from pathlib import Path
from typing import ClassVar

import numpy as np
import pytest
from another_python import ROOT
from reconstruct_clip import make_clip

from freeart21 import processes
from freeart21.files.result import read_result
from freeart21.files.sequence import read_sequence, write_sequence
from freeart21.gaussians import Gaussians
from freeart21.reconstruction import Reconstruction
from reconstruct import VERSION, cache, pipeline
from reconstruct.commands import reconstruct as command
from reconstruct.pipeline import reconstruct_folder, reconstruct_until
from reconstruct.renders import render
from reconstruct.settings import GaussianSettings, ReconstructSettings
from reconstruct.stages import CACHED_STAGES, STAGES, settings_used_by

QUIET = ReconstructSettings(progress=False, gaussians=GaussianSettings(rounds=2, warm_up=1, begin=500, most=500))


@pytest.fixture(scope="module")
def sequence(tmp_path_factory):
    """A small clip, with a truth folder next to it."""
    place = tmp_path_factory.mktemp("clip")
    folder = place / "sequences" / "hinge-s0"
    (place / "truth" / "hinge-s0").mkdir(parents=True)
    (place / "truth" / "hinge-s0" / "truth.json").write_text("{}")
    write_sequence(folder, make_clip("hinge", 10, (120, 90), spin=0.2, queries=((3, 8, np.eye(4)),)).recording, 2e-5)
    return folder


@pytest.fixture(scope="module")
def finished(sequence, tmp_path_factory):
    """The result of one uninterrupted run, with its stages cached."""
    out = tmp_path_factory.mktemp("whole") / "out"
    assert isinstance(reconstruct_folder(sequence, out, QUIET, keep_work=True), Reconstruction)
    return out


@pytest.fixture(scope="module")
def whole(finished):
    """What one uninterrupted run writes."""
    return contents(finished)


def contents(out):
    """Every file's bytes by name; what a run took is left out."""
    found = {str(path.relative_to(out)): path.read_bytes() for path in out.rglob("*") if path.is_file()}
    prediction = json.loads(found["prediction.json"])
    assert set(prediction.pop("seconds")) == {stage.name for stage in STAGES}
    diagnostics = json.loads(found["diagnostics.json"])
    assert diagnostics.pop("peak_bytes") > 0
    return {**found, "prediction.json": prediction, "diagnostics.json": diagnostics}


# ---- the folder ----------------------------------------------------------------------------------------------------

CODE = ("", ".py", ".pyc", ".nbi", ".nbc", ".pth", ".toml")
AUDIT = """
import json, os, sys
opened = set()
def hook(event, arguments):
    if event in ("open", "os.listdir", "os.scandir") and isinstance(arguments[0], (str, bytes, os.PathLike)):
        opened.add(os.path.realpath(os.fsdecode(arguments[0])))
sys.addaudithook(hook)
from pathlib import Path
from reconstruct.pipeline import reconstruct_folder
from reconstruct.settings import read_settings
reconstruct_folder(Path(sys.argv[1]), Path(sys.argv[2]), read_settings(Path(sys.argv[3])))
print(json.dumps(sorted(opened)))
"""


def test_a_sequence_alone_is_all_it_opens(sequence, finished, tmp_path):
    alone = tmp_path / "elsewhere" / "x7f3"
    alone.parent.mkdir()
    shutil.copytree(sequence, alone)
    out = tmp_path / "answers" / "x7f3"
    done = subprocess.run(
        [sys.executable, "-c", AUDIT, alone, out, finished / "prediction.json"],
        cwd=ROOT,
        capture_output=True,
        text=True,
        check=True,
    )
    opened = [Path(p) for p in json.loads(done.stdout.splitlines()[-1])]
    assert any(p.is_relative_to(alone.resolve()) for p in opened), "the hook saw nothing"
    home_of_python = {Path(p).resolve() for p in (*sys.path, sys.prefix, sys.base_prefix) if p}
    libraries = [*home_of_python, Path("/proc"), Path("/sys"), Path("/dev"), Path("/etc"), Path("/usr"), Path("/lib")]
    mine = [tmp_path.resolve() / "elsewhere" / "x7f3", tmp_path.resolve() / "answers"]
    for path in opened:
        if path.is_relative_to(tmp_path.resolve()):
            assert any(path.is_relative_to(a) for a in mine), path
        else:
            code = path.is_relative_to(ROOT) and (
                path.suffix in CODE or {"freeart21.egg-info", "__pycache__"} & set(path.parts)
            )
            assert code or any(path.is_relative_to(a) for a in libraries) or str(path).startswith("/tmp"), path
        assert "truth" not in path.parts, path
    here, there = read_result(finished), read_result(out)
    assert np.array_equal(there.states, here.states) and np.array_equal(there.part_masks, here.part_masks)
    assert np.array_equal(there.Ts_camera_moving, here.Ts_camera_moving)


def test_folder_holds_renders_masks_and_settings(sequence, finished):
    recording, result = read_sequence(sequence), read_result(finished)
    data = json.loads((finished / "prediction.json").read_text())
    assert data["settings"]["joint"]["type_rule"] == "residual" and set(data["seconds"]) >= {"tracks", "renders"}
    assert (finished / "renders" / "00000.png").is_file()
    posed = result.articulation.posed(result.Ts_camera_reference[5], float(result.states[5]))
    picture, frame = render(recording.camera, list(posed)), recording.frame(5)
    shown = (picture < 255).any(2)
    assert (shown & frame.mask).sum() / (shown | frame.mask).sum() > 0.9
    both = shown & frame.mask
    assert np.median(np.abs(picture[both].astype(int) - frame.rgb[both])) < 25


FREE = ["free_adjustment", "free_adjustment"]  # one a part


class Calls:
    """Counts how often a stage is solved; stops in the stage `stop`."""

    def __init__(self, monkeypatch, stop=None):
        self.solved, self.stop = [], stop
        for name in ("find_seeds", "bridge_gaps", "choose_joint_type", "free_adjustment", "optimise", "fuse"):
            monkeypatch.setattr(pipeline, name, self._counted(name, getattr(pipeline, name)))

    def _counted(self, name, function):
        def counted(*arguments):
            if self.stop == name:
                raise KeyboardInterrupt
            self.solved.append(name)
            return function(*arguments)

        return counted


# ---- stages --------------------------------------------------------------------------------------------------------


def _coloured(video, known, settings, rng):
    """Stands for the stage `gaussians`: some that nobody could find again without the same random numbers."""
    return replace(known, appearance=some_gaussians(rng))


def some_gaussians(rng, n=50):
    numbers = {"means": 3, "quaternions": 4, "scales": 3, "colours": 3, "normals": 3, "light": 3}
    arrays = {name: rng.uniform(0.1, 1, (4 if name == "light" else n, width)) for name, width in numbers.items()}
    weights = np.clip(rng.normal(0.5, 0.6, n), 0, 1)
    return Gaussians(opacities=rng.uniform(0, 1, n), part_weights=weights, **arrays)


def _up_to_joint(finished, out):
    """Keeps for `out` what `finished` found before the stage `gaussians`."""
    cache.work_folder(out).mkdir()
    for name in ("segmentation", "joint"):
        shutil.copy(cache.work_folder(finished) / f"{name}.npz", cache.work_folder(out))


@pytest.fixture(scope="module")
def coloured(sequence, finished, tmp_path_factory):
    """The result of an uninterrupted run with `_coloured`, with its stages cached."""
    out = tmp_path_factory.mktemp("coloured") / "out"
    _up_to_joint(finished, out)
    with pytest.MonkeyPatch.context() as patch:
        patch.setitem(pipeline.SOLVERS, "gaussians", _coloured)
        reconstruct_folder(sequence, out, QUIET, keep_work=True)
    return out


def _run_until_killed(sequence, out, stage):
    """As `reconstruct_folder` with `_coloured`, but it hangs in a stage and then writes the file `in_STAGE`."""

    def hangs(*_):
        (out.parent / f"in_{stage}").touch()
        time.sleep(600)

    pipeline.SOLVERS.update({"gaussians": _coloured, stage: hangs})
    reconstruct_folder(sequence, out, QUIET)


def test_killed_after_the_gaussians_a_run_goes_on_to_the_same_ones(sequence, finished, coloured, tmp_path, monkeypatch):
    out = tmp_path / "out"
    _up_to_joint(finished, out)
    process = multiprocessing.get_context("spawn").Process(target=_run_until_killed, args=(sequence, out, "poses"))
    process.start()
    deadline = time.monotonic() + 60
    while not (tmp_path / "in_poses").exists() and time.monotonic() < deadline:
        time.sleep(0.01)
    os.kill(process.pid, signal.SIGKILL)
    process.join()
    assert process.exitcode == -signal.SIGKILL and not out.exists()
    assert cache.StageCache(sequence, out, QUIET).load_last()[0].stage == "gaussians"
    monkeypatch.setitem(pipeline.SOLVERS, "gaussians", _coloured)
    reconstruct_folder(sequence, out, QUIET, keep_work=True)
    assert contents(out) == contents(coloured) and "gaussians.ply" in contents(out)
    found, whole = (
        cache.StageCache(sequence, o, QUIET).load_last()[0].state.result.appearance for o in (out, coloured)
    )
    for f in fields(Gaussians):
        assert np.array_equal(getattr(found, f.name), getattr(whole, f.name)), f.name


def test_stopped_by_the_user_or_after_a_stage_a_run_goes_on_to_the_same_bytes(
    sequence, whole, tmp_path, monkeypatch, capsys
):
    monkeypatch.setattr(processes, "_hints", [])
    out = tmp_path / "ours" / "hinge-s0"
    work = cache.work_folder(out)
    with monkeypatch.context() as patch, pytest.raises(KeyboardInterrupt):
        Calls(patch, "bridge_gaps")
        command(sequence, out, settings=QUIET)
    assert str(work) in processes.current_hint() and "goes on" in processes.current_hint()
    assert [path.name for path in out.parent.iterdir()] == [work.name]
    calls = Calls(monkeypatch)
    assert command(sequence, out, until="joint", settings=QUIET) == 0
    assert calls.solved == ["bridge_gaps", *FREE, "choose_joint_type", "bridge_gaps"]
    assert str(work / "joint.npz") in capsys.readouterr().out and not out.exists()
    calls.solved.clear()
    assert reconstruct_until(sequence, out, "segmentation", QUIET) == work / "segmentation.npz" and not calls.solved
    assert command(sequence, out, keep_work=True, settings=QUIET) == 0
    assert calls.solved == ["optimise", *FREE, "fuse", "fuse"]
    assert {path.stem for path in work.iterdir()} == set(CACHED_STAGES)
    method = json.loads((out.parent / "method.json").read_text())
    assert VERSION in method["code"] and contents(out)["prediction.json"]["settings"]["solver"] == VERSION
    assert contents(out) == whole


# ---- the table of stages -------------------------------------------------------------------------------------------


class Watched(ReconstructSettings):
    """Settings that tell which of them were read."""

    read: ClassVar[set[str]] = set()

    def __getattribute__(self, name):
        Watched.read.add(name)
        return super().__getattribute__(name)


COARSE = replace(QUIET, surfaces=replace(QUIET.surfaces, voxel=2.0))


@pytest.fixture(scope="module")
def coarse(sequence, tmp_path_factory):
    """The result of one uninterrupted run with COARSE, and the settings that each stage read."""
    out, groups, found = tmp_path_factory.mktemp("coarse") / "out", QUIET.to_json(), {}

    def watched(stage, solver):
        def solve(*arguments):
            Watched.read.clear()
            known = solver(*arguments)
            found[stage] = Watched.read & set(groups)
            return known

        return solve

    with pytest.MonkeyPatch.context() as patch:
        for stage, solver in list(pipeline.SOLVERS.items()):
            patch.setitem(pipeline.SOLVERS, stage, watched(stage, solver))
        reconstruct_folder(sequence, out, Watched(**vars(COARSE)))
    return out, found


def test_no_stage_reads_settings_that_the_table_gives_to_later_ones(coarse):
    """A stage whose key lacks what it reads would be taken for that of other settings."""
    found = coarse[1]
    assert "growth" in found["segmentation"] and "gaps" in found["joint"]
    for stage in CACHED_STAGES:
        assert found[stage] <= set(settings_used_by(stage, QUIET.to_json())), stage


# ---- what makes a kept stage invalid -------------------------------------------------------------------------------


def test_changed_settings_are_solved_again_from_the_first_stage_that_uses_them(
    sequence, finished, coarse, tmp_path, monkeypatch
):
    out = tmp_path / "out"
    shutil.copytree(cache.work_folder(finished), cache.work_folder(out))
    calls = Calls(monkeypatch)
    reconstruct_folder(sequence, out, COARSE)
    assert [path.name for path in tmp_path.iterdir()] == ["out"], "what was kept goes when the result is there"
    assert calls.solved == ["optimise", *FREE, "fuse", "fuse"]  # the Gaussians begin with surfaces
    assert contents(out) == contents(coarse[0])


@pytest.mark.parametrize("harm", ["cut", "bit", "garbled", "text"])
def test_a_damaged_stage_is_one_line_and_solved_again(harm, sequence, finished, tmp_path, monkeypatch, capsys):
    out, whole = tmp_path / "out", contents(finished)
    shutil.copytree(cache.work_folder(finished), cache.work_folder(out))
    path = cache.work_folder(out) / "surfaces.npz"
    data = bytearray(path.read_bytes())
    bit, garbled = bytearray(data), bytearray(data)
    stream = data.index(b"state.result.states.npy") + 23  # and the header's extra field: 20 bytes
    bit[stream + 40] ^= 1
    garbled[stream : stream + 60] = b"\xff" * 60
    harmed = {"cut": data[:-100], "bit": bit, "garbled": garbled, "text": b"not an archive"}
    path.write_bytes(harmed[harm])
    calls = Calls(monkeypatch)
    reconstruct_folder(sequence, out, replace(QUIET, progress=True))
    lines = [line for line in capsys.readouterr().err.splitlines() if "surfaces.npz" in line]
    assert len(lines) == 1 and "not a readable stage" in lines[0]
    assert calls.solved == ["fuse", "fuse"]
    found = contents(out)
    assert found.pop("prediction.json")["states"] == whole["prediction.json"]["states"]
    assert found == {name: data for name, data in whole.items() if name != "prediction.json"}
