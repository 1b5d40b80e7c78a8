"""A measured set from recordings in text, JSON or MAT files (`time_series`).

The user states the asset and joint, columns, units, gravity and the drive (`SeriesSettings`). What has one possible
reading alone is taken without, and reported in a line; what has several is refused in a line that names the option.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field, replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from freeart21.asset import Asset
from freeart21.errors import FreeArtError
from freeart21.files import atomic, base_json, checked
from freeart21.files.actuator_json import actuator_from_json
from freeart21.files.asset import find_movable_joint, read_asset
from freeart21.files.json_record import read_record
from freeart21.files.measured import MAX_RATE_HZ, MIN_SAMPLES, read_measured, write_measured
from freeart21.files.urdf import UrdfJoint
from freeart21.formats.position_units import joint_mechanics, unit_by_motion
from freeart21.formats.series_settings import SeriesSettings
from freeart21.formats.series_units import POSITIONS, TIMES, split_unit, unit_sizes
from freeart21.formats.time_series import Series, join_names, read_series
from freeart21.measured import Measured, Run, drop_duplicate_runs
from freeart21.mechanics import Actuator
from freeart21.se3 import Array
from freeart21.turns import is_wrapped, unwrap_angles, unwrap_command

_NAMES = {
    "t": "t time times timestamp timestamps stamp elapsed clock",
    "q": "q angle pos position theta phi joint_position joint_pos jointangle joint_angle qpos",
    "effort": "effort torque tau force joint_effort joint_torque motor_torque",
    "q_command": "q_command command cmd goal goal_position target target_position setpoint set_point reference ref "
    "q_des q_ref desired desired_position position_command",
    "enabled": "enabled enable torque_enable torque_enabled servo_on motor_on drive_on",
}
"""Role to the usual names of its column, without case and unit."""
ROLES = (*_NAMES, "qd", "voltage", *base_json.COLUMNS)
"""time; position; force or torque on the joint; commanded position; drive on or off; velocity; voltage; base motion."""
_NEEDS = {
    "effort": "--effort commanded (to the actuator) or external (a known push on the moving part)",
    "q_command": "--actuator STIFFNESS DAMPING of its position controller",
    "voltage": "an actuator of type 'dc_motor' in --circumstances",
}
"""Role of the drive to the option that describes it."""
_WORDS = {"t": "the time", "q": "the joint's position", "enabled": "the drive's switch: runs are split there"}
_OPTIONS = {"t": "--unit-t", "q": "--unit-q", "q_command": "--unit-q", "effort": "--unit-effort"}
GRAVITY = (0.0, 0.0, -9.81)
"""m/s^2, z up."""
_EVEN = 0.02
"""Relative deviation of 95 % of time steps from the median, up to which times count as nominal, not read from a
clock."""
_BEYOND = 0.25
"""Share of a joint's range by which readings can exceed its limits in the right unit."""
_MOVED = 0.05
"""Smallest motion, as a share of the joint's range, that shows its unit: a wrong unit changes it by 57 or 1000."""
Values = dict[str, Array]
"""Role to the (n,) numbers of one run."""


@dataclass(frozen=True)
class Circumstances:
    """The file of `--circumstances`: what measured.json can say and no option does."""

    actuator: dict[str, Any] | None = None
    base: Any = None
    """"moving", or an object with axis and point."""
    prescribed: Any = None
    """True for all runs, or the names of runs, whose motion was prescribed by something else than the efforts."""
    units: dict[str, str] = field(default_factory=dict)
    """Role to unit."""
    wrapped: bool | None = None
    """Whether angles are within one turn. With None, jumps of a turn are removed."""


def _read_circumstances(settings: SeriesSettings, columns: dict[str, str]) -> tuple[Circumstances, Actuator | None]:
    """The contents of the file of circumstances, and the actuator, which describes each drive in `columns`."""
    where, facts = settings.circumstances, Circumstances()
    if where is not None:
        facts = read_record(Circumstances, checked.read_json(where, root=checked.ANYWHERE), str(where))
    if settings.actuator is not None and facts.actuator is not None:
        raise FreeArtError(f"--actuator and the actuator of {where}: expected one of them")
    law = None if facts.actuator is None else actuator_from_json(facts.actuator, str(where))
    law = law if settings.actuator is None else Actuator(None, *settings.actuator)
    described = {"effort": settings.effort, "q_command": law, "voltage": law and law.motor}
    for role, need in _NEEDS.items():
        if role in columns and described[role] is None:
            raise FreeArtError(f"--columns {role}={columns[role]} needs {need}")
    return facts, law


def columns_from(words: tuple[str, ...]) -> dict[str, str]:
    """Role to column, from words such as t=time."""
    columns = {role: name for role, _, name in (word.partition("=") for word in words)}
    for role, name in columns.items():
        if role not in ROLES or not name:
            raise FreeArtError(f"--columns {role}={name}: expected ROLE=NAME, such as t=time, of {', '.join(ROLES)}")
    return columns


def measure_series(files: Iterable[Path], out: Path, settings: SeriesSettings) -> list[str]:
    """Write `out/measured` from recordings of one joint of `settings.asset`; gives a line for each guess.

    Raises FreeArtError when the files cannot be read, their columns or units are not certain, or they make no measured
    set; nothing is written then.
    """
    if settings.asset is None:
        raise FreeArtError("measure: files need --asset FOLDER or URDF, the object whose joint was measured")
    if settings.rate_hz is not None and not 0 < settings.rate_hz <= MAX_RATE_HZ:
        raise FreeArtError(
            f"--rate-hz {settings.rate_hz:g}: expected above 0 and at most {MAX_RATE_HZ:g} rows a second"
        )
    asset = read_asset(settings.asset, settings.joint)
    joint = find_movable_joint(asset.urdf, asset.joint)
    kind = joint.joint_type
    assert kind is not None  # movable
    columns = columns_from(settings.columns)
    facts, law = _read_circumstances(settings, columns)
    drives = {role for role in _NEEDS if role in columns}
    drives |= {"effort"} if settings.effort else set()
    drives |= {"q_command"} if settings.actuator else set()
    notes = [] if settings.joint else [f"joint '{joint.name}' ({joint.type}), the only movable one (else --joint)"]
    origin: dict[str, Path] = {}
    runs: dict[str, Values] = {}
    roles: dict[str, str] = {}
    written: dict[str, str | None] = {}
    for file in map(Path, files):
        series = read_series(file)
        roles, guesses = _assign_columns(series, columns, drives, settings.rate_hz)
        notes += [note for note in guesses if note not in notes]
        found = {role: series.units.get(name) for role, name in roles.items()}
        if origin and found != written:
            raise FreeArtError(f"{file} has columns and units {found}, expected those of the first: {written}")
        written = found
        for name, values in _runs_of(series, roles, settings.rate_hz):
            while name in runs:
                name += "_2"
            runs[name], origin[name] = _clean_rows(name, values, notes), file
    where = settings.circumstances or Path("measure")
    for role in facts.units:
        if role not in roles:
            raise FreeArtError(f"{where}: units of '{role}', which no column has; expected {', '.join(roles)}")
    stated = {"t": settings.unit_t, "q": settings.unit_q, "effort": settings.unit_effort, **facts.units}

    def find_size(role: str, guess: Callable[[], tuple[str, str]] | None = None) -> float:
        """Size in SI of the unit that is stated, written, guessed with a reason, or the default."""
        known, unit = unit_sizes(role, kind), stated.get(role)
        option = _OPTIONS.get(role, f"--circumstances: units of {role}")
        if unit is None and written.get(role) in known:
            unit = str(written[role])
            notes.append(f"{_WORDS.get(role, role)} is in {unit}, as written (else {option})")
        elif unit is None:
            unit, why = guess() if guess is not None else (next(iter(known)), "a default")
            notes.append(f"{_WORDS.get(role, role)} is in {unit}, {why} (else {option})")
        if role == "q" and kind == "revolute" and re.fullmatch(r"counts=[1-9]\d{0,11}", unit):
            return 2 * np.pi / int(unit[7:])
        if unit not in known:
            more = ", counts=N (per turn)" if role == "q" and kind == "revolute" else ""
            raise FreeArtError(f"{option} {unit}: joint '{joint.name}' is {kind}, expected {', '.join(known)}{more}")
        return known[unit]

    steps = np.concatenate([np.diff(values["t"]) for values in runs.values()])
    size_t = find_size("t", lambda: _unit_by_step(steps)) if "t" in roles else 1.0
    odd = float(np.quantile(np.abs(steps / np.median(steps) - 1), 0.95))
    notes.append(f"{1 / (size_t * np.median(steps)):.4g} rows a second, {'' if odd <= _EVEN else 'un'}evenly spaced")
    for values in runs.values():
        values["t"] = (values["t"] - values["t"][0]) * size_t
    gravity = np.asarray(GRAVITY if settings.gravity is None else settings.gravity, float)
    if settings.gravity is None:
        notes.append(f"gravity 0 0 -9.81 m/s^2, with z of link '{asset.reference_link}' up (else --gravity)")
    sign = -1.0 if settings.reverse else 1.0
    for role in roles:
        if role not in ("t", "q", "q_command", "enabled"):
            size = find_size(role) * (1.0 if role in base_json.COLUMNS else sign)
            for values in runs.values():
                if role in values:
                    values[role] = size * values[role]
    for values in runs.values():
        for role in ("q", "q_command"):
            if role in values:
                values[role] = sign * (values[role] - settings.zero)
    size_q = find_size(
        "q", lambda: _unit_by_range(roles["q"], written["q"], list(runs.values()), asset, joint, gravity)
    )
    held_out = _find_runs(settings.held_out, origin, "--held-out")
    prescribed = _find_runs(
        runs if facts.prescribed is True else facts.prescribed or (), origin, f"{where}: prescribed"
    )
    made = []
    for name, values in runs.items():
        run = _make_run(name, values, size_q, kind == "revolute" and facts.wrapped is not False, notes)
        marks = {"held_out": name in held_out if held_out else None, "prescribed": True if name in prescribed else None}
        made.append(replace(run, **marks))
    for role in drives:
        notes.append(f"{role}: {settings.interpolation or 'unknown'} between its rows (else --interpolation)")
    if not settings.held_out and len(made) > 1:
        notes.append(f"no run is held out: `gap` leaves each out in turn: {join_names(list(runs))} (else --held-out)")
    moves = bool(set(roles) & set(base_json.COLUMNS))
    marked, copies = drop_duplicate_runs(tuple(made))
    measured = Measured(
        joint.name,
        kind,
        asset.T_canonical_reference[:3, :3] @ gravity,
        settings.rate_hz or float(1 / (np.median(steps) * size_t)),
        "recorded" if odd > _EVEN else "nominal",
        settings.effort if "effort" in roles else None,
        law,
        settings.inertia_relative,
        settings.gravity_relative,
        marked,
        settings.interpolation or "unknown",
        base_json.base_axis_of(facts.base or ("moving" if moves else "fixed"), moves, base_json.ANGLE in roles, where),
    )
    with atomic.new_folder(out) as aside:
        write_measured(aside / "measured", measured)
        try:
            read_measured(aside / "measured")
        except FreeArtError as error:
            raise FreeArtError(str(error).replace(f"{aside}/", "")) from error  # that folder is gone then
    return [*notes, *copies]


def _assign_columns(
    series: Series, columns: dict[str, str], drives: set[str], rate_hz: float | None
) -> tuple[dict[str, str], list[str]]:
    """Role to column of one file: those that are stated, and others where one column alone can have the role.

    Also a line for each of the latter. FreeArtError when a role that is needed has no or several columns, or a column
    looks like a drive that is not described.
    """
    roles = {role: series.find_column(name) if "+" not in name else name for role, name in columns.items()}
    free = [name for name in series.columns if name not in roles.values()]
    usual = {role: [name for name in free if split_unit(name)[0] in names.split()] for role, names in _NAMES.items()}
    wanted = [*([] if rate_hz else ["t"]), *sorted(drives), *(["enabled"] if drives and usual["enabled"] else []), "q"]
    notes = []
    for role in wanted:
        if role in roles:
            continue
        found = usual[role]
        if not found and role in ("t", "q"):
            units = TIMES if role == "t" else (*POSITIONS["revolute"], *POSITIONS["prismatic"])
            found = [name for name in free if series.units.get(name) in units]
        if not found and role == "q":
            others = {name for other in usual.values() for name in other}
            found = [name for name in free if name not in others]
        if len(found) != 1:
            raise FreeArtError(
                f"{series.path}: which column is {role}? Expected --columns {role}=NAME"
                f"{', or --rate-hz for rows without times' if role == 't' else ''}; columns: "
                f"{join_names(found or list(series.columns))}"
            )
        roles[role] = found[0]
        free.remove(found[0])
        notes.append(f"column '{found[0]}' is {_WORDS.get(role, role)}")
    for role in ("effort", "q_command"):
        if role not in roles and usual[role] and not {"t", "q"} <= {*columns, *(["t"] if rate_hz else [])}:
            raise FreeArtError(
                f"{series.path}: column '{usual[role][0]}' looks like {role}: expected {_NEEDS[role]}; or, if it drove "
                f"nothing, --columns {' '.join(f'{r}={roles[r]}' for r in ('t', 'q') if r in roles)}"
            )
    return roles, notes


def _runs_of(series: Series, roles: dict[str, str], rate_hz: float | None) -> list[tuple[str, Values]]:
    """The runs of one file, split where the drive was switched on or off: their names, and values as in the file.

    Stretches shorter than MIN_SAMPLES are left out.
    """
    columns = {role: series.column(name) for role, name in roles.items()}
    sizes = {role: [len(run) for run in runs] for role, runs in columns.items()}
    for role, size in sizes.items():
        if size != sizes["q"]:
            raise FreeArtError(f"{series.path}: '{roles['q']}' has {sizes['q']} rows, but '{roles[role]}' {size}")
    stem = re.sub(r"[^\w.-]+", "_", series.path.stem).strip("._") or "run"
    made: list[tuple[str, Values]] = []
    for k, n in enumerate(sizes["q"]):
        name = f"{stem}_{k + 1}" if len(sizes["q"]) > 1 else stem
        values = {role: runs[k] for role, runs in columns.items()}
        if rate_hz is not None:
            values.setdefault("t", np.arange(n) / rate_hz)
        on = np.nan_to_num(values.pop("enabled", np.ones(n))) != 0
        edges = [0, *(np.flatnonzero(np.diff(on)) + 1).tolist(), n]
        for i, (begin, end) in enumerate(pairwise(edges)):
            without = () if on[begin] else _NEEDS
            part = {role: v[begin:end] for role, v in values.items() if role not in without}
            if len(edges) == 2:
                made.append((name, part))
            elif end - begin >= MIN_SAMPLES:
                made.append((f"{name}_{'on' if on[begin] else 'off'}_{i + 1}", part))
    return made


def _clean_rows(name: str, values: Values, notes: list[str]) -> Values:
    """The run without rows whose time is missing or repeated, from the first row on where every drive has a value."""
    t = values["t"]
    rows = np.flatnonzero(np.isfinite(t))
    rows = rows[np.diff(t[rows], prepend=np.nan) != 0]
    for role in _NEEDS:
        if role in values:
            rows = rows[int(np.argmax(np.isfinite(values[role][rows]))) :]
    if len(rows) < MIN_SAMPLES:
        raise FreeArtError(
            f"run '{name}' has {len(rows)} rows of a new time and with its drive, expected {MIN_SAMPLES} or more"
        )
    if len(rows) < len(t):
        notes.append(f"{name}: {len(t) - len(rows)} rows without a new time or a value of the drive were left out")
    return {role: v[rows] for role, v in values.items()}


def _make_run(name: str, values: Values, size_q: float, unwraps: bool, notes: list[str]) -> Run:
    """The run of these values, all in SI but positions and commands, whose unit is `size_q`; without jumps of a turn
    when it `unwraps`."""
    q, command, turns = size_q * values["q"], values.get("q_command"), 0
    command = None if command is None else size_q * command
    if unwraps:
        q, turns = unwrap_angles(q)
    if unwraps and command is not None:
        command, more = unwrap_command(command, q)
        turns += more
    if turns:
        notes.append(f"{name}: {turns} jumps of a whole turn were removed")
    base = base_json.base_of({"t_s": values["t"], **values}, Path(name))
    own = {role: values.get(role) for role in ("effort", "voltage", "qd")}
    return Run(name, values["t"], q, q_command=command, base=base, **own)


def _unit_by_step(steps: Array) -> tuple[str, str]:
    """The unit of times with these steps that gives some 2 to 2000 rows a second; FreeArtError when they count rows."""
    step = float(np.median(steps))
    if (steps == 1).all():
        raise FreeArtError("times count rows: expected --rate-hz, or --unit-t if they are times")
    unit = next((unit for unit, most in (("s", 0.5), ("ms", 500.0), ("us", 5e5)) if step < most), "ns")
    return unit, f"by a step of {step:.4g}"


def _unit_by_range(
    name: str, written: str | None, runs: list[Values], asset: Asset, joint: UrdfJoint, gravity: Array
) -> tuple[str, str]:
    """rad or deg, m or mm, and the reason: by the joint's limits, jumps of a turn, then the asset's equation of motion.

    Positions in `runs` are from the joint's zero, in the unknown unit; all else is in SI. Raises FreeArtError when more
    or less than one unit remains.
    """
    revolute = joint.joint_type == "revolute"
    sizes = {"rad": 1.0, "deg": np.pi / 180} if revolute else {"m": 1.0, "mm": 1e-3}
    q = np.concatenate([[0.0] if np.isnan(values["q"]).all() else values["q"] for values in runs])
    low, high, span = float(np.nanmin(q)), float(np.nanmax(q)), joint.upper - joint.lower
    if written == "counts":
        able, why = {}, "counts have no unit of their own"
    elif np.isfinite(span):
        least, most = joint.lower - _BEYOND * span, joint.upper + _BEYOND * span
        able = {unit: size for unit, size in sizes.items() if least <= low * size and high * size <= most}
        why = "the joint's limits allow it in " + (" and ".join(able) or "none")
    else:
        able, why = sizes, "the joint has no limits"
    if len(able) == 1:
        return next(iter(able)), "by the joint's limits"
    wrapped = [u for u, size in able.items() if revolute and any(is_wrapped(size * values["q"]) for values in runs)]
    if len(wrapped) == 1:
        return wrapped[0], "by its jumps from one end of a turn to the other"
    driven = any(role in values for values in runs for role in ("q_command", "voltage", *base_json.COLUMNS))
    if able and not driven and (mechanics := joint_mechanics(asset, gravity)) is not None:
        motions = [(values["t"], values["q"], values.get("effort")) for values in runs]
        if (unit := unit_by_motion(mechanics, motions, able)) is not None:
            return unit, "by the asset's inertia and the acting forces"
    if able and np.isfinite(span) and (high - low) >= _MOVED * span:
        return next(iter(able)), "by the joint's limits"
    raise FreeArtError(
        f"column '{name}': in which unit are positions of {low:.4g} to {high:.4g}? {why}, and no motion tells it: "
        f"expected {' or '.join(f'--unit-q {unit}' for unit in sizes)}{' or --unit-q counts=N (per turn)' * revolute}"
    )


def _find_runs(named: Any, origin: dict[str, Path], what: str) -> set[str]:
    """Names of the runs that are given by their names, their numbers from 1, or their files."""
    found: set[str] = set()
    for given in named if isinstance(named, list | tuple | dict) else [named]:
        own = {name for name, file in origin.items() if given in (name, file.name, file.stem, str(file))}
        own = own or {name for k, name in enumerate(origin, 1) if given == str(k)}
        if not own:
            raise FreeArtError(f"{what}: there is no run {given!r}; runs: {join_names(list(origin))}")
        found |= own
    return found
