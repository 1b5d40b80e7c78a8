"""Fits started from alternatives: effects that do much the same as a fitted one."""

from __future__ import annotations

from dataclasses import dataclass, replace

from freeart21.effects.base import Alternative, Effect
from freeart21.se3 import Array
from simgap.fit.fit import Fit, Model, ParameterMap, Problem, Starts, initial_theta
from simgap.fit.model import repeats_family
from simgap.models import kernel


@dataclass(frozen=True)
class AlternativeStart:
    """Initial guess of a set with one effect replaced."""

    model: Model
    theta: Array
    """(p,)"""
    starts: Starts
    old: Effect
    """The replaced effect."""
    new: str


def find_alternatives(problem: Problem, fit: Fit, names: tuple[str, ...]) -> list[AlternativeStart]:
    """Starts with an effect replaced by one of `names` that does much the same (`Effect.alternatives`)."""
    numbers = ParameterMap(fit.model).vector(fit.theta)[0]
    cosine, sine, constant = map(float, numbers[kernel.GRAVITY_COS : kernel.GRAVITY_CONST + 1])
    operating_point = replace(
        problem.operating_point, inertia=float(numbers[kernel.INERTIA]), gravity=(cosine, sine, constant)
    )
    others = {*names} - {*fit.model.names}
    found = [
        _swap_effect(problem, fit, effect, other)
        for effect in fit.effects
        for other in effect.alternatives(operating_point)
        if other.name in others
    ]
    return [at for at in found if not repeats_family(at.model.names)]


def find_confounded(problem: Problem, fit: Fit, names: tuple[str, ...]) -> list[AlternativeStart]:
    """Those with an effect replaced by its confounded one."""
    return [at for at in find_alternatives(problem, fit, names) if at.new == at.old.confounded_with]


def _swap_effect(problem: Problem, fit: Fit, old: Effect, other: Alternative) -> AlternativeStart:
    model = Model(problem, tuple(sorted({*fit.model.names, other.name} - {old.name})))
    starts = {name: (q + other.position_shift, v) for name, (q, v) in fit.starts.items()}
    return AlternativeStart(model, initial_theta(model, fit, {other.name: other.point}), starts, old, other.name)
