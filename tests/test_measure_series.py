"""Recordings in common formats become a measured set: guesses are right and reported, the rest is asked for."""

from __future__ import annotations

import json
import re
import zlib
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from command_line import run_command
from gap_case import asset_of
from refusal import assert_refused
from scipy.io import savemat

from freeart21.errors import FreeArtError
from freeart21.files.asset import read_asset, write_asset_json
from freeart21.files.measured import read_measured
from freeart21.formats.measured_series import SeriesSettings, columns_from, measure_series
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
    joint, out = options.pop("joint", None), folder / options.pop("out", "out")
    notes = measure_series([path], out, asset, joint, SeriesSettings(**options))
    return read_measured(out / "measured"), "\n".join(notes)


TABLE = np.column_stack([T, Q])
FORMS = {
    "commas": text(TABLE, "time,angle"),
    "spaces after commas": text(TABLE, "timestamp, angle", ", "),
    "semicolons and decimal commas": text(TABLE, "t;pos", ";", ","),
    "tabs, no header": text(TABLE, "", "\t"),
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
        "the time",
        "the joint's position",
        "times are in",
        "positions are in",
        "gravity 0 0 -9.81",
        "by 10%, its weight by 5%",
    ):
        assert word in output
    assert ("times are in ms" in output) == form.startswith("milli") and ("in deg" in output) == form.startswith(
        "degrees"
    )


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


def test_rows_without_times_use_the_given_rate(tmp_path: Path, asset: Path):
    measured, output = imported(tmp_path, asset, text(Q[:, None], "angle"), rate_hz=100.0)
    np.testing.assert_allclose(measured.runs[0].times_s, T, atol=1e-12)
    assert measured.rate_hz == 100 and "100 rows a second" in output


def test_sensor_wraps_are_undone(tmp_path: Path):
    urdf = asset_of(tmp_path / "asset")
    urdf.write_text(urdf.read_text().replace('type="revolute"', 'type="continuous"'))
    wound = 12 * T
    wrapped = np.degrees((wound + np.pi) % (2 * np.pi) - np.pi)
    measured, output = imported(tmp_path, urdf, text(np.column_stack([T, wrapped]), "time,angle"))
    np.testing.assert_allclose(measured.runs[0].q, wound, atol=1e-6)
    assert "positions are in deg, by its jumps" in output and "2 jumps of the position by a whole turn" in output


def test_empty_rows_are_dropped_and_reported(tmp_path: Path, asset: Path):
    lines = text(TABLE, "time,angle").splitlines()
    lines[10:10] = [lines[9]]  # a reading sent twice
    lines[30] = lines[30].split(",")[0] + ","  # a reading lost
    lines.append("0.8")  # cut off
    measured, output = imported(tmp_path, asset, "\n".join(lines))
    (run,) = measured.runs
    assert len(run.q) == len(Q) and np.isnan(run.q).sum() == 1
    assert "1 rows without a new time" in output
    assert "1 rows with another number of cells than 2" in output


def test_gravity_is_in_the_reference_links_frame(tmp_path: Path, asset: Path):
    plain = read_asset(asset)
    turned = np.array([[1.0, 0, 0, 0.3], [0, 0, -1, 0], [0, 1, 0, 0], [0, 0, 0, 1]])
    write_asset_json(asset.parent, replace(plain, T_canonical_reference=turned))
    measured, _ = imported(tmp_path, asset.parent, text(TABLE, "time,angle"))
    np.testing.assert_allclose(measured.gravity, [0, 9.81, 0], atol=1e-12)


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
    assert "q_command: held or smooth between rows is unknown" in output
    assert measured.interpolation == "unknown" and "runs are split there" in output


def test_efforts_state_hold_and_unit(tmp_path: Path, asset: Path):
    content = text(DRIVEN[:, [0, 1, 3]], "time,position,torque")
    options = {"effort": "external", "unit_effort": "mN*m", "reverse": True, "interpolation": "held"}
    measured, output = imported(tmp_path, asset, content, **options)
    np.testing.assert_allclose(measured.runs[0].effort, -1e-3 * np.sin(3 * T), atol=1e-9)
    np.testing.assert_allclose(measured.runs[0].q, -Q, atol=1e-7)
    assert measured.effort_kind == "external" and "effort: each value holds" in output
    assert measured.interpolation == "held"


def test_empty_drive_cells_are_skipped(tmp_path: Path, asset: Path):
    lines = text(DRIVEN[:, [0, 1, 3]], "time,position,torque").splitlines()
    lines[6] = lines[6].rsplit(",", 1)[0] + ","
    measured, output = imported(tmp_path, asset, "\n".join(lines), effort="commanded")
    (run,) = measured.runs
    assert (
        np.flatnonzero(np.isnan(run.effort)).tolist() == [5] and "1 empty cells of drives count as no value" in output
    )
    lines[1:4] = [line.rsplit(",", 1)[0] + "," for line in lines[1:4]]  # the drive's topic began later
    options = {"effort": "commanded", "columns": {"effort": "torque"}}
    later, output = imported(tmp_path, asset, "\n".join(lines), name="later.csv", out="later", **options)
    np.testing.assert_allclose(later.runs[0].times_s, run.times_s[3:] - run.times_s[3], atol=1e-9)
    assert later.runs[0].effort[0] == run.effort[3] and "the first 3 rows were left out: they have no effort" in output
    lines[1:76] = [line.rsplit(",", 1)[0] + "," for line in lines[1:76]]
    with pytest.raises(FreeArtError, match="effort begin in row 76 of 80, expected 20 rows or more from there on"):
        imported(tmp_path, asset, "\n".join(lines), name="silent.csv", out="silent", **options)


def test_swapped_rows_are_sorted_and_a_second_recording_is_refused(tmp_path: Path, asset: Path):
    lines = text(TABLE, "time,angle").splitlines()
    lines[20], lines[21] = lines[21], lines[20]
    measured, output = imported(tmp_path, asset, "\n".join(lines))
    np.testing.assert_allclose(measured.runs[0].q, Q, atol=2e-7)
    assert "1 rows came late, and were sorted" in output
    with pytest.raises(FreeArtError, match="time goes back .* a second recording"):
        imported(tmp_path, asset, text(np.vstack([TABLE, TABLE]), "time,angle"), name="twice.csv", out="twice")


def test_a_wrapped_command_follows_its_position(tmp_path: Path):
    urdf = asset_of(tmp_path / "asset")
    urdf.write_text(urdf.read_text().replace('type="revolute"', 'type="continuous"'))
    wound = 12 * T + 2.5
    leapt = [(np.degrees(x) + 180) % 360 - 180 for x in (wound, wound + 0.2)]
    leapt[1] += 360  # and is counted from another turn
    content = text(np.column_stack([T, *leapt]), "time,angle,command")
    measured, output = imported(tmp_path, urdf, content, actuator=(5.0, 0.1), unit_q="deg")
    np.testing.assert_allclose(measured.runs[0].q, wound, atol=1e-6)
    np.testing.assert_allclose(measured.runs[0].q_command, wound + 0.2, atol=1e-6)
    assert "jumps of the command by a whole turn were removed" in output


def test_a_duplicate_recording_is_dropped(tmp_path: Path, asset: Path):
    for name in ("a.csv", "b.csv"):
        (tmp_path / name).write_text(text(TABLE, "time,angle"))
    (tmp_path / "c.csv").write_text(text(np.column_stack([T, 0.9 * Q]), "time,angle"))
    files = [tmp_path / name for name in ("a.csv", "b.csv", "c.csv")]
    notes = measure_series(files, tmp_path / "out", asset, None, SeriesSettings(held_out=("a",)))
    assert [run.name for run in read_measured(tmp_path / "out" / "measured").runs] == ["b", "c"]
    assert "run 'a' is run 'b' again, reading by reading: it was left out" in notes


def test_an_ignored_drive_column_is_reported(tmp_path: Path, asset: Path):
    content = text(DRIVEN[:, [0, 1, 3]], "time,position,torque")
    measured, output = imported(tmp_path, asset, content, columns={"t": "time", "q": "position"})
    assert measured.runs[0].effort is None and "column 'torque' is left out" in output


REFUSED = {
    "a drive": (
        text(DRIVEN[:, [0, 1, 3]], "time,position,torque"),
        {},
        "column 'torque' looks like an effort: expected --effort",
    ),
    "a command": (
        text(DRIVEN[:, [0, 1, 2]], "time,pos,setpoint"),
        {},
        "column 'setpoint' looks like a command: expected --act",
    ),
    "no time": (
        text(np.column_stack([Q, -Q]), "a,b"),
        {},
        "which column is the time. --columns t=NAME.*; columns: a, b",
    ),
    "no position": (
        text(np.column_stack([T, Q, Q]), "time,a,b"),
        {},
        "which column.* --columns q=NAME; columns: time, a, b",
    ),
    "two positions": (
        text(np.column_stack([T, Q, Q]), "time,theta,phi"),
        {},
        "is theta or phi.*columns: time, theta, phi",
    ),
    "no such column": (FORMS["commas"], {"columns": {"q": "x"}}, "run.csv has no column 'x'; columns: time, angle"),
    "no such joint": (FORMS["commas"], {"joint": "lid"}, "no movable joint 'lid'; movable joints: j"),
    "no such run": (FORMS["commas"], {"held_out": ("b",)}, "--held-out: there is no run 'b'; runs: run"),
    "all held out": (FORMS["commas"], {"held_out": ("run",)}, "^measured.json: all 1 runs are held out"),
    "metres of a hinge": (FORMS["commas"], {"unit_q": "mm"}, "--unit-q mm: joint 'j' is revolute, expected rad, deg"),
    "newtons of a hinge": (
        text(DRIVEN[:, [0, 1, 3]], "time,q,tau"),
        {"effort": "external", "unit_effort": "N"},
        r"--unit-effort N: joint 'j' is revolute, expected N\*m",
    ),
    "time goes back": (text(np.vstack([TABLE, TABLE]), "time,angle"), {}, "time goes back from 0.79 to 0 in row 81"),
    "too short": (text(TABLE[:12], "time,angle"), {}, "has 12 rows of different times, expected 20 or more"),
    "no numbers": ("dear diary,\nhello", {}, "has no rows of numbers; it begins with 'dear diary,'"),
    "nothing": ("", {}, "has no rows"),
    "ragged": (text(TABLE, "time,angle") + "1,2,3\n" * 9, {}, "9 of 89 rows have another number of cells than 2"),
    "not text": (b"\0\1\2" * 50, {}, "is not text: it has NUL bytes"),
    "gravity": (
        FORMS["commas"],
        {"gravity": (0.0, np.nan, 0.0)},
        "--gravity 0.0 nan 0.0: expected a finite number each",
    ),
    "an endless law": (
        FORMS["commas"],
        {"actuator": (np.inf, 1.0)},
        "--actuator inf 1.0: expected a finite number each",
    ),
    "no reading": (
        text(np.column_stack([T, np.nan * Q]), "time,q"),
        {},
        "^run.csv has 0 readings of q that are numbers",
    ),
    "no rate": (text(Q[:, None], "angle"), {"rate_hz": 0.0}, "--rate-hz 0: expected above 0"),
    "heavy gravity": (FORMS["commas"], {"gravity": (0.0, 0.0, -981.0)}, "'gravity' is 981 long, expected m/s"),
    "a law without a column": (FORMS["commas"], {"actuator": (1.0, 1.0)}, "which column is q_command\\?"),
    "a column without a law": (
        FORMS["commas"],
        {"columns": {"q_command": "angle"}},
        "q_command=angle needs --actuator",
    ),
}


@pytest.mark.parametrize("what", REFUSED)
def test_unreadable_input_is_a_one_line_error_without_output(what: str, tmp_path: Path, asset: Path):
    content, options, message = REFUSED[what]
    with pytest.raises(FreeArtError, match=message) as caught:
        imported(tmp_path, asset, content, **options)
    assert "\n" not in str(caught.value) and ".part" not in str(caught.value)
    assert {p.name for p in tmp_path.iterdir()} == {"asset", "run.csv"}


@pytest.mark.parametrize(
    "name, content, message",
    [
        ("a.json", b"[" * 100_000, "is not JSON"),
        ("a.json", b"{}", "has no table: expected a list of objects"),
        ("a.mat", b"MATLAB 7.3 MAT-file" + b" " * 500, "of version 7.3"),
        ("a.mat", b"MATLAB 5.0" + bytes(200), "is not a readable MAT file"),
        ("a.mat", b"x" * 124 + b"\0\1IM" + b"\x0f\0\0\0\4\0\0\0abcd", "is not a readable MAT file"),
        ("a.xlsx", b"PK", "is a .xlsx file, expected text"),
        ("a.npz", b"PK", "is a .npz file, expected text"),
    ],
)
def test_hostile_files_are_a_one_line_error(name: str, content: bytes, message: str, tmp_path: Path, asset: Path):
    assert_refused(message, imported, tmp_path, asset, content, name)


def test_a_mat_file_that_crashes_scipy_is_a_one_line_error(tmp_path: Path, monkeypatch):
    """SciPy's reader crashes (SIGSEGV) on some broken files; here every file does."""
    content = mat(tmp_path, t=T, q=Q)
    monkeypatch.setattr("freeart21.formats.mat_file.sys.executable", str(tmp_path / "python"))
    (tmp_path / "python").write_text("#!/bin/sh\nkill -SEGV $$\n")
    (tmp_path / "python").chmod(0o755)
    (tmp_path / "a.mat").write_bytes(content)
    assert_refused(r"a\.mat is not a readable MAT file: the reader crashed on it", read_series, tmp_path / "a.mat")


def test_python_files_next_to_a_mat_file_are_not_run(tmp_path: Path, monkeypatch):
    content = mat(tmp_path, t=T, q=Q)
    (tmp_path / "numpy.py").write_text("raise SystemExit('imported')")
    (tmp_path / "a.mat").write_bytes(content)
    monkeypatch.chdir(tmp_path)
    assert set(read_series(Path("a.mat")).columns) == {"t", "q"}


def test_a_decompression_bomb_is_not_unpacked(tmp_path: Path, monkeypatch):
    monkeypatch.setattr("freeart21.formats.mat_file.MAX_BYTES", 1 << 20)
    packed = zlib.compress(bytes(2 << 20))
    header = b"MATLAB 5.0".ljust(124) + b"\0\1IM"
    (tmp_path / "bomb.mat").write_bytes(header + b"\x0f\0\0\0" + len(packed).to_bytes(4, "little") + packed)
    assert_refused("unpacks to more than", read_series, tmp_path / "bomb.mat")


def test_columns_come_from_options_or_a_file(tmp_path: Path):
    (tmp_path / "map.json").write_text('{"t": "time", "q": "angle"}')
    assert (
        columns_from(("t=time", "q=angle"))
        == columns_from((str(tmp_path / "map.json"),))
        == {"t": "time", "q": "angle"}
    )
    for words, message in (
        (("t=time", "angle"), "angle: expected ROLE=NAME"),
        (("x=time",), "no role 'x'; roles: t, q, eff"),
    ):
        assert_refused(message, columns_from, words)


def test_each_file_is_a_run_with_its_name(tmp_path: Path, asset: Path):
    for folder in ("a", "b"):
        (tmp_path / folder).mkdir()
        (tmp_path / folder / "run 1.csv").write_text(text(np.column_stack([T, Q + 0.01 * (folder == "b")]), "t,q"))
    files = [tmp_path / folder / "run 1.csv" for folder in ("a", "b")]
    measure_series(files, tmp_path / "out", asset, None, SeriesSettings())
    assert [run.name for run in read_measured(tmp_path / "out/measured").runs] == ["run_1", "run_1_2"]


def test_files_in_different_units_are_refused(tmp_path: Path, asset: Path):
    for name, unit in (("a", "deg"), ("b", "rad")):
        (tmp_path / f"{name}.csv").write_text(text(TABLE, f"time,angle [{unit}]"))
    with pytest.raises(FreeArtError, match=r"b.csv: q is in rad, but in deg in a.csv; expected the same for all"):
        measure_series([tmp_path / "a.csv", tmp_path / "b.csv"], tmp_path / "out", asset, None, SeriesSettings())


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
