"""Rules that look at shapes: what is seen against what is touched, mass against size, and parts that pass through."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from itertools import combinations, pairwise

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
from export.check.tree import Tree
from export.checklist import Finding
from export.delivered import Shapes
from freeart21 import se3
from freeart21.files.urdf import UrdfInertial
from freeart21.se3 import Array

SWEEP_STATES = 81
"""States of a joint between which parts move on straight lines: 2 degrees of half a turn. On 19 assets
(PartNet-Mobility, robots, exports) 41 and 161 gave the same verdicts and pairs."""
POINTS = 1000
"""Points on a part's surface: a share of 0.25 of them is known within 0.03 (2 sigma). With 300 one of the same 19,
whose share is 0.24, failed."""
DEPTH_SHARE = 1e-3
"""Part of the smaller part's size by which a point is inside: 1 mm of a cabinet, less than its boards are thick.
With 3e-4 the same 19 had the same verdicts, with 3e-4 to 4e-3 seven others: doors, a faucet, three exports."""
DEEP_SHARE = 0.1
"""Part of the smaller part's size that a point goes inside of the other to count as one that passes through. With .05
and .2 the same seven had the same verdicts."""
_ROUNDING = 1e-2
"""Of moments over mass: three digits in a file miss either by up to half of it."""
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
    yield from _pass_through(tree, {joint.child: groups[joint.parent][0] for joint in tree.joints.values()}, solids)


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


def _pass_through(tree: Tree, parents: Mapping[str, str], solids: Mapping[str, Body]) -> Iterator[Finding]:
    """Which bodies pass through each other when one joint goes from end to end, with what follows it; all other joints
    stand where they are loaded.

    Judged are neighbours and siblings, two bodies that hang on one, by the body in `parents` that each hangs on. Where
    others meet depends on the pose of the joints between: an arm may fold onto itself.
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
            if not _near(solids[one], solids[other], T_one_other):
                continue
            share, whose, when = _passing(solids[one], solids[other], T_one_other, states)
            if share > CUT_SHARE:
                which, through = (one, other) if whose == 0 else (other, one)
                said = f"over joint '{joint.name}' ({low:.3g} to {high:.3g}, others at rest) {share:.0%} of the surface"
                between = f", seen from {when.min():.3g} to {when.max():.3g}" if len(when) else ""
                yield Finding("parts.clear", f"{said} of '{which}' passes through '{through}'{between}")


def _near(one: Body, other: Body, T_one_other: Array) -> bool:
    """Whether balls around two bodies meet on the way, of poses (s, 4, 4) of the `other` in the frame of `one`."""
    apart = np.linalg.norm(se3.transform(T_one_other, other.middle[None]) - one.middle, axis=-1)
    step = np.linalg.norm(np.diff(se3.transform(T_one_other, other.middle[None])[:, 0], axis=0), axis=-1).max()
    return bool(apart.min() - step < 0.5 * (one.size + other.size))


def _passing(one: Body, other: Body, T_one_other: Array, states: Array) -> tuple[float, int, Array]:
    """The larger share of a surface that passes through the other body, whose it is (0 or 1), and the states in which
    points of it are inside."""
    size = min(one.size, other.size)
    worst, whose, when = 0.0, 0, np.zeros(0)
    for k, (points, solid, poses) in enumerate(
        ((one.points, other, se3.inverse(T_one_other)), (other.points, one, T_one_other))
    ):
        paths = se3.transform(poses, np.broadcast_to(points, (len(poses), *points.shape)))
        cut, inside = _cut(paths, solid, size)
        if cut.mean() > worst:
            worst, whose, when = float(cut.mean()), k, states[inside[:, cut].any(1)]
    return worst, whose, when


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
