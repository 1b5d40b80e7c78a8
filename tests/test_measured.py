"""A measured set is read unchanged; a bad one is a one-line error."""

from __future__ import annotations

import json
import re
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from mutations import MUTATED, mutated_arrays, mutated_json, mutated_table, reads_or_refuses
from refusal import assert_refused

from freeart21.errors import FreeArtError
from freeart21.files.measured import read_measured, write_measured

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
    _csv().replace("0.02,", "0.02,x"): "line 4 is '0.02,x0.0', expected 2 numbers",
    _csv(t_s=1e3 * TIMES): "has 10 s from reading to reading, but 'rate_hz' is 100: expected some 0.01 s",
}


@pytest.mark.parametrize("csv", BAD_FILES, ids=range(len(BAD_FILES)))
def test_a_bad_run_is_a_one_line_error(tmp_path: Path, csv: str):
    assert_refused(re.escape(BAD_FILES[csv]), read_measured, write(tmp_path, csv=csv))


BAD_HEADERS = [
    ({"units": {"t_s": "s", "q": "grad"}}, "'q' of a revolute joint is in 'grad', expected 'rad' or 'deg'"),
    ({"base": {"axis": [0, 0, 1]}}, "the base has an axis, but no run has a column 'base_angle'"),
    ({"runs": [{"file": "../run_0.csv"}]}, "leads out of the folder"),
    ({"runs": [{"file": "run_0.csv"}, {"file": "run_0", "kind": "poses"}]}, "two runs are called 'run_0'"),
    ({"gravity": [0, 0, -9810]}, "'gravity' is 9810 long, expected m/s^2"),
    ({"runs": [{"file": "run_0.csv", "held_out": True}]}, "all 1 runs are held out"),
]


@pytest.mark.parametrize("changes, message", BAD_HEADERS)
def test_a_bad_header_is_a_one_line_error(tmp_path: Path, changes: dict, message: str):
    assert_refused(re.escape(message), read_measured, write(tmp_path, changes))


DRIVEN = {
    "units": {"t_s": "s", "q": "rad", "effort": "N*m", "q_command": "rad"},
    "effort": "commanded",
    "interpolation": "held",
    "actuator": {"type": "position", "stiffness": 5.0, "damping": 0.5, "max_effort": 2.0},
}


@MUTATED
@given(data=st.data())
def test_a_broken_set_reads_or_is_one_line(tmp_path: Path, data):
    folder = write(tmp_path, DRIVEN, effort=np.sin(TIMES), q_command=np.cos(TIMES))
    header, run = folder / "measured.json", folder / "run_0.csv"
    if data.draw(st.booleans()):
        header.write_text(json.dumps(data.draw(mutated_json(json.loads(header.read_text())))))
    else:
        run.write_text(data.draw(mutated_table(run.read_text())))
    reads_or_refuses(read_measured, folder)


@MUTATED
@given(data=st.data())
def test_broken_poses_read_or_are_one_line(tmp_path: Path, data):
    folder = write(tmp_path, {"runs": [{"file": "run_p", "kind": "poses"}]})
    (folder / "run_p").mkdir(exist_ok=True)
    eye = np.tile(np.eye(4), (30, 1, 1))
    arrays = {"T_camera_reference": eye, "T_camera_moving": eye, "seen": np.ones((30, 2), bool), "times_s": TIMES[:30]}
    np.savez(folder / "run_p/poses.npz", **data.draw(mutated_arrays(arrays)))
    reads_or_refuses(read_measured, folder)


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


def test_drive_cells_may_be_empty_except_the_first(tmp_path: Path):
    changes = {"units": {"t_s": "s", "q": "rad", "effort": "N*m"}, "effort": "commanded"}
    rows = [f"{t:.3f},{0.1 * i},{'' if i % 3 else i}" for i, t in enumerate(TIMES)]
    folder = write(tmp_path / "a", changes, csv="t_s,q,effort\n" + "\n".join(rows))
    effort = read_measured(folder).runs[0].effort
    assert np.flatnonzero(np.isfinite(effort)).tolist() == list(range(0, 60, 3))
    rows[0] = "0.0,0.0,"
    with pytest.raises(FreeArtError, match="'effort' that is not a number, expected one in the first row"):
        read_measured(write(tmp_path / "b", changes, csv="t_s,q,effort\n" + "\n".join(rows)))


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
    with pytest.raises(FreeArtError, match="entry 0: 'prescribed' is 'yes', expected true or false"):
        read_measured(write(tmp_path / "d", {**changes, "runs": [{**runs[0], "prescribed": "yes"}, runs[1]]}))
