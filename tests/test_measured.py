"""A measured set is read unchanged; a bad one is a one-line error."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from refusal import assert_refused

from freeart21.errors import FreeArtError
from freeart21.files.measured import read_measured
from freeart21.files.measured_writer import write_measured
from freeart21.measured import Run, drop_duplicate_runs

TIMES = np.arange(60) * 0.01


def write(folder: Path, changes: dict | None = None, csv: str | None = None, **columns) -> Path:
    """A well-formed set of two runs with the given changes."""
    folder.mkdir(parents=True, exist_ok=True)
    table = {"t_s": TIMES, "q": 0.3 * np.cos(8 * TIMES), **columns}
    text = (
        ",".join(table)
        + "\n"
        + "\n".join(",".join(f"{v:.6f}" for v in row) for row in zip(*table.values(), strict=True))
    )
    (folder / "run_0.csv").write_text(text if csv is None else csv)
    other = text.replace("0.300000", "0.300001", 1) if changes is None or "runs" not in changes else text
    (folder / "run_1.csv").write_text(other)
    data = {
        "version": 1,
        "joint": "j",
        "joint_type": "revolute",
        "units": {"t_s": "s", "q": "rad"},
        "gravity": [0, 0, -9.81],
        "base": "fixed",
        "sampling": {"rate_hz": 100, "timestamps": "recorded"},
        "runs": [{"file": "run_0.csv", "held_out": False}, {"file": "run_1.csv", "held_out": True}],
        "asset_uncertainty": {"inertia_relative": 0.1, "gravity_relative": 0.05},
    }
    data.update(changes or {})
    (folder / "measured.json").write_text(json.dumps({k: v for k, v in data.items() if v is not ...}))
    return folder


def test_a_set_is_read_unchanged(tmp_path: Path):
    units = {"t_s": "s", "q": "rad", "effort": "N*m", "q_command": "rad"}
    actuator = {"type": "position", "stiffness": 5.0, "damping": 0.5}
    changes = {"units": units, "effort": "commanded", "actuator": actuator}
    measured = read_measured(write(tmp_path, changes, effort=np.sin(TIMES), q_command=np.cos(TIMES)))
    assert (measured.joint, measured.joint_type, measured.rate_hz) == ("j", "revolute", 100)
    assert (measured.timestamps, measured.effort_kind) == ("recorded", "commanded")
    assert (measured.inertia_relative, measured.gravity_relative) == (0.1, 0.05)
    assert (measured.actuator.stiffness, measured.actuator.damping) == (5.0, 0.5)
    np.testing.assert_array_equal(measured.gravity, [0, 0, -9.81])
    first, second = measured.runs
    assert (first.name, first.held_out, second.held_out) == ("run_0", False, True)
    np.testing.assert_allclose(first.q, 0.3 * np.cos(8 * TIMES), atol=1e-6)
    assert first.q_command is not None
    np.testing.assert_allclose(first.effort, np.sin(TIMES), atol=1e-6)


@pytest.mark.parametrize("how", ["held", "linear", "unknown"])
def test_effort_interpolation_round_trips(how: str, tmp_path: Path):
    units = {"t_s": "s", "q": "rad", "effort": "N*m"}
    changes = {"units": units, "effort": "commanded", "interpolation": how}
    measured = read_measured(write(tmp_path / "a", changes, effort=np.sin(TIMES)))
    assert measured.interpolation == how
    write_measured(tmp_path / "b", measured)
    assert read_measured(tmp_path / "b").interpolation == how
    plain = read_measured(write(tmp_path / "c", {**changes, "interpolation": ...}, effort=np.sin(TIMES)))
    assert plain.interpolation == "unknown"


def test_optional_fields_have_their_defaults(tmp_path: Path):
    plain = {"asset_uncertainty": ..., "runs": [{"file": "run_0.csv"}], "base": ...}
    measured = read_measured(write(tmp_path, plain))
    assert (measured.inertia_relative, measured.gravity_relative) == (0.0, 0.0)
    assert measured.actuator is None and measured.effort_kind is None
    assert measured.runs[0].held_out is None and measured.runs[0].effort is None


def test_a_missing_reading_is_nan(tmp_path: Path):
    rows = [f"{t:.3f},{'' if i == 7 else 0.1}" for i, t in enumerate(TIMES)]
    measured = read_measured(write(tmp_path, csv="t_s,q\n" + "\n".join(rows)))
    assert np.flatnonzero(np.isnan(measured.runs[0].q)).tolist() == [7]


def test_poses_are_in_the_reference_parts_frame(tmp_path: Path):
    from freeart21 import se3

    camera = se3.exp_se3([0.1, 0.2, 1.0, 0.3, -0.2, 0.5])
    motions = se3.exp_se3(np.outer(np.linspace(0, 0.5, 30), [0, 0, 0, 0, 0, 1.0]))
    folder = write(tmp_path, {"runs": [{"file": "run_p", "kind": "poses"}]})
    (folder / "run_p").mkdir()
    seen = np.ones((30, 2), bool)
    seen[4, 1] = False
    reference = np.broadcast_to(camera, motions.shape)
    np.savez(folder / "run_p/poses.npz", T_camera_reference=reference, T_camera_moving=camera @ motions, seen=seen)
    run = read_measured(folder).runs[0]
    assert np.isnan(run.q).all()
    np.testing.assert_allclose(run.poses, motions, atol=1e-9)
    np.testing.assert_array_equal(run.seen, np.arange(30) != 4)
    np.testing.assert_allclose(run.times_s, np.arange(30) / 100)


def _csv(**columns) -> str:
    table = {"t_s": TIMES, "q": 0.0 * TIMES, **columns}
    return ",".join(table) + "\n" + "\n".join(",".join(map(str, row)) for row in zip(*table.values(), strict=True))


BAD_FILES = {
    "\n".join(["t_s,q", "0,0", "0.01,0"]): "2 samples, expected 20 or more: the run is too short",
    _csv(t_s=np.where(np.arange(60) == 9, 0, TIMES)): "times must increase, but line 11 has 0 s after 0.08 s",
    _csv().replace("t_s,q", "t_s,angle"): "has no column 'q'; its columns: t_s, angle",
    _csv().replace("t_s,q", "time,q"): "has no column 't_s'; its columns: time, q",
    _csv(q=np.full(60, np.nan)): "has 0 readings of q that are numbers",
    _csv().replace("0.02,", "0.02,x"): "line 4 is '0.02,x0.0', expected 2 numbers",
    _csv(speed=TIMES): "has columns t_s, q, speed; expected each once of t_s, q, effort, q_command",
    _csv(effort=TIMES): "has 'effort', whose unit is not in 'units'",
    "": "has no column 't_s'; its columns: none",
    _csv(t_s=np.append(np.nan, TIMES[1:])): "the time is not a number in line 2",
    _csv().replace("0.02,", "0.02,\0", 1): "is not text: it has a NUL byte in line 4",
    _csv().replace("0.02,0.0", '"0.02,0.0'): "expected 2 numbers",
    "t_s,q\n0," + "9" * 200_000 + "\n": "line 2 is not CSV: field larger than field limit",
    _csv(q=np.where(np.arange(60) == 5, 1e30, 0)): "q is 1e+30 in line 7, expected rad or m",
    _csv(t_s=1e3 * TIMES): "has 10 s from reading to reading, but 'rate_hz' is 100: expected some 0.01 s",
    _csv().replace("\n", "\n\n").replace("0.02,", "0.02,x"): "line 7 is '0.02,x0.0'",
}


@pytest.mark.parametrize("csv", BAD_FILES, ids=range(len(BAD_FILES)))
def test_a_bad_run_is_a_one_line_error(tmp_path: Path, csv: str):
    assert_refused(re.escape(BAD_FILES[csv]), read_measured, write(tmp_path, csv=csv))


BAD_HEADERS = [
    ({"version": 2}, "has version 2, expected 1"),
    ({"joint_type": "ball"}, "'joint_type' is 'ball', expected revolute or prismatic"),
    ({"joint": ...}, "'joint' is None, expected text"),
    ({"units": {"t_s": "s", "q": "grad"}}, "'q' of a revolute joint is in 'grad', expected 'rad' or 'deg'"),
    ({"units": {"t_s": "ms", "q": "deg"}}, "'t_s' of a revolute joint is in 'ms', expected 's'"),
    ({"joint_type": "prismatic", "units": {"t_s": "s", "q": "deg"}}, "in 'deg', expected 'm' or 'mm'"),
    ({"wrapped": "yes"}, "'wrapped' is 'yes', expected true or false"),
    ({"units": {"t_s": "s"}}, "has 'q', whose unit is not in 'units'"),
    ({"gravity": [0, -9.81]}, "'gravity' has shape (2,), expected (3,)"),
    ({"base": "shaky"}, "base is 'shaky', expected 'fixed', 'moving' or an object with its axis"),
    ({"base": "moving"}, "base is 'moving', but no run has a column of its motion"),
    ({"base": {"axis": [0, 0, 1]}}, "the base has an axis, but no run has a column 'base_angle'"),
    ({"base": {"axis": [0, 0, 2]}}, "the base's axis is 2 long, expected a unit vector"),
    ({"sampling": {"rate_hz": 0, "timestamps": "recorded"}}, "'rate_hz' is 0, expected a number above 0"),
    (
        {"sampling": {"rate_hz": 100, "timestamps": "guessed"}},
        "'timestamps' is 'guessed', expected recorded or nominal",
    ),
    ({"runs": []}, "has 0 runs, expected 1 to 1000"),
    ({"runs": [{"file": "run_9.csv"}]}, "run_9.csv is missing"),
    ({"runs": [{"file": "../run_0.csv"}]}, "leads out of the folder"),
    ({"runs": [{"file": "run_0.csv", "kind": "video"}]}, "has kind 'video', expected csv, poses or rgbd"),
    ({"runs": [{"file": "run_0.csv", "held_out": 1.5}]}, "has held_out 1.5, expected true or false"),
    ({"runs": [{"file": "run_0.csv"}] * 2}, "'runs' names a file twice"),
    ({"runs": [{"file": "run_0.csv"}, {"file": "./run_0.csv", "held_out": True}]}, "'runs' names a file twice"),
    ({"runs": [{"file": "run_0.csv"}, {"file": "run_0", "kind": "poses"}]}, "would both be called 'run_0'"),
    ({"runs": [{"file": "."}]}, "is a folder, expected a CSV file"),
    ({"sampling": {"rate_hz": 1e30, "timestamps": "recorded"}}, "'rate_hz' is 1e+30, expected at most 100000"),
    ({"gravity": [0, 0, -9810]}, "'gravity' is 9810 long, expected m/s^2"),
    ({"runs": [{"file": "run_0.csv", "held_out": True}]}, "all 1 runs are held out"),
    ({"actuator": {"type": "velocity"}}, "the actuator's type is 'velocity', expected 'position'"),
    ({"actuator": {"type": "position", "stiffness": -1, "damping": 0}}, "'stiffness' is -1, expected 0 or more"),
    ({"interpolation": "cubic"}, "'interpolation' is 'cubic', expected held or linear or unknown"),
    ({"effort": "guessed"}, "'effort' is 'guessed', expected commanded or external"),
    ({"asset_uncertainty": {"inertia_relative": 10}}, "'inertia_relative' is 10, expected 0 (exact) to below 1"),
]


@pytest.mark.parametrize("changes, message", BAD_HEADERS)
def test_a_bad_header_is_a_one_line_error(tmp_path: Path, changes: dict, message: str):
    assert_refused(re.escape(message), read_measured, write(tmp_path, changes))


def test_a_copied_run_is_dropped_and_reported(tmp_path: Path):
    """A fitted run cannot confirm: of a fitted run and its copy the held-out one is dropped."""
    for k, flags in enumerate(((None, True), (True, False), (False, False))):
        runs = [{"file": f"run_{i}.csv", "held_out": out} for i, out in enumerate(flags)]
        measured = read_measured(write(tmp_path / str(k), {"runs": runs}))
        remaining, gone = (1, 0) if flags[0] else (0, 1)
        assert [run.name for run in measured.runs] == [f"run_{remaining}"]
        assert measured.notes == (
            f"run 'run_{gone}' is run 'run_{remaining}' again, reading by reading: it was left out",
        )
    assert not read_measured(write(tmp_path / "other")).notes


def test_rests_under_different_pushes_are_not_copies():
    still = np.zeros(60)
    runs = tuple(Run(f"r{k}", TIMES + k, still, k * np.ones(60)) for k in range(3))
    assert drop_duplicate_runs(runs) == (runs, ())
    assert len(drop_duplicate_runs((*runs, replace(runs[1], name="again")))[0]) == 3


def test_drive_cells_may_be_empty_except_the_first(tmp_path: Path):
    changes = {"units": {"t_s": "s", "q": "rad", "effort": "N*m"}, "effort": "commanded"}
    rows = [f"{t:.3f},{0.1 * i},{'' if i % 3 else i}" for i, t in enumerate(TIMES)]
    folder = write(tmp_path / "a", changes, csv="t_s,q,effort\n" + "\n".join(rows))
    effort = read_measured(folder).runs[0].effort
    assert np.flatnonzero(np.isfinite(effort)).tolist() == list(range(0, 60, 3))
    rows[0] = "0.0,0.0,"
    with pytest.raises(FreeArtError, match="'effort' that is not a number, expected one in the first row"):
        read_measured(write(tmp_path / "b", changes, csv="t_s,q,effort\n" + "\n".join(rows)))


def test_efforts_and_commands_need_to_be_explained(tmp_path: Path):
    units = {"t_s": "s", "q": "rad", "effort": "N*m", "q_command": "rad"}
    with pytest.raises(FreeArtError, match="has efforts, but 'effort' does not say"):
        read_measured(write(tmp_path, {"units": units}, effort=TIMES))
    with pytest.raises(FreeArtError, match="has 'q_command', but there is no 'actuator'"):
        read_measured(write(tmp_path, {"units": units}, q_command=TIMES))


def test_a_missing_set_is_a_one_line_error(tmp_path: Path):
    assert_refused("is not a measured set: expected a folder with measured.json", read_measured, tmp_path / "nothing")


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"seen": np.zeros((30, 2), bool)}, "has 0 poses in which both parts were seen, expected 20 or more"),
        ({"times_s": np.zeros(30)}, "times must increase, but pose 1 has 0 s after 0 s"),
        ({"times_s": np.arange(29.0)}, "expected one time and seen flag a pose"),
        ({"T_camera_moving": np.full((30, 4, 4), np.nan)}, "has 0 poses in which both parts were seen"),
        ({"T_camera_moving": np.zeros((30, 4, 4))}, "T_camera_moving"),
        ({"T_camera_moving": np.zeros((30, 3, 4))}, "expected (n, 4, 4) twice"),
        ({"T_camera_moving": np.full((30, 4, 4), "x")}, "is of type <U1, expected numbers"),
        ({"T_camera_moving": ...}, "has no T_camera_moving; it has"),
    ],
)
def test_bad_poses_are_a_one_line_error(tmp_path: Path, changes: dict, message: str):
    folder = write(tmp_path, {"runs": [{"file": "run_p", "kind": "poses"}]})
    (folder / "run_p").mkdir()
    eye = np.tile(np.eye(4), (30, 1, 1))
    data = {"T_camera_reference": eye, "T_camera_moving": eye, **changes}
    np.savez(folder / "run_p/poses.npz", **{k: v for k, v in data.items() if v is not ...})
    assert_refused(re.escape(message), read_measured, folder)


def test_oversized_input_is_refused(tmp_path: Path, monkeypatch):
    folder = write(tmp_path)
    monkeypatch.setattr("freeart21.files.measured.MAX_BYTES", 1000)
    assert_refused("bytes together, at most 1000 are read", read_measured, folder)


def test_a_prescribed_run_has_its_measured_effort(tmp_path: Path):
    units = {"t_s": "s", "q": "rad", "effort": "N*m"}
    runs = [{"file": "run_0.csv", "prescribed": True}, {"file": "run_1.csv", "prescribed": False, "held_out": True}]
    changes = {"units": units, "effort": "commanded", "runs": runs}
    folder = write(tmp_path / "a", changes, effort=TIMES)
    (folder / "run_1.csv").write_text((folder / "run_1.csv").read_text().replace("0.300000", "0.300001", 1))
    read = read_measured(folder)
    assert [run.prescribed for run in read.runs] == [True, False]
    write_measured(tmp_path / "b", read)
    assert [run.prescribed for run in read_measured(tmp_path / "b").runs] == [True, False]
    with pytest.raises(FreeArtError, match="run 'run_0' is prescribed, but has no 'effort'"):
        read_measured(write(tmp_path / "c", {"runs": runs}))
    with pytest.raises(FreeArtError, match="run 'run_0.csv' has prescribed 'yes', expected true or false"):
        read_measured(write(tmp_path / "d", {**changes, "runs": [{**runs[0], "prescribed": "yes"}, runs[1]]}))
