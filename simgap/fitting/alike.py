"""Sets that do much the same as one that was found, begun where they do: what a search from below may miss."""

from __future__ import annotations

from dataclasses import dataclass

from freeart21.effects import EFFECTS, Effect
from freeart21.effects.coulomb_friction import CoulombFriction
from freeart21.effects.load_friction import LoadFriction
from freeart21.effects.quadratic_drag import QuadraticDrag
from freeart21.effects.viscous_damping import ViscousDamping
from freeart21.se3 import Array
from simgap.fitting.fit import Fit, Problem, Starts, Theory, joined

_WIDTHS = 1.5
"""Widths of a notch from its middle to where it holds no more, about."""


@dataclass(frozen=True)
class Beginning:
    """Where a fit of a set begins."""

    theory: Theory
    theta: Array
    """(p,)"""
    starts: Starts


def twins(problem: Problem, fit: Fit, names: tuple[str, ...]) -> list[Beginning]:
    """The sets with an effect's twin in its place, started where both do the same under the usual load."""
    found = []
    for effect in fit.effects:
        twin = effect.twin
        if twin is None or twin not in names or twin in fit.theory.names:
            continue
        size = effect.values()[0]
        usual = size * problem.load if effect.needs_load else size / problem.load
        found.append(_instead(problem, fit, effect.name, twin, {next(iter(EFFECTS[twin].parameters())): usual}))
    return found


def losses(problem: Problem, fit: Fit, names: tuple[str, ...]) -> list[Beginning]:
    """The set with damping in the place of another loss, or drag in that of damping, started where half the top speed
    takes the same force: beside dry friction or slack a first-order guess may take one for the other."""
    found = []
    half, load = 0.5 * problem.speed, problem.load
    swaps: tuple[tuple[type[Effect], str, type[Effect], float], ...] = (
        (QuadraticDrag, "coefficient", ViscousDamping, half),
        (ViscousDamping, "coefficient", QuadraticDrag, 1 / half),
        (CoulombFriction, "level", ViscousDamping, 1 / half),
        (LoadFriction, "coefficient", ViscousDamping, load / half),
    )
    for old, size, new, ratio in swaps:
        if new.name in names and new.name not in fit.theory.names:
            sizes = [getattr(effect, size) for effect in fit.effects if isinstance(effect, old)]
            found += [_instead(problem, fit, old.name, new.name, {"coefficient": x * ratio}) for x in sizes]
    return found


def _instead(problem: Problem, fit: Fit, old: str, new: str, point: dict[str, float]) -> Beginning:
    """The set with `new` at `point` in the place of `old`, from there."""
    theory = Theory(problem, tuple(sorted({*fit.theory.names, new} - {old})))
    return Beginning(theory, joined(theory, fit, {new: point}), fit.starts)
