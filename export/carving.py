"""What one part sweeps is cut out of the other, so that they are nowhere in each other: a difference of solids."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from manifold3d import Error, Manifold, Mesh64
from numpy.typing import NDArray

from export.penetration import Overlap
from freeart21.articulation import PARTS, Articulation
from freeart21.joint import Joint
from freeart21.mesh import Mesh

COARSE = 9
"""States by which it is told which part loses less."""
MOST = 48
"""Copies of a part that are cut out at most: each costs up to 0.2 s."""
FINE = 0.2
"""Part of the tolerance by which solids may be simplified before they are cut."""
LARGEST = 0.5
"""Part of a part's volume that may be cut away: what loses more is not the same thing any more."""


@dataclass(frozen=True)
class Carved:
    """What is left of a part."""

    name: str
    """'reference' or 'moving'."""
    mesh: Mesh
    volume: float
    """m^3 that was cut away."""


def carved(parts: Articulation, low: float, high: float, tolerance: float, overlap: Overlap) -> Carved | str:
    """One of two closed parts without what the other sweeps over the states [low, high]; why not, when it cannot be.

    Cut is the part that loses less volume. Copies of the other stand so close that what they leave standing between
    them is no higher than `tolerance`, metres: a corner between copies a step apart leaves at most half of the step.

    Args:
        parts: in any frame, metres; meshes face outwards.
        low: rad or m.
        high: rad or m.
        tolerance: metres.
        overlap: of these parts.
    """
    solids = {}
    for name in PARTS:
        solid = solid_of(parts.part(name))
        if solid is None:
            return f"the {name} part is not closed"
        solids[name] = solid
    ways = {"reference": parts.joint, "moving": parts.joint.reversed()}
    others = {"reference": "moving", "moving": "reference"}

    def rest(name: str, states: NDArray[np.float64], error: float) -> tuple[Manifold, float]:
        """What is left of a part, to within `error`, and the m^3 that it lost."""
        target, tool = (solids[n].simplify(error) for n in (name, others[name]))
        left = _without(target, tool, ways[name], states)
        return left, float(target.volume() - left.volume())

    coarse = np.linspace(low, high, COARSE)
    lost = {name: rest(name, coarse, tolerance)[1] for name in solids}
    name = min(PARTS, key=lambda n: lost[n])
    inside = np.max([overlap.depths(float(state)) for state in coarse], axis=0) > 0
    travel = (high - low) * float(overlap.speeds[inside].max(initial=0.0))
    count = int(np.clip(np.ceil(travel / (2 * tolerance)), COARSE, MOST))
    left, volume = rest(name, np.linspace(low, high, count), tolerance * FINE)
    if left.status() != Error.NoError or left.volume() < (1 - LARGEST) * solids[name].volume():
        return f"more than {100 * LARGEST:g} % of the {name} part would be cut away"
    out = left.to_mesh64()
    mesh = Mesh(np.asarray(out.vert_properties)[:, :3], np.asarray(out.tri_verts).astype(np.int64))
    return Carved(name, mesh, volume)


def solid_of(mesh: Mesh) -> Manifold | None:
    """The closed solid of a mesh; None when the mesh is not closed."""
    if mesh.empty:
        return None
    points, place = np.unique(mesh.vertices, axis=0, return_inverse=True)
    faces = place.reshape(-1)[mesh.faces].astype(np.uint64)
    solid = Manifold(Mesh64(np.ascontiguousarray(points), np.ascontiguousarray(faces)))
    return solid if solid.status() == Error.NoError and solid.volume() > 0 else None


def _without(target: Manifold, tool: Manifold, joint: Joint, states: NDArray[np.float64]) -> Manifold:
    """`target` less `tool` at every state of `joint`."""
    for T in joint.transform(states):
        target = target - tool.transform(T[:3])
        target.num_tri()  # evaluates it: a late evaluation would join all tools first, which is slower
    return target
