"""A measured set on disk: measured.json and one file or folder a run, read and written."""

from __future__ import annotations

from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np

from freeart21 import se3
from freeart21.errors import FreeArtError
from freeart21.files import atomic, base_json, checked
from freeart21.files.actuator_json import actuator_from_json, actuator_to_json
from freeart21.files.base_json import base_columns
from freeart21.files.hashes import file_sha256
from freeart21.files.json_record import read_record
from freeart21.files.run_table import MAX_SAMPLES, read_table
from freeart21.joint import JointType
from freeart21.measured import EffortKind, Interpolation, Measured, Run, Timestamps, drop_duplicate_runs
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


@dataclass(frozen=True)
class _Run:
    """An entry of `runs`."""

    file: str
    kind: Literal["csv", "poses", "rgbd"] = "csv"
    held_out: bool | None = None
    prescribed: bool | None = None


@dataclass(frozen=True)
class _Sampling:
    rate_hz: float
    timestamps: Timestamps


@dataclass(frozen=True)
class _Uncertainty:
    """0 is exact."""

    inertia_relative: float = 0.0
    gravity_relative: float = 0.0


@dataclass(frozen=True)
class _Header:
    """measured.json."""

    version: int
    joint: str
    joint_type: JointType
    units: dict[str, str]
    gravity: tuple[float, float, float]
    sampling: _Sampling
    runs: tuple[_Run, ...]
    base: Any = "fixed"
    effort: EffortKind | None = None
    interpolation: Interpolation = "unknown"
    actuator: dict[str, Any] | None = None
    asset_uncertainty: _Uncertainty | None = None
    wrapped: bool | None = None


def read_measured(folder: Path) -> Measured:
    """The measured set in a folder. Raises FreeArtError when it is invalid."""
    header, files = _read_header(folder)
    path, kind, rate = Path(folder) / "measured.json", header.joint_type, header.sampling.rate_hz
    if not 0 < rate <= MAX_RATE_HZ:
        raise FreeArtError(
            f"{path}: 'rate_hz' is {rate:g}, expected above 0, at most {MAX_RATE_HZ:g} readings a second"
        )
    actuator = None if header.actuator is None else actuator_from_json(header.actuator, path)
    _check_units(header.units, kind, path)
    scales = {column: OTHER_UNITS.get(UNITS[kind][column], {}).get(unit, 1.0) for column, unit in header.units.items()}
    runs = tuple(_read_run(*entry, rate, scales, path) for entry in zip(files, header.runs, strict=True))
    runs, turns = _whole_turns(runs, kind, header.wrapped)
    runs, copies = drop_duplicate_runs(runs)
    _check_rate(runs, rate, path)
    _check_channels(runs, header.units, header.effort, actuator, path)
    bases = [run.base for run in runs if run.base is not None]
    base_axis = base_json.base_axis_of(header.base, bool(bases), any(b.angle is not None for b in bases), path)
    gravity = np.array(header.gravity)
    if np.linalg.norm(gravity) > MAX_GRAVITY:
        raise FreeArtError(
            f"{path}: 'gravity' is {np.linalg.norm(gravity):.4g} long, expected m/s^2, some 9.81 on earth"
        )
    if all(run.held_out for run in runs):
        raise FreeArtError(f"{path}: all {len(runs)} runs are held out, expected at least one to fit to")
    doubt = header.asset_uncertainty or _Uncertainty()
    for name, value in asdict(doubt).items():
        if not 0 <= value < 1:
            raise FreeArtError(f"{path}: '{name}' is {value:g}, expected 0 (exact) to below 1")
    return Measured(
        joint=header.joint,
        joint_type=kind,
        gravity=gravity,
        rate_hz=rate,
        timestamps=header.sampling.timestamps,
        effort_kind=header.effort,
        actuator=actuator,
        interpolation=header.interpolation,
        runs=runs,
        base_axis=base_axis,
        notes=(*turns, *copies),
        **asdict(doubt),
    )


def run_files(folder: Path) -> dict[str, Path]:
    """Run name to its file in the measured set in a folder; FreeArtError when there is none."""
    header, files = _read_header(folder)
    return {_name_of(entry.file): file for entry, file in zip(header.runs, files, strict=True)}


def run_hashes(folder: Path) -> dict[str, str]:
    """Run name to the SHA-256 of its file in the measured set in a folder."""
    return {name: file_sha256(file, folder) for name, file in run_files(folder).items()}


def _read_header(folder: Path) -> tuple[_Header, list[Path]]:
    """measured.json, and the files of its runs: different files of different names, of bounded total size."""
    folder = Path(folder)
    path = folder / "measured.json"
    if not folder.is_dir() or not checked.is_there(path):
        raise FreeArtError(f"{folder} is not a measured set: expected a folder with measured.json")
    header = read_record(_Header, checked.read_json(path), str(path), whole=True)
    if header.version != VERSION:
        raise FreeArtError(f"{path} has version {header.version}, expected {VERSION}")
    if not 1 <= len(header.runs) <= MAX_RUNS:
        raise FreeArtError(f"{path} has {len(header.runs)} runs, expected 1 to {MAX_RUNS}")
    files: dict[Path, str] = {}
    for entry in header.runs:
        file, name = checked.inside(folder, entry.file), _name_of(entry.file)
        if file.is_dir() and entry.kind == "poses":
            file = checked.inside(folder, f"{entry.file}/poses.npz")
        if file in files or name in files.values():
            raise FreeArtError(f"{path}: two runs are called '{name}' or are one file, expected each once")
        files[file] = name
    total = sum(file.stat().st_size for file in files if file.is_file())
    if total > MAX_BYTES:
        raise FreeArtError(f"{path}: the runs have {total} bytes together, at most {MAX_BYTES} are read")
    return header, list(files)


def _name_of(file: str) -> str:
    """The name of a file's run."""
    return str(Path(file.removesuffix("poses.npz") if file.endswith("/poses.npz") else file)).removesuffix(".csv")


def _read_run(file: Path, entry: _Run, rate_hz: float, scales: dict[str, float], path: Path) -> Run:
    name = _name_of(entry.file)
    if entry.kind == "rgbd":
        raise FreeArtError(
            f"{path}: run '{entry.file}' is of kind 'rgbd': run `freeart21 reconstruct` on it, then `freeart21 "
            "measure` on the result, which makes runs of kind 'poses'"
        )
    if entry.kind == "poses":
        return replace(_read_poses(file, name, rate_hz, entry.held_out), prescribed=entry.prescribed)
    table, lines = read_table(file, COLUMNS)
    table = {c: values * scales[c] if scales.get(c, 1.0) != 1.0 else values for c, values in table.items()}
    _check_series(file, table["t_s"], table["q"], [f"line {k}" for k in lines], "readings of q that are numbers")
    return Run(
        name,
        table["t_s"],
        table["q"],
        **{column: table.get(column) for column in (*DRIVES, "qd")},  # type: ignore[arg-type]
        base=base_json.base_of(table, file),
        held_out=entry.held_out,
        prescribed=entry.prescribed,
    )


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


def _check_units(units: dict[str, str], kind: JointType, path: Path) -> None:
    for column, unit in units.items():
        if column not in COLUMNS:
            raise FreeArtError(f"{path}: units of '{column}', expected {', '.join(COLUMNS)}")
        own = UNITS[kind][column]
        known = [own, *(other for other in OTHER_UNITS.get(own, ()) if own != "m" or column in ("q", "q_command"))]
        if unit not in known:
            raise FreeArtError(
                f"{path}: '{column}' of a {kind} joint is in {unit!r}, expected {' or '.join(map(repr, known))}"
            )


def _whole_turns(
    runs: tuple[Run, ...], kind: JointType, wrapped: bool | None
) -> tuple[tuple[Run, ...], tuple[str, ...]]:
    """The runs with unwrapped angles, and a line for each changed run.

    `wrapped` is true, false or None as in the file. With None, jumps are removed that are clearly the end of a turn.
    """
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
        columns += tuple(base_columns(run.base))
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


# --- written ----------------------------------------------------------------------------------------------------------


def write_measured(folder: Path, measured: Measured) -> None:
    """Write a set into `folder`, which is made. Poses are relative to the reference part: its own are the identity."""
    folder.mkdir(parents=True, exist_ok=True)
    units = UNITS[measured.joint_type]
    columns = {"t_s", "q"} | {c for c in DRIVES for r in measured.runs if getattr(r, c) is not None}
    columns |= {"qd" for run in measured.runs if run.qd is not None}
    columns |= {column for run in measured.runs for column in base_columns(run.base)}
    actuator = measured.actuator
    atomic.write_json(
        folder / "measured.json",
        {
            "version": VERSION,
            "joint": measured.joint,
            "joint_type": measured.joint_type,
            "units": {column: unit for column, unit in units.items() if column in columns},
            "gravity": measured.gravity,
            "base": _base(measured),
            "sampling": {"rate_hz": measured.rate_hz, "timestamps": measured.timestamps},
            "runs": [_write_run(folder, run) for run in measured.runs],
            **({"interpolation": measured.interpolation} if columns & set(DRIVES) else {}),
            **({} if measured.effort_kind is None else {"effort": measured.effort_kind}),
            **({} if actuator is None else {"actuator": actuator_to_json(actuator, _follows(actuator, columns))}),
            "asset_uncertainty": {
                "inertia_relative": measured.inertia_relative,
                "gravity_relative": measured.gravity_relative,
            },
        },
    )


def _base(measured: Measured) -> str | dict[str, Array]:
    """`base` of measured.json."""
    if measured.base_axis is not None:
        return {"axis": measured.base_axis.axis, "point": measured.base_axis.point}
    return "moving" if any(run.base is not None for run in measured.runs) else "fixed"


def _follows(actuator: Actuator, columns: set[str]) -> bool:
    return "q_command" in columns or actuator.stiffness > 0


def _write_run(folder: Path, run: Run) -> dict[str, str | bool]:
    """Write the file or folder of a run; gives its entry in measured.json."""
    marked = {word: getattr(run, word) for word in MARKS if getattr(run, word) is not None}
    if run.poses is None:
        _write_csv(folder / f"{run.name}.csv", run)
        return {"file": f"{run.name}.csv", **marked}
    if run.base is not None or any(getattr(run, column) is not None for column in DRIVES):
        raise FreeArtError(
            f"run '{run.name}' has poses and a drive or a moving base, which no file of a measured set can hold"
        )
    place = folder / run.name
    place.mkdir()
    seen = np.ones(len(run.times_s), bool) if run.seen is None else run.seen
    np.savez_compressed(
        place / "poses.npz",
        T_camera_reference=np.tile(np.eye(4), (len(run.times_s), 1, 1)),
        T_camera_moving=run.poses,
        times_s=run.times_s,
        seen=seen,
    )
    return {"file": run.name, "kind": "poses", **marked}


def _write_csv(path: Path, run: Run) -> None:
    """Write all digits of every number; a missing reading is an empty cell."""
    series = {"t_s": run.times_s, "q": run.q, "qd": run.qd, **{column: getattr(run, column) for column in DRIVES}}
    series |= base_columns(run.base)
    table = {name: values.tolist() for name, values in series.items() if values is not None}
    rows = (
        ",".join("" if value != value else repr(value) for value in row) for row in zip(*table.values(), strict=True)
    )
    atomic.write_bytes(path, "\n".join([",".join(table), *rows, ""]).encode())
