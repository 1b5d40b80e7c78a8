"""What an effect is: a named physical behaviour of a joint that the neutral simulation lacks.

An effect is a frozen dataclass whose fields, made by `parameter`, carry units and bounds. It says how it acts, and what
of it URDF and MJCF can express; `effects.json` holds all of it. To add one: one file here with one class, one test.
"""

from __future__ import annotations

import dataclasses
import functools
from abc import ABC
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any, ClassVar, Literal, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from freeart21.errors import FreeArtError
from freeart21.joint import JOINT_TYPES, JointType
from freeart21.mechanics import JointMechanics
from freeart21.se3 import Array

Kind = Literal["dynamics", "kinematics", "sensing"]
Acts = Literal["force", "drive", "inertia", "stop", "command", "slack", "pose", "reading"]


@dataclass(frozen=True)
class Parameter:
    """Unit, bounds, size and meaning of one number of an effect."""

    revolute_unit: str | None
    """None when a revolute joint does not have this parameter."""
    prismatic_unit: str | None
    lower: float
    upper: float
    meaning: str
    scale: float
    """A usual size, above 0, in the same unit: what an optimiser divides by."""

    def unit(self, joint_type: JointType) -> str:
        """The SI unit for a joint of this type; FreeArtError when such a joint does not have this parameter."""
        unit = self.revolute_unit if joint_type == "revolute" else self.prismatic_unit
        if unit is None:
            raise FreeArtError(f"a {joint_type} joint has no parameter '{self.meaning}'")
        return unit


class Rotor(NamedTuple):
    """A drive's inertia on the shaft between it and the part, see `freeart21.events.drive_rebound`."""

    inertia: float = 0.0
    """kg*m^2 or kg."""
    throw_back: float = 0.0
    """Part of its speed that it comes back with after the part has stopped dead."""
    swing: float = 0.0
    """Seconds in which it swings by a radian on its shaft."""


@dataclass(frozen=True)
class OperatingPoint:
    """What an effect acts among in some recordings; SI units, a slider's in m and N."""

    joint_type: JointType
    speed: float
    """Largest speed."""
    span: float
    """Range of the positions."""
    load: float
    """Usual force on the bearing, N; 0 for nothing but rounding."""
    inertia: float
    """Of the joint, all in all."""
    gravity: tuple[float, float, float]
    """Of cos q, of sin q and constant."""


class Alternative(NamedTuple):
    """Another effect that does much the same, and its parameters."""

    name: str
    point: dict[str, float]
    position_shift: float = 0.0
    """By how much the positions are then ahead, rad or m."""


def parameter(
    revolute_unit: str | None,
    prismatic_unit: str | None,
    lower: float,
    upper: float,
    meaning: str,
    *,
    scale: float = 1.0,
    default: float | None = None,
) -> Any:
    """A dataclass field that is a parameter of an effect: SI units for both joint types, closed bounds, meaning, size.

    A unit of None says that joints of that type do not have the parameter; it then needs a `default` that does nothing.
    A file may leave out what both types have and has a `default`.
    """
    spec = Parameter(revolute_unit, prismatic_unit, lower, upper, meaning, scale)
    if default is None:
        return dataclasses.field(metadata={"parameter": spec})
    return dataclasses.field(default=default, metadata={"parameter": spec})


class Effect(ABC):
    """Base of all effects. Subclasses are frozen dataclasses with fields made by `parameter`.

    `kind` and `acts` say where an effect enters; the rest of it is a few methods, all vectorised over q, qd, t:

    dynamics, an equation (I + sum inertia) qdd = gravity + external force + actuator + sum force - friction:
      "force"    `law` is a generalised force (N*m or N) added to the joint. No force is steeper than `steepness()`;
                 an explicit integrator takes that as its bound. `remember` is for those with memory, see below.
      "drive"    `law` is a friction level (N*m or N, 0 or more): the joint feels -level * sign(qd) when it moves, and
                 sticks under any load up to level. Set-valued: needs events, or SAPIEN's drive as a saturated damper.
      "inertia"  `law` is an inertia (kg*m^2 or kg) that turns with the joint.
      "stop"     `law` is the speed after an impact at a limit that came in with qd; without any, impacts leave 0.
      "command"  acts on the actuator only: it gives `gain()` times the force that the command of `delay()` s ago makes,
                 and `bias_force()` besides while it is on.
      "slack"    the actuator's side is a body of its own, with `slack()` between it and the part.
    kinematics, "pose": `displacement` takes the moving part from where the ideal joint has it to where it truly is.
    sensing, "reading": what is written down at time t is q(t - delay()) + reading_error(q(t - delay())).

    `law(q, qd, load, memory, *parameters)` is a static method of scalars or arrays, plain numpy, no instance: so a
    fitter may compile it (`numba.njit(cls.law)`) or give it arrays of parameters. `load` is the bearing force in N
    (`JointMechanics.load`), 0 unless `needs_load`, or what gears carry where the effect is `geared`. `memory` is one
    number, `remember(q, memory, *parameters)` is its next value, at the start it is `remember(q, 0.0, ...)`; one that
    leaps, leaps by 1.

    Effects of one kind add up, in no order; displacements are multiplied in the order listed, the first one outermost.
    """

    name: ClassVar[str]
    kind: ClassVar[Kind] = "dynamics"
    acts: ClassVar[Acts]
    joint_types: ClassVar[tuple[str, ...]] = JOINT_TYPES
    """The types of joint that can have this effect."""
    needs_load: ClassVar[bool] = False
    """Whether `law` looks at the load on the bearing."""
    geared: ClassVar[bool] = False
    """Whether it is the drive's gears that rub, not the bearing: the load that `law` looks at is then what these carry,
    |force of the actuator - all other forces but friction|, N*m or N."""
    needs_effort: ClassVar[bool] = False
    """Whether runs tell it only in which the actuator was told its effort."""
    speed_dependent: ClassVar[bool] = True
    """Whether the force of one that acts as "force" changes with speed."""
    model_error: ClassVar[tuple[float, float]] = (0.2, 0.2)
    """By what part of itself a real one may differ from its formula: over the range of speeds, and over that of
    positions, there once as a slope and once between middle and ends. What has a speed or a place of its own, over
    those."""
    form_error: ClassVar[float] = 0.0
    """Part of itself by which the formula is off for real ones of other forms, all numbers fitted: what it leaves of a
    gap by that needs no other name."""
    support_widths: ClassVar[float] = 1.5
    """Of an effect with a place: how many widths from there its ends are."""

    rotor_fields: ClassVar[tuple[str, ...]] = ()
    """Of a drive's inertia: the parameters that are the numbers of its `Rotor`, in their order. Those of its shaft, all
    but the first, have no first guess of their own: how dead a stop is tells them."""
    drivetrain: ClassVar[bool] = False
    """Whether every geared drive has it: of such losses and inertias none shows alone."""
    neutral: ClassVar[float] = 0.0
    """Value of its first parameter with which it does nothing."""
    polar: ClassVar[bool] = False
    """Whether its two parameters are the length and the angle of a vector, in whose components it is linear."""
    time_driven: ClassVar[bool] = False
    """Whether a displacement goes with time, not with the joint's position."""
    joint_word: ClassVar[str | None] = None
    """What simulators call it that have it as one number of a joint: damping, drag, friction, armature, stiffness."""
    label: ClassVar[str] = ""
    """What a mechanic would call it."""
    experiment: ClassVar[str] = ""
    """What to record so that it parts from others that explain the same; empty for nothing that it has of its own."""

    complexity: ClassVar[int] = 1
    """How many effects it counts for where smaller sets come first: one for every three of its numbers, about."""
    range_fields: ClassVar[tuple[str, ...]] = ()
    """Parameters that are the ends of the way that was moved through, and no numbers to be fitted."""
    reduces_to: ClassVar[str | None] = None
    """The plainer effect that this one is in a special case: that one has the name unless it does worse."""
    confounded_with: ClassVar[str | None] = None
    """The effect that does the same wherever the load on the bearing stays as it is."""
    dissipates: ClassVar[bool] = False
    """Whether it takes energy from the joint wherever that moves."""
    common: ClassVar[bool] = False
    """Whether every machine has it, more or less, as all have friction and none must have a notch."""
    basis_of: ClassVar[tuple[str, ...]] = ()
    """Forces of any shape that it helps to make: of "position", of "velocity", of "direction" alone."""

    def __post_init__(self) -> None:
        for field, spec in self.parameters().items():
            value = getattr(self, field)
            if not isinstance(value, int | float) or not np.isfinite(value) or not spec.lower <= value <= spec.upper:
                raise FreeArtError(
                    f"effect '{self.name}' {field} is {value}, expected {spec.lower:g} to {spec.upper:g}"
                )
            object.__setattr__(self, field, float(value))

    @classmethod
    @functools.cache
    def parameters(cls, joint_type: JointType | None = None) -> dict[str, Parameter]:
        """Parameter name to its specification, in order: all of them, or those that a joint of this type has."""
        specs: dict[str, Parameter] = {f.name: f.metadata["parameter"] for f in dataclasses.fields(cls)}  # type: ignore[arg-type]
        absent = {"revolute": "revolute_unit", "prismatic": "prismatic_unit"}
        if joint_type is None:
            return specs
        return {name: spec for name, spec in specs.items() if getattr(spec, absent[joint_type]) is not None}

    def values(self) -> tuple[float, ...]:
        """The numbers of all parameters, as `law` takes them."""
        return tuple(getattr(self, name) for name in self.parameters())

    # dynamics

    @staticmethod
    def law(q: Any, qd: Any, load: Any, memory: Any, *parameters: Any) -> Any:
        """The effect's formula; what it gives is said by `acts`."""
        raise NotImplementedError

    @staticmethod
    def remember(q: Any, memory: Any, *parameters: Any) -> Any:
        """What an effect with memory knows after the joint was at `q`; 0 for one without."""
        return 0.0

    def force(self, q: Any, qd: Any, t: Any = 0.0, memory: Any = 0.0) -> Any:
        """Generalised force, N*m or N, at position `q` (rad or m), velocity `qd`, time `t` (s); 0 if it acts else."""
        return self.law(q, qd, 0.0, memory, *self.values()) if self.acts == "force" else 0.0

    def drive_limit(self, q: Any, qd: Any, load: Any = 0.0) -> Any:
        """Largest force, N*m or N, with which friction opposes motion under the bearing force `load`, N, or under what
        gears carry, N*m or N, of one that is `geared`."""
        return self.law(q, qd, load, 0.0, *self.values()) if self.acts == "drive" else 0.0

    def inertia(self) -> float:
        """kg*m^2 or kg that move with the joint."""
        return float(self.law(0.0, 0.0, 0.0, 0.0, *self.values())) if self.acts == "inertia" else 0.0

    def rebound(self, qd: Any) -> Any:
        """Velocity after an impact at a limit that was met with velocity `qd`."""
        return self.law(0.0, qd, 0.0, 0.0, *self.values()) if self.acts == "stop" else 0.0

    def steepness(self) -> float:
        """Largest -dF/dq that the force can have, N*m/rad or N/m."""
        return 0.0

    def damping(self) -> float:
        """Force against the motion per speed, N*m*s/rad or N*s/m."""
        return 0.0

    def rotor(self) -> Rotor:
        """The drive's inertia that it says, and how that comes back from a limit."""
        return Rotor(*(float(getattr(self, name)) for name in self.rotor_fields))

    def slack(self) -> float:
        """Free travel, rad or m, between the actuator's side and the part."""
        return 0.0

    def gain(self) -> float:
        """Part of the actuator's force that arrives."""
        return 1.0

    def bias_force(self) -> float:
        """Force of the actuator, N*m or N, beside what was commanded."""
        return 0.0

    def delay(self) -> float:
        """Seconds by which a command ("command") or a reading ("reading") comes late."""
        return 0.0

    def is_plausible(self) -> bool:
        """Whether real machines have it in this size; else it more likely stands for something that has no name."""
        return True

    # kinematics

    def displacement(self, q: ArrayLike, t: ArrayLike, mechanics: JointMechanics) -> Array:
        """(..., 4, 4) from the ideal to the true pose of the moving part at state `q` and time `t`, parent's frame.

        Directions across the axis are counted on the basis `perpendiculars(axis)` of that frame (the frame of the
        joint's parent link, as URDF has it).
        """
        raise NotImplementedError

    # sensing

    def reading_error(self, q: ArrayLike) -> Any:
        """What is read, less the position `q` that it is read at."""
        return 0.0 * np.asarray(q, float)

    # several of one kind, and other forms

    def merge(self, other: Effect) -> Effect | None:
        """One effect that does what this one and `other`, of the same class, do together; None where they stay two.

        Forces, friction and inertias of one number are in proportion to it and add; of what shafts give back the larger
        counts, as in a simulation. Raises FreeArtError where a joint has at most one.
        """
        size, *others = self.parameters()
        if self.acts not in ("force", "drive", "inertia") or {*others} - {*self.rotor_fields}:
            return None
        larger = {name: max(getattr(self, name), getattr(other, name)) for name in others}
        return type(self)(**{size: getattr(self, size) + getattr(other, size)}, **larger)

    def alternatives(self, at: OperatingPoint) -> list[Alternative]:
        """Effects that do much the same there, with the parameters at which they do: where a fit of one is found, fits
        of the others may begin."""
        return []

    @classmethod
    def from_rocking(cls, frequency: float, waves: Array) -> Effect:
        """The effect, one that is `in_time`, that is a rocking of the part in some runs.

        Args:
            frequency: Hz.
            waves: (runs, 2, 2) rad about the first and the second of `perpendiculars`, of sine and cosine of the time.
        """
        raise NotImplementedError

    # words

    def urdf_dynamics(self) -> dict[str, float]:
        """Attributes of URDF `<dynamics>` that say this effect; empty when URDF can't."""
        return {}

    def mjcf_joint(self) -> dict[str, float | tuple[float, ...]]:
        """Attributes of an MJCF `<joint>` that say this effect, a number or several; empty when MJCF can't."""
        return {}

    @classmethod
    def check_joint_type(cls, joint_type: JointType, where: str) -> None:
        """Raise FreeArtError when a joint of this type cannot have the effect."""
        if joint_type not in cls.joint_types:
            raise FreeArtError(
                f"{where}: effect '{cls.name}' on a {joint_type} joint, expected {' or '.join(cls.joint_types)}"
            )

    def to_json(self, joint_type: JointType) -> dict[str, Any]:
        """The effect as it stands in effects.json; FreeArtError when a joint of this type cannot have it."""
        self.check_joint_type(joint_type, "effects.json")
        specs = self.parameters(joint_type)
        for field in dataclasses.fields(self):  # type: ignore[arg-type]
            value = getattr(self, field.name)
            if field.name not in specs and value != field.default:
                raise FreeArtError(
                    f"effect '{self.name}' {field.name} is {value}, which a {joint_type} joint does not have"
                )
        return {
            "effect": self.name,
            "parameters": {
                name: {"value": getattr(self, name), "unit": spec.unit(joint_type)} for name, spec in specs.items()
            },
        }

    @classmethod
    def from_json(cls, data: dict[str, Any], joint_type: JointType, where: str) -> Effect:
        """The effect of one effects.json entry; FreeArtError on a missing or unknown parameter, unit or joint type."""
        cls.check_joint_type(joint_type, where)
        given, specs = data.get("parameters"), cls.parameters(joint_type)
        if not isinstance(given, dict) or not set(specs) - cls._spare() <= set(given) <= set(specs):
            got = sorted(given) if isinstance(given, dict) else given
            raise FreeArtError(f"{where}: effect '{cls.name}' has parameters {got}, expected {sorted(specs)}")
        for name in given:
            entry, spec = given[name], specs[name]
            unit = entry.get("unit") if isinstance(entry, dict) else None
            if unit != spec.unit(joint_type):
                raise FreeArtError(
                    f"{where}: effect '{cls.name}' {name} has unit '{unit}', expected '{spec.unit(joint_type)}'"
                )
        return cls(**{name: entry.get("value") for name, entry in given.items()})

    @classmethod
    def _spare(cls) -> set[str]:
        """Names of the parameters that a file may leave out."""
        fields = [f for f in dataclasses.fields(cls) if f.default is not dataclasses.MISSING]  # type: ignore[arg-type]
        specs = cls.parameters()
        return {f.name for f in fields if specs[f.name].revolute_unit and specs[f.name].prismatic_unit}


def perpendiculars(axis: ArrayLike) -> tuple[Array, Array]:
    """Two unit vectors (3,) that with the unit vector `axis` (3,) make a right-handed basis (first, second, axis).

    The first is across the coordinate axis least along `axis` (the earlier one of equals).
    """
    axis = np.asarray(axis, float)
    # rounding keeps the choice the same for axes that differ by rounding errors only
    first = np.cross(np.eye(3)[int(np.argmin(np.round(np.abs(axis), 6)))], axis)
    first = first / np.linalg.norm(first)
    return first, np.cross(axis, first)


def strongest_rotor(effects: Iterable[Effect]) -> Rotor:
    """That of the drive inertias of a joint whose shaft gives back most; nothing without any."""
    rotors = [effect.rotor() for effect in effects if effect.rotor_fields]
    return max(rotors, key=lambda rotor: rotor.throw_back * rotor.inertia, default=Rotor())


def readings(effects: tuple[Effect, ...], times_s: ArrayLike, q: ArrayLike) -> Array:
    """What a position sensor with these effects writes down at `times_s` (n,), rising, of the true course `q` (n,).

    Between samples the course is a straight line, and beyond its ends it goes on as one.
    """
    times, true = np.asarray(times_s, float), np.asarray(q, float)
    sensing = [effect for effect in effects if effect.kind == "sensing"]
    late = float(np.sum([effect.delay() for effect in sensing]))
    if late and len(times) > 1:
        asked = times - late
        seen = np.interp(asked, times, true)
        for end, inner in ((0, 1), (-1, -2)):
            slope = (true[end] - true[inner]) / (times[end] - times[inner])
            beyond = asked < times[0] if end == 0 else asked > times[-1]
            seen[beyond] = true[end] + slope * (asked[beyond] - times[end])
    else:
        seen = true.copy()
    return np.asarray(seen + sum((effect.reading_error(seen) for effect in sensing), np.zeros(len(seen))))
