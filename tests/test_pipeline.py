"""A stopped reconstruction goes on to the same bytes; the reconstruction's benchmark counts as it says."""

import json
import multiprocessing
import os
import shutil
import signal
import time
from dataclasses import fields, replace
from typing import ClassVar

import numpy as np
import pytest
from reconstruct_clip import make_clip

from freeart21 import processes
from freeart21.files.sequence import write_sequence
from freeart21.gaussians import Gaussians
from freeart21.reconstruction import Reconstruction
from reconstruct import VERSION, cache, pipeline
from reconstruct.commands import reconstruct as command
from reconstruct.pipeline import reconstruct_folder, reconstruct_until
from reconstruct.settings import GaussianSettings, ReconstructSettings
from reconstruct.stages import CACHED_STAGES, STAGES, settings_used_by

QUIET = ReconstructSettings(progress=False, gaussians=GaussianSettings(rounds=3, warm_up=1, begin=3000, most=4000))


@pytest.fixture(scope="module")
def sequence(tmp_path_factory):
    folder = tmp_path_factory.mktemp("clip") / "hinge-s0"
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


@pytest.mark.parametrize(
    "stop, left",
    [
        ("bridge_gaps", ["bridge_gaps", *FREE, "choose_joint_type", "bridge_gaps", "optimise", *FREE, "fuse", "fuse"]),
        ("fuse", ["fuse", "fuse"]),
    ],
)
def test_a_stopped_run_goes_on_to_the_same_bytes(stop, left, sequence, whole, tmp_path, monkeypatch):
    out = tmp_path / "out"
    with monkeypatch.context() as patch, pytest.raises(KeyboardInterrupt):
        Calls(patch, stop)
        reconstruct_folder(sequence, out, QUIET)
    assert not out.exists() and cache.work_folder(out).is_dir()
    calls = Calls(monkeypatch)
    reconstruct_folder(sequence, out, QUIET)
    assert calls.solved == left
    assert contents(out) == whole
    assert [path.name for path in tmp_path.iterdir()] == ["out"], "what was kept goes when the result is there"


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


@pytest.mark.parametrize("stage, cached_stage", [("gaussians", "joint"), ("poses", "gaussians")])
def test_killed_in_the_gaussians_or_after_them_a_run_goes_on_to_the_same_ones(
    stage, cached_stage, sequence, finished, coloured, tmp_path, monkeypatch
):
    out = tmp_path / "out"
    _up_to_joint(finished, out)
    process = multiprocessing.get_context("spawn").Process(target=_run_until_killed, args=(sequence, out, stage))
    process.start()
    deadline = time.monotonic() + 60
    while not (tmp_path / f"in_{stage}").exists() and time.monotonic() < deadline:
        time.sleep(0.01)
    os.kill(process.pid, signal.SIGKILL)
    process.join()
    assert process.exitcode == -signal.SIGKILL and not out.exists()
    assert cache.StageCache(sequence, out, QUIET).load_last()[0].stage == cached_stage
    monkeypatch.setitem(pipeline.SOLVERS, "gaussians", _coloured)
    reconstruct_folder(sequence, out, QUIET, keep_work=True)
    assert contents(out) == contents(coloured) and "gaussians.ply" in contents(out)
    found, whole = (
        cache.StageCache(sequence, o, QUIET).load_last()[0].state.result.appearance for o in (out, coloured)
    )
    for f in fields(Gaussians):
        assert np.array_equal(getattr(found, f.name), getattr(whole, f.name)), f.name


def test_until_stops_keeps_and_goes_on(sequence, whole, tmp_path, monkeypatch, capsys):
    out = tmp_path / "ours" / "hinge-s0"
    assert command(sequence, out, until="joint", settings=QUIET) == 0
    work = cache.work_folder(out)
    assert str(work / "joint.npz") in capsys.readouterr().out and not out.exists()
    calls = Calls(monkeypatch)
    assert reconstruct_until(sequence, out, "segmentation", QUIET) == work / "segmentation.npz" and not calls.solved
    assert command(sequence, out, keep_work=True, settings=QUIET) == 0
    assert calls.solved == ["optimise", *FREE, "fuse", "fuse"]
    assert {path.stem for path in work.iterdir()} == set(CACHED_STAGES)
    method = json.loads((out.parent / "method.json").read_text())
    assert VERSION in method["code"] and contents(out)["prediction.json"]["settings"]["solver"] == VERSION
    assert contents(out) == whole


def test_interrupted_the_command_says_what_is_kept(sequence, tmp_path, monkeypatch):
    monkeypatch.setattr(processes, "_hints", [])
    Calls(monkeypatch, "bridge_gaps")
    with pytest.raises(KeyboardInterrupt):
        command(sequence, tmp_path / "ours" / "x", settings=QUIET)
    assert (
        str(cache.work_folder(tmp_path / "ours" / "x")) in processes.current_hint()
        and "goes on" in processes.current_hint()
    )
    assert [path.name for path in (tmp_path / "ours").iterdir()] == [".x.work"]


# ---- the table of stages -------------------------------------------------------------------------------------------


class Watched(ReconstructSettings):
    """Settings that tell which of them were read."""

    read: ClassVar[set[str]] = set()

    def __getattribute__(self, name):
        Watched.read.add(name)
        return super().__getattribute__(name)


def test_no_stage_reads_settings_that_the_table_gives_to_later_ones(sequence, tmp_path, monkeypatch):
    """A stage whose key lacks what it reads would be taken for that of other settings."""
    groups, found = QUIET.to_json(), {}

    def watched(stage, solver):
        def solve(*arguments):
            Watched.read.clear()
            known = solver(*arguments)
            found[stage] = Watched.read & set(groups)
            return known

        return solve

    for stage, solver in list(pipeline.SOLVERS.items()):
        monkeypatch.setitem(pipeline.SOLVERS, stage, watched(stage, solver))
    reconstruct_folder(sequence, tmp_path / "out", Watched(progress=False, gaussians=QUIET.gaussians))
    assert "growth" in found["segmentation"] and "gaps" in found["joint"]
    for stage in CACHED_STAGES:
        assert found[stage] <= set(settings_used_by(stage, groups)), stage


# ---- what makes a kept stage invalid -------------------------------------------------------------------------------


def test_changed_settings_are_solved_again_from_the_first_stage_that_uses_them(
    sequence, finished, tmp_path, monkeypatch
):
    out = tmp_path / "out"
    shutil.copytree(cache.work_folder(finished), cache.work_folder(out))
    calls = Calls(monkeypatch)
    coarse = replace(QUIET, surfaces=replace(QUIET.surfaces, voxel=2.0))
    reconstruct_folder(sequence, out, coarse, keep_work=True)
    assert calls.solved == ["optimise", *FREE, "fuse", "fuse"]  # the Gaussians begin with surfaces
    reconstruct_folder(sequence, tmp_path / "fresh", coarse)
    assert contents(out) == contents(tmp_path / "fresh")


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
