"""Data of others: which clips there are, how a captured motion is cut, and that variants share one geometry."""

from dataclasses import replace

import numpy as np
import pytest
import trimesh
from test_track import URDF as CASE

from benchmarks import outside, solve
from freeart21.errors import FreeArtError
from reconstruct.cache import work_folder
from reconstruct.settings import ReconstructSettings

URDF = """<robot name="box"><link name="base"/><link name="lid"/><link name="drawer"/>
<joint name="glue" type="fixed"><parent link="base"/><child link="drawer"/></joint>
<joint name="hinge" type="revolute"><parent link="base"/><child link="lid"/><axis xyz="0 0 1"/>
<limit lower="0" upper="1" effort="1" velocity="1"/></joint></robot>"""


def captured(path, q):
    """A take of joint angles `q`."""
    rows = np.zeros((len(q), 7), np.float32)
    rows[:, 0] = q
    path.parent.mkdir(parents=True, exist_ok=True)
    np.save(path, rows)
    return path


def test_what_is_absent_is_left_out_and_said_so(tmp_path):
    places = {"partnet": tmp_path / "p", "mocap": tmp_path / "m", "videos": tmp_path / "v", "urdfs": tmp_path / "u"}
    with pytest.raises(FreeArtError, match="there is no clip 'teapot'"):
        outside.main(**places, clips=("teapot",), work=tmp_path / "work")
    outside.main(**places, work=tmp_path / "work", out=tmp_path / "out.json")
    said = outside.checked.read_json(tmp_path / "out.json")
    assert said["rows"] == [] and set(said["settings"]["left_out"]) == {"partnet", "videos", *outside.CAPTURED}
    assert str(tmp_path) not in (tmp_path / "out.json").read_text(), "no places of this machine"


def test_clips_follow_from_the_data_alone(tmp_path):
    for number in ("1000", "200", "30"):
        (tmp_path / "partnet_mobility" / number).mkdir(parents=True)
        (tmp_path / "partnet_mobility" / number / "mobility.urdf").write_text(URDF)
    (tmp_path / "partnet_mobility" / "30" / "mobility.urdf").write_text("no urdf")
    for take in ("s2_laptop_use_01", "s1_laptop_use_02", "s1_laptop_grab_01"):
        captured(tmp_path / "mocap" / f"{take}.object.npy", np.linspace(0, 1, 30))
    places = tmp_path / "partnet_mobility", tmp_path / "mocap", tmp_path / "urdfs"
    clips, left_out = outside.clips_of(*places, 20)
    assert [(c.name, c.settings.sensor, c.settings.joint) for c in clips[:-1]] == [
        ("200", "tof", "hinge"),
        ("1000", "noise2", "hinge"),
    ], "in the order of their numbers, one that is broken counted"
    assert clips[-1].object == "folding_display", "stands in where the object is absent"
    assert "30" in left_out and (clips[-1].name, clips[-1].settings.track.name) == (
        "laptop",
        "s1_laptop_use_02.object.npy",
    )


def test_captured_motion_is_of_the_object_itself_where_it_can_be_recorded(tmp_path):
    folder = tmp_path / "case"
    folder.mkdir()
    trimesh.creation.box((100, 100, 20)).export(folder / "lid.stl")
    (folder / "case.urdf").write_text(CASE)
    assert outside.own_urdf(folder) is None, "a mesh of it is absent"
    trimesh.creation.box((0.1, 0.1, 0.04)).export(folder / "box.obj")
    assert outside.own_urdf(folder) == folder / "case.urdf"
    (folder / "a.urdf").write_text(CASE)
    assert outside.own_urdf(folder) == folder / "case.urdf", "that of its own name first"
    (folder / "case.urdf").write_text("no urdf")
    assert outside.own_urdf(folder) == folder / "a.urdf"
    assert outside.own_urdf(tmp_path / "none") is None


def test_variants_go_on_from_one_geometry(tmp_path, monkeypatch):
    """The shared stages are given to each variant, and what they took of memory, too, however often it is begun."""
    geometry, solved = tmp_path / "geometry" / "a", []

    def until(sequence, out, stage, settings):
        assert (out, stage) == (geometry, "joint")
        file = work_folder(out) / "joint.npz"
        if not file.is_file():
            solved.append(sequence)
            file.parent.mkdir(parents=True)
            file.write_bytes(b"joint")
        return file

    monkeypatch.setattr("reconstruct.pipeline.reconstruct_until", until)
    peaks = iter([3.5, 0.5, 0.25])
    monkeypatch.setattr(solve, "_peak_gb", lambda: next(peaks))
    took = [
        solve.from_geometry(tmp_path / "seq", tmp_path / name / "a", geometry, ReconstructSettings())
        for name in ("ours", "beside", "beside")
    ]
    assert took == [3.5, 3.5, 3.5] and len(solved) == 1
    for name in ("ours", "beside"):
        assert (work_folder(tmp_path / name / "a") / "joint.npz").read_bytes() == b"joint"
    assert solve.from_geometry(tmp_path / "seq", tmp_path / "alone", None, ReconstructSettings()) == 0.0
    assert not work_folder(tmp_path / "alone").exists()


def test_a_run_goes_on_object_by_object_variant_by_variant(tmp_path, monkeypatch):
    """What is solved is kept at once; the next run solves what lacks, and leaves no shared stages behind."""
    places = {name: solve.Place(tmp_path / "work" / name, tmp_path / "kept" / name) for name in ("ours", "beside")}
    own = ReconstructSettings(progress=False)
    variants = {"ours": own, "beside": replace(own, seed=1)}
    keys = {"ours": "k1", "beside": "k2"}
    job = solve.Job("stapler", "a", solve.RecordSettings())
    monkeypatch.setattr(solve, "_bytes_of", lambda folder, sequence: "d4")

    def in_a_process(task, workers):
        if task.variant == "beside" and not done:
            raise KeyboardInterrupt
        work_folder(task.geometry).mkdir(parents=True, exist_ok=True)
        done.append(task.variant)
        values = dict.fromkeys((m.id for m in solve.protocol_named(solve.PROTOCOL).metrics), 0.0)
        row = solve.Row("a", "revolute", "ok", "", "asset", False, 0.5, values, {})
        return solve.Outcome("stapler", "wave", row, {"joint": 1.0}, 1.0, "1", "abc", {}, 1, task.data), False

    done = []
    monkeypatch.setattr(solve, "_in_a_process", in_a_process)

    def run():
        known = solve.known_outcomes({"a": keys}, places, tmp_path)
        tasks = solve.tasks_of(job, keys, tmp_path, places, variants, tmp_path / "geometry", known)
        return known, tasks

    known, tasks = run()
    assert known == {} and [task.variant for task in tasks] == ["ours", "beside"]
    assert tasks[1].settings.seed == 1 and tasks[1].key == "k2" and tasks[0].geometry == tasks[1].geometry
    solve.solve_all([tasks[:1]], 1, 0)
    known, tasks = run()
    assert list(known) == [("ours", "a")] and [task.variant for task in tasks] == ["beside"]
    solve.solve_all([tasks], 1, 1)
    known, tasks = run()
    assert set(known) == {("ours", "a"), ("beside", "a")} and tasks == [] and done == ["ours", "beside"]
    assert not work_folder(tmp_path / "geometry" / "a").exists()
    assert solve.known_outcomes({"a": {"ours": "other"}}, places, tmp_path) == {}
