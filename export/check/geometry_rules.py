"""Rules that look at shapes: what is seen against what is touched, mass against size, and parts that pass through."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from itertools import pairwise

import numpy as np
import trimesh
from numpy.typing import NDArray

from export.check.rules import (
    BENT_SHARE,
    CUT_SHARE,
    INERTIA_HIGH,
    INERTIA_LOW,
    SHIFT_SHARE,
    THIN_SHARE,
    THIN_SHIFT,
)
from export.check.solids import Body, body_of
from export.check.tree import Tree, TreeJoint
from export.checklist import Finding
from export.delivered import Shapes
from freeart21 import se3
from freeart21.files.urdf import UrdfInertial
from freeart21.se3 import Array

SWEEP_STATES = 81
"""States of a joint between which parts move on straight lines: 2 degrees of half a turn."""
POINTS = 1000
"""Points on a part's surface: a share of 0.25 of them is known within 0.03 (2 sigma)."""
DEPTH_SHARE = 1e-3
"""Part of the smaller part's size by which a point is inside: 1 mm of a cabinet, less than its boards are thick."""
DEEP_SHARE = 0.1
"""Part of the smaller part's size that a point goes inside of the other to count as one that passes through."""
_ROUNDING = 1e-2
"""Of moments, which files write with few digits."""
_DIRECTIONS = np.concatenate([np.eye(3), trimesh.creation.icosphere(2).vertices])
"""(n, 3) unit vectors along which shapes are compared, 5 degrees apart at most."""


def shape_findings(tree: Tree, seen: Mapping[str, Shapes], touched: Mapping[str, Shapes]) -> Iterator[Finding]:
    """What is wrong with the shapes of a tree's links, link to visual and collision shapes."""
    for link in tree.links:
        yield from _compare(link, seen.get(link, []), touched.get(link, []))
    groups = tree.rigid_groups()
    for link, inertial in tree.inertials.items():
        T_own_body = se3.inverse(groups[link][1])
        both = [
            (T_own_body @ groups[other][1] @ T, mesh)
            for other in tree.links
            if groups[other][0] == groups[link][0]
            for T, mesh in (*seen.get(other, []), *touched.get(other, []))
        ]
        yield from _fit_inertia(link, inertial, both)
    bodies: dict[str, Shapes] = {}
    for link in tree.links:
        shapes = touched.get(link) or seen.get(link, [])
        bodies.setdefault(groups[link][0], []).extend((groups[link][1] @ T, mesh) for T, mesh in shapes)
    solids = {name: body for name, shapes in bodies.items() if (body := body_of(shapes, POINTS)) is not None}
    for joint in tree.joints.values():
        parent, T_body_parent = groups[joint.parent]
        if joint.kind is not None and joint.stated and parent in solids and joint.child in solids:
            yield from _pass_through(joint, T_body_parent, solids[parent], solids[joint.child])


def _corners(shapes: Shapes) -> Array:
    """(n, 3) vertices of all triangles, in the link's frame."""
    found = [se3.transform(T, mesh.vertices[np.unique(mesh.faces)]) for T, mesh in shapes if len(mesh.faces)]
    return np.concatenate(found) if found else np.zeros((0, 3))


def _compare(link: str, seen: Shapes, touched: Shapes) -> Iterator[Finding]:
    """Visual against collision shapes by their convex hulls' ends along many directions.

    A collision shape may stand out on both sides (a box around a pan), or leave something out (a handle): then it is
    beyond the visual on one side and short of it on the other by a little only. Much of both is a shape in another
    place.
    """
    visual, collision = _corners(seen), _corners(touched)
    if not (len(visual) and len(collision)):
        return
    ends = [(points @ _DIRECTIONS.T).max(0) + (points @ -_DIRECTIONS.T).max(0) * 1j for points in (visual, collision)]
    width_seen, width_touched = (end.real + end.imag for end in ends)
    size_seen, size_touched = width_seen.max(), width_touched.max()
    beyond, opposite = ends[1].real - ends[0].real, ends[1].imag - ends[0].imag
    shift = np.minimum(beyond, -opposite)
    narrow = np.maximum(THIN_SHARE * np.minimum(width_seen, width_touched), THIN_SHIFT * size_seen)
    bar = np.minimum(SHIFT_SHARE * size_seen, narrow)
    worst = int(np.argmax(shift / np.maximum(bar, 1e-300)))
    bent = np.abs(width_touched - width_seen)
    if bent.max() > BENT_SHARE * max(size_seen, size_touched):
        k = int(np.argmax(bent))
        said = f"collision of link '{link}' is {width_touched[k]:.3g} m wide along {_direction(_DIRECTIONS[k])}"
        yield Finding("collision.matches-visual", f"{said}, its visual {width_seen[k]:.3g} m")
    elif shift[worst] > bar[worst]:
        said = f"collision of link '{link}' is {shift[worst]:.3g} m from its visual"
        where = f"along {_direction(_DIRECTIONS[worst])}, expected at most {bar[worst]:.2g}"
        yield Finding("collision.matches-visual", f"{said} {where} of its {size_seen:.3g} m")


def _direction(vector: Array) -> str:
    k = int(np.argmax(np.abs(vector)))
    if abs(vector[k]) > 0.999:
        return f"{'-' if vector[k] < 0 else ''}{'xyz'[k]}"
    return f"({', '.join(f'{x:.2g}' for x in vector + 0.0)})"


def _fit_inertia(link: str, inertial: UrdfInertial, shapes: Shapes) -> Iterator[Finding]:
    """The largest moment against mass times the square of the furthest point's distance from the centre of mass."""
    points = _corners(shapes)
    if not len(points) or not inertial.mass > 0:
        return
    reach = float(np.linalg.norm(points - inertial.centre, axis=1).max())
    moment = float(np.linalg.eigvalsh(inertial.inertia)[-1])
    most = inertial.mass * reach**2
    said = f"link '{link}' of {inertial.mass:.3g} kg that reaches {reach:.3g} m has a moment of {moment:.3g} kg m^2"
    if moment > INERTIA_HIGH * most * (1 + _ROUNDING):
        yield Finding("inertia.fits-shape", f"{said}, at most {INERTIA_HIGH * most:.3g} is possible")
    elif 0 < moment < INERTIA_LOW * most:
        yield Finding("inertia.fits-shape", f"{said}, expected at least {INERTIA_LOW * most:.3g}")


def _pass_through(joint: TreeJoint, T_body_parent: Array, still: Body, moving: Body) -> Iterator[Finding]:
    """Whether two neighbours pass through each other when their joint alone goes from end to end."""
    low, high = joint.sweep
    if not low < high:
        return
    states = np.linspace(low, high, SWEEP_STATES)
    Ts = np.stack([T_body_parent @ joint.transform(float(q)) for q in states])
    size = min(still.size, moving.size)
    worst, which, when = 0.0, "", np.zeros(0)
    for points, other, poses, name in (
        (moving.points, still, Ts, f"'{joint.child}'"),
        (still.points, moving, se3.inverse(Ts), f"what '{joint.child}' hangs on"),
    ):
        cut, inside = _cut(se3.transform(poses, np.broadcast_to(points, (SWEEP_STATES, *points.shape))), other, size)
        if cut.mean() > worst:
            worst, which, when = float(cut.mean()), name, states[inside[:, cut].any(1)]
    if worst > CUT_SHARE:
        through = f"{worst:.0%} of the surface of {which} passes through the other part"
        between = f", seen from {when.min():.3g} to {when.max():.3g}" if len(when) else ""
        yield Finding("parts.clear", f"over joint '{joint.name}' ({low:.3g} to {high:.3g}) {through}{between}")


def _cut(paths: Array, other: Body, size: float) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """(n,) whether points on paths (s, n, 3) pass through a body: in on one side and out on the other, or far inside;
    and (s, n) where they are inside of it."""
    steps = list(pairwise(paths))
    eps = DEPTH_SHARE * size
    inside = np.stack([other.depth(points) > eps for points in paths])
    on_way = np.stack([other.depth_between(start, end) > eps for start, end in steps])
    seq = np.empty((2 * len(paths) - 1, paths.shape[1]), bool)
    seq[::2], seq[1::2] = inside, on_way
    before, after = (~seq).cumsum(0) > 0, (~seq[::-1]).cumsum(0)[::-1] > 0
    through = (seq & before & after).any(0)
    way, longest = np.zeros(paths.shape[1]), np.zeros(paths.shape[1])
    for k, (start, end) in enumerate(steps):
        way = np.where(inside[k] & inside[k + 1], way + np.linalg.norm(end - start, axis=1), 0.0)
        longest = np.maximum(longest, way)
    return through | ((longest > DEEP_SHARE * size) & ~inside.all(0)), inside
