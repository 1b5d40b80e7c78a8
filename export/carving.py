"""What one part sweeps is cut out of the other, so that they are nowhere in each other: a difference of solids."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from manifold3d import Error, Manifold, Mesh64
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from export.penetration import Overlap
from freeart21 import se3
from freeart21.articulation import Articulation
from freeart21.joint import Joint
from freeart21.mesh import Mesh

COARSE = 9
"""States by which it is told which part loses less."""
MOST = 96
"""Copies of a part that are cut out at most."""
LARGEST = 0.5
"""Part of a part's volume that may be cut away: what loses more is not the same thing any more."""


@dataclass(frozen=True)
class Carved:
    """A part after cutting."""

    name: str
    """'reference' or 'moving'."""
    mesh: Mesh
    faces_before: NDArray[np.int64]
    """(F,) which triangle of the part's mesh each triangle is of; -1 of a cut's."""
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
    solids = {name: solid_of(parts.part(name)) for name in ("reference", "moving")}
    for name, solid in solids.items():
        if solid is None:
            return f"the {name} part is not closed"
    ways = {"reference": parts.joint, "moving": parts.joint.reversed()}
    others = {"reference": "moving", "moving": "reference"}

    def rest(name: str, states: NDArray[np.float64], fine: bool) -> Manifold:
        target, tool = solids[name], solids[others[name]]
        assert target is not None and tool is not None
        return _without(target, tool if fine else tool.simplify(tolerance), ways[name], states)

    coarse = np.linspace(low, high, COARSE)
    lost = {
        name: solid.volume() - rest(name, coarse, False).volume() for name, solid in solids.items() if solid is not None
    }
    name = min(("reference", "moving"), key=lambda n: lost[n])
    inside = np.max([overlap.depths(float(state)) for state in coarse], axis=0) > 0
    travel = (high - low) * float(overlap.speeds[inside].max(initial=0.0))
    count = int(np.clip(np.ceil(travel / (2 * tolerance)), COARSE, MOST))
    states = np.linspace(low, high, count)
    left = rest(name, states, True)
    before = solids[name]
    assert before is not None
    if left.status() != Error.NoError or left.volume() < (1 - LARGEST) * before.volume():
        return f"more than {100 * LARGEST:g} % of the {name} part would be cut away"
    mesh, faces = _mesh_of(left, parts.part(name), before.original_id())
    return Carved(name, mesh, faces, float(before.volume() - left.volume()))


def solid_of(mesh: Mesh) -> Manifold | None:
    """The closed solid of a mesh, its triangles numbered; None when the mesh is not closed."""
    if mesh.empty:
        return None
    points, place = np.unique(mesh.vertices, axis=0, return_inverse=True)
    faces = place.reshape(-1)[mesh.faces].astype(np.uint64)
    number = Manifold.reserve_ids(1)
    solid = Manifold(
        Mesh64(
            np.ascontiguousarray(points),
            np.ascontiguousarray(faces),
            run_index=np.array([0, 3 * len(faces)], np.uint64),
            run_original_id=np.array([number], np.uint32),
            face_id=np.arange(len(faces), dtype=np.uint64),
        )
    )
    return solid if solid.status() == Error.NoError and solid.volume() > 0 else None


def _without(target: Manifold, tool: Manifold, joint: Joint, states: NDArray[np.float64]) -> Manifold:
    """`target` less `tool` at every state of `joint`."""
    for T in joint.transform(states):
        target = target - tool.transform(T[:3])
    return target


def _mesh_of(solid: Manifold, before: Mesh, number: int) -> tuple[Mesh, NDArray[np.int64]]:
    """A solid's mesh with the colours of the nearest vertices of before, and its triangles' numbers there."""
    out = solid.to_mesh64()
    vertices, faces = np.asarray(out.vert_properties)[:, :3], np.asarray(out.tri_verts).astype(np.int64)
    numbers = np.full(len(faces), -1)
    index = np.asarray(out.run_index) // 3
    for k, run in enumerate(out.run_original_id):
        if run == number:
            own = slice(int(index[k]), int(index[k + 1]))
            numbers[own] = np.asarray(out.face_id)[own]
    colours = None if before.colours is None else before.colours[cKDTree(before.vertices).query(vertices)[1]]
    return Mesh(vertices, faces, colours), numbers
