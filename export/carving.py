"""Carving: the volume that one part sweeps is subtracted from the other, so that they do not overlap."""

from __future__ import annotations

import itertools
from dataclasses import dataclass, replace

import numpy as np
from manifold3d import Error, Manifold, Mesh64, OpType

from export.penetration import Overlap
from freeart21 import se3
from freeart21.articulation import PARTS, Articulation
from freeart21.joint import Joint
from freeart21.mesh import Mesh
from freeart21.se3 import Array

OVERLAP_STATES = 9
"""States at which the overlap is measured."""
STEP_TOLERANCES = 3.0
"""Tolerances that a part moves from copy to copy: a ridge between two copies of an edge of radius r is as high as the
square of the step over 8 r, .1 mm for steps of 1.5 mm and a radius of 3 mm."""
STEP_WALLS = 0.75
"""Most of its walls' thickness that a part moves from copy to copy: a longer step leaves films between the copies.
Below 1 so that copies overlap; how far below is set by hand."""
COARSE_COPIES, ROUGH_COPIES, MAX_COPIES = 8, 128, 256
"""Copies that are subtracted to find which part loses less, and at most: of a rough part, and of any other. With 64 a
nightstand's drawer, which slides 28 cm, was 2 mm in the ridges that were left, with 128 .9 mm."""
ROUGH_TRIANGLES = 5_000
"""Triangles from which on a part is rough: the swept space then has more with each copy.
Set by hand, between a box of boards and a reconstructed part (10,000 and more)."""
SIMPLIFY_SHARE = 0.1
"""Tolerance of simplifying solids over the overlap tolerance. It also removes sheets of no thickness: with one in its
doorway a cabinet seemed 23 mm in its drawer."""
SWEEP_SHARE = 0.4
"""The same of swept space, which grows with each copy: a filing cabinet's took 23 s, at .1 30 s, and left parts as deep
in each other."""
MIN_PIECE = 0.01
"""Fraction of a solid's volume below which a loose piece is dropped, as `meshes.MIN_COMPONENT`."""
SPOT_ROUNDS = 3
"""Times that spots are looked for and cut, set by hand: a drawer unit was clear after one."""
MAX_SPOTS = 100
"""More are no spots: cutting 300 out of a cabinet of 2 m doubled its triangles, and left it 7 mm in its drawer."""
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

    The part that loses less volume is carved, by copies of the other so dense that ridges between them are about as
    high as `tolerance`.

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

    def subtract(name: str, dense: bool) -> Manifold:
        tool = solids[others[name]]
        walls = 2 * tool.volume() / tool.surface_area()  # exact for a sheet, two thirds of the radius of a ball
        steps = travel / min(STEP_TOLERANCES * tolerance, STEP_WALLS * walls) if dense else 0.0
        most = ROUGH_COPIES if tool.num_tri() > ROUGH_TRIANGLES else MAX_COPIES
        copies = int(np.clip(np.ceil(steps) + 1, COARSE_COPIES, most))
        rest = solids[name] - sweep(tool, joints[name], low, high, copies, SWEEP_SHARE * tolerance)
        return rest.as_original().simplify(SIMPLIFY_SHARE * tolerance)

    lost = {name: solids[name].volume() - subtract(name, False).volume() for name in PARTS}
    for name in sorted(PARTS, key=lambda name: lost[name]):
        if lost[name] > MAX_CUT_SHARE * solids[name].volume():
            continue
        rest = drop_small_pieces(subtract(name, True))
        if is_valid(rest) and rest.volume() >= (1 - MAX_CUT_SHARE) * solids[name].volume():
            other = solids[others[name]]
            return CarvedPart(name, _to_mesh(rest), _to_mesh(other), float(solids[name].volume() - rest.volume()))
    return f"more than {100 * MAX_CUT_SHARE:g} % of either part would be cut away"


def cut_spots(parts: Articulation, name: str, states: Array, tolerance: float) -> Mesh:
    """Part `name` without the spots where the other one still is deeper in it than `tolerance`, m, at states (n,).

    Simplifying moves a few points of a carved part, as at a thin rail, by more than all others. Around each the convex
    hull of what is there of the other part is cut out along the motion. That adds so few triangles that the part need
    not be simplified again. The part as it is where one of the two is not closed, and as far as it loses no more than
    `MAX_CUT_SHARE` of its volume.
    """
    meshes = {part: parts.part(part) for part in PARTS}
    carved, tool = make_solid(meshes[name]), make_solid(meshes["moving" if name == "reference" else "reference"])
    if carved is None or tool is None:
        return meshes[name]
    joint = parts.joint if name == "reference" else replace(parts.joint, axis=-parts.joint.axis)
    least = (1 - MAX_CUT_SHARE) * carved.volume()
    for _ in range(SPOT_ROUNDS):
        now = Articulation(parts.joint, meshes["reference"], meshes["moving"])
        points, depth, at = Overlap(now, samples=None).deep_points(states, tolerance)
        if not len(depth):
            break
        if name == "reference":  # where they are on the other part
            points = se3.transform(se3.inverse(joint.transform(at)), points[:, None])[:, 0]
        size, spots = float(depth.max()), np.zeros((0, 3))
        while len(points):
            spots = np.append(spots, points[:1], axis=0)
            points = points[np.abs(points - points[0]).max(1) > size]
        if len(spots) > MAX_SPOTS:
            break
        cubes = [Manifold.cube((2 * size,) * 3, True).translate(spot) for spot in spots]
        deviation = SIMPLIFY_SHARE * tolerance
        hulls = [
            _sweep_hull((tool ^ cube).hull(), joint, spot, states, deviation)
            for cube, spot in zip(cubes, spots, strict=True)
        ]
        rest = carved - Manifold.batch_boolean(hulls, OpType.Add)
        carved = drop_small_pieces(rest.as_original().simplify(SIMPLIFY_SHARE * tolerance))
        if carved.volume() < least:
            break
        meshes[name] = _to_mesh(carved)
    return meshes[name]


def _sweep_hull(hull: Manifold, joint: Joint, at: Array, states: Array, deviation: float) -> Manifold:
    """What a convex body at (3,) sweeps over the range of `states`, with arcs to `deviation`, m."""
    count = 2
    if joint.type == "revolute":
        arm = max(float(np.linalg.norm(np.cross(joint.axis, at - joint.pivot))), deviation)
        count += int(np.ptp(states) / (2 * np.arccos(1 - deviation / arm)))
    placed = [hull.transform(joint.transform(q)[:3]) for q in np.linspace(states.min(), states.max(), count)]
    pairs = [Manifold.batch_hull([a, b]) for a, b in itertools.pairwise(placed)]
    return Manifold.batch_boolean(pairs, OpType.Add)


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


def drop_small_pieces(solid: Manifold) -> Manifold:
    """The solid without loose pieces of less than `MIN_PIECE` of it: films between copies. Hollows stay."""
    found = [(piece, piece.volume()) for piece in solid.decompose()]  # a hollow is a piece of negative volume
    small = [piece for piece, volume in found if 0 <= volume < MIN_PIECE * solid.volume()]
    return solid - Manifold.batch_boolean(small, OpType.Add) if small else solid  # composing would fill hollows


def _to_mesh(solid: Manifold) -> Mesh:
    found = solid.to_mesh64()
    return Mesh(np.asarray(found.vert_properties)[:, :3], np.asarray(found.tri_verts).astype(np.int64))


def sweep(tool: Manifold, joint: Joint, low: float, high: float, copies: int, smooth: float) -> Manifold:
    """What `tool` covers at `copies` states of `joint` or more, evenly from `low` to `high`; simplified by `smooth`, m.

    Each round unites what the rounds before covered with the same moved on, which doubles the copies: seven unions
    cover 128 copies. Each is computed at once, as manifold3d would put it off and then unite all copies together.
    """
    rounds = int(np.ceil(np.log2(copies)))
    swept = tool.transform(joint.transform(low)[:3])
    for k in range(rounds):
        swept = swept + swept.transform(joint.transform((high - low) * 2**k / (2**rounds - 1))[:3])
        swept.num_tri()
        swept = swept.as_original().simplify(smooth)
    return swept
