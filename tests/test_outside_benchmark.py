"""Data of others: which clips there are, how a captured motion is cut, and that variants share one geometry."""

import json
from dataclasses import replace

import numpy as np
import trimesh
from refusal import assert_refused
from test_track import URDF as CASE

from benchmarks import outside, outside_assets, solve
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
    assert_refused("there is no clip 'teapot'", outside.main, **places, clips=("teapot",), work=tmp_path / "work")
    outside.main(**places, work=tmp_path / "work", out=tmp_path / "out.json")
    document = json.loads((tmp_path / "out.json").read_text())
    assert document["rows"] == [] and set(document["settings"]["left_out"]) == {"partnet", "videos", *outside.CAPTURED}
    assert str(tmp_path) not in (tmp_path / "out.json").read_text(), "no places of this machine"


def test_assets_of_what_is_absent_are_left_out_too(tmp_path):
    places = {"partnet": tmp_path / "p", "mocap": tmp_path / "m", "urdfs": tmp_path / "u"}
    assert_refused(
        "there is no clip 'teapot'", outside_assets.main, **places, clips=("teapot",), work=tmp_path / "work"
    )
    outside_assets.main(**places, work=tmp_path / "work", out=tmp_path / "out.json")
    text = (tmp_path / "out.json").read_text()
    assert json.loads(text)["rows"] == [] and str(tmp_path) not in text
    assert set(json.loads(text)["settings"]["left_out"]) == {"partnet", *outside.CAPTURED}


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


def test_variants_of_a_recording_are_jobs_one_after_the_other(tmp_path, monkeypatch):
    """Each is run again when its settings or the data change; what is solved is known to the next run."""
    own = ReconstructSettings(progress=False)
    variants = {"ours": own, "beside": replace(own, seed=1)}
    case = solve.Case("stapler", "wave", tmp_path / "sequences" / "a", tmp_path / "truth" / "a", ["d4"])
    first, second = solve.solving_jobs(case, variants)
    assert second.needs == (first.name,) == ("ours/a",) and first.arguments["geometry"] == "{folder}/geometry/a"
    (alone,) = solve.solving_jobs(case, {"ours": own})
    assert alone.arguments["geometry"] is None and alone.key == first.key != second.key
    assert solve.solving_jobs(replace(case, recording=["d5"]), variants)[0].key != first.key

    values = dict.fromkeys((m.id for m in solve.protocol_named(solve.PROTOCOL).metrics), 0.0)
    row = solve.asdict(solve.Row("a", "revolute", "ok", "", "asset", False, 0.5, values, {}))
    answer = {"row": row, "seconds": {"joint": 1.0}, "peak_gb": 1.0, "commit": "abc", "machine": {}}
    monkeypatch.setattr(solve, "run_calls", lambda *given: {"ours/a": answer})
    found = solve.solve_cases([case], variants, tmp_path)
    assert list(found) == [("ours", "a")] and found["ours", "a"].row == solve.Row.from_json(row)


def test_calls_are_run_once_and_a_failed_one_is_reported(tmp_path):
    call = "reconstruct.cache:work_folder"
    todo = [solve.jobs.Job("good/a", call="json:loads", arguments={"s": '{"x": 1}'})]
    todo.append(solve.jobs.Job("bad/a", call=call, arguments={"nothing": 1}))
    own = {"ours": ReconstructSettings()}
    assert solve.run_calls(tmp_path, todo, own, known_only=True) == {}
    found = solve.run_calls(tmp_path, todo, own)
    assert found["good/a"] == {"x": 1} and "TypeError" in found["bad/a"]["crash"]
    assert solve.run_calls(tmp_path, todo, own, known_only=True) == {"good/a": {"x": 1}}
