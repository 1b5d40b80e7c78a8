"""What one part sweeps is cut out of the other, so that they are nowhere in each other: a difference of solids."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from manifold3d import Error, Manifold, Mesh64, OpType
from numpy.typing import NDArray

from export.penetration import Overlap
from freeart21.articulation import PARTS, Articulation
from freeart21.joint import Joint
from freeart21.mesh import Mesh

COARSE = 9
"""States at which it is looked where the parts are in each other."""
ROUGHLY = 5
"""Doublings of the states of a turn by which it is told which part loses less. Not measured."""
MOST = 8
"""Doublings of what turns at most: 256 copies."""
FINE = 0.1
"""Part of the tolerance by which solids may be simplified before and after each doubling: at .4 a drawer stayed 1.7 mm
in its cabinet, at .2 .4. Sheets thinner than that go: on one in its doorway a cabinet seemed 23 mm in its drawer."""
CRUMB = 0.01
"""Part of a solid below which a loose piece of it is dropped, as `MeshSettings.min_component`."""
LARGEST = 0.8
"""Part of a part's volume that may be cut away: what loses more is not the same thing any more. Where nobody looked in
between, closed halves of a phone each fill the other's place, too: at .5 a phone and a USB stick were refused."""


@dataclass(frozen=True)
class Carved:
    """What is left of a part."""

    name: str
    """'reference' or 'moving'."""
    mesh: Mesh
    other: Mesh
    """The other part, without its sheets that have no thickness: they are no matter, and swept nothing."""
    volume: float
    """m^3 that was cut away."""


def carved(parts: Articulation, low: float, high: float, tolerance: float, overlap: Overlap) -> Carved | str:
    """One of two closed parts without what the other sweeps over the states [low, high]; why not, when it cannot be.

    Cut is the part that loses less volume. What slides sweeps is made as it is; what turns is copied so close that what
    the copies leave standing between them is no higher than `tolerance`, metres: a corner between copies a step apart
    leaves at most half of the step.

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
        solids[name] = solid.simplify(FINE * tolerance)
    back = replace(parts.joint, axis=-parts.joint.axis)
    ways = {"reference": parts.joint, "moving": back}  # of the other part, as each part has it at each state
    others = {"reference": "moving", "moving": "reference"}
    coarse = np.linspace(low, high, COARSE)
    inside = np.max([overlap.depths(float(state)) for state in coarse], axis=0) > 0
    travel = (high - low) * float(overlap.speeds[inside].max(initial=0.0))
    doublings = int(np.clip(np.ceil(np.log2(travel / (2 * tolerance) + 1)), ROUGHLY, MOST))

    def left(name: str, doublings: int) -> Manifold:
        way, tool = ways[name], solids[others[name]]
        if way.type == "prismatic":
            swept = _slid(tool.transform(way.transform(low)[:3]), (high - low) * way.axis).simplify(FINE * tolerance)
        else:
            swept = _swept(tool, way, low, high, doublings, FINE * tolerance)
        return _without_crumbs((solids[name] - swept).as_original().simplify(FINE * tolerance))

    roughly = {name: left(name, ROUGHLY) for name in PARTS}
    for name in sorted(PARTS, key=lambda name: solids[name].volume() - roughly[name].volume()):
        rest = roughly[name] if parts.joint.type == "prismatic" else left(name, doublings)
        if sound(rest) and rest.volume() >= (1 - LARGEST) * solids[name].volume():
            other = solids[others[name]]
            return Carved(name, _mesh(rest), _mesh(other), float(solids[name].volume() - rest.volume()))
    return f"more than {100 * LARGEST:g} % of either part would be cut away"


def sound(solid: Manifold) -> bool:
    """Whether a solid came out of its making as one, and not empty."""
    return solid.status() == Error.NoError and solid.volume() > 0


def solid_of(mesh: Mesh) -> Manifold | None:
    """The closed solid of a mesh; None when the mesh is not closed."""
    if mesh.empty:
        return None
    points, place = np.unique(mesh.vertices, axis=0, return_inverse=True)
    faces = place.reshape(-1)[mesh.faces].astype(np.uint64)
    solid = Manifold(Mesh64(np.ascontiguousarray(points), np.ascontiguousarray(faces)))
    return solid if sound(solid) else None


def _mesh(solid: Manifold) -> Mesh:
    found = solid.to_mesh64()
    return Mesh(np.asarray(found.vert_properties)[:, :3], np.asarray(found.tri_verts).astype(np.int64))


def _without_crumbs(solid: Manifold) -> Manifold:
    """The solid without loose pieces of less than `CRUMB` of it: films that stood between two copies. Hollows stay."""
    found = [(piece, piece.volume()) for piece in solid.decompose()]  # a hollow is a piece of negative volume
    crumbs = [piece for piece, volume in found if 0 <= volume < CRUMB * solid.volume()]
    return solid - Manifold.batch_boolean(crumbs, OpType.Add) if crumbs else solid  # composing would fill hollows


_PRISM = np.array([[0, 2, 1], [3, 4, 5], [0, 1, 4], [0, 4, 3], [1, 2, 5], [1, 5, 4], [2, 0, 3], [2, 3, 5]], np.uint64)
"""Triangles of a prism over 0, 1, 2 below 3, 4, 5."""


def _slid(tool: Manifold, way: NDArray[np.float64]) -> Manifold:
    """What `tool` sweeps along `way` (3,), m: it, and a prism on each triangle that faces along the way.

    Copies leave steps: a cabinet's carcass had 215,000 triangles after 256 of them, cut so it has 32,000.
    """
    mesh = tool.to_mesh64()
    corners = np.asarray(mesh.vert_properties)[:, :3][np.asarray(mesh.tri_verts).astype(np.int64)]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    prisms = [
        Manifold(Mesh64(np.concatenate([triangle, triangle + way]), _PRISM)) for triangle in corners[normals @ way > 0]
    ]
    kept = [prism for prism in prisms if sound(prism)]
    return Manifold.batch_boolean([tool, *kept], OpType.Add).as_original()


def _swept(tool: Manifold, joint: Joint, low: float, high: float, doublings: int, smooth: float) -> Manifold:
    """The union of `tool` at 2**doublings states of `joint` from `low` to `high`, made plainer by `smooth`, m,
    after each doubling.

    A joint's motions by a and by b are one by a + b: so each union with its own copy, moved on, doubles the states.
    """
    step = (high - low) / (2**doublings - 1)
    swept = tool.transform(joint.transform(low)[:3])
    for k in range(doublings):
        swept = swept + swept.transform(joint.transform(2**k * step)[:3])
        swept = swept.as_original().simplify(smooth)  # as of one solid: where two meet is else kept for ever
    return swept
