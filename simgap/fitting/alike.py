"""Sets that do much the same as one that was found, begun where they do: what a search from below may miss."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from freeart21.effects import EFFECTS, Effect
from freeart21.effects.armature import Armature
from freeart21.effects.coulomb_friction import CoulombFriction
from freeart21.effects.detent import Detent
from freeart21.effects.encoder_offset import EncoderOffset
from freeart21.effects.latch import Latch
from freeart21.effects.load_friction import LoadFriction
from freeart21.effects.quadratic_drag import QuadraticDrag
from freeart21.effects.viscous_damping import ViscousDamping
from freeart21.se3 import Array
from simgap.fitting.fit import Fit, Problem, Reader, Starts, Theory, joined
from simgap.motion import kernel

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
        if twin is None or twin not in names or twin in fit.theory.names or not problem.bearing_loaded:
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


def turned(problem: Problem, fit: Fit, names: tuple[str, ...]) -> list[Beginning]:
    """The set with gravity that pulls from elsewhere in the place of a hinge's zero that is off: the same motion,
    wherever nothing else has a place."""
    hinge = problem.plant.joint_type == "revolute" and "gravity_offset" in names
    if not hinge or "encoder_offset" not in fit.theory.names or "gravity_offset" in fit.theory.names:
        return []
    by = next(e.offset for e in fit.effects if isinstance(e, EncoderOffset))
    numbers = Reader(fit.theory).numbers(fit.theta)[0]
    pull = complex(numbers[kernel.GRAVITY_COS], numbers[kernel.GRAVITY_SIN])
    change = pull * complex(np.exp(1j * by)) - pull
    point = {"cosine": change.real, "sine": change.imag}
    return [_instead(problem, fit, "encoder_offset", "gravity_offset", point, by)]


def lighter(problem: Problem, fit: Fit, names: tuple[str, ...]) -> list[Beginning]:
    """The set with gravity that pulls less in the place of a drive's inertia: the same motion, where no other force is
    known."""
    own = fit.theory.names
    if "armature" not in own or "gravity_offset" in own or "gravity_offset" not in names:
        return []
    numbers = Reader(fit.theory).numbers(fit.theta)[0]
    added = next(e.inertia() for e in fit.effects if isinstance(e, Armature))
    less = -added / numbers[kernel.INERTIA]
    pulls = {"cosine": kernel.GRAVITY_COS, "sine": kernel.GRAVITY_SIN, "constant": kernel.GRAVITY_CONST}
    point = {name: float(less * numbers[at]) for name, at in pulls.items()}
    return [_instead(problem, fit, "armature", "gravity_offset", point)]


def narrowed(problem: Problem, fit: Fit, names: tuple[str, ...]) -> list[Beginning]:
    """The set with a spring in the place of a notch so wide that nothing of it but its slope is seen."""
    own = fit.theory.names
    if "detent" not in own or "return_spring" in own or "return_spring" not in names:
        return []
    notch = next(e for e in fit.effects if isinstance(e, Detent))
    return [_instead(problem, fit, "detent", "return_spring", {"stiffness": notch.steepness(), "rest": notch.centre})]


def held(problem: Problem, fit: Fit, names: tuple[str, ...]) -> list[Beginning]:
    """The set with a notch in the place of a catch, or a catch in that of a notch, of the same force at the same
    place."""
    found = []
    for effect in fit.effects:
        if isinstance(effect, Latch) and "detent" in names and "detent" not in fit.theory.names:
            point = {"peak": effect.hold, "centre": effect.position, "width": effect.travel / _WIDTHS}
            found.append(_instead(problem, fit, "latch", "detent", point))
        if isinstance(effect, Detent) and "latch" in names and "latch" not in fit.theory.names:
            point = {"hold": effect.peak, "position": effect.centre, "travel": _WIDTHS * effect.width, "capture": 0.5}
            found.append(_instead(problem, fit, "detent", "latch", point))
    return found


def _instead(problem: Problem, fit: Fit, old: str, new: str, point: dict[str, float], ahead: float = 0.0) -> Beginning:
    """The set with `new` at `point` in the place of `old`, from there; all starts go `ahead` (rad or m)."""
    theory = Theory(problem, tuple(sorted({*fit.theory.names, new} - {old})))
    starts = {name: (q + ahead, v) for name, (q, v) in fit.starts.items()}
    return Beginning(theory, joined(theory, fit, {new: point}), starts)
