"""Sets that do much the same as one that was found, begun where they do: what a search from below may miss."""

from __future__ import annotations

import numpy as np

from freeart21.effects import Effect
from freeart21.effects.armature import Armature
from freeart21.effects.coulomb_friction import CoulombFriction
from freeart21.effects.detent import Detent
from freeart21.effects.encoder_offset import EncoderOffset
from freeart21.effects.load_friction import LoadFriction
from freeart21.effects.quadratic_drag import QuadraticDrag
from freeart21.effects.viscous_damping import ViscousDamping
from simgap.fitting.fit import Fit, Reader, Theory, fitted, joined
from simgap.fitting.search import Search
from simgap.motion import kernel

TWINS = {"coulomb_friction": ("level", "load_friction"), "load_friction": ("coefficient", "coulomb_friction")}
"""Effect to its size's name and to the effect that does the same where the load on the bearing stays as it is."""


def twins(search: Search, fit: Fit) -> list[Fit]:
    """The sets with an effect's twin in its place, started where both do the same under the usual load."""
    found = []
    for name in fit.theory.names:
        size, twin = TWINS.get(name, ("", ""))
        if twin not in search.names or twin in fit.theory.names:
            continue
        value = getattr(next(e for e in fit.effects if e.name == name), size)
        load = search.problem.load
        usual = value * load if name == "load_friction" else value / load
        found.append(_instead(search, fit, name, twin, {TWINS[twin][0]: usual}))
    return found


def losses(search: Search, fit: Fit) -> list[Fit]:
    """The set with damping in the place of another loss, or drag in that of damping, started where half the top speed
    takes the same force: beside dry friction or slack a first-order guess may take one for the other."""
    found = []
    half, load = 0.5 * search.problem.speed, search.problem.load
    swaps: tuple[tuple[type[Effect], str, type[Effect], float], ...] = (
        (QuadraticDrag, "coefficient", ViscousDamping, half),
        (ViscousDamping, "coefficient", QuadraticDrag, 1 / half),
        (CoulombFriction, "level", ViscousDamping, 1 / half),
        (LoadFriction, "coefficient", ViscousDamping, load / half),
    )
    for old, size, new, ratio in swaps:
        if new.name in search.names and new.name not in fit.theory.names:
            sizes = [getattr(effect, size) for effect in fit.effects if isinstance(effect, old)]
            found += [_instead(search, fit, old.name, new.name, {"coefficient": x * ratio}) for x in sizes]
    return found


def turned(search: Search, fit: Fit) -> list[Fit]:
    """The set with gravity that pulls from elsewhere in the place of a hinge's zero that is off: the same motion,
    wherever nothing else has a place."""
    hinge = search.problem.plant.joint_type == "revolute" and "gravity_offset" in search.names
    if not hinge or "encoder_offset" not in fit.theory.names or "gravity_offset" in fit.theory.names:
        return []
    by = next(e.offset for e in fit.effects if isinstance(e, EncoderOffset))
    numbers = Reader(fit.theory).numbers(fit.theta)[0]
    pull = complex(numbers[kernel.GRAVITY_COS], numbers[kernel.GRAVITY_SIN])
    change = pull * complex(np.exp(1j * by)) - pull
    point = {"cosine": change.real, "sine": change.imag}
    return [_instead(search, fit, "encoder_offset", "gravity_offset", point, by)]


def lighter(search: Search, fit: Fit) -> list[Fit]:
    """The set with gravity that pulls less in the place of a drive's inertia: the same motion, where no other force is
    known."""
    names = fit.theory.names
    if "armature" not in names or "gravity_offset" in names or "gravity_offset" not in search.names:
        return []
    numbers = Reader(fit.theory).numbers(fit.theta)[0]
    added = next(e.inertia() for e in fit.effects if isinstance(e, Armature))
    less = -added / numbers[kernel.INERTIA]
    pulls = {"cosine": kernel.GRAVITY_COS, "sine": kernel.GRAVITY_SIN, "constant": kernel.GRAVITY_CONST}
    point = {name: float(less * numbers[at]) for name, at in pulls.items()}
    return [_instead(search, fit, "armature", "gravity_offset", point)]


def narrowed(search: Search, fit: Fit) -> list[Fit]:
    """The set with a spring in the place of a notch so wide that nothing of it but its slope is seen."""
    names = fit.theory.names
    if "detent" not in names or "return_spring" in names or "return_spring" not in search.names:
        return []
    known = search.fits.get(tuple(sorted({*names, "return_spring"} - {"detent"})))
    if known is not None and known.cost <= fit.cost:
        return []
    notch = next(e for e in fit.effects if isinstance(e, Detent))
    return [_instead(search, fit, "detent", "return_spring", {"stiffness": notch.steepness(), "rest": notch.centre})]


def _instead(search: Search, fit: Fit, old: str, new: str, point: dict[str, float], ahead: float = 0.0) -> Fit:
    """The set with `new` at `point` in the place of `old`, fitted from there; all starts go `ahead` (rad or m)."""
    theory = Theory(search.problem, tuple(sorted({*fit.theory.names, new} - {old})))
    starts = {name: (q + ahead, v) for name, (q, v) in fit.starts.items()}
    return search.keep(fitted(theory, search.train, joined(theory, fit, {new: point}), starts))
