"""A measured set from recordings in text, JSON or MAT files (`time_series`): columns, units, rate, a line per guess.

The user states the asset and joint, gravity, and the drive. Which column is the time, whether positions are degrees or
radians, and the like are guessed, and each guess is reported. A column that looks like a drive must be named or
excluded by the user: treating a driven joint as free would give false effects.
"""

from __future__ import annotations

import contextlib
import json
import re
from collections.abc import Iterable
from dataclasses import dataclass, field, replace
from itertools import pairwise
from pathlib import Path
from typing import Any, Literal

import numpy as np

from freeart21.errors import FreeArtError
from freeart21.files import atomic, base_json, checked
from freeart21.files.asset import find_movable_joint, read_asset
from freeart21.files.measured import MAX_RATE_HZ, MIN_SAMPLES, read_measured, write_measured
from freeart21.files.urdf import UrdfJoint
from freeart21.formats import circumstances
from freeart21.formats.circumstances import Circumstances
from freeart21.formats.position_units import RawMotion, joint_mechanics, unit_by_motion
from freeart21.formats.series_rows import RawRun, remove_bad_times, trim_start
from freeart21.formats.time_series import Series, join_names, read_series
from freeart21.joint import JointType
from freeart21.measured import EffortKind, Interpolation, Measured, Run, drop_duplicate_runs
from freeart21.mechanics import Actuator, JointMechanics
from freeart21.se3 import Array
from freeart21.turns import is_wrapped, unwrap_angles, unwrap_command

ROLES = ("t", "q", "effort", "q_command", "enabled", *circumstances.COLUMNS)
"""time; position; force or torque on the joint; commanded position; drive on or off; velocity; voltage; base motion."""
DRIVES = ("effort", "q_command", "voltage")
"""Roles of the drive."""
TIME_UNITS = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}
ANGLES = {"rad": 1.0, "deg": np.pi / 180, "turns": 2 * np.pi}
LENGTHS = {"m": 1.0, "cm": 1e-2, "mm": 1e-3}
EFFORTS = {"N*m": 1.0, "N*cm": 1e-2, "mN*m": 1e-3, "N": 1.0, "mN": 1e-3}
TimeUnit = Literal["s", "ms", "us", "ns"]
EffortUnit = Literal["N*m", "N*cm", "mN*m", "N", "mN"]
GRAVITY = (0.0, 0.0, -9.81)
"""m/s^2, z up."""
UNSURE = (0.1, 0.05)
"""Default relative uncertainty of an asset's inertia, and of its gravity torque or force: the values of the `simgap`
benchmark. Larger ones hide real effects, smaller ones cause false ones."""

_ROLE_NAMES = {
    "t": "t time times timestamp timestamps stamp elapsed clock",
    "q": "q angle pos position theta phi joint_position joint_pos jointangle joint_angle qpos",
    "effort": "effort torque tau force joint_effort joint_torque motor_torque",
    "q_command": "q_command command cmd goal goal_position target target_position setpoint set_point reference ref "
    "q_des q_ref desired desired_position position_command",
    "enabled": "enabled enable torque_enable torque_enabled servo_on motor_on drive_on",
}
"""Role to column names, without case and unit."""
_UNIT_NAMES = {
    "s": "s", "sec": "s", "secs": "s", "second": "s", "seconds": "s", "ms": "ms", "msec": "ms", "us": "us", "ns": "ns",
    "nsec": "ns", "nsecs": "ns", "usec": "us", "rad": "rad", "radian": "rad", "radians": "rad", "deg": "deg",
    "degs": "deg", "degree": "deg", "degrees": "deg", "°": "deg", "turns": "turns", "rev": "turns", "m": "m",
    "meters": "m", "metres": "m", "cm": "cm", "mm": "mm", "nm": "N*m", "n*m": "N*m", "n.m": "N*m", "n m": "N*m",
    "mnm": "mN*m", "ncm": "N*cm", "n": "N",
}  # fmt: skip
"""Unit as written in files, in lower case, to our name of it."""
_COUNT_NAMES = (
    *("count", "counts", "encoder_counts", "tick", "ticks", "pulses", "steps", "raw", "raw_position", "adc", "lsb"),
)
"""Names, in lower case, of columns with raw sensor counts."""
_EVEN = 0.02
"""Relative deviation of 95 % of time steps from the median, up to which times count as nominal, not read from a
clock."""
_BEYOND = 0.25
"""Share of a joint's range by which readings can exceed its limits in the right unit."""
_MOVED = 0.05
"""Smallest motion, as a share of the joint's range, that shows its unit: a wrong unit changes it by 57 or 1000."""


@dataclass(frozen=True)
class SeriesSettings:
    """What the user states of recordings; None is guessed, or absent."""

    columns: dict[str, str] = field(default_factory=dict)
    """Role to a column's name. Names joined by '+' are consecutive runs."""
    unit_t: TimeUnit | None = None
    unit_q: str | None = None
    """A unit of `ANGLES` or `LENGTHS`, or `counts=4096` (per turn)."""
    unit_effort: EffortUnit | None = None
    zero: float = 0.0
    """Recorded position, in its unit, where the asset's joint is at 0."""
    reverse: bool = False
    """Whether the recording's positive direction is opposite to the joint axis."""
    rate_hz: float | None = None
    """Rows per second, of rows without times."""
    gravity: tuple[float, float, float] | None = None
    """m/s^2, in the frame of the asset's reference link."""
    effort: EffortKind | None = None
    actuator: tuple[float, float] | None = None
    """Stiffness, N*m/rad or N/m, and damping, N*m*s/rad or N*s/m, of the position controller."""
    interpolation: Interpolation | None = None
    """Efforts and commands between their rows; unknown when None."""
    inertia_relative: float | None = None
    gravity_relative: float | None = None
    held_out: tuple[str, ...] = ()
    """Names of runs, their numbers from 1, or names of files for all their runs."""
    circumstances: Circumstances = field(default_factory=Circumstances)
    """What has no option of its own."""


_BETWEEN = {
    "held": "each value holds until the next row",
    "linear": "linear between rows",
    "unknown": "held or smooth between rows is unknown; the runs can show it (else --interpolation)",
}


def measure_series(
    files: Iterable[Path], out: Path, asset: Path, joint: str | None, settings: SeriesSettings
) -> list[str]:
    """Write `out/measured` from recordings of one joint of `asset` (a folder or a URDF); gives a line for each guess.

    Raises FreeArtError when the files cannot be read, their columns are ambiguous, or they make no measured set;
    nothing is written then.
    """
    _check_numbers(settings)
    files = [Path(file) for file in files]
    chosen = read_asset(Path(asset), joint)
    scored = find_movable_joint(chosen.urdf, chosen.joint)
    kind = scored.joint_type
    assert kind is not None  # movable
    notes = []
    if joint is None:
        notes.append(
            f"joint '{scored.name}' ({scored.type}), the only movable one of {chosen.urdf.name} (else --joint)"
        )
    all_series = [read_series(file) for file in files]
    drives = _named_drives(settings)
    roles = []
    for series in all_series:
        notes += [f"{series.path.name}: {note}" for note in series.notes]
        found, guesses = _roles(series, settings, drives)
        roles.append(found)
        notes += [note for note in guesses if note not in notes]
    raw = [run for series, role in zip(all_series, roles, strict=True) for run in _raw_runs(series, role, settings)]
    written = _written_units(all_series, roles)
    raw, rate, clock = _scale_times(raw, settings, written.get("t"), roles[0].get("t"), notes)
    gravity, uncertainty = _gravity_and_uncertainty(settings, chosen.reference_link, notes)
    runs = _scale_runs(raw, kind, scored, settings, (written, roles[0]), notes, joint_mechanics(chosen, gravity))
    if drives:
        inputs = " and ".join(d for d in DRIVES if d in roles[0])
        notes.append(f"{inputs}: {_BETWEEN[settings.interpolation or 'unknown']}")
    marked, copies = drop_duplicate_runs(_mark_held_out(runs, files, settings.held_out))
    notes += copies
    if not settings.held_out and len(runs) > 1:
        names = join_names([run.name for run in runs])
        notes.append(f"no run is held out: `gap` leaves each out in turn: {names} (else --held-out)")
    measured = Measured(
        scored.name,
        kind,
        chosen.T_canonical_reference[:3, :3] @ gravity,
        rate,
        "recorded" if clock else "nominal",
        settings.effort if "effort" in roles[0] else None,
        _actuator(settings),
        *uncertainty,
        tuple(replace(run, prescribed=settings.circumstances.is_prescribed(run.name)) for run in marked),
        settings.interpolation or "unknown",
        settings.circumstances.base_axis(set(roles[0])),
    )
    _check_prescribed(settings.circumstances, marked)
    with atomic.new_folder(out) as aside:
        write_measured(aside / "measured", measured)
        try:
            read_measured(aside / "measured")
        except FreeArtError as error:  # the temporary folder does not appear in the message
            raise FreeArtError(
                re.sub(rf"{re.escape(str(aside.resolve()))}/\S*/|{re.escape(str(aside))}/\S*/", "", str(error))
            ) from error
    return notes


def _actuator(settings: SeriesSettings) -> Actuator | None:
    """The actuator, from an option or the file of circumstances."""
    return settings.circumstances.actuator if settings.actuator is None else Actuator(None, *settings.actuator)


def _check_prescribed(circumstances: Circumstances, runs: Iterable[Run]) -> None:
    """FreeArtError when a prescribed run does not exist."""
    names = [run.name for run in runs]
    prescribed = circumstances.prescribed
    odd = [name for name in (prescribed if isinstance(prescribed, tuple) else ()) if name not in names]
    if odd:
        where = circumstances.where
        raise FreeArtError(f"{where}: there is no run '{odd[0]}' to be prescribed; runs: {join_names(names)}")


def _check_numbers(settings: SeriesSettings) -> None:
    """FreeArtError when a number of the settings is not finite or out of range."""
    for name in ("rate_hz", "zero", "gravity", "actuator", "inertia_relative", "gravity_relative"):
        value = getattr(settings, name)
        if value is not None and not np.isfinite(value).all():
            given = " ".join(map(str, np.atleast_1d(value)))
            raise FreeArtError(f"--{name.replace('_', '-')} {given}: expected a finite number each")
    if settings.rate_hz is not None and not 0 < settings.rate_hz <= MAX_RATE_HZ:
        raise FreeArtError(
            f"--rate-hz {settings.rate_hz:g}: expected above 0 and at most {MAX_RATE_HZ:g} rows a second"
        )


def _gravity_and_uncertainty(
    settings: SeriesSettings, link: str, notes: list[str]
) -> tuple[Array, tuple[float, float]]:
    """(3,) gravity in the frame of `link`, m/s^2, and the relative uncertainties of inertia and gravity force."""
    gravity = np.asarray(GRAVITY if settings.gravity is None else settings.gravity, float)
    if settings.gravity is None:
        notes.append(f"gravity 0 0 -9.81 m/s^2, with z of link '{link}' up (else --gravity)")
    inertia, weight = settings.inertia_relative, settings.gravity_relative
    uncertainty = (UNSURE[0] if inertia is None else inertia, UNSURE[1] if weight is None else weight)
    if inertia is None or weight is None:
        notes.append(
            f"the asset's inertia is uncertain by {uncertainty[0]:.0%}, its weight by {uncertainty[1]:.0%} (else "
            "--inertia-relative, --gravity-relative)"
        )
    return gravity, uncertainty


def _written_units(all_series: list[Series], roles: list[dict[str, str]]) -> dict[str, str | None]:
    """Role to the unit in the files, None without one; FreeArtError when files differ."""
    first, *others = [
        {role: _unit_of(series.units.get(name), name) for role, name in found.items()}
        for series, found in zip(all_series, roles, strict=True)
    ]
    for series, units in zip(all_series[1:], others, strict=True):
        for role, unit in units.items():
            if unit != first.get(role, unit):
                raise FreeArtError(
                    f"{series.path}: {role} is in {unit or 'an unstated unit'}, but in "
                    f"{first[role] or 'an unstated one'} in {all_series[0].path.name}; expected the same for all"
                )
    return first


def columns_from(words: tuple[str, ...]) -> dict[str, str]:
    """Role to column, from words such as t=time, or from one JSON file."""
    if len(words) == 1 and "=" not in words[0]:
        path = Path(words[0])
        columns: dict[str, object] = dict(checked.read_json(path, root=checked.ANYWHERE))
    else:
        pairs = [word.partition("=") for word in words]
        wrong = [word for word, (_, equals, name) in zip(words, pairs, strict=True) if not equals or not name]
        if wrong:
            raise FreeArtError(f"--columns {wrong[0]}: expected ROLE=NAME, such as t=time, or one JSON file")
        columns = {role: name for role, _, name in pairs}
    for role, name in columns.items():
        if role not in ROLES:
            raise FreeArtError(f"--columns: there is no role '{role}'; roles: {', '.join(ROLES)}")
        if not isinstance(name, str):
            raise FreeArtError(f"--columns: {role} is {json.dumps(name)}, expected the name of a column")
    return {role: str(name) for role, name in columns.items()}


def _named_drives(settings: SeriesSettings) -> set[str]:
    """The drives that the user names; FreeArtError when one lacks its description."""
    named = set(DRIVES) & set(settings.columns)
    if "effort" in named and settings.effort is None:
        raise FreeArtError(f"--columns effort={settings.columns['effort']} needs --effort {_EFFORT_HELP}")
    if settings.actuator is not None and settings.circumstances.actuator is not None:
        raise FreeArtError(f"--actuator and the actuator of {settings.circumstances.where}: expected one of them")
    actuator = settings.circumstances.actuator
    if "voltage" in settings.columns and (actuator is None or actuator.motor is None):
        raise FreeArtError(
            f"--columns voltage={settings.columns['voltage']} needs an actuator of type 'dc_motor' in --circumstances"
        )
    if "q_command" in named and _actuator(settings) is None:
        raise FreeArtError(f"--columns q_command={settings.columns['q_command']} needs --actuator {_ACTUATOR_HELP}")
    return named | ({"effort"} if settings.effort else set()) | ({"q_command"} if settings.actuator else set())


_EFFORT_HELP = "commanded (to the actuator) or external (a known push on the moving part)"
_ACTUATOR_HELP = "STIFFNESS DAMPING of its position controller"


def _split_unit(name: str) -> tuple[str, str | None]:
    """A column's name in lower case without its unit, and the unit: ('angle', 'deg') for 'Angle_deg'."""
    low = re.sub(r"[^a-z0-9°*.]+", "_", name.casefold()).strip("_")
    head, _, tail = low.rpartition("_")
    if head and tail in _UNIT_NAMES and tail != "m":
        return head, _UNIT_NAMES[tail]
    return (low, "s") if low in ("seconds", "secs", "sec") else (low, None)


def _unit_of(written: str | None, name: str | None) -> str | None:
    """The unit of a column: as written next to its name, or as part of its name."""
    if written is not None and written.casefold() in _UNIT_NAMES:
        return _UNIT_NAMES[written.casefold()]
    return _split_unit(name)[1] if name else None


def _roles(series: Series, settings: SeriesSettings, drives: set[str]) -> tuple[dict[str, str], list[str]]:
    """Role to column of one file, and a line for each guess."""
    roles = {role: series.find_column(name) if "+" not in name else name for role, name in settings.columns.items()}
    names = [name for name in series.columns if name not in roles.values()]
    notes = []
    exists = f"columns: {join_names(list(series.columns))}"
    if "t" not in roles and settings.rate_hz is None:
        time = _columns_of(series, names, "t") or [n for n in names if _could_be_time(series.columns[n])][:1]
        if not time:
            raise FreeArtError(
                f"{series.path}: which column is the time? --columns t=NAME, or --rate-hz for rows without; {exists}"
            )
        roles["t"] = time[0]
        names.remove(time[0])
        notes.append(f"column '{time[0]}' is the time")
    elif "t" not in roles:
        notes.append(f"{settings.rate_hz:g} rows a second")
    missing = [role for role in ("effort", "q_command") if role not in roles]
    candidates = {role: _columns_of(series, names, role) for role in missing}
    if "q" not in roles:
        rest = [n for n in names if not any(n in found for found in candidates.values())]
        length = len(series.columns[roles["t"]][0]) if roles.get("t") in series.columns else None
        rest = [n for n in rest if length is None or len(series.columns[n][0]) == length]
        position = _columns_of(series, rest, "q") or (rest[:1] if len(rest) == 1 or rest == _numbered(rest) else [])
        if len(position) != 1:
            which = f"{' or '.join(position)}?" if position else "which column?"
            raise FreeArtError(f"{series.path}: the joint's position is {which} --columns q=NAME; {exists}")
        roles["q"] = position[0]
        notes.append(f"column '{position[0]}' is the joint's position")
    settled = {"q"} | ({"t"} if settings.rate_hz is None else set()) <= set(settings.columns)
    for role in missing:
        if role in drives:
            if len(candidates[role]) != 1:
                raise FreeArtError(f"{series.path}: which column is {role}? --columns {role}=NAME; {exists}")
            roles[role] = candidates[role][0]
            notes.append(f"column '{candidates[role][0]}' is {role}")
        elif candidates[role] and settled:
            notes.append(f"column '{candidates[role][0]}' is left out, as it was not named in --columns")
        elif candidates[role]:
            need = f"--effort {_EFFORT_HELP}" if role == "effort" else f"--actuator {_ACTUATOR_HELP}"
            others = " ".join(f"{r}={n}" for r, n in roles.items() if r in ("t", "q"))
            what = "an effort" if role == "effort" else "a command"
            raise FreeArtError(
                f"{series.path}: column '{candidates[role][0]}' looks like {what}: expected {need}; or, if it drove "
                f"nothing, --columns {others}"
            )
    switch = _columns_of(series, names, "enabled")
    if drives and switch and "enabled" not in roles:
        roles["enabled"] = switch[0]
        notes.append(f"column '{switch[0]}' says when the drive is on: runs are split there")
    return roles, notes


def _columns_of(series: Series, names: list[str], role: str) -> list[str]:
    """Columns with a name of the role, best first. Only the best one, but all for positions."""
    known = _ROLE_NAMES[role].split()
    found = sorted((n for n in names if _split_unit(n)[0] in known), key=lambda n: known.index(_split_unit(n)[0]))
    if not found and role == "t":
        found = [
            n for n in names if _split_unit(n) == ("seconds", "s") or _split_unit(n)[0] in ("sec", "secs", "seconds")
        ]
    return found[:1] if found and role != "q" else found


def _numbered(names: list[str]) -> list[str]:
    """`names` if they are the numbers of columns without a header, else none."""
    return names if names and all(name.isdigit() for name in names) else []


def _could_be_time(runs: tuple[Array, ...]) -> bool:
    """Whether a column never decreases, and mostly increases."""
    steps = np.diff(runs[0][np.isfinite(runs[0])])
    return bool(len(steps) > MIN_SAMPLES and (steps >= 0).all() and np.median(steps) > 0)


def _raw_runs(series: Series, roles: dict[str, str], settings: SeriesSettings) -> list[RawRun]:
    """The runs of one file, split where the drive was switched on or off."""
    columns = {role: series.column(name) for role, name in roles.items()}
    count = len(columns["q"])
    for role, runs in columns.items():
        if len(runs) != count or any(len(a) != len(b) for a, b in zip(runs, columns["q"], strict=True)):
            own, other = (join_names([str(len(run)) for run in r]) for r in (columns["q"], runs))
            raise FreeArtError(f"{series.path}: columns '{roles['q']}' and '{roles[role]}' have {own} and {other} rows")
    stem = _stem(series.path)
    made = []
    for k in range(count):
        values = {role: runs[k] for role, runs in columns.items()}
        if "t" not in values:
            assert settings.rate_hz is not None
            values["t"] = np.arange(len(values["q"])) / settings.rate_hz
        made += _split_by_drive(RawRun(stem if count == 1 else f"{stem}_{k + 1}", values))
    return made


def _split_by_drive(run: RawRun) -> list[RawRun]:
    """The stretches of a run with the drive on or off, without those shorter than MIN_SAMPLES."""
    if "enabled" not in run.values:
        return [run]
    on = np.nan_to_num(run.values["enabled"]) != 0
    edges = [0, *(np.flatnonzero(np.diff(on.astype(int))) + 1).tolist(), len(on)]
    parts: list[RawRun] = []
    for begin, end in pairwise(edges):
        values = {role: v[begin:end] for role, v in run.values.items() if role != "enabled"}
        if not on[begin]:
            values = {role: v for role, v in values.items() if role not in DRIVES}
        name = run.name if len(edges) == 2 else f"{run.name}_{'on' if on[begin] else 'off'}_{len(parts) + 1}"
        parts.append(RawRun(name, values))
    return [part for part in parts if len(part.values["t"]) >= MIN_SAMPLES] or parts


def _scale_times(
    runs: list[RawRun], settings: SeriesSettings, written: str | None, name: str | None, notes: list[str]
) -> tuple[list[RawRun], float, bool]:
    """Runs with times in seconds from 0, their rate in Hz, and whether their times were read from a clock."""
    if name is None:
        assert settings.rate_hz is not None
        return runs, settings.rate_hz, False
    runs = [trim_start(remove_bad_times(run, notes), notes) for run in runs]
    steps = np.concatenate([np.diff(run.values["t"]) for run in runs])
    step = float(np.median(steps))
    unit: str | None = settings.unit_t
    if unit is None:
        unit, why = (written, "as written") if written in TIME_UNITS else _time_unit(step)
        notes.append(f"times are in {unit}, {why}: {1 / (step * TIME_UNITS[unit]):.4g} rows a second (else --unit-t)")
    scale = TIME_UNITS[unit]
    odd = float(np.quantile(np.abs(steps / step - 1), 0.95))
    jitters = odd > _EVEN
    if jitters:
        notes.append(f"times are uneven (by {min(odd, 9.99):.0%} of a step): taken as recorded by a clock")
    else:
        notes.append("times are even: taken as nominal, not recorded by a clock")
    if steps.max() > 10 * step:
        notes.append(f"the largest gap between two rows is {steps.max() * scale:.3g} s, {steps.max() / step:.0f} steps")
    clocks = [(run.values["t"] - run.values["t"][0]) * scale for run in runs]
    timed = [replace(run, values={**run.values, "t": t}) for run, t in zip(runs, clocks, strict=True)]
    return timed, 1 / (step * scale), jitters


def _time_unit(step: float) -> tuple[str, str]:
    """The unit that gives some 2 to 2000 rows a second, and the reason."""
    for unit, most in (("s", 0.5), ("ms", 500.0), ("us", 5e5)):
        if step < most:
            return unit, f"by a step of {step:.4g}"
    return "ns", f"by a step of {step:.4g}"


def _scale_runs(
    runs: list[RawRun],
    kind: JointType,
    joint: UrdfJoint,
    settings: SeriesSettings,
    units_and_names: tuple[dict[str, str | None], dict[str, str]],
    notes: list[str],
    mechanics: JointMechanics | None,
) -> list[Run]:
    """Runs of positions in rad or m from the joint's zero, and of efforts in N*m or N."""
    units, names = units_and_names
    sizes = ANGLES if kind == "revolute" else LENGTHS
    sign = -1.0 if settings.reverse else 1.0
    written = units.get("effort")
    effort_unit: str | None = settings.unit_effort or (written if written in EFFORTS else None)
    expected = "N*m" if kind == "revolute" else "N"
    if "effort" in names and effort_unit is None:
        effort_unit = expected
        notes.append(f"efforts are in {expected}, a default (else --unit-effort)")
    if effort_unit is not None and effort_unit.endswith("m") != (kind == "revolute"):
        raise FreeArtError(f"--unit-effort {effort_unit}: joint '{joint.name}' is {kind}, expected {expected}")
    unit = settings.unit_q or units.get("q")
    if settings.unit_q is None and unit not in sizes:
        known = sign * EFFORTS[effort_unit or "N"]
        unit, why = _position_unit(runs, joint, settings, names["q"], mechanics, known)
        low, high = _position_range(runs)
        notes.append(f"positions are in {unit}, {why}: {low:.4g} to {high:.4g} (else --unit-q)")
    elif settings.unit_q is None:
        low, high = _position_range(runs)
        notes.append(f"positions are in {unit}, as written: {low:.4g} to {high:.4g} (else --unit-q)")
    size_q = unit_size(str(unit), kind, joint.name)
    made, wrapped, turned, empty = [], 0, 0, 0
    taken: set[str] = set()
    for run in runs:
        values = run.values
        q = sign * size_q * (values["q"] - settings.zero)
        if kind == "revolute" and settings.circumstances.wrapped is not False:
            q, turns = unwrap_angles(q)
            wrapped += turns
        drives: dict[str, Any] = {"effort": None, "q_command": None}
        for role in drives:
            if role in values:
                empty += int(np.isnan(values[role]).sum())
                zero, size = (settings.zero, size_q) if role == "q_command" else (0.0, EFFORTS[effort_unit or "N"])
                drives[role] = sign * size * (values[role] - zero)
        if kind == "revolute" and drives["q_command"] is not None and settings.circumstances.wrapped is not False:
            drives["q_command"], turns = unwrap_command(drives["q_command"], q)
            turned += turns
        name = next(n for n in (run.name, *(f"{run.name}_{k}" for k in range(2, 10**6))) if n not in taken)
        taken.add(name)
        made.append(replace(_with_other_columns(Run(name, values["t"], q), values, kind, sign, settings), **drives))
    if wrapped:
        notes.append(f"{wrapped} jumps of the position by a whole turn were removed")
    if turned:
        notes.append(f"{turned} jumps of the command by a whole turn were removed")
    if empty:
        notes.append(f"{empty} empty cells of drives count as no value")
    return made


def _with_other_columns(
    run: Run, values: dict[str, Array], kind: JointType, sign: float, settings: SeriesSettings
) -> Run:
    """The run with velocity and voltage, which have the sign of positions, and the motion of its base."""
    others = {r: settings.circumstances.scale(r, kind) * values[r] for r in circumstances.COLUMNS if r in values}
    own = {role: sign * others[role] for role in ("qd", "voltage") if role in others}
    base = {role: series for role, series in others.items() if role not in own}
    moved = base_json.base_of({"t_s": values["t"], **base}, Path(run.name)) if base else None
    return replace(run, qd=own.get("qd"), voltage=own.get("voltage"), base=moved)


def _position_range(runs: list[RawRun]) -> tuple[float, float]:
    q = np.concatenate([run.values["q"] for run in runs])
    q = q[np.isfinite(q)]
    return (float(q.min()), float(q.max())) if len(q) else (0.0, 0.0)


def unit_size(unit: str, kind: JointType, joint: str) -> float:
    """Size of a unit of positions in rad or m, such as deg or counts=4096 (per turn); FreeArtError for an unknown
    one."""
    sizes = ANGLES if kind == "revolute" else LENGTHS
    name, _, number = unit.partition("=")
    if name == "counts" and kind == "revolute":
        with contextlib.suppress(ValueError):
            if 1 <= float(number) <= 1e12:
                return 2 * np.pi / float(number)
        raise FreeArtError(f"--unit-q {unit}: expected counts=N (per turn), such as counts=4096")
    if unit not in sizes:
        more = " or counts=N (per turn)" if kind == "revolute" else ""
        raise FreeArtError(f"--unit-q {unit}: joint '{joint}' is {kind}, expected {', '.join(sizes)}{more}")
    return sizes[unit]


def _position_unit(
    runs: list[RawRun],
    joint: UrdfJoint,
    settings: SeriesSettings,
    name: str,
    mechanics: JointMechanics | None,
    effort: float,
) -> tuple[str, str]:
    """rad or deg, m or mm, and the reason: from the joint's limits, then from the asset's equation of motion.

    `effort` is the efforts' unit in N*m or N, negative when opposite to the asset's joint. Raises FreeArtError when the
    unit stays unknown.
    """
    revolute = joint.joint_type == "revolute"
    sizes = {"rad": 1.0, "deg": ANGLES["deg"]} if revolute else {"m": 1.0, "mm": LENGTHS["mm"]}
    low, high = _position_range(runs)
    options = " or ".join(f"--unit-q {unit}" for unit in [*sizes, *(["counts=N (N per turn)"] if revolute else [])])
    what = f"column '{name}': in which unit are positions that read {low:.4g} to {high:.4g}?"
    if _split_unit(name)[0] in _COUNT_NAMES:
        raise FreeArtError(f"{what} It seems to be sensor counts: expected {options}")
    sign = -1.0 if settings.reverse else 1.0
    ends = sorted((sign * (low - settings.zero), sign * (high - settings.zero)))
    span = joint.upper - joint.lower
    slack = _BEYOND * span
    limited = bool(np.isfinite(span))
    able = {
        unit: size
        for unit, size in sizes.items()
        if not limited or (joint.lower - slack <= ends[0] * size and ends[1] * size <= joint.upper + slack)
    }
    if not able:
        raise FreeArtError(f"{what} Neither {' nor '.join(sizes)} is within the joint's limits: expected {options}")
    if len(able) == 1:
        return next(iter(able)), "by the joint's limits"
    if not any(np.isfinite(run.values["q"]).any() for run in runs):
        return next(iter(sizes)), "as there are no readings"
    jumping = [u for u, size in able.items() if revolute and any(is_wrapped(size * r.values["q"]) for r in runs)]
    if len(jumping) == 1:
        return jumping[0], "by its jumps from one end of a turn to the other"
    driven = any(role in run.values for run in runs for role in ("q_command", "voltage", *base_json.COLUMNS))
    if mechanics is not None and not driven:
        q = [sign * (run.values["q"] - settings.zero) for run in runs]
        pushed = [effort * run.values["effort"] if "effort" in run.values else None for run in runs]
        times = [run.values["t"] for run in runs]
        unit = unit_by_motion(mechanics, [RawMotion(*each) for each in zip(times, q, pushed, strict=True)], able)
        if unit is not None:
            return unit, "by the asset's inertia and the acting forces"
    default = next(iter(sizes))
    if limited and (ends[1] - ends[0]) * sizes[default] >= _MOVED * span:
        return default, "by the joint's limits"
    raise FreeArtError(f"{what} Neither the joint's limits nor its motion show it: expected {options}")


def _mark_held_out(runs: list[Run], files: list[Path], named: tuple[str, ...]) -> tuple[Run, ...]:
    """The runs with `held_out` set by name; unset for all when none is named."""
    if not named:
        return tuple(runs)
    wanted: set[str] = set()
    names = [run.name for run in runs]
    for given in named:
        stems = [_stem(file) for file in files if given in (file.name, file.stem, str(file))]
        matches = {name for name in names if name == given or any(f"{name}_".startswith(f"{stem}_") for stem in stems)}
        if not matches and given.isdigit() and 1 <= int(given) <= len(names):
            matches = {names[int(given) - 1]}
        if not matches:
            raise FreeArtError(f"--held-out: there is no run '{given}'; runs: {join_names(names)}")
        wanted |= matches
    return tuple(replace(run, held_out=run.name in wanted) for run in runs)


def _stem(file: Path) -> str:
    """The name of a file's run."""
    return re.sub(r"[^\w.-]+", "_", file.stem).strip("._") or "run"
