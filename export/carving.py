"""What one part sweeps is cut out of the other, so that they are nowhere in each other: a difference of solids."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from manifold3d import CrossSection, Error, FillRule, Manifold, Mesh64, OpType
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from export.penetration import Overlap
from freeart21.articulation import PARTS, Articulation
from freeart21.effects import perpendiculars
from freeart21.joint import Joint
from freeart21.mesh import Mesh
from freeart21.se3 import Array

Faces = NDArray[np.int64]

COARSE = 9
"""States at which it is looked where the parts are in each other."""
ROUGHLY = 5
"""Doublings of the states of a turn by which it is told which part loses less. Not measured."""
MOST = 8
"""Doublings of what turns at most: 256 copies."""
FINE = 0.1
"""Part of the tolerance by which solids may be simplified before and after each doubling: at .4 a drawer stayed 1.7 mm
in its cabinet, at .2 .4. Sheets thinner than that go: on one in its doorway a cabinet seemed 23 mm in its drawer."""
MOST_TRIANGLES = 500_000
"""Of what a turning part sweeps: beyond, its copies are cut out one by one. Parts of six objects had 30,000 to 260,000
after all doublings. Those of a cabinet of loose boards (PartNet-Mobility 45940) doubled each time, to eight million."""
FORESEEN = 0.1
"""Part of these from which on their number after all doublings is predicted, each growing as the last did: below, a
doubling takes less than a second. Of the same six objects the predictions were 272,000 at most, of the cabinet's at its
second doubling 1.2 million."""
COPIES = 32
"""Cut out one by one. Of that cabinet they leave parts that were 7.4 mm in each other 0.1 mm deep, in 14 s; eight
doublings left 0.34 mm in 178 s."""
BETWEEN = 8
"""Copies between which what is left is made plainer."""
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
    leaves at most half of the step. Where their union only grows, there are `COPIES`.

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

    one_by_one = set()

    def left(name: str, doublings: int) -> Manifold:
        way, tool, smooth = ways[name], solids[others[name]], FINE * tolerance
        if way.type == "prismatic":
            swept = _slid(tool.transform(way.transform(low)[:3]), (high - low) * way.axis).simplify(smooth)
        else:
            swept = _swept(tool, way, low, high, doublings, smooth)
        if swept is None:
            one_by_one.add(name)
        rest = _without_copies(solids[name], tool, way, low, high, smooth) if swept is None else solids[name] - swept
        return _without_crumbs(rest.as_original().simplify(smooth))

    roughly = {name: left(name, ROUGHLY) for name in PARTS}
    for name in sorted(PARTS, key=lambda name: solids[name].volume() - roughly[name].volume()):
        final = parts.joint.type == "prismatic" or name in one_by_one
        rest = roughly[name] if final else left(name, doublings)
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


_ACROSS = 1e-6
"""Of a face's slope to a way, below which the face lies along it and sweeps nothing. Not measured."""
_FOLDED = 1e-3
"""Part of a patch's area that may lie above the rest of it, seen along a way: rounding of the projection. With it a
coil sweeps what its copies do (tests/test_carving.py)."""


def _slid(tool: Manifold, way: Array) -> Manifold:
    """What `tool` sweeps along `way` (3,), m: it, and the patches of its surface that face along the way, drawn out.

    Copies leave steps: a cabinet's carcass had 215,000 triangles after 256 of them, cut so it has 32,000. A prism on
    each triangle is as exact, but the union of those on a phone's rounded edges had not ended after 17 minutes; of
    patches it takes five seconds.
    """
    mesh = tool.to_mesh64()
    points, faces = np.asarray(mesh.vert_properties)[:, :3], np.asarray(mesh.tri_verts).astype(np.int64)
    corners = points[faces]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    facing = faces[normals @ way > _ACROSS * np.linalg.norm(normals, axis=1) * np.linalg.norm(way)]
    drawn = (_drawn(points, patch, way) for patch in _unfolded(points, facing, way))
    return Manifold.batch_boolean([tool, *filter(sound, drawn)], OpType.Add).as_original()


def _drawn(points: Array, patch: Faces, way: Array) -> Manifold:
    """The solid between a patch (t, 3) of a surface and itself moved on by `way`."""
    corners, _ = _connected(patch)  # where two corners of it touch in a point only, that is two
    own, first, faces = np.unique(corners, return_index=True, return_inverse=True)
    below, faces, count = points[patch.ravel()[first]], faces.reshape(-1, 3), len(own)
    edges = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
    inner = set(map(tuple, edges[:, ::-1].tolist()))
    a, b = np.array([edge for edge in edges.tolist() if tuple(edge) not in inner]).T
    walls = [np.stack([a, b, b + count], -1), np.stack([a, b + count, a + count], -1)]
    closed = np.concatenate([faces[:, ::-1], faces + count, *walls]).astype(np.uint64)
    return Manifold(Mesh64(np.concatenate([below, below + way]), np.ascontiguousarray(closed)))


def _unfolded(points: Array, faces: Faces, way: Array) -> Iterator[Faces]:
    """Connected patches of faces (t, 3), none of which lies above itself as seen along `way`: one that does is cut in
    two at half its depth."""
    todo = [faces]
    while todo:
        faces = todo.pop()
        _, piece = _connected(faces)
        for k in range(int(piece.max(initial=-1)) + 1):
            patch = faces[piece == k]
            if len(patch) == 1 or not _folds(points[patch], way):
                yield patch
                continue
            depth = points[patch].mean(1) @ way
            order = np.argsort(depth, kind="stable")
            todo += [patch[order[: len(order) // 2]], patch[order[len(order) // 2 :]]]


def _folds(triangles: Array, way: Array) -> bool:
    """Whether triangles (t, 3, 3) lie above each other as seen along `way`."""
    flat = triangles @ np.stack(perpendiculars(way / np.linalg.norm(way)), -1)
    flat = flat / np.ptp(flat, axis=(0, 1)).max()  # the areas of a unit square: the library counts in small steps
    a, b = flat[:, 1] - flat[:, 0], flat[:, 2] - flat[:, 0]
    area = 0.5 * float(np.abs(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]).sum())
    covered = CrossSection([np.ascontiguousarray(t) for t in flat], FillRule.NonZero).area()
    return area - covered > _FOLDED * area


def _connected(faces: Faces) -> tuple[Faces, Faces]:
    """(t, 3) the number of the corner that each corner of these triangles (t, 3) is one with, and (t,) that of the
    patch that each is of; they hang together by edges."""
    count = len(faces)
    corner = np.arange(3 * count).reshape(-1, 3)
    ways = ([0, 1], [1, 2], [2, 0])
    edges, ends = (np.concatenate([table[:, way] for way in ways]) for table in (faces, corner))
    back = edges[:, 0] > edges[:, 1]
    edges[back], ends[back] = edges[back][:, ::-1], ends[back][:, ::-1]
    order = np.lexsort(edges.T)
    edges, ends = edges[order], ends[order]
    at = np.flatnonzero((edges[1:] == edges[:-1]).all(1))

    def joined(a: Faces, b: Faces, size: int) -> Faces:
        return np.asarray(connected_components(coo_array((np.ones(len(a)), (a, b)), (size, size)), False)[1], np.int64)

    corners = joined(ends[at].ravel(), ends[at + 1].ravel(), 3 * count).reshape(-1, 3)
    return corners, joined(ends[at, 0] // 3, ends[at + 1, 0] // 3, count)


def _swept(tool: Manifold, joint: Joint, low: float, high: float, doublings: int, smooth: float) -> Manifold | None:
    """The union of `tool` at 2**doublings states of `joint` from `low` to `high`, made plainer by `smooth`, m,
    after each doubling; None when it has, or is going to have, more than `MOST_TRIANGLES`.

    A joint's motions by a and by b are one by a + b: so each union with its own copy, moved on, doubles the states.
    """
    step = (high - low) / (2**doublings - 1)
    swept = tool.transform(joint.transform(low)[:3])
    for k in range(doublings):
        before = swept.num_tri()
        swept = swept + swept.transform(joint.transform(2**k * step)[:3])
        swept = swept.as_original().simplify(smooth)  # as of one solid: where two meet is else kept for ever
        now = swept.num_tri()
        left = doublings - 1 - k if now > FORESEEN * MOST_TRIANGLES else 0
        if now * (now / before) ** left > MOST_TRIANGLES:
            return None
    return swept


def _without_copies(solid: Manifold, tool: Manifold, joint: Joint, low: float, high: float, smooth: float) -> Manifold:
    """The solid without `tool` at `COPIES` states of `joint` from `low` to `high`, one after the other: it gets the
    triangles of what they cut alone, where their union has those of all; made plainer by `smooth`, m."""
    for k, state in enumerate(np.linspace(low, high, COPIES)):
        solid = solid - tool.transform(joint.transform(float(state))[:3])
        if k % BETWEEN == BETWEEN - 1:
            solid = solid.as_original().simplify(smooth)
    return solid
