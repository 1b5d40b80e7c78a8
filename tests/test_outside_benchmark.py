"""Data of others: which clips there are, how a captured motion is cut; rows, reports and tables of all benchmarks."""

import importlib
import json
import sys

import numpy as np
import pytest
from refusal import assert_refused

from benchmarks import outside, results
from benchmarks.common import ROOT, run_rows, run_within, write_report

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
    places = {"partnet": tmp_path / "p", "mocap": tmp_path / "m", "urdfs": tmp_path / "u"}
    assert_refused("there is no clip 'teapot'", outside.main, **places, clips=("teapot",), work=tmp_path / "work")
    outside.main(**places, work=tmp_path / "work", out=tmp_path / "out.json")
    document = json.loads((tmp_path / "out.json").read_text())
    assert document["rows"] == [] and set(document["settings"]["left_out"]) == {"partnet", *outside.CAPTURED}
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


@pytest.mark.parametrize("path", sorted((ROOT / "benchmarks").glob("*.py")), ids=lambda path: path.stem)
def test_every_benchmark_is_imported_and_says_what_it_is(path):
    assert importlib.import_module(f"benchmarks.{path.stem}").__doc__


def test_rows_are_made_once_each_apart_and_a_failed_one_again(tmp_path):
    todo = {"good": ("key", json.loads, ('{"x": 1}',)), "bad": ("key", json.loads, ("no",))}
    found = run_rows(tmp_path, todo)
    assert found["good"] == {"x": 1} and found["bad"]["crash"].startswith("JSONDecodeError: ")
    todo = {"good": ("key", json.loads, ('{"x": 2}',)), "bad": ("key", json.loads, ("{}",))}
    assert run_rows(tmp_path, todo) == {"good": {"x": 1}, "bad": {}}
    assert run_rows(tmp_path, {"good": ("another key", *todo["good"][1:])})["good"] == {"x": 2}


def test_a_report_says_what_it_was_measured_with_and_a_table_is_filled_from_it(tmp_path):
    write_report(tmp_path / "report.json", {"frames": 3}, rows=[])
    report = json.loads((tmp_path / "report.json").read_text())
    assert {"commit", "date", "machine", "versions", "settings", "rows"} == set(report)
    text = "before\n<!-- table score -->\nold\n<!-- end -->\nafter\n"
    filled = results.fill(text)
    assert "old" not in filled and filled.startswith("before") and filled.endswith("after\n")
    assert results.fill(filled) == filled


def test_a_command_is_killed_when_its_time_is_over(tmp_path):
    ended = run_within(1.0, [sys.executable, "-c", "print('on')\nwhile True: pass"], tmp_path)
    assert ended.code is None and ended.seconds < 5
    ended = run_within(60.0, [sys.executable, "-c", "print('one'); print('two'); raise SystemExit(3)"], tmp_path)
    assert (ended.code, ended.last) == (3, "two")
