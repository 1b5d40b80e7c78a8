"""Sets that do much the same as one that was found, begun where they do: what a search from below may miss."""

from __future__ import annotations

from dataclasses import dataclass

from freeart21.effects.base import Alternative, Effect, OperatingPoint
from freeart21.se3 import Array
from simgap.fit.fit import Fit, Model, ParameterMap, Problem, Starts, initial_theta
from simgap.models import kernel


@dataclass(frozen=True)
class AlternativeStart:
    """Where a fit of a set begins."""

    model: Model
    theta: Array
    """(p,)"""
    starts: Starts
    old: Effect
    """The effect of the set that was found, in whose place is `new`."""
    new: str


def find_alternatives(problem: Problem, fit: Fit, names: tuple[str, ...]) -> list[AlternativeStart]:
    """The sets with another effect, of `names`, in the place of one that does much the same (`Effect.alternatives`)."""
    numbers = ParameterMap(fit.model).vector(fit.theta)[0]
    cosine, sine, constant = map(float, numbers[kernel.GRAVITY_COS : kernel.GRAVITY_CONST + 1])
    operating_point = OperatingPoint(
        problem.plant.joint_type,
        problem.speed,
        problem.q_high - problem.q_low,
        problem.load if problem.bearing_loaded else 0.0,
        float(numbers[kernel.INERTIA]),
        (cosine, sine, constant),
    )
    others = {*names} - {*fit.model.names}
    return [
        _swap_effect(problem, fit, effect, other)
        for effect in fit.effects
        for other in effect.alternatives(operating_point)
        if other.name in others
    ]


def find_confounded(problem: Problem, fit: Fit, names: tuple[str, ...]) -> list[AlternativeStart]:
    """Those with an effect's twin in its place."""
    return [at for at in find_alternatives(problem, fit, names) if at.new == at.old.confounded_with]


def _swap_effect(problem: Problem, fit: Fit, old: Effect, other: Alternative) -> AlternativeStart:
    model = Model(problem, tuple(sorted({*fit.model.names, other.name} - {old.name})))
    starts = {name: (q + other.position_shift, v) for name, (q, v) in fit.starts.items()}
    return AlternativeStart(model, initial_theta(model, fit, {other.name: other.point}), starts, old, other.name)
