"""A measured set on disk: measured.json and one file or folder a run."""

from __future__ import annotations

import csv
import io
from pathlib import Path
from typing import Any, cast

import numpy as np

from freeart21 import se3
from freeart21.errors import FreeArtError
from freeart21.files import checked
from freeart21.joint import JOINT_TYPES, JointType
from freeart21.measured import EFFORT_KINDS, TIMESTAMPS, EffortKind, Measured, Run, Timestamps
from freeart21.mechanics import Actuator
from freeart21.se3 import Array

VERSION = 1
MAX_CSV_BYTES = 256 << 20
MAX_RUNS = 1000
MIN_SAMPLES = 20
"""Fewer readings say nothing of a motion."""
COLUMNS = ("t_s", "q", "effort", "q_command")
UNITS: dict[str, dict[str, str]] = {
    "revolute": {"t_s": "s", "q": "rad", "effort": "N*m", "q_command": "rad"},
    "prismatic": {"t_s": "s", "q": "m", "effort": "N", "q_command": "m"},
}


def read_measured(folder: Path) -> Measured:
    """The measured set in a folder; FreeArtError says in one line what is wrong with it."""
    folder = Path(folder)
    path = folder / "measured.json"
    if not folder.is_dir() or not path.is_file():
        raise FreeArtError(f"{folder} is not a measured set: expected a folder with measured.json")
    data = checked.read_json(path)
    if data.get("version") != VERSION:
        raise FreeArtError(f"{path} has version {data.get('version')!r}, expected {VERSION}")
    kind = cast(JointType, _one_of(data, "joint_type", JOINT_TYPES, path))
    if data.get("base", "fixed") != "fixed":
        raise FreeArtError(f"{path}: base is {data['base']!r}, expected 'fixed'")
    sampling = _object(data, "sampling", path)
    rate = _positive(sampling, "rate_hz", path)
    timestamps = cast(Timestamps, _one_of(sampling, "timestamps", TIMESTAMPS, path))
    efforts = cast(EffortKind, _one_of(data, "effort", EFFORT_KINDS, path)) if data.get("effort") is not None else None
    actuator = _actuator(data, path)
    uncertainty = _object(data, "asset_uncertainty", path) if data.get("asset_uncertainty") is not None else {}
    runs = tuple(_read_run(folder, entry, kind, rate, path) for entry in _listed_runs(data, path))
    if len({run.name for run in runs}) != len(runs):
        raise FreeArtError(f"{path}: 'runs' names a file twice, expected each once")
    units = _units(data, kind, path)
    _check_channels(runs, units, efforts, actuator, path)
    if all(run.held_out for run in runs):
        raise FreeArtError(f"{path}: all {len(runs)} runs are held out, expected at least one to fit to")
    return Measured(
        joint=checked.text(data, "joint", path),
        joint_type=kind,
        gravity=checked.numbers(data, "gravity", (3,), path),
        rate_hz=rate,
        timestamps=timestamps,
        effort_kind=efforts,
        actuator=actuator,
        inertia_relative=_relative(uncertainty, "inertia_relative", path),
        gravity_relative=_relative(uncertainty, "gravity_relative", path),
        runs=runs,
    )


def _listed_runs(data: dict[str, Any], path: Path) -> list[dict[str, Any]]:
    listed = data.get("runs")
    if not isinstance(listed, list) or not all(isinstance(e, dict) and isinstance(e.get("file"), str) for e in listed):
        raise FreeArtError(f"{path}: 'runs' must be a list of objects with a 'file'")
    if not 1 <= len(listed) <= MAX_RUNS:
        raise FreeArtError(f"{path} has {len(listed)} runs, expected 1 to {MAX_RUNS}")
    for entry in listed:
        if entry.get("held_out") not in (None, True, False):
            raise FreeArtError(
                f"{path}: run '{entry['file']}' has held_out {entry['held_out']!r}, expected true or false"
            )
    return listed


def _read_run(folder: Path, entry: dict[str, Any], kind: JointType, rate_hz: float, path: Path) -> Run:
    file = checked.inside(folder, entry["file"])
    how = entry.get("kind", "csv")
    name = entry["file"].removesuffix("/poses.npz").removesuffix("/").removesuffix(".csv")
    if how == "csv":
        table = _read_csv(file)
        _check_series(file, table["t_s"], table["q"])
        return Run(
            name,
            table["t_s"],
            table["q"],
            table.get("effort"),
            table.get("q_command"),
            None,
            None,
            entry.get("held_out"),
        )
    if how == "poses":
        return _read_poses(file, name, rate_hz, entry.get("held_out"))
    if how == "rgbd":
        raise FreeArtError(
            f"{path}: run '{entry['file']}' is of kind 'rgbd': run `freeart21 reconstruct` on it and give its "
            "poses.npz as kind 'poses'"
        )
    raise FreeArtError(f"{path}: run '{entry['file']}' has kind {how!r}, expected csv, poses or rgbd")


def _read_csv(file: Path) -> dict[str, Array]:
    """Column name to (n,) numbers; an empty cell of a column other than t_s is NaN."""
    try:
        text = checked.require_file(file, MAX_CSV_BYTES).read_text("utf-8-sig")
    except UnicodeDecodeError as error:
        raise FreeArtError(f"{file} is not text: {error}") from error
    rows = [row for row in csv.reader(io.StringIO(text)) if row]
    header = [cell.strip() for cell in rows[0]] if rows else []
    for column in ("t_s", "q"):
        if column not in header:
            raise FreeArtError(f"{file} has no column '{column}'; its columns: {', '.join(header) or 'none'}")
    unknown = [column for column in header if column not in COLUMNS]
    if unknown or len(set(header)) != len(header):
        raise FreeArtError(f"{file} has columns {', '.join(header)}; expected each once of {', '.join(COLUMNS)}")
    values = np.empty((len(rows) - 1, len(header)))
    for i, row in enumerate(rows[1:]):
        try:
            values[i] = [float(cell) if cell.strip() else np.nan for cell in row]
        except ValueError as error:
            raise FreeArtError(f"{file} line {i + 2} is '{','.join(row)}', expected {len(header)} numbers") from error
    return {column: np.ascontiguousarray(values[:, i]) for i, column in enumerate(header)}


def _read_poses(file: Path, name: str, rate_hz: float, held_out: bool | None) -> Run:
    """Poses as a result folder has them; their times are `times_s` when it is there, else even at the rate."""
    file = file / "poses.npz" if file.is_dir() else file
    data = checked.read_npz(file, ("T_camera_reference", "T_camera_moving"))
    try:
        extra = checked.read_npz(file, ("times_s",))
    except FreeArtError:
        extra = {}
    try:
        seen = np.asarray(checked.read_npz(file, ("seen",))["seen"], bool)
    except FreeArtError:
        seen = None
    reference, moving = (np.asarray(data[k], float) for k in ("T_camera_reference", "T_camera_moving"))
    n = len(reference) if reference.ndim else 0
    if reference.shape != (n, 4, 4) or moving.shape != (n, 4, 4):
        raise FreeArtError(f"{file} has poses of shapes {reference.shape} and {moving.shape}, expected (n, 4, 4) twice")
    times = np.asarray(extra.get("times_s", np.arange(n) / rate_hz), float)
    if times.shape != (n,) or (seen is not None and (seen.ndim not in (1, 2) or len(seen) != n)):
        raise FreeArtError(
            f"{file} has {n} poses, times of shape {times.shape}, expected one time and seen flag a pose"
        )
    if seen is not None and seen.ndim == 2:
        seen = np.asarray(seen.all(1))
    usable = np.isfinite(reference).all((1, 2)) & np.isfinite(moving).all((1, 2))
    seen = np.asarray(usable if seen is None else seen & usable)
    poses = np.tile(np.eye(4), (n, 1, 1))
    poses[usable] = se3.inverse(se3.check_poses(f"{file} T_camera_reference", reference[usable])) @ se3.check_poses(
        f"{file} T_camera_moving", moving[usable]
    )
    _check_series(file, times, np.where(seen, 0.0, np.nan))
    return Run(name, times, np.full(n, np.nan), None, None, poses, seen, held_out)


def _check_series(file: Path, times: Array, q: Array) -> None:
    if len(times) < MIN_SAMPLES:
        raise FreeArtError(f"{file} has {len(times)} samples, expected {MIN_SAMPLES} or more: the run is too short")
    if not np.isfinite(times).all():
        raise FreeArtError(f"{file}: 't_s' is not a number in line {int(np.argmin(np.isfinite(times))) + 2}")
    steps = np.diff(times)
    if not (steps > 0).all():
        i = int(np.argmin(steps > 0))
        raise FreeArtError(f"{file}: times must increase, but line {i + 3} has {times[i + 1]:g} s after {times[i]:g} s")
    readings = int(np.isfinite(q).sum())
    if readings < MIN_SAMPLES:
        raise FreeArtError(f"{file} has {readings} readings of q that are numbers, expected {MIN_SAMPLES} or more")


def _units(data: dict[str, Any], kind: JointType, path: Path) -> dict[str, str]:
    units = _object(data, "units", path)
    for column, unit in units.items():
        if column not in COLUMNS:
            raise FreeArtError(f"{path}: units of '{column}', expected {', '.join(COLUMNS)}")
        if unit != UNITS[kind][column]:
            raise FreeArtError(f"{path}: '{column}' of a {kind} joint is in {unit!r}, expected '{UNITS[kind][column]}'")
    return units


def _check_channels(
    runs: tuple[Run, ...], units: dict[str, str], efforts: str | None, actuator: Actuator | None, path: Path
) -> None:
    """Every column has its unit, and whoever drives says how."""
    for run in runs:
        columns: tuple[str, ...] = () if run.poses is not None else ("t_s", "q")
        columns += tuple(c for c in ("effort", "q_command") if getattr(run, c) is not None)
        for column in columns:
            if column not in units:
                raise FreeArtError(f"{path}: run '{run.name}' has '{column}', whose unit is not in 'units'")
        for column in ("effort", "q_command"):
            values = getattr(run, column)
            if values is not None and not np.isfinite(values).all():
                raise FreeArtError(f"{path}: run '{run.name}' has '{column}' that is not a number, expected one a row")
        if run.effort is not None and efforts is None:
            raise FreeArtError(f"{path}: run '{run.name}' has efforts, but 'effort' does not say commanded or external")
        if run.q_command is not None and actuator is None:
            raise FreeArtError(f"{path}: run '{run.name}' has 'q_command', but there is no 'actuator' that follows it")


def _actuator(data: dict[str, Any], path: Path) -> Actuator | None:
    if data.get("actuator") is None:
        return None
    given = _object(data, "actuator", path)
    if given.get("type") != "position":
        raise FreeArtError(f"{path}: the actuator's type is {given.get('type')!r}, expected 'position'")
    stiffness, damping = (_number(given, key, path) for key in ("stiffness", "damping"))
    if min(stiffness, damping) < 0:
        raise FreeArtError(
            f"{path}: the actuator's stiffness and damping are {stiffness:g} and {damping:g}, expected 0 or more"
        )
    return Actuator(None, stiffness, damping)


def _object(data: dict[str, Any], key: str, path: Path) -> dict[str, Any]:
    value = data.get(key)
    if not isinstance(value, dict):
        raise FreeArtError(f"{path}: '{key}' is {value!r}, expected an object")
    return value


def _one_of(data: dict[str, Any], key: str, choices: tuple[str, ...], path: Path) -> str:
    value = data.get(key)
    if value not in choices:
        raise FreeArtError(f"{path}: '{key}' is {value!r}, expected {' or '.join(choices)}")
    return str(value)


def _number(data: dict[str, Any], key: str, path: Path) -> float:
    value = data.get(key)
    if isinstance(value, bool) or not isinstance(value, int | float) or not np.isfinite(value):
        raise FreeArtError(f"{path}: '{key}' is {value!r}, expected a finite number")
    return float(value)


def _positive(data: dict[str, Any], key: str, path: Path) -> float:
    value = _number(data, key, path)
    if value <= 0:
        raise FreeArtError(f"{path}: '{key}' is {value:g}, expected a number above 0")
    return value


def _relative(data: dict[str, Any], key: str, path: Path) -> float:
    value = _number(data, key, path) if key in data else 0.0
    if not 0 <= value < 1:
        raise FreeArtError(f"{path}: '{key}' is {value:g}, expected 0 (exact) to below 1")
    return value
