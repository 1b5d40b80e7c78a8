"""Cuts the convex collision shapes of two parts so that they do not overlap anywhere in the joint's range.

Even where the parts are clear of each other their shapes can overlap: each may extend beyond its part by the tolerance
of the decomposition, which can exceed the gap of a drawer. Two convex shapes are separated by a plane; both are cut
along the one that costs the least surface.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import QhullError

from export.decomposition import robust_hull
from freeart21 import se3
from freeart21.joint import Joint
from freeart21.se3 import Array

ARC = 0.05
"""rad of a turn treated as one motion: in between, a point 30 cm from the axis bulges out by 0.1 mm."""
_MAX_ARCS = 128
"""Most arcs, enough for a full turn."""
_DEPTH_COST = 1e-3
"""m^2 of lost surface that a metre of cut depth counts as: of cuts that lose the same the shallowest is made."""
_MIN_SINE = 0.05
"""Sine of the angle to the direction of motion from which a direction counts as across it. Not measured."""
_ROUNDING = 1e-9
"""m by which corners on a plane may miss it, in double precision on parts of metres."""
_SURFACE_SLACK = 1e-4
"""m that a surface point may lie outside the shape that covers it."""


@dataclass
class _ConvexShape:
    """A convex collision shape: corners, face normals, edges, and the surface that it covers."""

    corners: Array
    surface: Array
    """(n, 3) points of the part's surface in it, m."""
    weights: Array
    """(n,) m^2 per point, divided by the number of shapes that cover it."""
    cut: bool = False
    normals: Array = field(init=False)
    edges: NDArray[np.int64] = field(init=False)

    def __post_init__(self) -> None:
        hull = robust_hull(self.corners)
        self.normals = _unique_directions(hull.equations[:, :3])
        edges = np.concatenate([hull.simplices[:, [0, 1]], hull.simplices[:, [1, 2]], hull.simplices[:, [2, 0]]])
        self.edges = np.unique(np.sort(edges, axis=1), axis=0)

    def cut_by(self, planes: list[tuple[Array, float]], min_thickness_m: float) -> _ConvexShape | None:
        """The shape where n x <= d for every plane; None when the rest is thinner than `min_thickness_m`."""
        solid: _ConvexShape | None = self
        for n, d in planes:
            solid = None if solid is None else solid._cut_below(n, d, min_thickness_m)
        return solid

    def _cut_below(self, n: Array, d: float, min_thickness_m: float) -> _ConvexShape | None:
        height = self.corners @ n - d
        if height.max() <= _ROUNDING:
            return self
        if -height.min() < min_thickness_m:
            return None
        a, b = self.edges.T
        across = height[a] * height[b] < 0
        a, b = a[across], b[across]
        t = (height[a] / (height[a] - height[b]))[:, None]
        points = np.concatenate([self.corners[height <= 0], (1 - t) * self.corners[a] + t * self.corners[b]])
        try:
            hull = robust_hull(points)
        except (QhullError, ValueError):
            return None
        below = self.surface @ n <= d + _SURFACE_SLACK
        return _ConvexShape(points[hull.vertices], self.surface[below], self.weights[below], True)


def _unique_directions(normals: Array) -> Array:
    """Unit vectors (n, 3) without duplicates."""
    return normals[np.unique(np.round(normals, 4), axis=0, return_index=True)[1]]


def separate_shapes(
    shapes: dict[str, list[Array]],
    surfaces: dict[str, tuple[Array, float]],
    joint: Joint,
    fixed: str,
    tolerance: float,
    min_thickness_m: float,
) -> dict[str, list[Array | None]]:
    """Corners of the shapes that are left, in the same order: the given array where nothing was cut, None where nothing
    is left.

    Args:
        shapes: corners (k, 3) of the convex shapes of both parts, m, at state zero.
        surfaces: per part points (n, 3) of its surface, and m^2 per point.
        joint: motion of the other part against the `fixed` one, in the same frame, with the range to clear.
        fixed: the part whose frame that is.
        tolerance: m that shapes may overlap.
        min_thickness_m: m; thinner remainders are dropped.
    """
    other = next(name for name in shapes if name != fixed)
    solids: dict[str, list[_ConvexShape | None]] = {
        name: _assign_surface(shapes[name], *surfaces[name]) for name in shapes
    }
    for start, stop in _split_range(joint):
        Ts = joint.transform(np.array([start, stop]))
        boxes = _bounding_boxes([None if s is None else s.corners for s in solids[fixed]])
        swept = [None if s is None else _swept_corners(s.corners, Ts) for s in solids[other]]
        for k, box in enumerate(_bounding_boxes(swept)):
            near = ((boxes[:, 0] < box[1] - tolerance) & (box[0] + tolerance < boxes[:, 1])).all(-1)
            for i in np.flatnonzero(near):
                still, moves = solids[fixed][i], solids[other][k]
                if still is not None and moves is not None:
                    solids[fixed][i], solids[other][k] = _separate_pair(still, moves, Ts, tolerance, min_thickness_m)
    return {
        name: [
            None if new is None else new.corners if new.cut else old
            for old, new in zip(shapes[name], solids[name], strict=True)
        ]
        for name in shapes
    }


def _split_range(joint: Joint) -> Iterator[tuple[float, float]]:
    """Intervals of the joint's range over which a convex shape sweeps nearly the hull of its two end poses."""
    turn = joint.upper - joint.lower if joint.type == "revolute" else 0.0
    states = np.linspace(joint.lower, joint.upper, int(np.clip(np.ceil(turn / ARC), 1, _MAX_ARCS)) + 1)
    return zip(states[:-1].tolist(), states[1:].tolist(), strict=True)


def _assign_surface(shapes: list[Array], points: Array, area: float) -> list[_ConvexShape | None]:
    inside, times = [], np.zeros(len(points))
    for corners in shapes:
        hull = robust_hull(corners)
        near = np.flatnonzero(
            ((points >= corners.min(0) - _SURFACE_SLACK) & (points <= corners.max(0) + _SURFACE_SLACK)).all(1)
        )
        beyond = points[near] @ hull.equations[:, :3].T + hull.equations[:, 3]
        inside.append(near[(beyond <= _SURFACE_SLACK).all(1)])
        times[inside[-1]] += 1
    return [_ConvexShape(corners, points[own], area / times[own]) for corners, own in zip(shapes, inside, strict=True)]


def _swept_corners(corners: Array, Ts: Array) -> Array:
    return se3.transform(Ts, np.broadcast_to(corners, (len(Ts), *corners.shape))).reshape(-1, 3)


def _bounding_boxes(shapes: list[Array | None]) -> Array:
    """(n, 2, 3) lowest and highest corner of each shape; empty boxes for None."""
    empty = np.array([np.full(3, np.inf), np.full(3, -np.inf)])
    return np.array([empty if p is None else [p.min(0), p.max(0)] for p in shapes]).reshape(-1, 2, 3)


def _separate_pair(
    still: _ConvexShape, moves: _ConvexShape, Ts: Array, tolerance: float, min_thickness_m: float
) -> tuple[_ConvexShape | None, _ConvexShape | None]:
    """Two shapes, cut along a plane if the second, moved from Ts[0] to Ts[1], overlaps the first."""
    swept = _swept_corners(moves.corners, Ts)
    normals = np.concatenate([still.normals, *(-moves.normals @ T[:3, :3].T for T in Ts)])
    for more in (False, True):  # for most pairs a face plane of one of them separates
        normals = np.concatenate([normals, _directions_across(normals, Ts)]) if more else normals
        top, bottom = (still.corners @ normals.T).max(0), (swept @ normals.T).min(0)
        depth = top - bottom
        if depth.min() <= tolerance:
            return still, moves
    # Plane n x = d: the first shape keeps what is below, the second what is above in both poses.
    mine = still.surface @ normals.T
    theirs = np.min([se3.transform(T, moves.surface) @ normals.T for T in Ts], axis=0)
    least = (still.corners @ normals.T).min(0) + min_thickness_m
    most = np.min([(se3.transform(T, moves.corners) @ normals.T).max(0) for T in Ts], axis=0) - min_thickness_m
    cost, best, d = np.inf, 0, 0.0
    for k in np.argsort(depth):
        if _DEPTH_COST * depth[k] >= cost:
            break
        lost, offset = _best_offset(
            (mine[:, k] - _SURFACE_SLACK, still.weights),
            (theirs[:, k] + _SURFACE_SLACK, moves.weights),
            (bottom[k], top[k]),
            (least[k], most[k]),
        )
        if lost + _DEPTH_COST * depth[k] < cost:
            cost, best, d = lost + _DEPTH_COST * depth[k], int(k), offset
    n = normals[best]
    planes = [(-T[:3, :3].T @ n, float(T[:3, 3] @ n - d)) for T in Ts]
    return still.cut_by([(n, d)], min_thickness_m), moves.cut_by(planes, min_thickness_m)


def _best_offset(
    below: tuple[Array, Array], above: tuple[Array, Array], ends: tuple[float, float], room: tuple[float, float]
) -> tuple[float, float]:
    """Least lost m^2 for a plane between `ends`, and its offset, in the middle of all that lose as little.

    `below` and `above` are heights (n,) and m^2 (n,) of the points to keep on either side. Below the first of `room`
    nothing is left of the lower shape, beyond the second nothing of the upper one.
    """
    (low, share_low), (high, share_high) = (
        (heights[order], np.concatenate([[0.0], np.cumsum(weights[order])]))
        for heights, weights, order in ((*pair, np.argsort(pair[0])) for pair in (below, above))
    )
    steps = np.unique(np.clip(np.concatenate([low, high, ends, room]), *ends))
    at = np.concatenate([ends, 0.5 * (steps[1:] + steps[:-1])])
    width = np.concatenate([[0.0, 0.0], np.diff(steps)])
    lost_low = share_low[-1] - share_low[np.searchsorted(low, at, "right")]
    lost_high = share_high[np.searchsorted(high, at, "left")]
    lost = np.where(at < room[0], share_low[-1], lost_low) + np.where(at > room[1], share_high[-1], lost_high)
    best = int(np.lexsort([-width, np.round(lost, 12)])[0])
    return float(lost[best]), float(at[best])


def _directions_across(normals: Array, Ts: Array) -> Array:
    """(n, 3) the directions projected across the motion: candidates for the sides of the swept shape."""
    slide = Ts[-1, :3, 3] - Ts[0, :3, 3]
    length = float(np.linalg.norm(slide))
    if length == 0:
        return np.zeros((0, 3))
    way = slide / length
    across = normals - (normals @ way)[:, None] * way
    size = np.linalg.norm(across, axis=1)
    return _unique_directions(across[size > _MIN_SINE] / size[size > _MIN_SINE, None])
