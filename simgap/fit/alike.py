"""Sets that do much the same as one that was found, begun where they do: what a search from below may miss."""

from __future__ import annotations

from dataclasses import dataclass

from freeart21.effects.base import Alternative, Effect, Surroundings
from freeart21.se3 import Array
from simgap.fit.fit import Fit, Problem, Reader, Starts, Theory, joined
from simgap.models import kernel


@dataclass(frozen=True)
class Beginning:
    """Where a fit of a set begins."""

    theory: Theory
    theta: Array
    """(p,)"""
    starts: Starts
    old: Effect
    """The effect of the set that was found, in whose place is `new`."""
    new: str


def alternatives(problem: Problem, fit: Fit, names: tuple[str, ...]) -> list[Beginning]:
    """The sets with another effect, of `names`, in the place of one that does much the same (`Effect.alternatives`)."""
    numbers = Reader(fit.theory).numbers(fit.theta)[0]
    cosine, sine, constant = map(float, numbers[kernel.GRAVITY_COS : kernel.GRAVITY_CONST + 1])
    among = Surroundings(
        problem.plant.joint_type,
        problem.speed,
        problem.q_high - problem.q_low,
        problem.load if problem.bearing_loaded else 0.0,
        float(numbers[kernel.INERTIA]),
        (cosine, sine, constant),
    )
    others = {*names} - {*fit.theory.names}
    return [
        _instead(problem, fit, effect, other)
        for effect in fit.effects
        for other in effect.alternatives(among)
        if other.name in others
    ]


def twins(problem: Problem, fit: Fit, names: tuple[str, ...]) -> list[Beginning]:
    """Those with an effect's twin in its place."""
    return [at for at in alternatives(problem, fit, names) if at.new == at.old.twin]


def _instead(problem: Problem, fit: Fit, old: Effect, other: Alternative) -> Beginning:
    theory = Theory(problem, tuple(sorted({*fit.theory.names, other.name} - {old.name})))
    starts = {name: (q + other.ahead, v) for name, (q, v) in fit.starts.items()}
    return Beginning(theory, joined(theory, fit, {other.name: other.point}), starts, old, other.name)
