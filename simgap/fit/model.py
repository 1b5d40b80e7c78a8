"""What is fitted: a set of effects that may be missing, how far the asset itself may be off, and their bounds."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from freeart21.effects import EFFECTS, Effect
from freeart21.se3 import Array
from simgap.models import kernel, laws
from simgap.models.surrogate import Nuisance, Plant, effect_terms, make_vector
from simgap.settings import FitSettings, SurrogateSettings

_FRICTION = "friction form"
"""Owner of how all dry friction that is missing builds up."""
SHAFT = "shaft form"
"""Owner of how a drive's inertia comes back when the part stops dead: no shaft is stiff."""
_FORM = " form"
"""What the name of an effect is followed by in the owner of how it departs from its formula."""
HOLDING = "holding"
"""The asset's number that says how inputs go on between their rows; no lateness of half a row is an effect."""


@dataclass(frozen=True)
class ParameterRange:
    """One number that is fitted."""

    owner: str
    """Name of an effect, 'asset', or what is fitted beside effects ('friction form', 'shaft form')."""
    name: str
    lower: float
    upper: float
    size: float
    """A usual size."""
    prior: float = np.inf
    """Standard deviation of what is known of it beforehand, about its neutral value."""
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
    """Floor at rest."""
    force: float = 1.0
    """Root mean square of the forces at work, N*m or N."""
    load: float = 1.0
    """A usual force on the bearing, N."""
    gear_load: float = 1.0
    """What the drive's gears usually carry, N*m or N."""
    unknown_inputs: bool = False
    """Whether nobody knows if commands and efforts last until their next rows or go on smoothly: where between the two
    they are is then fitted, either end being as likely as any place between."""
    fit: FitSettings = field(default_factory=FitSettings)
    surrogate: SurrogateSettings = field(default_factory=SurrogateSettings)
    inverse_dynamics: bool = False
    """Whether the motion is prescribed and the force is read (`simgap.measure.prescribed`): residuals are then of
    force."""

    def reference_load(self, cls: type[Effect]) -> float:
        """A usual load of what an effect looks at."""
        return self.gear_load if cls.geared else self.load

    def range_ends(self, cls: type[Effect]) -> dict[str, float]:
        """Parameters of an effect that are the ends of the way that was moved through."""
        return dict(zip(cls.range_fields, (self.q_low, self.q_high), strict=False))

    def covers_range(self, cls: type[Effect]) -> bool:
        """Whether an effect over the way that was moved through can say so long a way; a wheel's turns it cannot."""
        specs = cls.parameters()
        return all(specs[name].lower <= x <= specs[name].upper for name, x in self.range_ends(cls).items())

    @property
    def reference(self) -> tuple[float, float, float]:
        """Largest speed, middle and half range of position."""
        return self.speed, 0.5 * (self.q_low + self.q_high), max(0.5 * (self.q_high - self.q_low), 1e-9)

    @property
    def bearing_loaded(self) -> bool:
        """Whether anything but rounding presses on the bearing."""
        mechanics = self.plant.mechanics
        return self.load > 1e-9 * mechanics.mass * float(np.linalg.norm(mechanics.gravity))

    @property
    def reaches_limit(self) -> bool:
        """Whether any run comes to a limit."""
        near = 0.02 * (self.q_high - self.q_low)
        return self.q_low < self.plant.lower + near or self.q_high > self.plant.upper - near

    @property
    def crossing_s(self) -> float:
        """Seconds in which the range moved through is crossed at top speed: how fast all goes here."""
        return (self.q_high - self.q_low) / max(self.speed, 1e-9)


@dataclass(frozen=True)
class Model:
    """A set of effects that may be missing, and what of it is fitted."""

    problem: Problem
    names: tuple[str, ...]
    instant_friction: bool = False
    """Whether dry friction is there at once after a reversal, as in simulators; else it builds up, as real friction
    does."""
    model_error: tuple[tuple[str, float], ...] = ()
    """Effects, and usual first numbers of theirs, that depart from their formulas as real ones do (`Effect.departs`):
    no oil is quite viscous and no spring quite straight. Each is then its formula, and parts of the formula at its
    usual size that are a slope over the speeds, and a slope and a bend over the places that were moved through, any
    size of these up to what the effect says being as likely: a discrepancy inside the model (Brynjarsdottir and O'Hagan
    2014), so that what a strong effect's formula leaves gets no other name. At its usual size: what is no product of
    two numbers is far easier to fit."""

    @property
    def classes(self) -> tuple[type[Effect], ...]:
        """Of the added effects."""
        return tuple(EFFECTS[name] for name in self.names)

    def ranges(self) -> tuple[ParameterRange, ...]:
        """All that is fitted, but the starts."""
        problem, found = self.problem, []
        if problem.inertia_relative > 0:
            r = problem.inertia_relative
            found.append(ParameterRange("asset", "inertia", 1 - r, 1 + r, r, r, 1.0))
        terms = problem.plant.gravity_terms
        if problem.gravity_relative > 0 and np.any(terms[0]):
            r = problem.gravity_relative
            found.append(ParameterRange("asset", "gravity", 1 - r, 1 + r, r, r, 1.0))
        size = float(np.linalg.norm(terms[0]))
        for i in (1, 2):
            column = float(np.linalg.norm(terms[i]))
            lean = problem.fit.tilt_rad
            if i == 1 and problem.plant.joint_type == "revolute" and column > 0:
                lean += problem.gravity_relative * size / column  # a centre of mass that is off turns the pull, too
            if lean > 0 and column > 1e-6 * np.linalg.norm(terms):
                found.append(ParameterRange("asset", f"lean_{i}", -lean, lean, lean, lean))
        if problem.unknown_inputs:
            found.append(ParameterRange("asset", HOLDING, 0.0, 1.0, 0.25, 1 / np.sqrt(12), 0.5))
        for cls in self.classes:
            found += [self._range(cls, name) for name in self.free_parameters(cls)]
        if not self.instant_friction and any(cls.acts == "drive" for cls in self.classes):
            found.append(ParameterRange(_FRICTION, "travel_root", 0.1, 1.0, 0.3, 0.5, 0.3))
            found.append(ParameterRange(_FRICTION, "gripping", 0.0, 2.0, 0.3, 0.5, 0.5))
        acts = {cls.acts for cls in self.classes}
        shaft = max((len(cls.rotor_fields) for cls in self.classes), default=0)
        if shaft > 1 and problem.reaches_limit and not problem.inverse_dynamics and "stop" not in acts:
            # part of the most that a shaft gives back; where no run tells, as if all of that were as likely
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
        """The parameters of an effect that are its own: what a shaft gives back, and when, is fitted in their place."""
        excluded = (*cls.rotor_fields[1:], *cls.range_fields)
        return [n for n in cls.parameters(self.problem.plant.joint_type) if n not in excluded]

    def _range(self, cls: type[Effect], name: str) -> ParameterRange:
        """Bounds and size of an effect's parameter on these data: nothing beyond what was moved through."""
        spec, problem = cls.parameters()[name], self.problem
        unit, span = spec.unit(problem.plant.joint_type), problem.q_high - problem.q_low
        low, high, size = spec.lower, spec.upper, spec.scale
        local = any(s.lower >= 0 and s.revolute_unit == "rad" for s in cls.parameters().values())
        if unit in ("rad", "m") and cls.acts == "reading":
            low, high, size = -0.6 * span, 0.6 * span, 0.1 * span
        elif unit in ("rad", "m") and spec.lower < 0:
            reach = 0.1 * span if local else 3 * span
            low, high, size = problem.q_low - reach, problem.q_high + reach, 0.1 * span
        elif unit in ("rad", "m") and cls.acts != "drive":
            # what is wider than a third of the way moved through is no local effect, and looks like a spring
            low, high, size = max(2 * problem.sigma, 1e-3 * span), 0.35 * span, 0.05 * span
        elif unit in ("N*m", "N") and cls.range_fields:
            # where a fold's runs do not come it is no more than a part of the forces at work
            return ParameterRange(cls.name, name, low, high, 0.1 * problem.force, 0.3 * problem.force)
        elif unit in ("N*m", "N") and cls.acts == "command":
            size = 0.1 * problem.force
        elif unit in ("rad/s", "m/s"):
            low, high, size = 0.01 * problem.speed, problem.speed, 0.1 * problem.speed
        elif unit == "s":
            low, high = max(spec.lower, -0.5), 0.5
        elif unit in ("kg*m^2", "kg"):
            size = 0.1 * problem.plant.mechanics.inertia
            low = 1e-3 * size if cls.acts == "inertia" else 0.2 * size  # a lighter drive side moves no otherwise
            low, high = max(spec.lower, low), 1e3 * size
        elif unit in ("s/rad", "s/m"):
            # impacts of one speed do not tell it: without need it is none
            usual = 1 / problem.speed
            return ParameterRange(cls.name, name, low, 50 * usual, 0.5 * usual, usual)
        elif unit == "1":
            high = min(spec.upper, 10.0)
        return ParameterRange(cls.name, name, max(low, spec.lower), min(high, spec.upper), size)

    def neutral(self) -> Array:
        """(p,) a point at which the asset is right; effects are at half their usual size."""
        return np.array(
            [
                np.clip(r.neutral if r.owner == "asset" or "form" in r.owner else 0.5 * r.size, r.lower, r.upper)
                for r in self.ranges()
            ]
        )

    def effects(self, theta: Array) -> tuple[Effect, ...]:
        """The added effects at parameters (p,)."""
        return ParameterMap(self).added(theta)


def model_error_terms(cls: type[Effect]) -> dict[str, float]:
    """Ways in which a real effect departs from its formula, and by what part of itself at most."""
    if cls.name not in laws.LAWS or cls.acts == "stop":
        return {}
    over_speed, over_place = cls.model_error
    ways = {"over speed": over_speed, "over place": over_place, "bend": over_place}
    return {way: most for way, most in ways.items() if most > 0}


class ParameterMap:
    """Turns parameters into the kernel's vectors."""

    def __init__(self, model: Model):
        self.model: Model = model
        self.ranges = model.ranges()
        self.base = model.problem.plant.effects
        self.owners = [r.owner for r in self.ranges]
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
        """The effect, if it is a drive, as it comes back from limits: a rotor on its shaft by its own share of all
        inertia, but behind a slack the drive side."""
        slack = any(e.acts == "slack" for e in (*self.base, *added))
        own, shaft = effect.rotor().inertia, effect.rotor_fields[1:]
        if not shaft or (slack and effect.acts != "slack"):
            return effect
        part = self.nuisance(theta).inertia * self.model.problem.plant.mechanics.inertia
        share = self.drive_share(theta, added) if slack else own / (part + own)
        values = self.rebound_ratio(theta, share), self.swing_time(theta, share)
        return replace(effect, **dict(zip(shaft, values, strict=False)))  # type: ignore[type-var]

    def rebound_ratio(self, theta: Array, share: float) -> float:
        """Part of its speed that a drive comes back with, whose `share` of all inertia is known.

        Of the drive's inertia alone on a shaft that stops at the other end, a damping ratio z is left of that of both:
        see `events.drive_rebound`.
        """
        z = self.model.problem.fit.shaft_damping * np.sqrt(1 - share)
        most = np.exp(-2 * z * np.arccos(z) / np.sqrt(1 - z * z))
        return float(theta[self.owners.index(SHAFT)] * most)

    def swing_time(self, theta: Array, share: float) -> float:
        """Seconds in which the drive alone swings by a radian on its shaft, slower than it and the part together."""
        found = [x for r, x in zip(self.ranges, theta, strict=True) if (r.owner, r.name) == (SHAFT, "swing")]
        most = self.model.problem.fit.swing_tolerance * self.model.problem.crossing_s
        return float(found[0] * most / np.sqrt(1 - share)) if found else 0.0

    def drive_share(self, theta: Array, added: Sequence[Effect]) -> float:
        """Part of all inertia that is a drive's, as large as it may be: what is taken for the part's own inertia beyond
        the least that this may be is the drive's as well."""
        own, doubt = self.model.problem.plant.mechanics.inertia, self.model.problem.inertia_relative
        drive = sum(e.rotor().inertia for e in added)
        taken = self.nuisance(theta).inertia
        return float((drive + (taken - 1 + doubt) * own) / (taken * own + drive))

    def nuisance(self, theta: Array) -> Nuisance:
        """How the asset is off."""
        asset = {r.name: float(x) for r, x in zip(self.ranges, theta, strict=True) if r.owner == "asset"}
        return Nuisance(
            asset.get("inertia", 1.0),
            asset.get("gravity", 1.0),
            (asset.get("lean_1", 0.0), asset.get("lean_2", 0.0)),
            asset.get(HOLDING, 0.0),
        )

    def vector(self, theta: Array) -> tuple[Array, tuple[Effect, ...]]:
        """The vector, start left at 0, and all effects."""
        effects, problem = self.effects(theta), self.model.problem
        numbers = make_vector(problem.plant, effects, self.nuisance(theta))
        if _FRICTION in self.owners:
            root, gripping = theta[(at := self.owners.index(_FRICTION)) : at + 2]
            numbers[kernel.TRAVEL] = problem.fit.travel_tolerance * (problem.q_high - problem.q_low) * root**2
            numbers[kernel.GRIPPING] = gripping
        if self.model.model_error:
            self._set_model_error(numbers, effects, theta)
        return numbers, effects

    def _set_model_error(self, numbers: Array, effects: tuple[Effect, ...], theta: Array) -> None:
        """Write into the kernel's vector how effects depart from their formulas."""
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
