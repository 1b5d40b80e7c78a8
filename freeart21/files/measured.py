"""A measured set on disk: measured.json and one file or folder a run."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path
from typing import Any, cast

import numpy as np

from freeart21 import se3
from freeart21.errors import FreeArtError
from freeart21.files import base_json, checked
from freeart21.files.actuator_json import actuator_from_json
from freeart21.files.hashes import file_sha256
from freeart21.files.run_table import MAX_SAMPLES, read_table
from freeart21.joint import JOINT_TYPES, JointType
from freeart21.measured import (
    EFFORT_KINDS,
    INTERPOLATIONS,
    TIMESTAMPS,
    EffortKind,
    Interpolation,
    Measured,
    Run,
    Timestamps,
    drop_duplicate_runs,
)
from freeart21.mechanics import Actuator
from freeart21.se3 import Array
from freeart21.turns import is_wrapped, unwrap_angles, unwrap_command

VERSION = 1
MAX_BYTES = 256 << 20
"""Size limit of all runs together."""
MAX_RUNS = 1000
MAX_RATE_HZ = 1e5
MAX_GRAVITY = 50.0
"""m/s^2; larger values are in another unit."""
MAX_POSITION = 1e4
"""rad or m; larger values are no joint positions."""
MIN_SAMPLES = 20
"""Fewest readings of a run."""
DRIVES = ("effort", "q_command", "voltage", "enabled")
"""Columns of the joint's drive."""
COLUMNS = ("t_s", "q", *DRIVES, "qd", *base_json.COLUMNS)
MARKS = ("held_out", "prescribed")
"""Flags of a run in measured.json."""
_SHARED_UNITS = {"t_s": "s", "voltage": "V", "enabled": "1", **base_json.COLUMNS}
UNITS: dict[str, dict[str, str]] = {
    "revolute": {"q": "rad", "qd": "rad/s", "effort": "N*m", "q_command": "rad", **_SHARED_UNITS},
    "prismatic": {"q": "m", "qd": "m/s", "effort": "N", "q_command": "m", **_SHARED_UNITS},
}
OTHER_UNITS: dict[str, dict[str, float]] = {
    "rad": {"deg": np.pi / 180},
    "rad/s": {"deg/s": np.pi / 180},
    "m": {"mm": 1e-3},
    "m/s": {"mm/s": 1e-3},
}
"""Unit to other accepted units, and their sizes in it."""


def read_measured(folder: Path) -> Measured:
    """The measured set in a folder. Raises FreeArtError when it is invalid."""
    folder = Path(folder)
    path = folder / "measured.json"
    if not folder.is_dir() or not checked.is_there(path):
        raise FreeArtError(f"{folder} is not a measured set: expected a folder with measured.json")
    data = checked.read_json(path)
    if data.get("version") != VERSION:
        raise FreeArtError(f"{path} has version {data.get('version')!r}, expected {VERSION}")
    kind = cast(JointType, checked.one_of(data, "joint_type", JOINT_TYPES, path))
    sampling = checked.json_object(data, "sampling", path)
    rate = checked.number(sampling, "rate_hz", path, checked.ABOVE_ZERO, expected="a number above 0")
    if rate > MAX_RATE_HZ:
        raise FreeArtError(f"{path}: 'rate_hz' is {rate:g}, expected at most {MAX_RATE_HZ:g} readings a second")
    timestamps = cast(Timestamps, checked.one_of(sampling, "timestamps", TIMESTAMPS, path))
    stated = data.get("effort") is not None
    efforts = cast(EffortKind, checked.one_of(data, "effort", EFFORT_KINDS, path)) if stated else None
    between = checked.one_of(data, "interpolation", INTERPOLATIONS, path) if "interpolation" in data else "unknown"
    actuator = _actuator(data, path)
    uncertain = data.get("asset_uncertainty") is not None
    uncertainty = checked.json_object(data, "asset_uncertainty", path) if uncertain else {}
    listed = _listed_runs(data, path)
    files = _run_files(folder, listed, path)
    units = _units(data, kind, path)
    scales = {column: _scale(unit, UNITS[kind][column]) for column, unit in units.items()}
    runs = tuple(_read_run(file, entry, kind, rate, scales, path) for file, entry in zip(files, listed, strict=True))
    runs, turns = _whole_turns(runs, kind, data.get("wrapped"), path)
    runs, copies = drop_duplicate_runs(runs)
    notes = (*turns, *copies)
    _check_rate(runs, rate, path)
    _check_channels(runs, units, efforts, actuator, path)
    bases = [run.base for run in runs if run.base is not None]
    turned = any(base.angle is not None for base in bases)
    base_axis = base_json.base_axis_of(data.get("base", "fixed"), bool(bases), turned, path)
    gravity = checked.numbers(data, "gravity", (3,), path)
    if np.linalg.norm(gravity) > MAX_GRAVITY:
        raise FreeArtError(
            f"{path}: 'gravity' is {np.linalg.norm(gravity):.4g} long, expected m/s^2, some 9.81 on earth"
        )
    if all(run.held_out for run in runs):
        raise FreeArtError(f"{path}: all {len(runs)} runs are held out, expected at least one to fit to")
    return Measured(
        joint=checked.text(data, "joint", path),
        joint_type=kind,
        gravity=gravity,
        rate_hz=rate,
        timestamps=timestamps,
        effort_kind=efforts,
        actuator=actuator,
        interpolation=cast(Interpolation, between),
        inertia_relative=_relative(uncertainty, "inertia_relative", path),
        gravity_relative=_relative(uncertainty, "gravity_relative", path),
        runs=runs,
        base_axis=base_axis,
        notes=notes,
    )


def run_files(folder: Path) -> dict[str, Path]:
    """Run name to its file in the measured set in a folder; FreeArtError when there is none."""
    path = folder / "measured.json"
    if not folder.is_dir() or not checked.is_there(path):
        raise FreeArtError(f"{folder} is not a measured set: expected a folder with measured.json")
    listed = _listed_runs(checked.read_json(path), path)
    files = _run_files(folder, listed, path)
    return {_name_of(entry["file"]): file for entry, file in zip(listed, files, strict=True)}


def run_hashes(folder: Path) -> dict[str, str]:
    """Run name to the SHA-256 of its file in the measured set in a folder."""
    return {name: file_sha256(file, folder) for name, file in run_files(folder).items()}


def _listed_runs(data: dict[str, Any], path: Path) -> list[dict[str, Any]]:
    listed = data.get("runs")
    if not isinstance(listed, list) or not all(isinstance(e, dict) and isinstance(e.get("file"), str) for e in listed):
        raise FreeArtError(f"{path}: 'runs' must be a list of objects with a 'file'")
    if not 1 <= len(listed) <= MAX_RUNS:
        raise FreeArtError(f"{path} has {len(listed)} runs, expected 1 to {MAX_RUNS}")
    for entry in listed:
        for word in MARKS:
            if entry.get(word) not in (None, True, False):
                raise FreeArtError(f"{path}: run '{entry['file']}' has {word} {entry[word]!r}, expected true or false")
    return listed


def _run_files(folder: Path, listed: list[dict[str, Any]], path: Path) -> list[Path]:
    """The files of all runs: different files of different names, of bounded total size."""
    files: dict[Path, str] = {}
    names: dict[str, str] = {}
    for entry in listed:
        file, listed_name = checked.inside(folder, entry["file"]), entry["file"]
        if file.is_dir() and entry.get("kind") == "poses":
            file = checked.inside(folder, f"{listed_name}/poses.npz")
        if file in files:
            raise FreeArtError(
                f"{path}: 'runs' names a file twice, as '{files[file]}' and '{listed_name}', expected each once"
            )
        name = _name_of(listed_name)
        if name in names:
            raise FreeArtError(
                f"{path}: runs '{names[name]}' and '{listed_name}' would both be called '{name}', expected other names"
            )
        files[file], names[name] = listed_name, listed_name
    total = sum(file.stat().st_size for file in files if file.is_file())
    if total > MAX_BYTES:
        raise FreeArtError(f"{path}: the runs have {total} bytes together, at most {MAX_BYTES} are read")
    return list(files)


def _name_of(file: str) -> str:
    """The name of a file's run."""
    return str(Path(file.removesuffix("poses.npz") if file.endswith("/poses.npz") else file)).removesuffix(".csv")


def _read_run(
    file: Path, entry: dict[str, Any], kind: JointType, rate_hz: float, scales: dict[str, float], path: Path
) -> Run:
    how, name, held_out = entry.get("kind", "csv"), _name_of(entry["file"]), entry.get("held_out")
    if how == "csv":
        table, lines = read_table(file, COLUMNS)
        table = {c: values * scales[c] if scales.get(c, 1.0) != 1.0 else values for c, values in table.items()}
        _check_series(file, table["t_s"], table["q"], [f"line {k}" for k in lines], "readings of q that are numbers")
        effort, command, voltage, enabled = (table.get(column) for column in DRIVES)
        return Run(
            name, table["t_s"], table["q"], effort, command, None, None, held_out, voltage, enabled,
            base_json.base_of(table, file), table.get("qd"), entry.get("prescribed"),
        )  # fmt: skip
    if how == "poses":
        return replace(_read_poses(file, name, rate_hz, held_out), prescribed=entry.get("prescribed"))
    if how == "rgbd":
        raise FreeArtError(
            f"{path}: run '{entry['file']}' is of kind 'rgbd': run `freeart21 reconstruct` on it, then `freeart21 "
            "measure` on the result, which makes runs of kind 'poses'"
        )
    raise FreeArtError(f"{path}: run '{entry['file']}' has kind {how!r}, expected csv, poses or rgbd")


def _read_poses(file: Path, name: str, rate_hz: float, held_out: bool | None) -> Run:
    """Poses as in a result folder, at `times_s` if the file has it, else evenly spaced at `rate_hz`."""
    data = checked.read_npz(file, ("T_camera_reference", "T_camera_moving"), optional=("times_s", "seen"))
    for key, values in data.items():
        if values.dtype.kind not in "fiub":
            raise FreeArtError(f"{file}: '{key}' is of type {values.dtype}, expected numbers")
    reference, moving = (np.asarray(data[k], float) for k in ("T_camera_reference", "T_camera_moving"))
    n = len(reference) if reference.ndim else 0
    if reference.shape != (n, 4, 4) or moving.shape != (n, 4, 4):
        raise FreeArtError(f"{file} has poses of shapes {reference.shape} and {moving.shape}, expected (n, 4, 4) twice")
    if n > MAX_SAMPLES:
        raise FreeArtError(f"{file} has {n} poses, at most {MAX_SAMPLES} are read: thin them out")
    times = np.asarray(data.get("times_s", np.arange(n) / rate_hz), float)
    seen = np.asarray(data["seen"] if "seen" in data else np.ones(n), bool)
    if times.shape != (n,) or seen.ndim not in (1, 2) or len(seen) != n:
        raise FreeArtError(
            f"{file} has {n} poses, times of shape {times.shape} and seen flags of shape {seen.shape}, expected one "
            "time and seen flag a pose"
        )
    usable = np.isfinite(reference).all((1, 2)) & np.isfinite(moving).all((1, 2))
    seen = np.asarray(usable & (seen.all(1) if seen.ndim == 2 else seen))
    poses = np.tile(np.eye(4), (n, 1, 1))
    if usable.any():
        poses[usable] = se3.inverse(se3.check_poses(f"{file} T_camera_reference", reference[usable])) @ se3.check_poses(
            f"{file} T_camera_moving", moving[usable]
        )
    places = [f"pose {i}" for i in range(n)]
    _check_series(file, times, np.where(seen, 0.0, np.nan), places, "poses in which both parts were seen")
    return Run(name, times, np.full(n, np.nan), None, None, poses, seen, held_out)


def _check_series(file: Path, times: Array, q: Array, places: list[str], what: str) -> None:
    if len(times) < MIN_SAMPLES:
        raise FreeArtError(f"{file} has {len(times)} samples, expected {MIN_SAMPLES} or more: the run is too short")
    if not np.isfinite(times).all():
        raise FreeArtError(f"{file}: the time is not a number in {places[int(np.argmin(np.isfinite(times)))]}")
    steps = np.diff(times)
    if not (steps > 0).all():
        i = int(np.argmin(steps > 0))
        raise FreeArtError(
            f"{file}: times must increase, but {places[i + 1]} has {times[i + 1]:g} s after {times[i]:g} s"
        )
    readings = int(np.isfinite(q).sum())
    if readings < MIN_SAMPLES:
        raise FreeArtError(f"{file} has {readings} {what}, expected {MIN_SAMPLES} or more")
    far = np.nan_to_num(np.abs(q), posinf=0.0) > MAX_POSITION
    if far.any():
        i = int(np.argmax(far))
        raise FreeArtError(f"{file}: q is {q[i]:g} in {places[i]}, expected rad or m, {MAX_POSITION:g} at most")


def _check_rate(runs: tuple[Run, ...], rate_hz: float, path: Path) -> None:
    """FreeArtError when times are in another unit than seconds."""
    for run in runs:
        step = float(np.median(np.diff(run.times_s)))
        if not 1 / 30 < step * rate_hz < 30:
            raise FreeArtError(
                f"{path}: run '{run.name}' has {step:g} s from reading to reading, but 'rate_hz' is {rate_hz:g}: "
                f"expected some {1 / rate_hz:g} s (are its times seconds?)"
            )


def _units(data: dict[str, Any], kind: JointType, path: Path) -> dict[str, str]:
    units = checked.json_object(data, "units", path)
    for column, unit in units.items():
        if column not in COLUMNS:
            raise FreeArtError(f"{path}: units of '{column}', expected {', '.join(COLUMNS)}")
        own = UNITS[kind][column]
        known = [own, *(other for other in OTHER_UNITS.get(own, ()) if own != "m" or column in ("q", "q_command"))]
        if unit not in known:
            raise FreeArtError(
                f"{path}: '{column}' of a {kind} joint is in {unit!r}, expected {' or '.join(map(repr, known))}"
            )
    return units


def _scale(unit: str, own: str) -> float:
    """Size of `unit` in the unit `own`."""
    return 1.0 if unit == own else OTHER_UNITS[own][unit]


def _whole_turns(
    runs: tuple[Run, ...], kind: JointType, wrapped: Any, path: Path
) -> tuple[tuple[Run, ...], tuple[str, ...]]:
    """The runs with unwrapped angles, and a line for each changed run.

    `wrapped` is true, false or None as in the file. With None, jumps are removed that are clearly the end of a turn.
    """
    if wrapped not in (None, True, False):
        raise FreeArtError(f"{path}: 'wrapped' is {wrapped!r}, expected true or false")
    if kind != "revolute" or wrapped is False:
        return runs, ()
    found, notes = [], []
    for run in runs:
        q, jumps = unwrap_angles(run.q, np.pi) if wrapped or is_wrapped(run.q) else (run.q, 0)
        command = run.q_command
        if command is not None and (wrapped or jumps):
            command, turned = unwrap_command(command, q)
            jumps += turned
        if jumps:
            how = "" if wrapped else ', recognised by jumps from one end of a turn to the other (else "wrapped": false)'
            notes.append(f"run '{run.name}': angles were within one turn and have been unwrapped, {jumps} jumps{how}")
        found.append(replace(run, q=q, q_command=command))
    return tuple(found), tuple(notes)


def _check_channels(
    runs: tuple[Run, ...], units: dict[str, str], efforts: str | None, actuator: Actuator | None, path: Path
) -> None:
    """FreeArtError when a column has no unit, or a drive lacks its description."""
    for run in runs:
        columns: tuple[str, ...] = () if run.poses is not None else ("t_s", "q")
        columns += () if run.qd is None else ("qd",)
        columns += tuple(c for c in DRIVES if getattr(run, c) is not None)
        columns += tuple(base_json.base_columns(run.base))
        for column in columns:
            if column not in units:
                raise FreeArtError(f"{path}: run '{run.name}' has '{column}', whose unit is not in 'units'")
        for column in DRIVES:
            values = getattr(run, column)
            if values is not None and not (np.isfinite(values[0]) and not np.isinf(values).any()):
                raise FreeArtError(
                    f"{path}: run '{run.name}' has '{column}' that is not a number, expected one in the first row, and "
                    "in others one or an empty cell"
                )
        if run.prescribed and run.effort is None:
            raise FreeArtError(
                f"{path}: run '{run.name}' is prescribed, but has no 'effort', expected the force that its motion took"
            )
        if run.effort is not None and efforts is None:
            raise FreeArtError(f"{path}: run '{run.name}' has efforts, but 'effort' does not say commanded or external")
        if run.q_command is not None and (actuator is None or not actuator.stiffness):
            raise FreeArtError(f"{path}: run '{run.name}' has 'q_command', but there is no 'actuator' that follows it")
        if run.voltage is not None and (actuator is None or actuator.motor is None):
            raise FreeArtError(f"{path}: run '{run.name}' has 'voltage', but there is no 'actuator' of type 'dc_motor'")
        commanded = (
            run.q_command is not None or run.voltage is not None or (run.effort is not None and efforts == "commanded")
        )
        if run.enabled is not None and not commanded:
            raise FreeArtError(f"{path}: run '{run.name}' has 'enabled', but nothing that was commanded")


def _actuator(data: dict[str, Any], path: Path) -> Actuator | None:
    given = data.get("actuator") is not None
    return actuator_from_json(checked.json_object(data, "actuator", path), path) if given else None


def _relative(data: dict[str, Any], key: str, path: Path) -> float:
    if key not in data:
        return 0.0
    return checked.number(data, key, path, 0.0, math.nextafter(1.0, 0.0), "0 (exact) to below 1")
