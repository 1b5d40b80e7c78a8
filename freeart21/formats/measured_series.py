"""A measured set from recordings as people have them (`time_series`): columns, units, rate, and a line for each guess.

A recording does not say of which asset and joint it is, where gravity points, or what drove it: that is asked. What it
nearly says (which column is the time, whether degrees or radians) is guessed, and each guess is told. A column that
looks like a drive is never left out in silence: a joint that was driven, taken for a free one, has false effects.
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
from freeart21.files.asset import UrdfJoint, find_movable_joint, read_asset
from freeart21.files.measured import MAX_RATE_HZ, MIN_SAMPLES, read_measured
from freeart21.files.measured_writer import write_measured
from freeart21.formats import circumstances
from freeart21.formats.circumstances import Circumstances
from freeart21.formats.position_units import RawMotion, joint_mechanics, unit_by_motion
from freeart21.formats.series_rows import Raw, rising, trim_start
from freeart21.formats.time_series import Series, listed, read_series
from freeart21.joint import JointType
from freeart21.measured import EffortKind, Interpolation, Measured, Run, drop_duplicate_runs
from freeart21.mechanics import Actuator, JointMechanics
from freeart21.se3 import Array
from freeart21.turns import is_wrapped, unwrap_angles, unwrap_command

ROLES = ("t", "q", "effort", "q_command", "enabled", *circumstances.COLUMNS)
"""time; position; force or torque on the joint; commanded position; 0 where the drive was off; velocity; voltage; how
the base moved."""
DRIVES = ("effort", "q_command", "voltage")
"""Roles of what drove the joint."""
TIME_UNITS = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}
ANGLES = {"rad": 1.0, "deg": np.pi / 180, "turns": 2 * np.pi}
LENGTHS = {"m": 1.0, "cm": 1e-2, "mm": 1e-3}
EFFORTS = {"N*m": 1.0, "N*cm": 1e-2, "mN*m": 1e-3, "N": 1.0, "mN": 1e-3}
TimeUnit = Literal["s", "ms", "us", "ns"]
EffortUnit = Literal["N*m", "N*cm", "mN*m", "N", "mN"]
GRAVITY = (0.0, 0.0, -9.81)
"""m/s^2, z up."""
UNSURE = (0.1, 0.05)
"""Part of itself by which an asset's inertia, and its weight's torque or force, may be off when nobody says: what the
benchmark of `simgap` takes a bench to be worth. Larger ones explain away what they should not, smaller ones invent."""

_NAMES = {
    "t": "t time times timestamp timestamps stamp elapsed clock",
    "q": "q angle pos position theta phi joint_position joint_pos jointangle joint_angle qpos",
    "effort": "effort torque tau force joint_effort joint_torque motor_torque",
    "q_command": "q_command command cmd goal goal_position target target_position setpoint set_point reference ref "
    "q_des q_ref desired desired_position position_command",
    "enabled": "enabled enable torque_enable torque_enabled servo_on motor_on drive_on",
}
"""Names, without case and units, that columns of a role have."""
_WORDS = {
    "s": "s", "sec": "s", "secs": "s", "second": "s", "seconds": "s", "ms": "ms", "msec": "ms", "us": "us", "ns": "ns",
    "nsec": "ns", "nsecs": "ns", "usec": "us", "rad": "rad", "radian": "rad", "radians": "rad", "deg": "deg",
    "degs": "deg", "degree": "deg", "degrees": "deg", "°": "deg", "turns": "turns", "rev": "turns", "m": "m",
    "meters": "m", "metres": "m", "cm": "cm", "mm": "mm", "nm": "N*m", "n*m": "N*m", "n.m": "N*m", "n m": "N*m",
    "mnm": "mN*m", "ncm": "N*cm", "n": "N",
}  # fmt: skip
"""How files write units."""
_COUNTS = ("count", "counts", "encoder_counts", "tick", "ticks", "pulses", "steps", "raw", "raw_position", "adc", "lsb")
"""Names, without case, of columns that hold no unit but what a sensor counts."""
_EVEN = 0.02
"""Part of the median step by which nearly all steps of even times may differ: a clock that was counted, not read."""
_BEYOND = 0.25
"""Part of a joint's range by which readings may lie beyond its limits before their unit is doubted."""
_MOVED = 0.05
"""Part of a joint's range that a motion takes at least for the range to tell its unit: one that is wrong makes it 57 or
1000 times as large."""


@dataclass(frozen=True)
class SeriesSettings:
    """What is told of recordings; None is guessed, or not there."""

    columns: dict[str, str] = field(default_factory=dict)
    """Role to the name of a column; several joined by '+' are runs one after the other."""
    unit_t: TimeUnit | None = None
    unit_q: str | None = None
    """Of `ANGLES` or `LENGTHS`, or `counts=4096`: so many counts a turn."""
    unit_effort: EffortUnit | None = None
    zero: float = 0.0
    """The recording's position, in its unit, at the asset's joint position 0."""
    reverse: bool = False
    """The recording counts against the asset's joint."""
    rate_hz: float | None = None
    """Of rows without times."""
    gravity: tuple[float, float, float] | None = None
    """m/s^2, in the frame of the asset's reference link."""
    effort: EffortKind | None = None
    actuator: tuple[float, float] | None = None
    """Stiffness, N*m/rad or N/m, and damping, N*m*s/rad or N*s/m, of the law that follows the commands."""
    interpolation: Interpolation | None = None
    """Of efforts and commands between their rows; nobody knows when None."""
    inertia_relative: float | None = None
    gravity_relative: float | None = None
    held_out: tuple[str, ...] = ()
    """Names of runs, their numbers from 1, or names of files whose runs are all meant."""
    told: Circumstances = field(default_factory=Circumstances)
    """What there is no option for."""


_BETWEEN = {
    "held": "every value is held until the next row",
    "linear": "it goes straight from row to row",
    "unknown": "held until the next row or going on smoothly, nobody knows: the runs may tell (else --interpolation)",
}


def measure_series(
    files: Iterable[Path], out: Path, asset: Path, joint: str | None, settings: SeriesSettings
) -> list[str]:
    """Write `out/measured` from recordings of one joint of `asset` (a folder or a URDF); a line for each guess.

    Raises FreeArtError, in one line, when the files cannot be read, do not say which column is which, or make no
    measured set; nothing is then written.
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
    drives = _told_drives(settings)
    roles = []
    for series in all_series:
        notes += [f"{series.path.name}: {note}" for note in series.notes]
        found, said = _roles(series, settings, drives)
        roles.append(found)
        notes += [note for note in said if note not in notes]
    raw = [run for series, role in zip(all_series, roles, strict=True) for run in _raw_runs(series, role, settings)]
    said_units = _said_units(all_series, roles)
    raw, rate, clock = _timed(raw, settings, said_units.get("t"), roles[0].get("t"), notes)
    gravity, unsure = _circumstances(settings, chosen.reference_link, notes)
    runs = _scaled(raw, kind, scored, settings, (said_units, roles[0]), notes, joint_mechanics(chosen, gravity))
    if drives:
        held = " and ".join(d for d in DRIVES if d in roles[0])
        notes.append(f"{held}: {_BETWEEN[settings.interpolation or 'unknown']}")
    marked, copies = drop_duplicate_runs(_held_out(runs, files, settings.held_out))
    notes += copies
    if not settings.held_out and len(runs) > 1:
        names = listed([run.name for run in runs])
        notes.append(f"no run is held out: `gap` leaves each out in turn: {names} (else --held-out)")
    measured = Measured(
        scored.name,
        kind,
        chosen.T_canonical_reference[:3, :3] @ gravity,
        rate,
        "recorded" if clock else "nominal",
        settings.effort if "effort" in roles[0] else None,
        _actuator(settings),
        *unsure,
        tuple(replace(run, prescribed=settings.told.marks(run.name)) for run in marked),
        settings.interpolation or "unknown",
        settings.told.base_axis(set(roles[0])),
    )
    _check_prescribed(settings.told, marked)
    with atomic.new_folder(out) as aside:
        write_measured(aside / "measured", measured)
        try:
            read_measured(aside / "measured")
        except FreeArtError as error:  # of files that nobody will see: by their names alone
            raise FreeArtError(
                re.sub(rf"{re.escape(str(aside.resolve()))}/\S*/|{re.escape(str(aside))}/\S*/", "", str(error))
            ) from error
    return notes


def _actuator(settings: SeriesSettings) -> Actuator | None:
    """What is told of the actuator, by an option or in the file of circumstances."""
    return settings.told.actuator if settings.actuator is None else Actuator(None, *settings.actuator)


def _check_prescribed(told: Circumstances, runs: Iterable[Run]) -> None:
    """FreeArtError when a run that is called prescribed is not there."""
    names = [run.name for run in runs]
    odd = [name for name in (told.prescribed if isinstance(told.prescribed, tuple) else ()) if name not in names]
    if odd:
        raise FreeArtError(f"{told.where}: there is no run '{odd[0]}' to be prescribed; runs: {listed(names)}")


def _check_numbers(settings: SeriesSettings) -> None:
    """FreeArtError when a number that was told cannot be one."""
    for name in ("rate_hz", "zero", "gravity", "actuator", "inertia_relative", "gravity_relative"):
        value = getattr(settings, name)
        if value is not None and not np.isfinite(value).all():
            said = " ".join(map(str, np.atleast_1d(value)))
            raise FreeArtError(f"--{name.replace('_', '-')} {said}: expected a finite number each")
    if settings.rate_hz is not None and not 0 < settings.rate_hz <= MAX_RATE_HZ:
        raise FreeArtError(
            f"--rate-hz {settings.rate_hz:g}: expected above 0 and at most {MAX_RATE_HZ:g} rows a second"
        )


def _circumstances(settings: SeriesSettings, link: str, notes: list[str]) -> tuple[Array, tuple[float, float]]:
    """(3,) gravity in the frame of `link`, and how far inertia and weight of the asset may be off."""
    gravity = np.asarray(GRAVITY if settings.gravity is None else settings.gravity, float)
    if settings.gravity is None:
        notes.append(f"gravity 0 0 -9.81 m/s^2, z of link '{link}' being up (else --gravity)")
    inertia, weight = settings.inertia_relative, settings.gravity_relative
    unsure = (UNSURE[0] if inertia is None else inertia, UNSURE[1] if weight is None else weight)
    if inertia is None or weight is None:
        notes.append(
            f"the asset's inertia may be off by {unsure[0]:.0%} and its weight by {unsure[1]:.0%} (else "
            "--inertia-relative, --gravity-relative)"
        )
    return gravity, unsure


def _said_units(all_series: list[Series], roles: list[dict[str, str]]) -> dict[str, str | None]:
    """Role to the unit that the files write; FreeArtError when one writes another than the first."""
    first, *others = [
        {role: _unit_of(series.units.get(name), name) for role, name in found.items()}
        for series, found in zip(all_series, roles, strict=True)
    ]
    for series, units in zip(all_series[1:], others, strict=True):
        for role, unit in units.items():
            if unit != first.get(role, unit):
                raise FreeArtError(
                    f"{series.path}: {role} is in {unit or 'a unit that is not written'}, but in "
                    f"{first[role] or 'one that is not written'} in {all_series[0].path.name}; expected one for all"
                )
    return first


def columns_from(words: tuple[str, ...]) -> dict[str, str]:
    """Role to column, of words such as t=time, or of one JSON file that maps them."""
    if len(words) == 1 and "=" not in words[0]:
        path = Path(words[0])
        told: dict[str, object] = dict(checked.read_json(path, root=checked.ANYWHERE))
    else:
        pairs = [word.partition("=") for word in words]
        wrong = [word for word, (_, equals, name) in zip(words, pairs, strict=True) if not equals or not name]
        if wrong:
            raise FreeArtError(f"--columns {wrong[0]}: expected ROLE=NAME, such as t=time, or one JSON file of such")
        told = {role: name for role, _, name in pairs}
    for role, name in told.items():
        if role not in ROLES:
            raise FreeArtError(f"--columns: there is no role '{role}'; roles: {', '.join(ROLES)}")
        if not isinstance(name, str):
            raise FreeArtError(f"--columns: {role} is {json.dumps(name)}, expected the name of a column")
    return {role: str(name) for role, name in told.items()}


def _told_drives(settings: SeriesSettings) -> set[str]:
    """The drives that are told of; FreeArtError when one has no law, or a law no column."""
    named = set(DRIVES) & set(settings.columns)
    if "effort" in named and settings.effort is None:
        raise FreeArtError(f"--columns effort={settings.columns['effort']} needs --effort {_EFFORT_HELP}")
    if settings.actuator is not None and settings.told.actuator is not None:
        raise FreeArtError(f"--actuator and the actuator of {settings.told.where}: expected one of them")
    if "voltage" in settings.columns and (settings.told.actuator is None or settings.told.actuator.motor is None):
        raise FreeArtError(
            f"--columns voltage={settings.columns['voltage']} needs an actuator of type 'dc_motor' in --circumstances"
        )
    if "q_command" in named and _actuator(settings) is None:
        raise FreeArtError(f"--columns q_command={settings.columns['q_command']} needs --actuator {_ACTUATOR_HELP}")
    return named | ({"effort"} if settings.effort else set()) | ({"q_command"} if settings.actuator else set())


_EFFORT_HELP = "commanded (it passes the actuator) or external (a push of known size on the moving part)"
_ACTUATOR_HELP = "STIFFNESS DAMPING of the law that follows it"


def _bare(name: str) -> tuple[str, str | None]:
    """A column's name without case and unit, and the unit, such as ('angle', 'deg') of 'Angle_deg'."""
    low = re.sub(r"[^a-z0-9°*.]+", "_", name.casefold()).strip("_")
    head, _, tail = low.rpartition("_")
    if head and tail in _WORDS and tail != "m":
        return head, _WORDS[tail]
    return (low, "s") if low in ("seconds", "secs", "sec") else (low, None)


def _unit_of(said: str | None, name: str | None) -> str | None:
    """The unit that a file writes beside a column or into its name."""
    if said is not None and said.casefold() in _WORDS:
        return _WORDS[said.casefold()]
    return _bare(name)[1] if name else None


def _roles(series: Series, settings: SeriesSettings, drives: set[str]) -> tuple[dict[str, str], list[str]]:
    """Role to column of one file, and a line for each that was guessed."""
    roles = {role: series.found(name) if "+" not in name else name for role, name in settings.columns.items()}
    names = [name for name in series.columns if name not in roles.values()]
    notes = []
    exists = f"columns: {listed(list(series.columns))}"
    if "t" not in roles and settings.rate_hz is None:
        time = _named(series, names, "t") or [n for n in names if _may_be_time(series.columns[n])][:1]
        if not time:
            raise FreeArtError(
                f"{series.path}: which column is the time? --columns t=NAME, or --rate-hz for rows without; {exists}"
            )
        roles["t"] = time[0]
        names.remove(time[0])
        notes.append(f"column '{time[0]}' is the time")
    elif "t" not in roles:
        notes.append(f"rows come {settings.rate_hz:g} times a second")
    wanted = [role for role in ("effort", "q_command") if role not in roles]
    seen = {role: _named(series, names, role) for role in wanted}
    if "q" not in roles:
        rest = [n for n in names if not any(n in found for found in seen.values())]
        length = len(series.columns[roles["t"]][0]) if roles.get("t") in series.columns else None
        rest = [n for n in rest if length is None or len(series.columns[n][0]) == length]
        position = _named(series, rest, "q") or (rest[:1] if len(rest) == 1 or rest == _counted(rest) else [])
        if len(position) != 1:
            which = f"{' or '.join(position)}?" if position else "which column?"
            raise FreeArtError(f"{series.path}: the joint's position is {which} --columns q=NAME; {exists}")
        roles["q"] = position[0]
        notes.append(f"column '{position[0]}' is the joint's position")
    left_out = {"q"} | ({"t"} if settings.rate_hz is None else set()) <= set(settings.columns)
    for role in wanted:
        if role in drives:
            if len(seen[role]) != 1:
                raise FreeArtError(f"{series.path}: which column is {role}? --columns {role}=NAME; {exists}")
            roles[role] = seen[role][0]
            notes.append(f"column '{seen[role][0]}' is {role}")
        elif seen[role] and left_out:
            notes.append(f"column '{seen[role][0]}' is left out: it is said to drive nothing")
        elif seen[role]:
            need = f"--effort {_EFFORT_HELP}" if role == "effort" else f"--actuator {_ACTUATOR_HELP}"
            keep = " ".join(f"{r}={n}" for r, n in roles.items() if r in ("t", "q"))
            what = "an effort" if role == "effort" else "a command"
            raise FreeArtError(
                f"{series.path}: column '{seen[role][0]}' looks like {what}: say {need}; or, if it drove nothing, "
                f"--columns {keep}"
            )
    switch = _named(series, names, "enabled")
    if drives and switch and "enabled" not in roles:
        roles["enabled"] = switch[0]
        notes.append(f"column '{switch[0]}' says where the drive is on: runs are cut there")
    return roles, notes


def _named(series: Series, names: list[str], role: str) -> list[str]:
    """Columns whose name is one of a role's, the surest first; only one when a name is the role's own."""
    known = _NAMES[role].split()
    found = sorted((n for n in names if _bare(n)[0] in known), key=lambda n: known.index(_bare(n)[0]))
    if not found and role == "t":
        found = [n for n in names if _bare(n) == ("seconds", "s") or _bare(n)[0] in ("sec", "secs", "seconds")]
    return found[:1] if found and role != "q" else found


def _counted(names: list[str]) -> list[str]:
    """`names` when they are the numbers of columns without a header, else nothing."""
    return names if names and all(name.isdigit() for name in names) else []


def _may_be_time(runs: tuple[Array, ...]) -> bool:
    """Whether a column rises from row to row."""
    steps = np.diff(runs[0][np.isfinite(runs[0])])
    return bool(len(steps) > MIN_SAMPLES and (steps >= 0).all() and np.median(steps) > 0)


def _raw_runs(series: Series, roles: dict[str, str], settings: SeriesSettings) -> list[Raw]:
    """The runs of one file, cut where the drive was switched on or off."""
    told = {role: series.column(name) for role, name in roles.items()}
    count = len(told["q"])
    for role, runs in told.items():
        if len(runs) != count or any(len(a) != len(b) for a, b in zip(runs, told["q"], strict=True)):
            own, other = (listed([str(len(run)) for run in r]) for r in (told["q"], runs))
            raise FreeArtError(f"{series.path}: columns '{roles['q']}' and '{roles[role]}' have {own} and {other} rows")
    stem = _stem(series.path)
    made = []
    for k in range(count):
        values = {role: runs[k] for role, runs in told.items()}
        if "t" not in values:
            assert settings.rate_hz is not None
            values["t"] = np.arange(len(values["q"])) / settings.rate_hz
        made += _switched(Raw(stem if count == 1 else f"{stem}_{k + 1}", values))
    return made


def _switched(run: Raw) -> list[Raw]:
    """The stretches of a run in which its drive was on or off; those that are too short say nothing and go."""
    if "enabled" not in run.values:
        return [run]
    on = np.nan_to_num(run.values["enabled"]) != 0
    edges = [0, *(np.flatnonzero(np.diff(on.astype(int))) + 1).tolist(), len(on)]
    parts: list[Raw] = []
    for begin, end in pairwise(edges):
        values = {role: v[begin:end] for role, v in run.values.items() if role != "enabled"}
        if not on[begin]:
            values = {role: v for role, v in values.items() if role not in DRIVES}
        name = run.name if len(edges) == 2 else f"{run.name}_{'on' if on[begin] else 'off'}_{len(parts) + 1}"
        parts.append(Raw(name, values))
    return [part for part in parts if len(part.values["t"]) >= MIN_SAMPLES] or parts


def _timed(
    runs: list[Raw], settings: SeriesSettings, said: str | None, name: str | None, notes: list[str]
) -> tuple[list[Raw], float, bool]:
    """Runs with times in seconds from 0, their rate, and whether their times were read from a clock."""
    if name is None:
        assert settings.rate_hz is not None
        return runs, settings.rate_hz, False
    runs = [trim_start(rising(run, notes), notes) for run in runs]
    steps = np.concatenate([np.diff(run.values["t"]) for run in runs])
    step = float(np.median(steps))
    unit: str | None = settings.unit_t
    if unit is None:
        unit = said
        unit, why = (unit, "as it says") if unit in TIME_UNITS else _time_unit(step)
        notes.append(f"times are in {unit}, {why}: {1 / (step * TIME_UNITS[unit]):.4g} rows a second (else --unit-t)")
    scale = TIME_UNITS[unit]
    odd = float(np.quantile(np.abs(steps / step - 1), 0.95))
    jitters = odd > _EVEN
    if jitters:
        notes.append(f"times are uneven (by {min(odd, 9.99):.0%} of a step): taken as read from a clock and believed")
    else:
        notes.append("times are even: taken as counted, not read from a clock")
    if steps.max() > 10 * step:
        notes.append(f"the largest gap between two rows is {steps.max() * scale:.3g} s, {steps.max() / step:.0f} steps")
    clocks = [(run.values["t"] - run.values["t"][0]) * scale for run in runs]
    timed = [replace(run, values={**run.values, "t": t}) for run, t in zip(runs, clocks, strict=True)]
    return timed, 1 / (step * scale), jitters


def _time_unit(step: float) -> tuple[str, str]:
    """The unit in which rows come some 2 to 2000 times a second."""
    for unit, most in (("s", 0.5), ("ms", 500.0), ("us", 5e5)):
        if step < most:
            return unit, f"by a step of {step:.4g}"
    return "ns", f"by a step of {step:.4g}"


def _scaled(
    runs: list[Raw],
    kind: JointType,
    joint: UrdfJoint,
    settings: SeriesSettings,
    said: tuple[dict[str, str | None], dict[str, str]],
    notes: list[str],
    mechanics: JointMechanics | None,
) -> list[Run]:
    """Runs of positions in rad or m from the joint's zero, and of efforts in N*m or N."""
    units, names = said
    sizes = ANGLES if kind == "revolute" else LENGTHS
    sign = -1.0 if settings.reverse else 1.0
    written = units.get("effort")
    effort_unit: str | None = settings.unit_effort or (written if written in EFFORTS else None)
    expected = "N*m" if kind == "revolute" else "N"
    if "effort" in names and effort_unit is None:
        effort_unit = expected
        notes.append(f"efforts are in {expected}, which nothing says (else --unit-effort)")
    if effort_unit is not None and effort_unit.endswith("m") != (kind == "revolute"):
        raise FreeArtError(f"--unit-effort {effort_unit}: joint '{joint.name}' is {kind}, expected {expected}")
    unit = settings.unit_q or units.get("q")
    if settings.unit_q is None and unit not in sizes:
        known = sign * EFFORTS[effort_unit or "N"]
        unit, why = _position_unit(runs, joint, settings, names["q"], mechanics, known)
        low, high = _range(runs)
        notes.append(f"positions are in {unit}, {why}: {low:.4g} to {high:.4g} (else --unit-q)")
    elif settings.unit_q is None:
        low, high = _range(runs)
        notes.append(f"positions are in {unit}, as it says: {low:.4g} to {high:.4g} (else --unit-q)")
    size_q = unit_size(str(unit), kind, joint.name)
    made, wrapped, turned, empty = [], 0, 0, 0
    taken: set[str] = set()
    for run in runs:
        values = run.values
        q = sign * size_q * (values["q"] - settings.zero)
        if kind == "revolute" and settings.told.wrapped is not False:
            q, turns = unwrap_angles(q)
            wrapped += turns
        drives: dict[str, Any] = {"effort": None, "q_command": None}
        for role in drives:
            if role in values:
                empty += int(np.isnan(values[role]).sum())
                zero, size = (settings.zero, size_q) if role == "q_command" else (0.0, EFFORTS[effort_unit or "N"])
                drives[role] = sign * size * (values[role] - zero)
        if kind == "revolute" and drives["q_command"] is not None and settings.told.wrapped is not False:
            drives["q_command"], turns = unwrap_command(drives["q_command"], q)
            turned += turns
        name = next(n for n in (run.name, *(f"{run.name}_{k}" for k in range(2, 10**6))) if n not in taken)
        taken.add(name)
        made.append(replace(_beside(Run(name, values["t"], q), values, kind, sign, settings), **drives))
    if wrapped:
        notes.append(f"{wrapped} jumps of the position by a whole turn were undone")
    if turned:
        notes.append(f"{turned} jumps of the command by a whole turn were undone")
    if empty:
        notes.append(f"{empty} empty cells of drives are no rows of theirs")
    return made


def _beside(run: Run, values: dict[str, Array], kind: JointType, sign: float, settings: SeriesSettings) -> Run:
    """The run with what else was told of it: velocity and voltage, which count as positions do, and its base."""
    others = {r: settings.told.scale(r, kind) * values[r] for r in circumstances.COLUMNS if r in values}
    own = {role: sign * others[role] for role in ("qd", "voltage") if role in others}
    base = {role: series for role, series in others.items() if role not in own}
    moved = base_json.base_of({"t_s": values["t"], **base}, Path(run.name)) if base else None
    return replace(run, qd=own.get("qd"), voltage=own.get("voltage"), base=moved)


def _range(runs: list[Raw]) -> tuple[float, float]:
    q = np.concatenate([run.values["q"] for run in runs])
    q = q[np.isfinite(q)]
    return (float(q.min()), float(q.max())) if len(q) else (0.0, 0.0)


def unit_size(unit: str, kind: JointType, joint: str) -> float:
    """rad or m of one of a unit of positions, such as deg or counts=4096 (a turn); FreeArtError for another."""
    sizes = ANGLES if kind == "revolute" else LENGTHS
    name, _, number = unit.partition("=")
    if name == "counts" and kind == "revolute":
        with contextlib.suppress(ValueError):
            if 1 <= float(number) <= 1e12:
                return 2 * np.pi / float(number)
        raise FreeArtError(f"--unit-q {unit}: expected counts=N of N counts a turn, such as counts=4096")
    if unit not in sizes:
        more = " or counts=N (a turn)" if kind == "revolute" else ""
        raise FreeArtError(f"--unit-q {unit}: joint '{joint}' is {kind}, expected {', '.join(sizes)}{more}")
    return sizes[unit]


def _position_unit(
    runs: list[Raw],
    joint: UrdfJoint,
    settings: SeriesSettings,
    name: str,
    mechanics: JointMechanics | None,
    effort: float,
) -> tuple[str, str]:
    """rad or deg, m or mm, and why: what the joint's limits allow, and the asset's equation of motion says.

    `effort` is one of the efforts' unit in N*m or N, against the asset's joint when below 0. Raises FreeArtError when
    nothing tells.
    """
    revolute = joint.joint_type == "revolute"
    sizes = {"rad": 1.0, "deg": ANGLES["deg"]} if revolute else {"m": 1.0, "mm": LENGTHS["mm"]}
    low, high = _range(runs)
    asked = " or ".join(f"--unit-q {unit}" for unit in [*sizes, *(["counts=N (N a turn)"] if revolute else [])])
    what = f"column '{name}': in which unit are positions that read {low:.4g} to {high:.4g}?"
    if _bare(name)[0] in _COUNTS:
        raise FreeArtError(f"{what} Its name says counts: expected {asked}")
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
        raise FreeArtError(f"{what} Neither {' nor '.join(sizes)} is within the joint's limits: expected {asked}")
    if len(able) == 1:
        return next(iter(able)), "by the joint's limits"
    if not any(np.isfinite(run.values["q"]).any() for run in runs):
        return next(iter(sizes)), "as nothing was read"
    leaping = [u for u, size in able.items() if revolute and any(is_wrapped(size * r.values["q"]) for r in runs)]
    if len(leaping) == 1:
        return leaping[0], "by its leaps from one end of a turn to the other"
    driven = any(role in run.values for run in runs for role in ("q_command", "voltage", *base_json.COLUMNS))
    if mechanics is not None and not driven:
        q = [sign * (run.values["q"] - settings.zero) for run in runs]
        pushed = [effort * run.values["effort"] if "effort" in run.values else None for run in runs]
        times = [run.values["t"] for run in runs]
        unit = unit_by_motion(mechanics, [RawMotion(*each) for each in zip(times, q, pushed, strict=True)], able)
        if unit is not None:
            return unit, "by the asset's inertia and the forces at work"
    near = next(iter(sizes))
    if limited and (ends[1] - ends[0]) * sizes[near] >= _MOVED * span:
        return near, "by the joint's limits"
    raise FreeArtError(f"{what} Neither the joint's limits nor its motion tell: expected {asked}")


def _held_out(runs: list[Run], files: list[Path], named: tuple[str, ...]) -> tuple[Run, ...]:
    """Runs of which those that are named are held out; None of any when none is named."""
    if not named:
        return tuple(runs)
    wanted: set[str] = set()
    names = [run.name for run in runs]
    for said in named:
        stems = [_stem(file) for file in files if said in (file.name, file.stem, str(file))]
        mine = {name for name in names if name == said or any(f"{name}_".startswith(f"{stem}_") for stem in stems)}
        if not mine and said.isdigit() and 1 <= int(said) <= len(names):
            mine = {names[int(said) - 1]}
        if not mine:
            raise FreeArtError(f"--held-out: there is no run '{said}'; runs: {listed(names)}")
        wanted |= mine
    return tuple(replace(run, held_out=run.name in wanted) for run in runs)


def _stem(file: Path) -> str:
    """What the run of a file is called."""
    return re.sub(r"[^\w.-]+", "_", file.stem).strip("._") or "run"
