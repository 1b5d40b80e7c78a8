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
from typing import Literal

import numpy as np

from freeart21.errors import FreeArtError
from freeart21.files import atomic, base_json, checked
from freeart21.files.asset import find_movable_joint, read_asset
from freeart21.files.measured import MAX_RATE_HZ, MIN_SAMPLES, read_measured, write_measured
from freeart21.files.urdf import UrdfJoint
from freeart21.formats import circumstances
from freeart21.formats.circumstances import Circumstances
from freeart21.formats.position_units import joint_mechanics, unit_by_motion
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
Values = dict[str, Array]
"""Role to the (n,) numbers of one run."""

_ROLE_NAMES = {
    "t": "t time times timestamp timestamps stamp elapsed clock sec secs seconds",
    "q": "q angle pos position theta phi joint_position joint_pos jointangle joint_angle qpos",
    "effort": "effort torque tau force joint_effort joint_torque motor_torque",
    "q_command": "q_command command cmd goal goal_position target target_position setpoint set_point reference ref "
    "q_des q_ref desired desired_position position_command",
    "enabled": "enabled enable torque_enable torque_enabled servo_on motor_on drive_on",
}
"""Role to column names, without case and unit, the likeliest first."""
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
_SWAPPED, _SWAPPED_STEPS = 0.05, 10
"""Largest share of late rows, and by how many steps, in one recording: networks swap neighbours, while a second
recording starts again. Not measured."""
_NEEDS = {
    "effort": "--effort commanded (to the actuator) or external (a known push on the moving part)",
    "q_command": "--actuator STIFFNESS DAMPING of its position controller",
    "voltage": "an actuator of type 'dc_motor' in --circumstances",
}
"""Drive to the option that describes it."""
_BETWEEN = {
    "held": "each value holds until the next row",
    "linear": "linear between rows",
    "unknown": "held or smooth between rows is unknown; the runs can show it (else --interpolation)",
}


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

    def __post_init__(self) -> None:
        for name in ("rate_hz", "zero", "gravity", "actuator", "inertia_relative", "gravity_relative"):
            value = getattr(self, name)
            if value is not None and not np.isfinite(value).all():
                given = " ".join(map(str, np.atleast_1d(value)))
                raise FreeArtError(f"--{name.replace('_', '-')} {given}: expected a finite number each")
        if self.rate_hz is not None and not 0 < self.rate_hz <= MAX_RATE_HZ:
            raise FreeArtError(
                f"--rate-hz {self.rate_hz:g}: expected above 0 and at most {MAX_RATE_HZ:g} rows a second"
            )
        if self.actuator is not None and self.circumstances.actuator is not None:
            raise FreeArtError(f"--actuator and the actuator of {self.circumstances.where}: expected one of them")
        law = self.law
        described = {"effort": self.effort, "q_command": law, "voltage": law and law.motor}
        for role in DRIVES:
            if role in self.columns and described[role] is None:
                raise FreeArtError(f"--columns {role}={self.columns[role]} needs {_NEEDS[role]}")

    @property
    def law(self) -> Actuator | None:
        """The actuator, from an option or the file of circumstances."""
        return self.circumstances.actuator if self.actuator is None else Actuator(None, *self.actuator)

    @property
    def drives(self) -> set[str]:
        """The drives that the user names or describes."""
        described = {"effort"} if self.effort else set()
        return described | ({"q_command"} if self.actuator else set()) | (set(DRIVES) & set(self.columns))

    @property
    def sign(self) -> float:
        """-1 where the recording's positive direction is opposite to the joint axis."""
        return -1.0 if self.reverse else 1.0


def columns_from(words: tuple[str, ...]) -> dict[str, str]:
    """Role to column, from words such as t=time, or from one JSON file."""
    if len(words) == 1 and "=" not in words[0]:
        columns = dict(checked.read_json(Path(words[0]), root=checked.ANYWHERE))
    else:
        columns = {role: name for role, _, name in (word.partition("=") for word in words)}
    for role, name in columns.items():
        if name == "":
            raise FreeArtError(f"--columns {role}: expected ROLE=NAME, such as t=time, or one JSON file")
        if role not in ROLES:
            raise FreeArtError(f"--columns: there is no role '{role}'; roles: {', '.join(ROLES)}")
        if not isinstance(name, str):
            raise FreeArtError(f"--columns: {role} is {json.dumps(name)}, expected the name of a column")
    return columns


def measure_series(
    files: Iterable[Path], out: Path, asset: Path, joint: str | None, settings: SeriesSettings
) -> list[str]:
    """Write `out/measured` from recordings of one joint of `asset` (a folder or a URDF); gives a line for each guess.

    Raises FreeArtError when the files cannot be read, their columns are ambiguous, or they make no measured set;
    nothing is written then.
    """
    files, facts, notes = [Path(file) for file in files], settings.circumstances, []
    chosen = read_asset(Path(asset), joint)
    scored = find_movable_joint(chosen.urdf, chosen.joint)
    kind = scored.joint_type
    assert kind is not None  # movable
    if joint is None:
        notes.append(
            f"joint '{scored.name}' ({scored.type}), the only movable one of {chosen.urdf.name} (else --joint)"
        )
    all_series, roles = [read_series(file) for file in files], []
    for series in all_series:
        notes += [f"{series.path.name}: {note}" for note in series.notes]
        found, guesses = _roles(series, settings)
        roles.append(found)
        notes += [note for note in guesses if note not in notes]
    runs: dict[str, Values] = {}
    for series, found in zip(all_series, roles, strict=True):
        for name, values in _runs_of(series, found, settings):
            tries = (name, *(f"{name}_{k}" for k in range(2, 10**6)))
            runs[next(free for free in tries if free not in runs)] = values
    units = _written_units(all_series, roles)
    names = roles[0]
    rate, clock = settings.rate_hz or 0.0, False
    if "t" in names:
        runs = {name: _clean_rows(name, values, notes) for name, values in runs.items()}
        runs, rate, clock = _scale_times(runs, settings.unit_t, units["t"], notes)
    gravity = np.asarray(GRAVITY if settings.gravity is None else settings.gravity, float)
    if settings.gravity is None:
        notes.append(f"gravity 0 0 -9.81 m/s^2, with z of link '{chosen.reference_link}' up (else --gravity)")
    given = settings.inertia_relative, settings.gravity_relative
    uncertainty = [own if one is None else one for one, own in zip(given, UNSURE, strict=True)]
    if None in given:
        notes.append(
            f"the asset's inertia is uncertain by {uncertainty[0]:.0%}, its weight by {uncertainty[1]:.0%} (else "
            "--inertia-relative, --gravity-relative)"
        )
    size_effort = _effort_size(settings, units.get("effort"), "effort" in names, scored, notes)
    size_q = _position_size(
        runs, scored, settings, names["q"], units["q"], size_effort, joint_mechanics(chosen, gravity), notes
    )
    made = _scale_runs(runs, kind, settings, size_q, size_effort, notes)
    if settings.drives:
        inputs = " and ".join(d for d in DRIVES if d in names)
        notes.append(f"{inputs}: {_BETWEEN[settings.interpolation or 'unknown']}")
    marked, copies = drop_duplicate_runs(_mark_held_out(made, files, settings.held_out))
    notes += copies
    if not settings.held_out and len(made) > 1:
        notes.append(
            f"no run is held out: `gap` leaves each out in turn: {join_names([run.name for run in made])} (else "
            "--held-out)"
        )
    measured = Measured(
        scored.name,
        kind,
        chosen.T_canonical_reference[:3, :3] @ gravity,
        rate,
        "recorded" if clock else "nominal",
        settings.effort if "effort" in names else None,
        settings.law,
        *uncertainty,
        facts.mark_prescribed(marked),
        settings.interpolation or "unknown",
        facts.base_axis(set(names)),
    )
    with atomic.new_folder(out) as aside:
        write_measured(aside / "measured", measured)
        try:
            read_measured(aside / "measured")
        except FreeArtError as error:  # the temporary folder does not appear in the message
            raise FreeArtError(
                re.sub(rf"{re.escape(str(aside.resolve()))}/\S*/|{re.escape(str(aside))}/\S*/", "", str(error))
            ) from error
    return notes


# columns


def _split_unit(name: str) -> tuple[str, str | None]:
    """A column's name in lower case without its unit, and the unit: ('angle', 'deg') for 'Angle_deg'."""
    low = re.sub(r"[^a-z0-9°*.]+", "_", name.casefold()).strip("_")
    head, _, tail = low.rpartition("_")
    if head and tail in _UNIT_NAMES and tail != "m":
        return head, _UNIT_NAMES[tail]
    return (low, "s") if low in ("seconds", "secs", "sec") else (low, None)


def _written_units(all_series: list[Series], roles: list[dict[str, str]]) -> dict[str, str | None]:
    """Role to the unit next to or in its column's name, None without one; FreeArtError when files differ."""
    first: dict[str, str | None] = {}
    for series, found in zip(all_series, roles, strict=True):
        for role, name in found.items():
            unit = _UNIT_NAMES.get(series.units.get(name, "").casefold()) or _split_unit(name)[1]
            if first.setdefault(role, unit) != unit:
                raise FreeArtError(
                    f"{series.path}: {role} is in {unit or 'an unstated unit'}, but in "
                    f"{first[role] or 'an unstated one'} in {all_series[0].path.name}; expected the same for all"
                )
    return first


def _roles(series: Series, settings: SeriesSettings) -> tuple[dict[str, str], list[str]]:
    """Role to column of one file, and a line for each guess."""
    roles = {role: series.find_column(name) if "+" not in name else name for role, name in settings.columns.items()}
    names = [name for name in series.columns if name not in roles.values()]
    notes = []
    exists = f"columns: {join_names(list(series.columns))}"

    def find(role: str, among: list[str]) -> list[str]:
        known = _ROLE_NAMES[role].split()
        return sorted((n for n in among if _split_unit(n)[0] in known), key=lambda n: known.index(_split_unit(n)[0]))

    def take(role: str, name: str, what: str) -> None:
        roles[role] = name
        notes.append(f"column '{name}' {what}")

    if "t" not in roles and settings.rate_hz is None:
        time = find("t", names) or [name for name in names if _could_be_time(series.columns[name][0])]
        if not time:
            raise FreeArtError(
                f"{series.path}: which column is the time? --columns t=NAME, or --rate-hz for rows without; {exists}"
            )
        take("t", time[0], "is the time")
        names.remove(time[0])
    elif "t" not in roles:
        notes.append(f"{settings.rate_hz:g} rows a second")
    candidates = {role: find(role, names)[:1] for role in ("effort", "q_command") if role not in roles}
    if "q" not in roles:
        length = len(series.columns[roles["t"]][0]) if roles.get("t") in series.columns else None
        rest = [name for name in names if [name] not in candidates.values()]
        rest = [name for name in rest if length in (None, len(series.columns[name][0]))]
        alone = len(rest) == 1 or all(name.isdigit() for name in rest)  # numbers are columns without a header
        position = find("q", rest) or (rest[:1] if alone else [])
        if len(position) != 1:
            which = f"{' or '.join(position)}?" if position else "which column?"
            raise FreeArtError(f"{series.path}: the joint's position is {which} --columns q=NAME; {exists}")
        take("q", position[0], "is the joint's position")
    settled = {"q"} | ({"t"} if settings.rate_hz is None else set()) <= set(settings.columns)
    for role, found in candidates.items():
        if role in settings.drives:
            if not found:
                raise FreeArtError(f"{series.path}: which column is {role}? --columns {role}=NAME; {exists}")
            take(role, found[0], f"is {role}")
        elif found and settled:
            notes.append(f"column '{found[0]}' is left out, as it was not named in --columns")
        elif found:
            others = " ".join(f"{r}={n}" for r, n in roles.items() if r in ("t", "q"))
            what = "an effort" if role == "effort" else "a command"
            raise FreeArtError(
                f"{series.path}: column '{found[0]}' looks like {what}: expected {_NEEDS[role]}; or, if it drove "
                f"nothing, --columns {others}"
            )
    switch = find("enabled", names)
    if settings.drives and switch and "enabled" not in roles:
        take("enabled", switch[0], "says when the drive is on: runs are split there")
    return roles, notes


def _could_be_time(column: Array) -> bool:
    """Whether a column never decreases, and mostly increases."""
    steps = np.diff(column[np.isfinite(column)])
    return bool(len(steps) > MIN_SAMPLES and (steps >= 0).all() and np.median(steps) > 0)


# rows


def _runs_of(series: Series, roles: dict[str, str], settings: SeriesSettings) -> list[tuple[str, Values]]:
    """The runs of one file, split where the drive was switched on or off: their names, and values as in the file."""
    columns = {role: series.column(name) for role, name in roles.items()}
    sizes = {role: [len(run) for run in runs] for role, runs in columns.items()}
    for role, size in sizes.items():
        if size != sizes["q"]:
            own, other = (join_names(list(map(str, one))) for one in (sizes["q"], size))
            raise FreeArtError(f"{series.path}: columns '{roles['q']}' and '{roles[role]}' have {own} and {other} rows")
    made: list[tuple[str, Values]] = []
    for k, n in enumerate(sizes["q"]):
        values = {role: runs[k] for role, runs in columns.items()}
        if settings.rate_hz is not None:
            values.setdefault("t", np.arange(n) / settings.rate_hz)
        made += _split_by_drive(_stem(series.path) + (f"_{k + 1}" if len(sizes["q"]) > 1 else ""), values)
    return made


def _stem(file: Path) -> str:
    """The name of a file's run."""
    return re.sub(r"[^\w.-]+", "_", file.stem).strip("._") or "run"


def _split_by_drive(name: str, values: Values) -> list[tuple[str, Values]]:
    """The stretches of a run with the drive on or off, without those shorter than MIN_SAMPLES."""
    if "enabled" not in values:
        return [(name, values)]
    on = np.nan_to_num(values["enabled"]) != 0
    edges = [0, *(np.flatnonzero(np.diff(on.astype(int))) + 1).tolist(), len(on)]
    parts: list[tuple[str, Values]] = []
    for k, (begin, end) in enumerate(pairwise(edges)):
        without = ("enabled",) if on[begin] else ("enabled", *DRIVES)
        part = {role: v[begin:end] for role, v in values.items() if role not in without}
        parts.append((name if len(edges) == 2 else f"{name}_{'on' if on[begin] else 'off'}_{k + 1}", part))
    return [part for part in parts if len(part[1]["t"]) >= MIN_SAMPLES] or parts


def _clean_rows(name: str, values: Values, notes: list[str]) -> Values:
    """The run without rows whose time is missing or repeated, sorted where a few are slightly out of order as after a
    network, from the first row on where every drive has a value. FreeArtError when time goes back."""
    t = values["t"]
    rows = np.flatnonzero(np.isfinite(t))
    steps = np.diff(t[rows])
    late = int((steps < 0).sum())
    by = (np.maximum.accumulate(t[rows]) - t[rows]).max(initial=0.0)
    if 0 < late <= _SWAPPED * len(t) and by <= _SWAPPED_STEPS * np.median(np.abs(steps)):
        rows = rows[np.argsort(t[rows], kind="stable")]
        notes.append(f"{name}: {late} rows came late, and were sorted")
    rows = rows[np.diff(t[rows], prepend=np.nan) != 0]
    if len(rows) < MIN_SAMPLES:
        raise FreeArtError(f"run '{name}' has {len(rows)} rows of different times, expected {MIN_SAMPLES} or more")
    back = np.flatnonzero(np.diff(t[rows]) < 0)
    if len(back):
        before, row = rows[back[0] : back[0] + 2]
        raise FreeArtError(
            f"run '{name}': time goes back from {t[before]:g} to {t[row]:g} in row {row + 1}, expected increasing "
            "times. Is it a second recording? Give each its own file"
        )
    if len(rows) < len(t):
        notes.append(f"{name}: {len(t) - len(rows)} rows without a new time were left out")
    drives = [role for role in DRIVES if role in values]
    known = {role: np.isfinite(values[role][rows]) for role in drives}
    lacking = [role for role in drives if not known[role].any()]
    if lacking:
        raise FreeArtError(f"run '{name}': {lacking[0]} has no value; leave out the column or the run")
    first = max((int(np.argmax(there)) for there in known.values()), default=0)
    if len(rows) - first < MIN_SAMPLES:
        raise FreeArtError(
            f"run '{name}': {' and '.join(drives)} begin in row {first + 1} of {len(rows)}, expected {MIN_SAMPLES} "
            "rows or more from there on"
        )
    if first:
        notes.append(f"{name}: the first {first} rows were left out: they have no {' and '.join(drives)}")
    return {role: v[rows[first:]] for role, v in values.items()}


# units


def _scale_times(
    runs: dict[str, Values], unit: str | None, written: str | None, notes: list[str]
) -> tuple[dict[str, Values], float, bool]:
    """Runs with times in seconds from 0, their rate in Hz, and whether their times were read from a clock.

    `unit` is that of the user, `written` that of the files. Without one, it gives some 2 to 2000 rows a second.
    """
    steps = np.concatenate([np.diff(values["t"]) for values in runs.values()])
    step = float(np.median(steps))
    if unit is None:
        unit, why = written, "as written"
        if unit not in TIME_UNITS:
            unit = next((unit for unit, most in (("s", 0.5), ("ms", 500.0), ("us", 5e5)) if step < most), "ns")
            why = f"by a step of {step:.4g}"
        notes.append(f"times are in {unit}, {why}: {1 / (step * TIME_UNITS[unit]):.4g} rows a second (else --unit-t)")
    scale = TIME_UNITS[unit]
    odd = float(np.quantile(np.abs(steps / step - 1), 0.95))
    if odd > _EVEN:
        notes.append(f"times are uneven (by {min(odd, 9.99):.0%} of a step): taken as recorded by a clock")
    else:
        notes.append("times are even: taken as nominal, not recorded by a clock")
    if steps.max() > 10 * step:
        notes.append(f"the largest gap between two rows is {steps.max() * scale:.3g} s, {steps.max() / step:.0f} steps")
    timed = {name: {**values, "t": (values["t"] - values["t"][0]) * scale} for name, values in runs.items()}
    return timed, 1 / (step * scale), odd > _EVEN


def _effort_size(
    settings: SeriesSettings, written: str | None, present: bool, joint: UrdfJoint, notes: list[str]
) -> float:
    """Size of the unit of efforts, in N*m or N."""
    expected = "N*m" if joint.joint_type == "revolute" else "N"
    unit: str | None = settings.unit_effort or (written if written in EFFORTS else None)
    if present and unit is None:
        notes.append(f"efforts are in {expected}, a default (else --unit-effort)")
    unit = unit or expected
    if unit.endswith("m") != (expected == "N*m"):
        raise FreeArtError(f"--unit-effort {unit}: joint '{joint.name}' is {joint.joint_type}, expected {expected}")
    return EFFORTS[unit]


def _position_size(
    runs: dict[str, Values],
    joint: UrdfJoint,
    settings: SeriesSettings,
    name: str,
    written: str | None,
    size_effort: float,
    mechanics: JointMechanics | None,
    notes: list[str],
) -> float:
    """Size of the unit of positions of the column `name`, in rad or m."""
    unit, kind = settings.unit_q, joint.joint_type
    sizes = ANGLES if kind == "revolute" else LENGTHS
    if unit is None:
        q = np.concatenate([values["q"] for values in runs.values()])
        q = q[np.isfinite(q)] if np.isfinite(q).any() else np.zeros(1)
        low, high = float(q.min()), float(q.max())
        unit, why = written, "as written"
        if unit not in sizes:
            unit, why = _guess_unit(runs, joint, settings, name, mechanics, size_effort, (low, high))
        notes.append(f"positions are in {unit}, {why}: {low:.4g} to {high:.4g} (else --unit-q)")
    word, _, number = unit.partition("=")
    if word == "counts" and kind == "revolute":
        with contextlib.suppress(ValueError):
            if 1 <= float(number) <= 1e12:
                return 2 * np.pi / float(number)
        raise FreeArtError(f"--unit-q {unit}: expected counts=N (per turn), such as counts=4096")
    if unit not in sizes:
        more = " or counts=N (per turn)" if kind == "revolute" else ""
        raise FreeArtError(f"--unit-q {unit}: joint '{joint.name}' is {kind}, expected {', '.join(sizes)}{more}")
    return sizes[unit]


def _guess_unit(
    runs: dict[str, Values],
    joint: UrdfJoint,
    settings: SeriesSettings,
    name: str,
    mechanics: JointMechanics | None,
    size_effort: float,
    ends: tuple[float, float],
) -> tuple[str, str]:
    """rad or deg, m or mm, and the reason: from the joint's limits, then from the asset's equation of motion.

    `ends` are the least and the largest reading. Raises FreeArtError when the unit stays unknown.
    """
    revolute, sign = joint.joint_type == "revolute", settings.sign
    sizes = {"rad": 1.0, "deg": ANGLES["deg"]} if revolute else {"m": 1.0, "mm": LENGTHS["mm"]}
    options = " or ".join(f"--unit-q {unit}" for unit in [*sizes, *(["counts=N (N per turn)"] if revolute else [])])

    def ask(why: str) -> FreeArtError:
        what = f"in which unit are positions that read {ends[0]:.4g} to {ends[1]:.4g}?"
        return FreeArtError(f"column '{name}': {what} {why}: expected {options}")

    if _split_unit(name)[0] in _COUNT_NAMES:
        raise ask("It seems to be sensor counts")
    low, high = sorted(sign * (end - settings.zero) for end in ends)
    span = joint.upper - joint.lower
    least, most = joint.lower - _BEYOND * span, joint.upper + _BEYOND * span
    limited = bool(np.isfinite(span))
    able = {unit: size for unit, size in sizes.items() if not limited or (least <= low * size and high * size <= most)}
    if not able:
        raise ask(f"Neither {' nor '.join(sizes)} is within the joint's limits")
    if len(able) == 1:
        return next(iter(able)), "by the joint's limits"
    default = next(iter(sizes))
    if not any(np.isfinite(values["q"]).any() for values in runs.values()):
        return default, "as there are no readings"
    jumping = [
        unit for unit, size in able.items() if revolute and any(is_wrapped(size * v["q"]) for v in runs.values())
    ]
    if len(jumping) == 1:
        return jumping[0], "by its jumps from one end of a turn to the other"
    driven = any(role in values for values in runs.values() for role in ("q_command", "voltage", *base_json.COLUMNS))
    if mechanics is not None and not driven:
        motions = [
            (v["t"], sign * (v["q"] - settings.zero), sign * size_effort * v["effort"] if "effort" in v else None)
            for v in runs.values()
        ]
        if (unit := unit_by_motion(mechanics, motions, able)) is not None:
            return unit, "by the asset's inertia and the acting forces"
    if limited and (high - low) * sizes[default] >= _MOVED * span:
        return default, "by the joint's limits"
    raise ask("Neither the joint's limits nor its motion show it")


def _scale_runs(
    runs: dict[str, Values],
    kind: JointType,
    settings: SeriesSettings,
    size_q: float,
    size_effort: float,
    notes: list[str],
) -> list[Run]:
    """Runs of positions in rad or m from the joint's zero, of efforts in N*m or N, and of all else in SI.

    Velocity and voltage have the sign of positions, the motion of the base has its own.
    """
    facts, sign = settings.circumstances, settings.sign
    unwraps = kind == "revolute" and facts.wrapped is not False
    made, counts = [], {"jumps of the position": 0, "jumps of the command": 0, "empty cells": 0}
    for name, values in runs.items():
        series = {role: facts.scale(role, kind) * values[role] for role in circumstances.COLUMNS if role in values}
        base = {role: column for role, column in series.items() if role in base_json.COLUMNS}
        own = {role: sign * column for role, column in series.items() if role not in base}
        own["q"] = sign * size_q * (values["q"] - settings.zero)
        if unwraps:
            own["q"], turns = unwrap_angles(own["q"])
            counts["jumps of the position"] += turns
        if "effort" in values:
            own["effort"] = sign * size_effort * values["effort"]
        if "q_command" in values:
            own["q_command"] = sign * size_q * (values["q_command"] - settings.zero)
            if unwraps:
                own["q_command"], turns = unwrap_command(own["q_command"], own["q"])
                counts["jumps of the command"] += turns
        counts["empty cells"] += sum(int(np.isnan(values[r]).sum()) for r in ("effort", "q_command") if r in values)
        moved = base_json.base_of({"t_s": values["t"], **base}, Path(name))
        made.append(Run(name, values["t"], base=moved, **own))
    for what, count in counts.items():
        how = "of drives count as no value" if what == "empty cells" else "by a whole turn were removed"
        if count:
            notes.append(f"{count} {what} {how}")
    return made


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
