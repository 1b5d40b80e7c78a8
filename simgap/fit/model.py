"""The fitted model: effects that may be missing, errors of the asset itself, and the bounds of all parameters."""

from __future__ import annotations

import functools
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from freeart21.effects import ASSET_ERRORS, EFFECTS, AssetError, Effect
from freeart21.effects.base import BEARING_TRAVEL, OperatingPoint
from freeart21.se3 import Array
from simgap.models import kernel, laws
from simgap.models.surrogate import Nuisance, Plant, effect_terms, make_vector

ASSET = "asset"
"""Owner of the parameters of asset errors, and of HOLDING."""
_FRICTION = "friction form"
"""Owner of the presliding parameters, shared by all missing dry friction."""
SHAFT = "shaft form"
"""Owner of the parameters of the drive's shaft: how its inertia rebounds when the part stops dead."""
_FORM = " form"
"""Suffix of the owner of an effect's model error."""
TILT_RAD = 7e-3
"""Prior standard deviation of the base's tilt; a usual mounting is 0.3 degrees off."""
_SHAFT_DAMPING = 0.35
"""Minimum damping ratio of a drive's inertia against the part on the shaft between them. Less damping is an elastic
drive, not an armature."""
_MAX_SWING = 0.02
"""Maximum time of one radian of that oscillation, as a share of the time to cross the range at top speed. A slower one
is an elastic drive."""
HOLDING = "holding"
"""Asset parameter: interpolation of the inputs between their rows. A delay of half a row is no effect."""


@dataclass(frozen=True)
class ParameterRange:
    """One fitted parameter."""

    owner: str
    """Name of an effect, 'asset', 'friction form', 'shaft form', or an effect's name + ' form'."""
    name: str
    lower: float
    upper: float
    size: float
    """Typical size."""
    prior: float = np.inf
    """Prior standard deviation about `neutral`."""
    neutral: float = 0.0


@dataclass(frozen=True)
class Problem:
    """What all fits to one measured set share."""

    plant: Plant
    inertia_relative: float
    gravity_relative: float
    q_low: float
    q_high: float
    speed: float
    """Largest speed of all runs."""
    sigma: float
    """Noise sigma at rest."""
    force: float = 1.0
    """RMS inertial force, N*m or N."""
    load: float = 1.0
    """Typical bearing force, N."""
    gear_load: float = 1.0
    """Typical load of the drive's gears, N*m or N."""
    unknown_inputs: bool = False
    """Whether the interpolation of commands and efforts between rows is unknown. It is then fitted, between smooth and
    zero-order hold, with a uniform prior."""
    tilt_rad: float = TILT_RAD
    """Prior standard deviation of the base's tilt in the plane of motion; 0 for none."""
    inverse_dynamics: bool = False
    """Whether motion is prescribed and the force is read (`simgap.measure.prescribed`): residuals are then of force."""

    def reference_load(self, cls: type[Effect]) -> float:
        """Typical load in an effect's law."""
        return self.gear_load if cls.geared else self.load

    def range_ends(self, cls: type[Effect]) -> dict[str, float]:
        """Parameters of an effect that are fixed at the ends of the range of motion."""
        return dict(zip(cls.range_fields, (self.q_low, self.q_high), strict=False))

    def covers_range(self, cls: type[Effect]) -> bool:
        """Whether the range of motion is within the bounds of an effect's `range_fields`; a wheel's turns are not."""
        specs = cls.parameters()
        return all(specs[name].lower <= x <= specs[name].upper for name, x in self.range_ends(cls).items())

    @functools.cached_property
    def operating_point(self) -> OperatingPoint:
        """Typical conditions, with inertia and gravity of the asset."""
        mechanics = self.plant.mechanics
        nominal, *tilted = ((float(a), float(b), float(c)) for a, b, c in self.plant.gravity_terms)
        return OperatingPoint(
            self.plant.joint_type,
            self.q_low,
            self.q_high,
            self.speed,
            self.sigma,
            self.force,
            self.load if self.bearing_loaded else 0.0,
            mechanics.inertia,
            nominal,
            tuple(tilted),
            self.inertia_relative,
            self.gravity_relative,
            self.tilt_rad,
        )

    @property
    def reference(self) -> tuple[float, float, float]:
        """Largest speed, and middle and half width of the range of motion."""
        return self.speed, 0.5 * (self.q_low + self.q_high), max(0.5 * (self.q_high - self.q_low), 1e-9)

    @property
    def bearing_loaded(self) -> bool:
        """Whether the bearing carries any load."""
        mechanics = self.plant.mechanics
        return self.load > 1e-9 * mechanics.mass * float(np.linalg.norm(mechanics.gravity))

    @property
    def reaches_limit(self) -> bool:
        """Whether any run reaches a limit."""
        near = 0.02 * (self.q_high - self.q_low)
        return self.q_low < self.plant.lower + near or self.q_high > self.plant.upper - near

    @property
    def crossing_s(self) -> float:
        """Time to cross the range of motion at top speed, s: the time scale of the motion."""
        return (self.q_high - self.q_low) / max(self.speed, 1e-9)


@dataclass(frozen=True)
class Model:
    """A set of missing effects with its parameters."""

    problem: Problem
    names: tuple[str, ...]
    instant_friction: bool = False
    """Friction without presliding, as in simulators; else it builds up after a reversal."""
    model_error: tuple[tuple[str, float], ...] = ()
    """(effect name, reference size): effects that may deviate from their formulas (`Effect.model_error`). Their force
    is the formula plus shares of the formula at its reference size: a slope over speed, and a slope and a bend over
    position, with uniform priors. This is a discrepancy inside the model (Brynjarsdottir and O'Hagan 2014), so that the
    form error of a strong effect gets no other name. The fixed reference size keeps the model free of products of two
    parameters."""

    @property
    def classes(self) -> tuple[type[Effect], ...]:
        """Classes of the added effects."""
        return tuple(EFFECTS[name] for name in self.names)

    @property
    def asset_errors(self) -> tuple[tuple[type[AssetError], tuple[str, ...]], ...]:
        """Errors of the asset with their uncertain parameters."""
        at = self.problem.operating_point
        return tuple(
            (cls, tuple(name for name in cls.parameters() if cls.uncertainty(name, at) > 0))
            for cls in ASSET_ERRORS.values()
        )

    def ranges(self) -> tuple[ParameterRange, ...]:
        """All parameters but the start states."""
        problem = self.problem
        found = [
            ParameterRange(ASSET, name, *cls.fit_range(name, problem.operating_point), cls.neutral)
            for cls, names in self.asset_errors
            for name in names
        ]
        if problem.unknown_inputs:
            found.append(ParameterRange(ASSET, HOLDING, 0.0, 1.0, 0.25, 1 / np.sqrt(12), 0.5))
        for cls in self.classes:
            found += [
                ParameterRange(cls.name, name, *cls.fit_range(name, problem.operating_point))
                for name in self.free_parameters(cls)
            ]
        if not self.instant_friction and any(cls.acts == "drive" for cls in self.classes):
            found.append(ParameterRange(_FRICTION, "travel_root", 0.1, 1.0, 0.3, 0.5, 0.3))
            found.append(ParameterRange(_FRICTION, "gripping", 0.0, 2.0, 0.3, 0.5, 0.5))
        acts = {cls.acts for cls in self.classes}
        shaft = max((len(cls.rotor_fields) for cls in self.classes), default=0)
        if shaft > 1 and problem.reaches_limit and not problem.inverse_dynamics and "stop" not in acts:
            # shares of their maxima, with uniform priors
            found.append(ParameterRange(SHAFT, "rebound", 0.0, 1.0, 0.1, 1 / np.sqrt(12), 0.5))
            if shaft > 2 and "slack" not in acts:
                found.append(ParameterRange(SHAFT, "swing", 0.0, 1.0, 0.1, 1 / np.sqrt(12), 0.5))
        if self.model_error:
            found += [
                ParameterRange(cls.name + _FORM, way, -most, most, 0.3 * most, most / np.sqrt(3))
                for cls in self.classes
                if cls.name in dict(self.model_error)
                for way, most in model_error_terms(cls).items()
            ]
        return tuple(found)

    def free_parameters(self, cls: type[Effect]) -> list[str]:
        """The fitted parameters of an effect; those of its shaft are fitted as SHAFT's."""
        excluded = (*cls.rotor_fields[1:], *cls.range_fields)
        return [n for n in cls.parameters(self.problem.plant.joint_type) if n not in excluded]

    def neutral(self) -> Array:
        """(p,) the point where the asset is exact and effects have half their typical size."""
        return np.array(
            [
                np.clip(r.neutral if r.owner == ASSET or "form" in r.owner else 0.5 * r.size, r.lower, r.upper)
                for r in self.ranges()
            ]
        )

    def effects(self, theta: Array) -> tuple[Effect, ...]:
        """The added effects at parameters (p,)."""
        return ParameterMap(self).added(theta)


def model_error_terms(cls: type[Effect]) -> dict[str, float]:
    """Terms of an effect's model error and their largest shares."""
    if cls.name not in laws.LAWS or cls.acts == "stop":
        return {}
    over_speed, over_place = cls.model_error
    ways = {"over speed": over_speed, "over place": over_place, "bend": over_place}
    return {way: most for way, most in ways.items() if most > 0}


def repeats_family(names: tuple[str, ...]) -> bool:
    """Whether two effects of a set are one effect in a special case (`Effect.reduces_to`): one of them does as much."""
    families = [EFFECTS[name].reduces_to or name for name in names]
    return len({*families}) < len(families)


class ParameterMap:
    """Maps parameters (p,) to effects and to the kernel's vectors."""

    def __init__(self, model: Model):
        self.model: Model = model
        self.ranges = model.ranges()
        self.base = model.problem.plant.effects
        self.owners = [r.owner for r in self.ranges]
        self.asset_errors = model.asset_errors
        self.free_fields = [(cls, model.free_parameters(cls)) for cls in model.classes]
        self.sensing = any(e.kind == "sensing" for e in self.base) or any(c.kind == "sensing" for c in model.classes)

    def effects(self, theta: Array) -> tuple[Effect, ...]:
        """The asset's own effects and the added ones."""
        return (*self.base, *self.added(theta))

    def added(self, theta: Array) -> tuple[Effect, ...]:
        """The added effects at parameters (p,)."""
        effects: list[Effect] = []
        for cls, names in self.free_fields:
            at = self.owners.index(cls.name)
            values = dict(zip(names, map(float, theta[at : at + len(names)]), strict=True))
            effects.append(cls(**values, **self.model.problem.range_ends(cls)))
        return tuple(self._with_shaft(theta, e, effects) for e in effects) if SHAFT in self.owners else tuple(effects)

    def _with_shaft(self, theta: Array, effect: Effect, added: Sequence[Effect]) -> Effect:
        """The effect with its shaft's rebound, if it is a drive. The rotor's share of all inertia counts, or that of
        the drive side of a slack."""
        slack = any(e.acts == "slack" for e in (*self.base, *added))
        own, shaft = effect.rotor().inertia, effect.rotor_fields[1:]
        if not shaft or (slack and effect.acts != "slack"):
            return effect
        part = self.nuisance(theta).inertia * self.model.problem.plant.mechanics.inertia
        share = self.drive_share(theta, added) if slack else own / (part + own)
        values = self.rebound_ratio(theta, share), self.swing_time(theta, share)
        return replace(effect, **dict(zip(shaft, values, strict=False)))  # type: ignore[type-var]

    def rebound_ratio(self, theta: Array, share: float) -> float:
        """Rebound speed ratio of a drive with this `share` of all inertia. A damping ratio z of both bodies together is
        z * sqrt(1 - share) of the drive alone; see `events.drive_rebound`."""
        z = _SHAFT_DAMPING * np.sqrt(1 - share)
        most = np.exp(-2 * z * np.arccos(z) / np.sqrt(1 - z * z))
        return float(theta[self.owners.index(SHAFT)] * most)

    def swing_time(self, theta: Array, share: float) -> float:
        """Time, s, in which the drive alone oscillates by one radian on its shaft."""
        found = [x for r, x in zip(self.ranges, theta, strict=True) if (r.owner, r.name) == (SHAFT, "swing")]
        most = _MAX_SWING * self.model.problem.crossing_s
        return float(found[0] * most / np.sqrt(1 - share)) if found else 0.0

    def drive_share(self, theta: Array, added: Sequence[Effect]) -> float:
        """Largest possible share of all inertia that is the drive's: inertia beyond the least of the part may be the
        drive's."""
        own, doubt = self.model.problem.plant.mechanics.inertia, self.model.problem.inertia_relative
        drive = sum(e.rotor().inertia for e in added)
        taken = self.nuisance(theta).inertia
        return float((drive + (taken - 1 + doubt) * own) / (taken * own + drive))

    def nuisance(self, theta: Array) -> Nuisance:
        """Errors of the asset, and how its inputs are held."""
        values = {r.name: float(x) for r, x in zip(self.ranges, theta, strict=True) if r.owner == ASSET}
        errors = [cls(**{name: values[name] for name in names}) for cls, names in self.asset_errors]
        return Nuisance.of(errors, values.get(HOLDING, 0.0))

    def vector(self, theta: Array) -> tuple[Array, tuple[Effect, ...]]:
        """The kernel's vector, start state 0, and all effects."""
        effects, problem = self.effects(theta), self.model.problem
        numbers = make_vector(problem.plant, effects, self.nuisance(theta))
        if _FRICTION in self.owners:
            root, gripping = theta[(at := self.owners.index(_FRICTION)) : at + 2]
            numbers[kernel.TRAVEL] = BEARING_TRAVEL * (problem.q_high - problem.q_low) * root**2
            numbers[kernel.GRIPPING] = gripping
        if self.model.model_error:
            self._set_model_error(numbers, effects, theta)
        return numbers, effects

    def _set_model_error(self, numbers: Array, effects: tuple[Effect, ...], theta: Array) -> None:
        """Write the model error of the effects into the kernel's vector."""
        speed, middle, half = self.model.problem.reference
        values = {(r.owner, r.name): float(x) for r, x in zip(self.ranges, theta, strict=True)}
        by_name = {e.name: e for e in effects}
        usual = dict(self.model.model_error)
        numbers[kernel.MODEL_ERROR_SPEED] = speed
        for which, _, at, local, _ in effect_terms(effects):
            if not local:
                numbers[at : at + 2] = middle, half
            name, size = laws.NAMES[which], by_name[laws.NAMES[which]].values()[0]
            times = usual.get(name, 0.0) / size if size else 0.0
            ways = ("over speed", "over place", "bend")
            numbers[at + 2 : at + 5] = [times * values.get((name + _FORM, way), 0.0) for way in ways]
