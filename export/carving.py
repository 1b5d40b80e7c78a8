"""Carving: the volume that one part sweeps is subtracted from the other, so that they do not overlap."""

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
from freeart21.mesh import Mesh, triangle_normals
from freeart21.se3 import Array

Faces = NDArray[np.int64]

OVERLAP_STATES = 9
"""States at which the overlap is measured."""
COARSE_DOUBLINGS = 5
"""Doublings of a turning part's copies, to find which part loses less. Not measured."""
MAX_DOUBLINGS = 8
"""Most doublings: 256 copies."""
SIMPLIFY_SHARE = 0.1
"""Tolerance of simplifying solids, before and after each doubling, over the overlap tolerance. At .4 a drawer stayed
1.7 mm in its cabinet, at .2 .4 mm. It also removes thinner sheets: with one in its doorway a cabinet seemed 23 mm in
its drawer."""
MAX_TRIANGLES = 500_000
"""Most triangles of a swept volume; beyond, copies are subtracted one by one. Six objects had 30,000 to 260,000 after
all doublings. A cabinet of loose boards (PartNet-Mobility 45940) doubled each time, to eight million."""
PREDICT_SHARE = 0.1
"""Share of these from which the final number is predicted by the growth of the last doubling; below, a doubling takes
less than a second. Predictions of the same six objects were 272,000 at most, the cabinet's 1.2 million at its second
doubling."""
COPIES = 32
"""Copies subtracted one by one. They leave parts of that cabinet that overlapped by 7.4 mm 0.1 mm deep, in 14 s; eight
doublings left 0.34 mm in 178 s."""
SIMPLIFY_EVERY = 8
"""Copies after which the rest is simplified."""
MIN_PIECE = 0.01
"""Fraction of a solid's volume below which a loose piece is dropped, as `meshes.MIN_COMPONENT`."""
MAX_CUT_SHARE = 0.8
"""Largest fraction of a part's volume that may be cut away. Closed halves of a phone each fill the other's place where
nobody looked between them: at .5 a phone and a USB stick were refused."""


@dataclass(frozen=True)
class CarvedPart:
    """The rest of the carved part."""

    name: str
    """'reference' or 'moving'."""
    mesh: Mesh
    other: Mesh
    """The other part without sheets of no thickness, which sweep nothing."""
    volume: float
    """m^3 cut away."""


def carve_overlap(parts: Articulation, low: float, high: float, tolerance: float, overlap: Overlap) -> CarvedPart | str:
    """One of two closed parts without the volume that the other sweeps over the states [low, high]; or why that fails.

    The part that loses less volume is carved. The volume swept by a sliding part is exact. A turning part is copied so
    densely that ridges between copies stay below `tolerance`: between two copies a step apart a ridge is at most half a
    step high.

    Args:
        parts: in any frame, m; meshes face outwards.
        low: rad or m.
        high: rad or m.
        tolerance: m.
        overlap: of these parts.
    """
    solids = {}
    for name in PARTS:
        solid = make_solid(parts.part(name))
        if solid is None:
            return f"the {name} part is not closed"
        solids[name] = solid.simplify(SIMPLIFY_SHARE * tolerance)
    back = replace(parts.joint, axis=-parts.joint.axis)
    joints = {"reference": parts.joint, "moving": back}  # motion of the other part in each part's frame
    others = {"reference": "moving", "moving": "reference"}
    coarse = np.linspace(low, high, OVERLAP_STATES)
    inside = np.max([overlap.depths(float(state)) for state in coarse], axis=0) > 0
    travel = (high - low) * float(overlap.speeds[inside].max(initial=0.0))
    doublings = int(np.clip(np.ceil(np.log2(travel / (2 * tolerance) + 1)), COARSE_DOUBLINGS, MAX_DOUBLINGS))

    one_by_one = set()

    def subtract(name: str, doublings: int) -> Manifold:
        joint, tool, smooth = joints[name], solids[others[name]], SIMPLIFY_SHARE * tolerance
        swept: Manifold | None
        if joint.type == "prismatic":
            start = tool.transform(joint.transform(low)[:3])
            swept = _sweep_translation(start, (high - low) * joint.axis).simplify(smooth)
        else:
            swept = _sweep_joint(tool, joint, low, high, doublings, smooth)
        if swept is None:
            one_by_one.add(name)
            rest = _subtract_copies(solids[name], tool, joint, low, high, smooth)
        else:
            rest = solids[name] - swept
        return drop_small_pieces(rest.as_original().simplify(smooth))

    coarse_rest = {name: subtract(name, COARSE_DOUBLINGS) for name in PARTS}
    for name in sorted(PARTS, key=lambda name: solids[name].volume() - coarse_rest[name].volume()):
        final = parts.joint.type == "prismatic" or name in one_by_one
        rest = coarse_rest[name] if final else subtract(name, doublings)
        if is_valid(rest) and rest.volume() >= (1 - MAX_CUT_SHARE) * solids[name].volume():
            other = solids[others[name]]
            return CarvedPart(name, _to_mesh(rest), _to_mesh(other), float(solids[name].volume() - rest.volume()))
    return f"more than {100 * MAX_CUT_SHARE:g} % of either part would be cut away"


def is_valid(solid: Manifold) -> bool:
    """Whether a solid is valid and not empty."""
    return bool(solid.status() == Error.NoError and solid.volume() > 0)


def make_solid(mesh: Mesh) -> Manifold | None:
    """The solid of a closed mesh; None when the mesh is not closed."""
    if mesh.empty:
        return None
    points, place = np.unique(mesh.vertices, axis=0, return_inverse=True)
    faces = place.reshape(-1)[mesh.faces].astype(np.uint64)
    solid = Manifold(Mesh64(np.ascontiguousarray(points), np.ascontiguousarray(faces)))
    return solid if is_valid(solid) else None


def _to_mesh(solid: Manifold) -> Mesh:
    found = solid.to_mesh64()
    return Mesh(np.asarray(found.vert_properties)[:, :3], np.asarray(found.tri_verts).astype(np.int64))


def drop_small_pieces(solid: Manifold) -> Manifold:
    """The solid without loose pieces of less than `MIN_PIECE` of it: films between copies. Hollows stay."""
    found = [(piece, piece.volume()) for piece in solid.decompose()]  # a hollow is a piece of negative volume
    small = [piece for piece, volume in found if 0 <= volume < MIN_PIECE * solid.volume()]
    return solid - Manifold.batch_boolean(small, OpType.Add) if small else solid  # composing would fill hollows


_PARALLEL = 1e-6
"""Sine of a face's angle to the direction of motion below which it sweeps nothing. Not measured."""
_OVERLAP_SHARE = 1e-3
"""Fraction of a patch's projected area that may overlap: rounding of the projection. With it a coil sweeps the volume
that its copies do."""


def _sweep_translation(tool: Manifold, way: Array) -> Manifold:
    """The volume that `tool` sweeps along `way` (3,), m: `tool`, united with the extrusions of its patches that face
    that way.

    Copies would leave steps: a cabinet's carcass had 215,000 triangles after 256 of them, and has 32,000 this way. A
    prism per triangle is as exact, but the union of those of a phone's rounded edges took over 17 minutes; with patches
    it takes five seconds.
    """
    mesh = tool.to_mesh64()
    points, faces = np.asarray(mesh.vert_properties)[:, :3], np.asarray(mesh.tri_verts).astype(np.int64)
    normals = triangle_normals(points, faces)
    facing = faces[normals @ way > _PARALLEL * np.linalg.norm(normals, axis=1) * np.linalg.norm(way)]
    extruded = (_extrude_patch(points, patch, way) for patch in _split_patches(points, facing, way))
    return Manifold.batch_boolean([tool, *filter(is_valid, extruded)], OpType.Add).as_original()


def _extrude_patch(points: Array, patch: Faces, way: Array) -> Manifold:
    """The solid between a patch (t, 3) of a surface and its copy moved by `way`."""
    corners, _ = _connect_triangles(patch)  # a vertex where the patch touches itself in a point counts twice
    own, first, faces = np.unique(corners, return_index=True, return_inverse=True)
    below, faces, count = points[patch.ravel()[first]], faces.reshape(-1, 3), len(own)
    edges = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
    inner = set(map(tuple, edges[:, ::-1].tolist()))
    a, b = np.array([edge for edge in edges.tolist() if tuple(edge) not in inner]).T
    walls = [np.stack([a, b, b + count], -1), np.stack([a, b + count, a + count], -1)]
    closed = np.concatenate([faces[:, ::-1], faces + count, *walls]).astype(np.uint64)
    return Manifold(Mesh64(np.concatenate([below, below + way]), np.ascontiguousarray(closed)))


def _split_patches(points: Array, faces: Faces, way: Array) -> Iterator[Faces]:
    """Connected patches of faces (t, 3) that do not overlap in projection along `way`: one that does is halved by
    depth."""
    pending = [faces]
    while pending:
        faces = pending.pop()
        _, piece = _connect_triangles(faces)
        for k in range(int(piece.max(initial=-1)) + 1):
            patch = faces[piece == k]
            if len(patch) == 1 or not _overlaps_itself(points[patch], way):
                yield patch
                continue
            depth = points[patch].mean(1) @ way
            order = np.argsort(depth, kind="stable")
            pending += [patch[order[: len(order) // 2]], patch[order[len(order) // 2 :]]]


def _overlaps_itself(triangles: Array, way: Array) -> bool:
    """Whether triangles (t, 3, 3) overlap in projection along `way`."""
    flat = triangles @ np.stack(perpendiculars(way / np.linalg.norm(way)), -1)
    flat = flat / np.ptp(flat, axis=(0, 1)).max()  # in the unit square: the library has a fixed resolution
    a, b = flat[:, 1] - flat[:, 0], flat[:, 2] - flat[:, 0]
    area = 0.5 * float(np.abs(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]).sum())
    covered = CrossSection([np.ascontiguousarray(t) for t in flat], FillRule.NonZero).area()
    return bool(area - covered > _OVERLAP_SHARE * area)


def _connect_triangles(faces: Faces) -> tuple[Faces, Faces]:
    """For triangles (t, 3): (t, 3) an index per corner, equal for corners joined by an edge, and (t,) an index of the
    patch.

    Only triangles that share an edge are connected.
    """
    count = len(faces)
    corner = np.arange(3 * count).reshape(-1, 3)
    ways = ([0, 1], [1, 2], [2, 0])
    edges, ends = (np.concatenate([table[:, way] for way in ways]) for table in (faces, corner))
    back = edges[:, 0] > edges[:, 1]
    edges[back], ends[back] = edges[back][:, ::-1], ends[back][:, ::-1]
    order = np.lexsort(edges.T)
    edges, ends = edges[order], ends[order]
    at = np.flatnonzero((edges[1:] == edges[:-1]).all(1))

    def components(a: Faces, b: Faces, size: int) -> Faces:
        return np.asarray(connected_components(coo_array((np.ones(len(a)), (a, b)), (size, size)), False)[1], np.int64)

    corners = components(ends[at].ravel(), ends[at + 1].ravel(), 3 * count).reshape(-1, 3)
    return corners, components(ends[at, 0] // 3, ends[at + 1, 0] // 3, count)


def _sweep_joint(
    tool: Manifold, joint: Joint, low: float, high: float, doublings: int, smooth: float
) -> Manifold | None:
    """The union of `tool` at 2**doublings states of `joint` from `low` to `high`, simplified by `smooth`, m, after each
    doubling; None when it has, or is predicted to have, more than `MAX_TRIANGLES`.

    A joint's motions by a and b compose to that by a + b, so the union with its own moved copy doubles the states.
    """
    step = (high - low) / (2**doublings - 1)
    swept = tool.transform(joint.transform(low)[:3])
    for k in range(doublings):
        before = swept.num_tri()
        swept = swept + swept.transform(joint.transform(2**k * step)[:3])
        swept = swept.as_original().simplify(smooth)  # as one solid: edges between two are never simplified
        now = swept.num_tri()
        remaining = doublings - 1 - k if now > PREDICT_SHARE * MAX_TRIANGLES else 0
        if now * (now / before) ** remaining > MAX_TRIANGLES:
            return None
    return swept


def _subtract_copies(solid: Manifold, tool: Manifold, joint: Joint, low: float, high: float, smooth: float) -> Manifold:
    """The solid without `tool` at `COPIES` states of `joint` from `low` to `high`, one after the other, simplified by
    `smooth`, m.

    It gets only triangles where copies cut it, while their union has those of all copies.
    """
    for k, state in enumerate(np.linspace(low, high, COPIES)):
        solid = solid - tool.transform(joint.transform(float(state))[:3])
        if k % SIMPLIFY_EVERY == SIMPLIFY_EVERY - 1:
            solid = solid.as_original().simplify(smooth)
    return solid
