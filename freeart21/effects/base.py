"""Base of all effects: a named physical behaviour of a joint that the neutral simulation lacks.

An effect is a frozen dataclass whose fields, made by `parameter`, have units and bounds. It defines how it acts and
what of it URDF and MJCF can express; `effects.json` stores all of it. A new one is one file here with one class, and
one test.
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

Kind = Literal["dynamics", "kinematics", "sensing", "asset"]
Acts = Literal["force", "drive", "inertia", "stop", "command", "slack", "pose", "reading", "asset"]


@dataclass(frozen=True)
class Parameter:
    """Unit, bounds, typical size and meaning of one parameter of an effect."""

    revolute_unit: str | None
    """None when a revolute joint does not have this parameter."""
    prismatic_unit: str | None
    lower: float
    upper: float
    meaning: str
    scale: float
    """Typical size, above 0, in the same unit."""

    def unit(self, joint_type: JointType) -> str:
        """SI unit for this joint type; FreeArtError when such a joint does not have the parameter."""
        unit = self.revolute_unit if joint_type == "revolute" else self.prismatic_unit
        if unit is None:
            raise FreeArtError(f"a {joint_type} joint has no parameter '{self.meaning}'")
        return unit


class Rotor(NamedTuple):
    """A drive's inertia on the shaft between it and the part, see `freeart21.events.drive_rebound`."""

    inertia: float = 0.0
    """kg*m^2 or kg."""
    throw_back: float = 0.0
    """Rebound speed ratio after the part has stopped dead."""
    swing: float = 0.0
    """Time of one radian of its oscillation on the shaft, s."""


BEARING_TRAVEL = 1e-2
"""Maximum presliding travel of any bearing's dry friction, as a share of the range. Filmed pendula had 8e-3."""
PLACES = 13
"""Places over the range of motion that fits start from."""


@dataclass(frozen=True)
class OperatingPoint:
    """Typical conditions of some recordings; SI units, a slider's in m and N."""

    joint_type: JointType
    q_low: float
    q_high: float
    """Range of motion."""
    speed: float
    """Largest speed."""
    noise: float
    """Standard deviation of readings at rest."""
    force: float
    """RMS inertial force."""
    load: float
    """Typical bearing force, N; 0 for none."""
    inertia: float
    """Of the joint, in all."""
    gravity: tuple[float, float, float]
    """Torque terms of cos q and sin q, and the constant."""
    tilted_gravity: tuple[tuple[float, float, float], ...] = ()
    """Change of these a rad of tilt of the base, in the plane of motion (along a slider) and across it."""
    inertia_relative: float = 0.0
    """Declared standard deviation of the asset's inertia, relative; 0 for exact."""
    gravity_relative: float = 0.0
    """The same of its gravity torque or force."""
    tilt: float = 0.0
    """The same of the base's tilt, rad."""

    @property
    def span(self) -> float:
        """Width of the range of motion."""
        return self.q_high - self.q_low


class FitRange(NamedTuple):
    """Bounds of a parameter in a fit to some recordings."""

    lower: float
    upper: float
    size: float
    """Typical size."""
    prior: float = np.inf
    """Prior standard deviation about 0."""


class Alternative(NamedTuple):
    """Another effect that does much the same, and its parameters."""

    name: str
    point: dict[str, float]
    position_shift: float = 0.0
    """Shift of the positions with it, rad or m."""


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
    """A dataclass field that is a parameter of an effect: SI units for both joint types, closed bounds, meaning and
    scale.

    With a unit of None, joints of that type do not have the parameter; it then needs a neutral `default`. Files may
    omit a parameter that both types have and that has a `default`.
    """
    spec = Parameter(revolute_unit, prismatic_unit, lower, upper, meaning, scale)
    if default is None:
        return dataclasses.field(metadata={"parameter": spec})
    return dataclasses.field(default=default, metadata={"parameter": spec})


class Effect(ABC):
    """Base of all effects. Subclasses are frozen dataclasses with fields made by `parameter`.

    `kind` and `acts` define where an effect enters. All methods are vectorised over q, qd, t:

    dynamics, in (I + sum inertia) qdd = gravity + external force + actuator + sum force - friction:
      "force"    `law` is a generalised force (N*m or N) on the joint, with a slope of at most `steepness()`, which
                 bounds the steps of explicit integrators. `remember` is for effects with memory.
      "drive"    `law` is a friction level (N*m or N, 0 or more): -level * sign(qd) in motion, sticking under any load
                 up to level. Set-valued: needs event detection, or SAPIEN's drive as a saturated damper.
      "inertia"  `law` is an inertia (kg*m^2 or kg) that moves with the joint.
      "stop"     `law` is the speed after an impact at a limit with qd before it; without any, impacts leave 0.
      "command"  acts on the actuator: it gives `gain()` times the force of the command of `delay()` s ago, plus
                 `bias_force()` while it is on.
      "slack"    the drive side is a body of its own, with `slack()` between it and the part.
    kinematics, "pose": `displacement` is the transform from the ideal to the true pose of the moving part.
    sensing, "reading": the reading at time t is q(t - delay()) + reading_error(q(t - delay())).
    asset, "asset": an error of the asset itself (`AssetError`), corrected in its `<inertial>`.

    `law(q, qd, load, memory, *parameters)` is a static method of scalars or arrays in plain numpy, so it can be
    compiled (`numba.njit(cls.law)`) or called with arrays of parameters. `load` is the bearing force, N
    (`JointMechanics.load`), 0 unless `needs_load`, or the gears' load if `geared`. `memory` is one number; `remember(q,
    memory, *parameters)` is its next value, at the start `remember(q, 0.0, ...)`; discontinuous memory changes by 1.

    Effects of one kind add up in any order; displacements are multiplied in the listed order, the first one outermost.
    """

    name: ClassVar[str]
    kind: ClassVar[Kind] = "dynamics"
    acts: ClassVar[Acts]
    joint_types: ClassVar[tuple[str, ...]] = JOINT_TYPES
    """Joint types that can have this effect."""
    needs_load: ClassVar[bool] = False
    """Whether `law` depends on the load of the bearing."""
    geared: ClassVar[bool] = False
    """Whether it is friction of the drive's gears instead of the bearing. `law` then takes the gears' load, |actuator
    force - all other forces but friction|, N*m or N."""
    needs_effort: ClassVar[bool] = False
    """Whether only runs with commanded effort can show it."""
    speed_dependent: ClassVar[bool] = True
    """Whether the force depends on speed ("force" only)."""
    model_error: ClassVar[tuple[float, float]] = (0.2, 0.2)
    """Largest relative deviation of real ones from the formula: over the range of speeds, and over that of positions
    (once as a slope, once as a bend). A speed or place of the effect's own is its range."""
    support_widths: ClassVar[float] = 1.5
    """Distance from the place of a local effect to where it ends, in widths."""

    rotor_fields: ClassVar[tuple[str, ...]] = ()
    """Parameters that are the fields of `Rotor`, in order. Those of the shaft, all but the first, have no initial
    guess; rebounds at stops determine them."""
    drivetrain: ClassVar[bool] = False
    """Whether every geared drive has it; such effects do not show one by one."""
    neutral: ClassVar[float] = 0.0
    """Value of the first parameter at which the effect vanishes."""
    trial_sizes: ClassVar[tuple[float, ...]] = ()
    """Values of the first parameter that fits start from, where a small one does not show."""
    polar: ClassVar[bool] = False
    """Whether its two parameters are length and angle of a vector, in whose components it is linear."""
    time_driven: ClassVar[bool] = False
    """Whether a displacement depends on time, not on the joint's position."""
    joint_word: ClassVar[str | None] = None
    """Name in simulators that have it as one number of a joint: damping, drag, friction, armature, stiffness."""
    label: ClassVar[str] = ""
    """Name in plain words, for users."""
    experiment: ClassVar[str] = ""
    """What to record to separate it from confounded effects; empty for nothing specific."""

    complexity: ClassVar[int] = 1
    """Number of effects that it counts for in model selection: about one per three parameters."""
    range_fields: ClassVar[tuple[str, ...]] = ()
    """Parameters fixed at the ends of the range of motion instead of fitted."""
    reduces_to: ClassVar[str | None] = None
    """The simpler effect that this one is in a special case; it is preferred unless it fits worse."""
    confounded_with: ClassVar[str | None] = None
    """The effect that does the same under constant bearing load."""
    dissipates: ClassVar[bool] = False
    """Whether it takes energy from the joint wherever it moves."""
    common: ClassVar[bool] = False
    """Whether every machine has it to some degree: all have friction, not all have a notch."""
    basis_of: ClassVar[tuple[str, ...]] = ()
    """Free-shape forces that it is a basis function of: over "position", over "velocity", of "direction" alone."""

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
        """All parameters, as `law` takes them."""
        return tuple(getattr(self, name) for name in self.parameters())

    # fits to recordings

    @classmethod
    def is_local(cls) -> bool:
        """Whether it is a force with a place and a width beyond which it vanishes."""
        lengths = [s.lower for s in cls.parameters().values() if s.revolute_unit == "rad"]
        return cls.acts == "force" and min(lengths, default=0.0) < 0 <= max(lengths, default=0.0)

    @classmethod
    def fit_range(cls, name: str, at: OperatingPoint) -> FitRange:
        """Bounds and typical size of a parameter, limited to what recordings of these conditions show."""
        spec = cls.parameters()[name]
        low, high, size, unit = spec.lower, spec.upper, spec.scale, spec.unit(at.joint_type)
        if spec.revolute_unit == "rad" and spec.lower < 0:
            reach = 0.1 * at.span if cls.is_local() else 3 * at.span
            low, high, size = at.q_low - reach, at.q_high + reach, 0.1 * at.span
        elif spec.revolute_unit == "rad":
            # wider than a third of the range it is not local, and looks like a spring
            low, high, size = max(2 * at.noise, 1e-3 * at.span), 0.35 * at.span, 0.05 * at.span
        elif spec.revolute_unit == "rad/s":
            low, high, size = 0.01 * at.speed, at.speed, 0.1 * at.speed
        elif unit == "s":
            low, high = max(spec.lower, -0.5), 0.5
        elif unit == "1":
            high = min(spec.upper, 10.0)
        return FitRange(max(low, spec.lower), min(high, spec.upper), size)

    @classmethod
    def trial_values(cls, name: str, at: OperatingPoint) -> list[float]:
        """Values of a place, width, speed or ratio that fits start from."""
        r, unit = cls.fit_range(name, at), cls.parameters()[name].revolute_unit
        if unit == "rad" and r.lower < at.q_low and r.upper > at.q_high:
            return list(np.linspace(at.q_low, at.q_high, PLACES))
        if unit == "rad":
            return [float(np.clip(part * at.span, r.lower, r.upper)) for part in (0.02, 0.06, 0.15)]
        if unit == "rad/s":
            return [float(np.clip(part * r.upper, r.lower, r.upper)) for part in (0.05, 0.2)]
        return [0.5 * min(r.upper, 1.0)]

    def restarts(self) -> list[dict[str, float]]:
        """Parameters near these that no gradient leads to; they may be out of bounds."""
        return []

    # dynamics

    @staticmethod
    def law(q: Any, qd: Any, load: Any, memory: Any, *parameters: Any) -> Any:
        """The effect's formula; `acts` defines its meaning."""
        raise NotImplementedError

    @staticmethod
    def remember(q: Any, memory: Any, *parameters: Any) -> Any:
        """The memory after the joint was at `q`; 0 for effects without."""
        return 0.0

    def force(self, q: Any, qd: Any, t: Any = 0.0, memory: Any = 0.0) -> Any:
        """Generalised force, N*m or N, at position `q` (rad or m), velocity `qd`, time `t` (s); 0 for other `acts`."""
        return self.law(q, qd, 0.0, memory, *self.values()) if self.acts == "force" else 0.0

    def drive_limit(self, q: Any, qd: Any, load: Any = 0.0) -> Any:
        """Largest friction force, N*m or N, under the bearing force `load`, N, or the gears' load, N*m or N, if
        `geared`."""
        return self.law(q, qd, load, 0.0, *self.values()) if self.acts == "drive" else 0.0

    def added_inertia(self) -> float:
        """kg*m^2 or kg that move with the joint."""
        return float(self.law(0.0, 0.0, 0.0, 0.0, *self.values())) if self.acts == "inertia" else 0.0

    def rebound(self, qd: Any) -> Any:
        """Velocity after an impact at a limit with velocity `qd` before it."""
        return self.law(0.0, qd, 0.0, 0.0, *self.values()) if self.acts == "stop" else 0.0

    def steepness(self) -> float:
        """Largest -dF/dq of the force, N*m/rad or N/m."""
        return 0.0

    def damping(self) -> float:
        """Force against the motion per speed, N*m*s/rad or N*s/m."""
        return 0.0

    def rotor(self) -> Rotor:
        """The drive's inertia, and how it rebounds at a limit."""
        return Rotor(*(float(getattr(self, name)) for name in self.rotor_fields))

    def slack(self) -> float:
        """Free travel, rad or m, between the drive side and the part."""
        return 0.0

    def gain(self) -> float:
        """Factor of the actuator's force."""
        return 1.0

    def bias_force(self) -> float:
        """Force of the actuator, N*m or N, in addition to the commanded one."""
        return 0.0

    def delay(self) -> float:
        """Delay of a command ("command") or a reading ("reading"), s."""
        return 0.0

    def is_plausible(self) -> bool:
        """Whether real machines have it in this size; else it more likely stands for something without a name."""
        return True

    # kinematics

    def displacement(self, q: ArrayLike, t: ArrayLike, mechanics: JointMechanics) -> Array:
        """(..., 4, 4) from the ideal to the true pose of the moving part at state `q` and time `t`, in the parent
        link's frame.

        Directions across the axis are in the basis `perpendiculars(axis)` of that frame.
        """
        raise NotImplementedError

    # sensing

    def reading_error(self, q: ArrayLike) -> Any:
        """Reading minus position, at position `q`."""
        return 0.0 * np.asarray(q, float)

    # relations between effects

    def merge(self, other: Effect) -> Effect | None:
        """One effect equal to this one and `other`, of the same class, together; None where they stay two.

        Forces, friction and inertias in proportion to their first parameter add up; shaft parameters take the larger
        value, as in a simulation. Raises FreeArtError where a joint has at most one.
        """
        size, *others = self.parameters()
        if self.acts not in ("force", "drive", "inertia") or {*others} - {*self.rotor_fields}:
            return None
        larger = {name: max(getattr(self, name), getattr(other, name)) for name in others}
        return type(self)(**{size: getattr(self, size) + getattr(other, size)}, **larger)

    def alternatives(self, at: OperatingPoint) -> list[Alternative]:
        """Effects that do much the same at an operating point, with parameters: starting points of other fits."""
        return []

    @classmethod
    def from_rocking(cls, frequency: float, waves: Array) -> Effect:
        """The effect, if `time_driven`, of an oscillation of the part in some runs.

        Args:
            frequency: Hz.
            waves: (runs, 2, 2) rad about the two `perpendiculars`, of sine and cosine of time.
        """
        raise NotImplementedError

    # file formats

    def urdf_dynamics(self) -> dict[str, float]:
        """Attributes of URDF `<dynamics>` that express this effect; empty for none."""
        return {}

    def mjcf_joint(self) -> dict[str, float | tuple[float, ...]]:
        """Attributes of an MJCF `<joint>` that express this effect, a number or several; empty for none."""
        return {}

    @classmethod
    def check_joint_type(cls, joint_type: JointType, where: str) -> None:
        """Raise FreeArtError when a joint of this type cannot have the effect."""
        if joint_type not in cls.joint_types:
            raise FreeArtError(
                f"{where}: effect '{cls.name}' on a {joint_type} joint, expected {' or '.join(cls.joint_types)}"
            )

    def to_json(self, joint_type: JointType) -> dict[str, Any]:
        """Entry of effects.json; FreeArtError when a joint of this type cannot have the effect."""
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
        """The effect of an effects.json entry; FreeArtError on a missing or unknown parameter, unit or joint type."""
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
        """Names of the parameters that files may omit."""
        fields = [f for f in dataclasses.fields(cls) if f.default is not dataclasses.MISSING]  # type: ignore[arg-type]
        specs = cls.parameters()
        return {f.name for f in fields if specs[f.name].revolute_unit and specs[f.name].prismatic_unit}


class AssetError(Effect):
    """Base of what the asset's own files may be wrong about, within a declared uncertainty.

    It is fitted beside every set of effects, each parameter with a normal prior about `neutral`. It is no entry of
    effects.json: its repair is in the URDF's `<inertial>`.
    """

    kind: ClassVar[Kind] = "asset"
    acts: ClassVar[Acts] = "asset"
    phrases: ClassVar[dict[str, str]]
    """A sentence for users by parameter, with {} for its value."""

    @classmethod
    def uncertainty(cls, name: str, at: OperatingPoint) -> float:
        """Prior standard deviation of a parameter; 0 where it is exact or does not change the motion."""
        raise NotImplementedError

    @classmethod
    def fit_range(cls, name: str, at: OperatingPoint) -> FitRange:
        doubt = cls.uncertainty(name, at)
        return FitRange(cls.neutral - doubt, cls.neutral + doubt, doubt, doubt)

    def inertia_factor(self) -> float:
        """True inertia over the asset's."""
        return 1.0

    def weight_factor(self) -> float:
        """True torque or force of gravity over the asset's."""
        return 1.0

    def tilt(self) -> tuple[float, float]:
        """rad of tilt of the base, in the plane of motion (along a slider) and across it."""
        return 0.0, 0.0


def perpendiculars(axis: ArrayLike) -> tuple[Array, Array]:
    """Two unit vectors (3,) that with the unit vector `axis` (3,) make a right-handed basis (first, second, axis).

    The first is perpendicular to the coordinate axis least along `axis`, the earlier one of equals.
    """
    axis = np.asarray(axis, float)
    # rounded, so that rounding errors of the axis do not change the choice
    first = np.cross(np.eye(3)[int(np.argmin(np.round(np.abs(axis), 6)))], axis)
    first = first / np.linalg.norm(first)
    return first, np.cross(axis, first)


def strongest_rotor(effects: Iterable[Effect]) -> Rotor:
    """The rotor of the effects that rebounds with the most momentum; a zero one without any."""
    rotors = [effect.rotor() for effect in effects if effect.rotor_fields]
    return max(rotors, key=lambda rotor: rotor.throw_back * rotor.inertia, default=Rotor())


def readings(effects: tuple[Effect, ...], times_s: ArrayLike, q: ArrayLike) -> Array:
    """(n,) readings of a position sensor with these effects at `times_s` (n,), rising, of the true positions `q` (n,).

    Positions are interpolated linearly, and extrapolated beyond the ends.
    """
    times, true = np.asarray(times_s, float), np.asarray(q, float)
    sensing = [effect for effect in effects if effect.kind == "sensing"]
    late = float(np.sum([effect.delay() for effect in sensing]))
    if late and len(times) > 1:
        delayed = times - late
        seen = np.interp(delayed, times, true)
        for end, inner in ((0, 1), (-1, -2)):
            slope = (true[end] - true[inner]) / (times[end] - times[inner])
            beyond = delayed < times[0] if end == 0 else delayed > times[-1]
            seen[beyond] = true[end] + slope * (delayed[beyond] - times[end])
    else:
        seen = true.copy()
    return np.asarray(seen + sum((effect.reading_error(seen) for effect in sensing), np.zeros(len(seen))))
