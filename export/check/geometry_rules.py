"""Rules on shapes: collision against visual, inertia against size, and parts that pass through each other."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from itertools import combinations, pairwise

import numpy as np
import trimesh
from numpy.typing import NDArray
from scipy.spatial import ConvexHull, QhullError

from export.check.rules import (
    AXIS_SHARE,
    BENT_SHARE,
    CUT_SHARE,
    DENSITY_HIGH,
    DENSITY_LOW,
    INERTIA_HIGH,
    INERTIA_LOW,
    SHIFT_SHARE,
    THIN_SHARE,
    THIN_SHIFT,
)
from export.check.solids import Body, make_body
from export.check.tree import Tree
from export.checklist import Finding, Shapes
from freeart21 import se3
from freeart21.files.urdf import UrdfInertial
from freeart21.se3 import Array

SWEEP_STATES = 81
"""States per joint, between which parts move on straight lines: 2 degrees for half a turn. On 19 assets
(PartNet-Mobility, robots, exports) 41 and 161 gave the same verdicts and pairs."""
POINTS = 1000
"""Points on a part's surface: a share of 0.25 is known within 0.03 (2 sigma). With 300, one of the same 19, with a
share of 0.24, failed."""
DEPTH_SHARE = 1e-3
"""Depth over the smaller part's size from which a point is inside: 1 mm for a cabinet, less than its boards' thickness.
With 3e-4 the same 19 had the same verdicts, with 3e-4 to 4e-3 seven others: doors, a faucet, three exports."""
DEEP_SHARE = 0.1
"""Path inside the other part, over the smaller part's size, from which a point passes through it. With .05 and .2 the
same seven had the same verdicts."""
_ROUNDING = 1e-2
"""Of moments over mass: numbers of three digits miss either by up to half of it."""
_DIRECTIONS = np.concatenate([np.eye(3), trimesh.creation.icosphere(2).vertices])
"""(n, 3) unit vectors along which shapes are compared, at most 5 degrees apart."""


def check_shapes(tree: Tree, seen: Mapping[str, Shapes], touched: Mapping[str, Shapes]) -> Iterator[Finding]:
    """Faults of the shapes of a tree's links, given visual and collision shapes by link."""
    for link in tree.links:
        yield from _check_match(link, seen.get(link, []), touched.get(link, []))
    groups = tree.rigid_groups()
    for link, inertial in tree.inertials.items():
        T_own_body = se3.inverse(groups[link][1])
        both = [
            (T_own_body @ groups[other][1] @ T, mesh)
            for other in tree.links
            if groups[other][0] == groups[link][0]
            for T, mesh in (*seen.get(other, []), *touched.get(other, []))
        ]
        yield from _check_inertia(link, inertial, both)
        yield from _check_mass(link, inertial.mass, both)
    bodies: dict[str, Shapes] = {}
    for link in tree.links:
        shapes = touched.get(link) or seen.get(link, [])
        bodies.setdefault(groups[link][0], []).extend((groups[link][1] @ T, mesh) for T, mesh in shapes)
    solids = {name: body for name, shapes in bodies.items() if (body := make_body(shapes, POINTS)) is not None}
    yield from _check_axes(tree, groups, bodies)
    yield from _check_clearance(tree, {joint.child: groups[joint.parent][0] for joint in tree.joints.values()}, solids)


def _shape_corners(shapes: Shapes) -> Array:
    """(n, 3) vertices of all triangles, in the link's frame."""
    found = [se3.transform(T, mesh.vertices[np.unique(mesh.faces)]) for T, mesh in shapes if len(mesh.faces)]
    return np.concatenate(found) if found else np.zeros((0, 3))


def _check_match(link: str, seen: Shapes, touched: Shapes) -> Iterator[Finding]:
    """Compare visual and collision shapes by their convex hulls' extents along many directions.

    A collision shape may extend beyond the visual on both sides (a box around a pan) or omit something (a handle): then
    it is far beyond on one side and little short on the other. Far off on both sides is a displaced shape.
    """
    visual, collision = _shape_corners(seen), _shape_corners(touched)
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
        width = f"collision of link '{link}' is {width_touched[k]:.3g} m wide along {_direction(_DIRECTIONS[k])}"
        yield Finding("collision.matches-visual", f"{width}, its visual {width_seen[k]:.3g} m")
    elif shift[worst] > bar[worst]:
        offset = f"collision of link '{link}' is {shift[worst]:.3g} m from its visual"
        where = f"along {_direction(_DIRECTIONS[worst])}, expected at most {bar[worst]:.2g}"
        yield Finding("collision.matches-visual", f"{offset} {where} of its {size_seen:.3g} m")


def _direction(vector: Array) -> str:
    k = int(np.argmax(np.abs(vector)))
    if abs(vector[k]) > 0.999:
        return f"{'-' if vector[k] < 0 else ''}{'xyz'[k]}"
    return f"({', '.join(f'{x:.2g}' for x in vector + 0.0)})"


def _check_inertia(link: str, inertial: UrdfInertial, shapes: Shapes) -> Iterator[Finding]:
    """The largest moment against mass times squared distance of the furthest point from the centre of mass."""
    points = _shape_corners(shapes)
    if not len(points) or not inertial.mass > 0:
        return
    reach = float(np.linalg.norm(points - inertial.centre, axis=1).max())
    moment = float(np.linalg.eigvalsh(inertial.inertia)[-1])
    most = inertial.mass * reach**2
    found = f"link '{link}' of {inertial.mass:.3g} kg that reaches {reach:.3g} m has a moment of {moment:.3g} kg m^2"
    if moment > INERTIA_HIGH * most * (1 + _ROUNDING):
        yield Finding("inertia.fits-shape", f"{found}, at most {INERTIA_HIGH * most:.3g} is possible")
    elif 0 < moment < INERTIA_LOW * most:
        yield Finding("inertia.fits-shape", f"{found}, expected at least {INERTIA_LOW * most:.3g}")


def _check_mass(link: str, mass: float, shapes: Shapes) -> Iterator[Finding]:
    """A body's mass against the volume of its shapes' convex hull; what has no volume is not judged."""
    points = _shape_corners(shapes)
    try:
        volume = float(ConvexHull(points).volume)
    except (QhullError, ValueError):
        return
    low, high = DENSITY_LOW * volume, DENSITY_HIGH * volume
    if not low <= mass <= high:
        bounds = f"expected {low:.3g} to {high:.3g} kg for what fills {1e3 * volume:.3g} litres at most"
        yield Finding("mass.possible", f"link '{link}' has a mass of {mass:.3g} kg, {bounds}")


def _check_axes(tree: Tree, groups: Mapping[str, tuple[str, Array]], bodies: Mapping[str, Shapes]) -> Iterator[Finding]:
    """Hinges whose axis is further from the part that it turns than both parts are large."""
    for joint in tree.movable:
        group, T = groups[joint.child]
        moved = _shape_corners(bodies.get(group, []))
        parent = _shape_corners(bodies.get(groups[joint.parent][0], []))
        if joint.joint_type != "revolute" or not len(moved):
            continue
        axis, pivot = T[:3, :3] @ joint.axis, se3.transform(T, joint.pivot[None])[0]
        distance = float(np.linalg.norm(np.cross(axis, moved - pivot), axis=1).min())
        size = sum(float(np.linalg.norm(np.ptp(points, axis=0))) for points in (moved, parent) if len(points))
        if distance > AXIS_SHARE * size:
            away = f"is {distance:.3g} m from '{joint.child}', which with its neighbour is {size:.3g} m large"
            yield Finding("axis.near", f"the axis of joint '{joint.name}' {away}")


def _check_clearance(tree: Tree, parents: Mapping[str, str], solids: Mapping[str, Body]) -> Iterator[Finding]:
    """Bodies that pass through each other when one joint, with its mimics, moves from end to end; other joints stay as
    loaded.

    Only neighbours and siblings (bodies with the same parent in `parents`) are judged. Whether others meet depends on
    the joints in between: an arm may fold onto itself.
    """
    pairs = [
        (one, other)
        for one, other in combinations(solids, 2)
        if parents.get(other) in (one, parents.get(one, "")) or parents.get(one) == other
    ]
    rest = {joint.name: joint.loaded for joint in tree.movable}
    for joint in tree.movable:
        low, high = joint.sweep
        if not (joint.stated and low < high):
            continue
        states = np.linspace(low, high, SWEEP_STATES)
        full = [tree.complete({**rest, joint.name: float(q)}) for q in states]
        positions = {name: np.array([q[name] for q in full]) for name in full[0]}
        Ts = tree.link_poses({name: q if np.ptp(q) > 0 else float(q[0]) for name, q in positions.items()})
        for one, other in pairs:
            if Ts[one].ndim == Ts[other].ndim == 2:
                continue
            T_one_other = se3.inverse(Ts[one]) @ Ts[other]
            if not _may_meet(solids[one], solids[other], T_one_other):
                continue
            share, whose, when = _crossing_share(solids[one], solids[other], T_one_other, states)
            if share > CUT_SHARE:
                which, through = (one, other) if whose == 0 else (other, one)
                motion = f"over joint '{joint.name}' ({low:.3g} to {high:.3g}, others at rest)"
                between = f", seen from {when.min():.3g} to {when.max():.3g}" if len(when) else ""
                yield Finding(
                    "parts.clear",
                    f"{motion} {share:.0%} of the surface of '{which}' passes through '{through}'{between}",
                )


def _may_meet(one: Body, other: Body, T_one_other: Array) -> bool:
    """Whether bounding spheres of two bodies meet on the way; poses (s, 4, 4) of the `other` in the frame of `one`."""
    distance = np.linalg.norm(se3.transform(T_one_other, other.middle[None]) - one.middle, axis=-1)
    step = np.linalg.norm(np.diff(se3.transform(T_one_other, other.middle[None])[:, 0], axis=0), axis=-1).max()
    return bool(distance.min() - step < 0.5 * (one.size + other.size))


def _crossing_share(one: Body, other: Body, T_one_other: Array, states: Array) -> tuple[float, int, Array]:
    """The larger share of a surface that passes through the other body, whose it is (0 or 1), and the states in which
    its points are inside."""
    size = min(one.size, other.size)
    worst, whose, when = 0.0, 0, np.zeros(0)
    for k, (points, solid, poses) in enumerate(
        ((one.points, other, se3.inverse(T_one_other)), (other.points, one, T_one_other))
    ):
        paths = se3.transform(poses, np.broadcast_to(points, (len(poses), *points.shape)))
        cut, inside = _find_crossing(paths, solid, size)
        if cut.mean() > worst:
            worst, whose, when = float(cut.mean()), k, states[inside[:, cut].any(1)]
    return worst, whose, when


def _find_crossing(paths: Array, other: Body, size: float) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """(n,) whether points on paths (s, n, 3) pass through a body: in on one side and out on the other, or far inside;
    and (s, n) where they are inside."""
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
