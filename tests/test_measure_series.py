"""Recordings in common formats become a measured set: guesses are right and reported, the rest is asked for."""

from __future__ import annotations

import json
import re
from pathlib import Path

import numpy as np
import pytest
from command_line import run_command
from gap_case import asset_of
from hypothesis import given, settings
from hypothesis import strategies as st
from mutations import MUTATED, mutated_bytes, mutated_json, mutated_table, reads_or_refuses
from refusal import assert_refused
from scipy.io import savemat

from freeart21.errors import FreeArtError
from freeart21.files.measured import read_measured
from freeart21.formats.measured_series import columns_from, measure_series
from freeart21.formats.series_settings import SeriesSettings
from freeart21.formats.time_series import read_series

T = 0.01 * np.arange(80)
Q = 0.8 * np.cos(7 * T) * np.exp(-0.3 * T)


@pytest.fixture
def asset(tmp_path: Path) -> Path:
    return asset_of(tmp_path / "asset")


def text(rows: np.ndarray, header: str = "", separator: str = ",", decimal: str = ".") -> str:
    lines = [separator.join(f"{v:.7f}".replace(".", decimal) for v in row) for row in rows]
    return "\n".join([*([header] if header else []), *lines]) + "\n"


def imported(folder: Path, asset: Path, content: str | bytes, name: str = "run.csv", **options):
    """The measured set of one file, and the printed lines."""
    path = folder / name
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    words = tuple(f"{role}={name}" for role, name in options.pop("columns", {}).items())
    notes = measure_series([path], folder / "out", SeriesSettings(asset=asset, columns=words, **options))
    return read_measured(folder / "out" / "measured"), "\n".join(notes)


TABLE = np.column_stack([T, Q])
FORMS = {
    "commas": text(TABLE, "time,angle"),
    "spaces after commas": text(TABLE, "timestamp, angle", ", "),
    "semicolons and decimal commas": text(TABLE, "t;pos", ";", ","),
    "tabs": text(TABLE, "time\tangle", "\t"),
    "white space": text(TABLE, "Time   Position", "    "),
    "a header in a comment": "# made by hand\n# time q\n" + text(TABLE, "", " "),
    "quotes and a unit": text(TABLE, '"Time [s]","Joint Angle (rad)"'),
    "a line of units": text(TABLE, "time,position\ns,rad"),
    "milliseconds": text(np.column_stack([1e3 * T, Q]), "time,q"),
    "milliseconds by name": text(np.column_stack([1e3 * T, Q]), "time_ms,q"),
    "microseconds by a bracket": text(np.column_stack([1e6 * T, Q]), "time [us],q"),
    "nanoseconds since 1970": "\n".join(["stamp,q", *(f"{10**18 + round(1e9 * t)},{q:.7f}" for t, q in TABLE)]),
    "degrees by the limits": text(np.column_stack([T, np.degrees(Q)]), "time,angle"),
    "degrees by name": text(np.column_stack([T, np.degrees(Q)]), "time,angle_deg"),
    "degrees by a bracket": text(np.column_stack([T, np.degrees(Q)]), "time,angle [deg]"),
    "more columns": text(np.column_stack([T, Q, np.gradient(Q, T), 20 + 0 * T]), "time,position,velocity,temperature"),
    "a byte order mark": "\ufeff" + text(TABLE, "time,angle"),
    "dates": "\n".join(["time,angle", *(f"2024-05-01T12:00:00.{round(1e6 * t):06d},{q:.7f}" for t, q in TABLE)]),
    "words beside": "\n".join(["time,state,angle", *(f"{t:.7f},RUN,{q:.7f}" for t, q in TABLE)]),
    "lines before the header": "Logger 3000\nserial,17,a,b\n\n" + text(TABLE, "time,angle"),
}


@pytest.mark.parametrize("form", FORMS)
def test_text_formats_are_equivalent(form: str, tmp_path: Path, asset: Path):
    measured, output = imported(tmp_path, asset, FORMS[form])
    (run,) = measured.runs
    np.testing.assert_allclose(run.times_s, T, atol=2e-7)
    np.testing.assert_allclose(run.q, Q, atol=2e-7)
    assert (measured.joint, measured.joint_type, measured.timestamps) == ("j", "revolute", "nominal")
    assert measured.rate_hz == pytest.approx(100, rel=1e-4)
    np.testing.assert_array_equal(measured.gravity, [0, 0, -9.81])
    assert (measured.inertia_relative, measured.gravity_relative) == (0.1, 0.05)
    for word in (
        "is the time",
        "is the joint's position",
        "the time is in",
        "the joint's position is in",
        "gravity 0 0 -9.81",
    ):
        assert word in output
    assert ("time is in ms" in output) == form.startswith("milli")
    assert ("in deg" in output) == form.startswith("degrees")


@pytest.mark.parametrize(
    "data",
    [
        {
            "about": {"mass": 0.5},
            "entries": [{"time": t, "angle": q, "on": True, "who": "me"} for t, q in TABLE.tolist()],
        },
        {"time": T.tolist(), "angle": Q.tolist(), "mass": 0.5, "tags": [1, 2]},
        TABLE.tolist(),
        {"log": {"data": [{"t": t, "q": [q, 0.0]} for t, q in TABLE.tolist()]}},
    ],
)
def test_json_tables_are_found_at_any_depth(data, tmp_path: Path, asset: Path):
    options = {"columns": {"q": "q:1"}} if isinstance(data, dict) and "log" in data else {}
    options = {"columns": {"t": "1", "q": "2"}} if isinstance(data, list) else options
    measured, _ = imported(tmp_path, asset, json.dumps(data), "log.json", **options)
    np.testing.assert_allclose(measured.runs[0].q, Q, rtol=1e-15)


def mat(folder: Path, **variables) -> bytes:
    savemat(folder / "made.mat", variables, do_compression=True)
    return (folder / "made.mat").read_bytes()


def test_mat_columns_come_from_vectors_matrices_and_fields(tmp_path: Path, asset: Path):
    row = np.stack([Q, np.gradient(Q, T)])
    content = mat(tmp_path, t=T[:, None], log={"theta": Q}, both=row, J=0.1)
    assert set(read_series(tmp_path / "made.mat").columns) == {"t", "log.theta", "both:1", "both:2"}
    for q in ("log.theta", "both:1"):
        folder = tmp_path / q.replace(":", "")
        folder.mkdir()
        measured, _ = imported(folder, asset, content, "log.mat", columns={"q": q})
        np.testing.assert_array_equal(measured.runs[0].q, Q)


def test_a_cell_array_is_one_run_per_cell(tmp_path: Path, asset: Path):
    cells, more = np.empty((2, 1), object), np.empty((1, 1), object)
    times, later = np.empty((2, 1), object), np.empty((1, 1), object)
    for k, (a, b) in enumerate(((cells, times), (cells, times), (more, later))):
        a[k % 2, 0], b[k % 2, 0] = np.stack([Q + np.pi + 0.01 * k, Q]), T[:, None] + 5
    content = mat(tmp_path, Y=cells, Time=times, Yv=more, Timev=later)
    columns = {"t": "Time+Timev", "q": "Y:1+Yv:1"}
    measured, _ = imported(tmp_path, asset, content, "log.mat", columns=columns, zero=np.pi, held_out=("3",))
    assert [(r.name, r.held_out) for r in measured.runs] == [("log_1", False), ("log_2", False), ("log_3", True)]
    for k, run in enumerate(measured.runs):
        np.testing.assert_allclose(run.q, Q + 0.01 * k, atol=1e-12)
        np.testing.assert_allclose(run.times_s, T, atol=1e-12)


def test_zero_and_sign_are_applied(tmp_path: Path, asset: Path):
    table = np.column_stack([T, 90 - np.degrees(Q)])
    measured, _ = imported(tmp_path, asset, text(table, "time,angle"), zero=90.0, reverse=True, unit_q="deg")
    np.testing.assert_allclose(measured.runs[0].q, Q, atol=2e-9)


def test_sensor_wraps_are_undone(tmp_path: Path):
    urdf = asset_of(tmp_path / "asset")
    urdf.write_text(urdf.read_text().replace('type="revolute"', 'type="continuous"'))
    wound = 12 * T
    wrapped = np.degrees((wound + np.pi) % (2 * np.pi) - np.pi)
    measured, output = imported(tmp_path, urdf, text(np.column_stack([T, wrapped]), "time,angle"))
    np.testing.assert_allclose(measured.runs[0].q, wound, atol=1e-6)
    assert "is in deg, by its jumps" in output and "2 jumps of a whole turn" in output


def test_empty_rows_are_dropped_and_reported(tmp_path: Path, asset: Path):
    lines = text(TABLE, "time,angle").splitlines()
    lines[10:10] = [lines[9]]  # a reading sent twice
    lines[30] = lines[30].split(",")[0] + ","  # a reading lost
    measured, output = imported(tmp_path, asset, "\n".join(lines))
    (run,) = measured.runs
    assert len(run.q) == len(Q) and np.isnan(run.q).sum() == 1
    assert "1 rows without a new time" in output


DRIVEN = np.column_stack([T, Q, np.degrees(np.sin(T)), np.sin(3 * T), (T < 0.4).astype(float)])


def test_commands_have_a_law_and_end_where_the_drive_is_off(tmp_path: Path, asset: Path):
    rows = DRIVEN[:, [0, 1, 2, 4]].copy()
    rows[:, 1] = np.degrees(rows[:, 1])
    content = text(rows, "timestamp,position,goal_position,torque_enable")
    measured, output = imported(tmp_path, asset, content, actuator=(60.0, 4.0))
    on, off = measured.runs
    assert (on.name, off.name) == ("run_on_1", "run_off_2") and off.q_command is None
    np.testing.assert_allclose(on.q_command, np.sin(T[:40]), atol=1e-8)
    assert (measured.actuator.stiffness, measured.actuator.damping) == (60, 4)
    assert "q_command: unknown between its rows" in output
    assert measured.interpolation == "unknown" and "runs are split there" in output


def test_efforts_state_hold_and_unit(tmp_path: Path, asset: Path):
    content = text(DRIVEN[:, [0, 1, 3]], "time,position,torque")
    options = {"effort": "external", "unit_effort": "mN*m", "reverse": True, "interpolation": "held"}
    measured, output = imported(tmp_path, asset, content, **options)
    np.testing.assert_allclose(measured.runs[0].effort, -1e-3 * np.sin(3 * T), atol=1e-9)
    np.testing.assert_allclose(measured.runs[0].q, -Q, atol=1e-7)
    assert measured.effort_kind == "external" and "effort: held between its rows" in output
    assert measured.interpolation == "held"


REFUSED = {
    "a drive": (
        text(DRIVEN[:, [0, 1, 3]], "time,position,torque"),
        {},
        "column 'torque' looks like effort: expected --effort",
    ),
    "no position": (
        text(np.column_stack([T, Q, Q]), "time,a,b"),
        {},
        "which column is q.* --columns q=NAME; columns: a, b",
    ),
    "no such column": (FORMS["commas"], {"columns": {"q": "x"}}, "run.csv has no column 'x'; columns: time, angle"),
    "no such joint": (FORMS["commas"], {"joint": "lid"}, "no movable joint 'lid'; movable joints: j"),
    "metres of a hinge": (FORMS["commas"], {"unit_q": "mm"}, "--unit-q mm: joint 'j' is revolute, expected rad, deg"),
    "time goes back": (
        text(np.vstack([TABLE, TABLE]), "time,angle"),
        {},
        "times must increase, but line 82 has 0 s after 0.79 s",
    ),
    "no numbers": ("dear diary,\nhello", {}, "has no rows of numbers; it begins with 'dear diary,'"),
}


@pytest.mark.parametrize("what", REFUSED)
def test_unreadable_input_is_a_one_line_error_without_output(what: str, tmp_path: Path, asset: Path):
    content, options, message = REFUSED[what]
    with pytest.raises(FreeArtError, match=message) as caught:
        imported(tmp_path, asset, content, **options)
    assert "\n" not in str(caught.value) and ".part" not in str(caught.value)
    assert {p.name for p in tmp_path.iterdir()} == {"asset", "run.csv"}


TABLES = {
    "a.csv": st.one_of(mutated_table(FORMS["quotes and a unit"]), mutated_table(FORMS["more columns"])),
    "a.json": mutated_json({"about": 1, "log": [{"t": t, "q": q} for t, q in TABLE.tolist()]}).map(json.dumps),
}


@MUTATED
@given(data=st.data())
def test_a_broken_recording_is_read_or_refused_in_one_line(tmp_path: Path, data):
    name = data.draw(st.sampled_from(sorted(TABLES)))
    (tmp_path / name).write_text(data.draw(TABLES[name]))
    reads_or_refuses(read_series, tmp_path / name)


@settings(MUTATED, max_examples=6)
@given(data=st.data())
def test_a_broken_mat_file_is_read_or_refused_in_one_line(tmp_path: Path, data):
    (tmp_path / "a.mat").write_bytes(data.draw(mutated_bytes(mat(tmp_path, t=T, q=Q))))
    reads_or_refuses(read_series, tmp_path / "a.mat")


def test_a_mat_file_that_crashes_scipy_is_a_one_line_error(tmp_path: Path, monkeypatch):
    """SciPy's reader crashes (SIGSEGV) on some broken files; here every file does."""
    content = mat(tmp_path, t=T, q=Q)
    monkeypatch.setattr("freeart21.formats.mat_file.sys.executable", str(tmp_path / "python"))
    (tmp_path / "python").write_text("#!/bin/sh\nkill -SEGV $$\n")
    (tmp_path / "python").chmod(0o755)
    (tmp_path / "a.mat").write_bytes(content)
    assert_refused(r"a\.mat is not a readable MAT file: the reader crashed on it", read_series, tmp_path / "a.mat")


def test_a_decompression_bomb_does_not_fill_the_memory(tmp_path: Path, monkeypatch):
    monkeypatch.setattr("freeart21.formats.mat_file.MAX_MEMORY", 300 << 20)
    (tmp_path / "bomb.mat").write_bytes(mat(tmp_path, t=np.zeros(300 << 20, np.uint8)))
    assert_refused("bomb.mat is not a readable MAT file: ", read_series, tmp_path / "bomb.mat")


@pytest.mark.parametrize("words", [("t=time", "angle"), ("x=time",), ("map.json",)])
def test_columns_are_roles_and_names(words: tuple[str, ...]):
    assert columns_from(("t=time", "q=angle")) == {"t": "time", "q": "angle"}
    assert_refused("expected ROLE=NAME, such as t=time, of t, q, effort", columns_from, words)


def test_the_command_line_follows_its_sources(tmp_path: Path, asset: Path, capsys):
    run = tmp_path / "run.csv"
    run.write_text(text(TABLE, "time,angle"))
    options = ("--asset", asset, "--joint", "j", "--gravity", 0, 0, -1.62, "--out", tmp_path / "lid")
    code, out, _ = run_command(capsys, "measure", run, *options)
    output = out.splitlines()
    assert code == 0
    assert output[-1].endswith(f"now `freeart21 gap {asset} {tmp_path / 'lid/measured'} --out GAP`")
    assert all(line.startswith("- ") for line in output[:-1]) and len(output) > 5
    assert read_measured(tmp_path / "lid/measured").gravity[2] == -1.62
    for words, line in (
        ((run,), "files need --asset FOLDER or URDF"),
        ((run, tmp_path, "--asset", asset), "expected files, one result, or truth folders; got .* among files"),
        ((tmp_path / "none.csv", "--asset", asset), "none.csv does not exist"),
        ((asset.parent, "--asset", asset), "--asset applies to files, but this was taken for truths: .*asset"),
        ((run, "--asset", asset, "--noise-mm", 1), "--noise-mm applies to truths, but this was taken for files"),
        ((), "expected files, one result, or truth folders; got nothing"),
    ):
        code, _, output = run_command(capsys, "measure", *words, "--out", tmp_path / "no")
        assert code == 1 and output.startswith("freeart21: measure: ") and re.search(line, output), output
        assert not (tmp_path / "no").exists()
