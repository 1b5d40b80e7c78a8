"""A stopped reconstruction goes on to the same bytes; the reconstruction's benchmark counts as it says."""

import json
import multiprocessing
import os
import shutil
import signal
import sys
import time
from dataclasses import fields, is_dataclass, replace
from types import SimpleNamespace
from typing import ClassVar, Literal, get_args, get_type_hints

import numpy as np
import pytest
from reconstruct_clip import make_clip

from benchmarks import solve as bench
from freeart21 import stopping
from freeart21.articulation import Articulation
from freeart21.errors import FreeArtError
from freeart21.files.sequence import read_sequence, write_sequence
from freeart21.gaussians import Gaussians
from freeart21.mesh import Mesh
from freeart21.reconstruction import Failure, Reconstruction
from leaderboard.rows import Row
from reconstruct import VERSION, cache, pipeline
from reconstruct.commands import STOP_AFTER
from reconstruct.commands import reconstruct as command
from reconstruct.gaussians import gsplat_backend
from reconstruct.gaussians.model import FAINT_COPY
from reconstruct.pipeline import reconstruct_folder, reconstruct_until
from reconstruct.scene import prepare_scene
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


def test_a_result_that_cannot_be_written_costs_no_stage(sequence, finished, whole, tmp_path, monkeypatch):
    out = tmp_path / "out"
    shutil.copytree(cache.work_folder(finished), cache.work_folder(out))

    def full(*_):
        raise OSError(28, "No space left on device")

    with monkeypatch.context() as patch, pytest.raises(OSError, match="No space"):
        patch.setattr(pipeline, "write_result", full)
        reconstruct_folder(sequence, out, QUIET)
    monkeypatch.setattr(pipeline, "prepare_scene", full)  # the video is not even looked at
    reconstruct_folder(sequence, out, QUIET)
    assert contents(out) == whole


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
        patch.setitem(pipeline._SOLVERS, "gaussians", _coloured)
        reconstruct_folder(sequence, out, QUIET, keep_work=True)
    return out


def _run_until_killed(sequence, out, stage):
    """As `reconstruct_folder` with `_coloured`, but it hangs in a stage and then writes the file `in_STAGE`."""

    def hangs(*_):
        (out.parent / f"in_{stage}").touch()
        time.sleep(600)

    pipeline._SOLVERS.update({"gaussians": _coloured, stage: hangs})
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
    monkeypatch.setitem(pipeline._SOLVERS, "gaussians", _coloured)
    reconstruct_folder(sequence, out, QUIET, keep_work=True)
    assert contents(out) == contents(coloured) and "gaussians.ply" in contents(out)
    found, whole = (
        cache.StageCache(sequence, o, QUIET).load_last()[0].state.result.appearance for o in (out, coloured)
    )
    for f in fields(Gaussians):
        assert np.array_equal(getattr(found, f.name), getattr(whole, f.name)), f.name


def test_the_answers_gaussians_stand_where_those_of_the_stage_did(sequence, coloured):
    work, recording = cache.StageCache(sequence, coloured, QUIET), read_sequence(sequence)
    known = cache._read_stage(work.path("poses"), "poses", work._keys["poses"]).state
    poses = replace(known.estimate.poses, states=known.estimate.poses.states + 0.3)  # a state zero far from frame 0's
    nothing = Mesh(np.zeros((0, 3)), np.zeros((0, 3)))
    estimate, articulation = replace(known.estimate, poses=poses), Articulation(poses.joint, nothing, nothing)
    scene = prepare_scene(recording, QUIET.scene)
    answer = pipeline._to_canonical_frame(articulation, replace(known, estimate=estimate), scene, recording)
    for q, state in zip(poses.states, answer.states, strict=True):
        expected = render_picture(known.appearance, poses.joint.transform(q), known.free_poses[0].Ts[0])
        found = render_picture(answer.appearance, answer.articulation.joint.transform(state), np.eye(4))
        assert expected.shape == found.shape and np.allclose(found, expected, atol=1e-5)


def render_picture(gaussians, motion, T):
    """(M, 17) what a rasteriser draws under a motion of the joint, then `T`; what is too faint for it left out."""
    found = []
    for weights, moved in (
        (gaussians.part_weights, gaussians.moved(T)),
        (1 - gaussians.part_weights, gaussians.moved(T @ motion)),
    ):
        opacities = gaussians.opacities * weights
        columns = [opacities[:, None], moved.means, moved.quaternions, moved.scales, moved.colours, moved.normals]
        found.append(np.concatenate(columns, 1)[opacities > FAINT_COPY])
    return np.concatenate(found)


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


def test_a_hopeless_video_fails_with_until_too(tmp_path):
    write_sequence(tmp_path / "rigid", make_clip("rigid", 10, (120, 90), spin=0.2).recording, 2e-5)
    with pytest.raises(FreeArtError, match="no stage 'tracks' to stop after; expected one of segmentation, joint, "):
        reconstruct_until(tmp_path / "rigid", tmp_path / "out", "tracks", QUIET)
    found = reconstruct_until(tmp_path / "rigid", tmp_path / "out", "poses", QUIET)
    assert isinstance(found, Failure) and found.stage == "segmentation"
    assert not (tmp_path / "out").exists() and not cache.work_folder(tmp_path / "out").exists()


def test_interrupted_the_command_says_what_is_kept(sequence, tmp_path, monkeypatch):
    monkeypatch.setattr(stopping, "_hints", [])
    Calls(monkeypatch, "bridge_gaps")
    with pytest.raises(KeyboardInterrupt):
        command(sequence, tmp_path / "ours" / "x", settings=QUIET)
    assert (
        str(cache.work_folder(tmp_path / "ours" / "x")) in stopping.current_hint()
        and "goes on" in stopping.current_hint()
    )
    assert [path.name for path in (tmp_path / "ours").iterdir()] == [".x.work"]


# ---- the table of stages -------------------------------------------------------------------------------------------


def test_command_line_pipeline_and_cache_know_the_stages_of_the_table(tmp_path):
    assert len({stage.name for stage in STAGES}) == len(STAGES)
    assert set(pipeline._SOLVERS) == set(CACHED_STAGES)
    until = get_type_hints(command)["until"]
    assert get_args(until) == (Literal[CACHED_STAGES], type(None))
    assert all(f"{stage.name}: {stage.description}." in STOP_AFTER for stage in STAGES if stage.cached)


def test_every_group_of_settings_counts_from_one_stage_on():
    groups = QUIET.to_json()
    named = [group for stage in STAGES for group in stage.first_used_settings]
    assert len(set(named)) == len(named) and set(named) <= set(groups)
    assert set(settings_used_by(CACHED_STAGES[-1], groups)) == set(groups) - {"renders"}, (
        "the last kept stage depends on all but one"
    )
    assert "a new group" in settings_used_by(CACHED_STAGES[0], {"a new group": {}}), (
        "and on nothing that nobody thought of too late"
    )


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

    for stage, solver in list(pipeline._SOLVERS.items()):
        monkeypatch.setitem(pipeline._SOLVERS, stage, watched(stage, solver))
    reconstruct_folder(sequence, tmp_path / "out", Watched(progress=False, gaussians=QUIET.gaussians))
    assert {"growth", "pieces"} <= found["segmentation"] and "gaps" in found["joint"]
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


def test_keys_change_with_what_a_stage_depends_on_and_nothing_else(sequence, tmp_path, monkeypatch):
    def changed(settings=QUIET, folder=sequence):
        now = cache.stage_keys(folder, settings)
        return [stage for stage in CACHED_STAGES if now[stage] != before[stage]]

    geometry = replace(QUIET, gaussians=replace(QUIET.gaussians, refine=False))
    on_the_processor = replace(QUIET, gaussians=replace(QUIET.gaussians, backend="numba"))
    before = cache.stage_keys(sequence, QUIET)
    assert len(set(before.values())) == len(before)
    assert changed(replace(QUIET, progress=True)) == []
    from_joint = ["joint", "gaussians", "poses", "surfaces"]
    assert changed(replace(QUIET, gaps=replace(QUIET.gaps, shortest_gap=3))) == from_joint
    assert changed(replace(QUIET, exchanges=replace(QUIET.exchanges, most=3))) == from_joint
    assert changed(geometry) == ["gaussians", "poses", "surfaces"]
    assert changed(replace(QUIET, surfaces=replace(QUIET.surfaces, voxel=2.0))) == ["gaussians", "poses", "surfaces"]
    with monkeypatch.context() as patch:
        patch.setattr(cache, "_describe_renderer", lambda: ["1.5.3", "2.9.0", "Some GPU"])
        assert changed() == ["gaussians", "poses", "surfaces"]
        on_a_gpu = [cache.stage_keys(sequence, s) for s in (geometry, on_the_processor)]
    assert on_a_gpu == [cache.stage_keys(sequence, s) for s in (geometry, on_the_processor)]
    assert changed(replace(QUIET, renders="video")) == []
    others = {"progress", "exchanges", "gaps", "gaussians", "surfaces", "renders", "given_poses"}
    for name in set(QUIET.to_json()) - others:
        group = getattr(QUIET, name)
        other = replace(group, **{fields(group)[0].name: 12345}) if is_dataclass(group) else 12345
        assert changed(replace(QUIET, **{name: other})) == list(CACHED_STAGES), name
    write_sequence(tmp_path / "a", make_clip("hinge", 10, (120, 90), spin=0.2).recording, 2e-5)
    assert changed(folder=tmp_path / "a") == [], "held-out views and the folder's name do not count"
    depth = tmp_path / "a" / "depth" / "00004.png"
    data = bytearray(depth.read_bytes())
    data[-20] ^= 1
    depth.write_bytes(data)
    assert changed(folder=tmp_path / "a") == list(CACHED_STAGES)
    monkeypatch.setattr(cache, "VERSION", "0")
    assert changed() == list(CACHED_STAGES)


@pytest.mark.parametrize("lack", [None, "torch is not installed"])
def test_where_gsplat_draws_keys_name_it_and_the_gpu(lack, monkeypatch):
    cuda = SimpleNamespace(get_device_name=lambda: "Some GPU")
    monkeypatch.setitem(sys.modules, "torch", SimpleNamespace(__version__="2.9.0", cuda=cuda))
    monkeypatch.setattr(gsplat_backend, "missing_requirement", lambda: lack)
    monkeypatch.setattr(cache.metadata, "version", {"gsplat": "1.5.3"}.__getitem__)
    assert cache._describe_renderer.__wrapped__() == (["1.5.3", "2.9.0", "Some GPU"] if lack is None else [])


@pytest.mark.parametrize("harm", ["cut", "bit", "garbled", "text"])
def test_a_damaged_stage_is_one_line_and_solved_again(harm, sequence, finished, tmp_path, monkeypatch, capsys):
    out, whole = tmp_path / "out", contents(finished)
    shutil.copytree(cache.work_folder(finished), cache.work_folder(out))
    path = cache.work_folder(out) / "surfaces.npz"
    data = bytearray(path.read_bytes())
    bit, garbled = bytearray(data), bytearray(data)
    bit[len(data) // 2] ^= 1
    stream = data.index(b"answer_states.npy") + 17  # and the header's extra field: 20 bytes
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


# ---- the benchmark -------------------------------------------------------------------------------------------------


def outcome(name, kind, seconds, peak, status="ok", **values):
    """A hand-made outcome."""
    own = {"joint_type": 1.0, "axis": 0.0, "position": 0.0, "state": 0.0, "miou": 1.0, "chamfer_w": 0.0}
    every = dict.fromkeys((m.id for m in bench.protocol_named(bench.PROTOCOL).metrics), 0.0)
    every |= {"psnr": None, "ssim": None, "chamfer_m": 0.0, **own, **values}
    if kind == "prismatic":
        every["position"] = None
    row = Row(name, kind, status, "", "asset", False, 0.5, every, {}, ("a note",))
    return bench.Outcome("stapler", "wave", row, {"tracks": 1.0, "joint": seconds - 1.0}, peak, "abc", {})


def test_summary_counts_means_and_failures():
    rows = [
        outcome("a", "revolute", 100, 1.5, axis=0.5, position=0.2, state=1.0, miou=0.9, chamfer_w=0.4, chamfer_m=1.0),
        outcome("b", "revolute", 200, 2.5, axis=11.5, position=0.4, state=3.0, miou=0.8, chamfer_w=0.6, chamfer_m=3.0),
        outcome("c", "prismatic", 300, 2.0, axis=3.0, state=0.25, miou=0.5, chamfer_w=0.2, chamfer_m=2.0),
        replace(outcome("d", "prismatic", 1, None, "failed", joint_type=0.0, axis=90.0, state=7.75), seconds={}),
    ]
    found = bench.summary(rows)
    assert found == {
        "n": 4,
        "type_right": 3,
        "failures": 3,
        "axis_deg_mean": pytest.approx(26.25),
        "axis_deg_worst": 90.0,
        "position_pct_mean": pytest.approx(0.3),
        "state_deg_mean": pytest.approx(2.0),
        "state_pct_mean": pytest.approx(4.0),
        "miou_mean": pytest.approx(0.8),
        "chamfer_w_pct_mean": pytest.approx(0.3),
        "chamfer_m_pct_mean": pytest.approx(1.5),
        "psnr_db_mean": None,
        "psnr_db_worst": None,
        "seconds_mean": pytest.approx(200.0),
        "peak_gb": 2.5,
    }
    groups = bench.by_type(rows)
    assert groups["revolute"]["axis"]["std"] == pytest.approx(11 / np.sqrt(2)), "n - 1 below the line"
    assert groups["prismatic"]["n"] == 2 and "position" not in groups["prismatic"]
    assert [o.row.sequence for o in bench.worst_first(rows)] == ["d", "b", "c", "a"]
    reach = next(goal.reach for goal in bench.GOALS if (goal.metric, goal.group) == ("state", "revolute"))
    assert bench.badness(rows[0].row) == (pytest.approx(1.0 / reach), "state")


@pytest.mark.parametrize(
    "values, fails",
    [
        ({"axis": 10.0, "miou": 0.6}, False),
        ({"axis": 10.01}, True),
        ({"miou": 0.59}, True),
        ({"joint_type": 0.0}, True),
        ({"status": "missing"}, True),
    ],
)
def test_what_counts_as_a_failure(values, fails):
    assert bench.has_failed(outcome("a", "revolute", 2, 1.0, **values).row) is fails
