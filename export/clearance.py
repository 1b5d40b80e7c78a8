"""Contact pieces of two parts cut back until they are nowhere in each other, whatever they stand out of their parts by.

Parts that are clear of each other are stood for by pieces that need not be: each may stand out by the tolerance of the
decomposition, which on a large part, or with few pieces, is wider than the gap of a drawer. Convex pieces can be told
apart by a plane for each pair; both are cut along the one that costs the least of the surfaces that they stand for.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import QhullError

from export.decomposition import hull_of
from freeart21 import se3
from freeart21.joint import Joint
from freeart21.se3 import Array

ARC = 0.05
"""rad of a turn that is taken as one motion: between its ends a point 30 cm from the axis bulges out by 0.1 mm."""
_MOST_ARCS = 128
"""Arcs at most: of a whole turn."""
_SLAB = 1e-3
"""m by which a millimetre of a cut counts as lost surface: of cuts that cost none the shallowest is made."""
_ASIDE = 0.05
"""Sine of the angle to the motion's way from which on a direction counts as across it. Not measured."""
_ROUNDING = 1e-9
"""m by which corners that lie on a plane may miss it: of doubles on parts of metres."""
_ON = 1e-4
"""m that a point of the surface may lie out of a piece that stands for it."""


@dataclass
class _Solid:
    """A convex piece: corners, planes that bound it, its edges, and the part's surface that it stands for."""

    corners: Array
    own: Array
    """(n, 3) points of the part's surface in it, m."""
    weights: Array
    """(n,) m^2 of the surface that each stands for: a share, where other pieces hold it as well."""
    cut: bool = False
    normals: Array = field(init=False)
    edges: NDArray[np.int64] = field(init=False)

    def __post_init__(self) -> None:
        hull = hull_of(self.corners)
        self.normals = _different(hull.equations[:, :3])
        edges = np.concatenate([hull.simplices[:, [0, 1]], hull.simplices[:, [1, 2]], hull.simplices[:, [2, 0]]])
        self.edges = np.unique(np.sort(edges, axis=1), axis=0)

    def without(self, planes: list[tuple[Array, float]], least_m: float) -> _Solid | None:
        """What is left where n x <= d for every plane; None when that is thinner than `least_m`."""
        solid: _Solid | None = self
        for n, d in planes:
            solid = None if solid is None else solid._below(n, d, least_m)
        return solid

    def _below(self, n: Array, d: float, least_m: float) -> _Solid | None:
        height = self.corners @ n - d
        if height.max() <= _ROUNDING:
            return self
        if -height.min() < least_m:
            return None
        a, b = self.edges.T
        across = height[a] * height[b] < 0
        a, b = a[across], b[across]
        t = (height[a] / (height[a] - height[b]))[:, None]
        points = np.concatenate([self.corners[height <= 0], (1 - t) * self.corners[a] + t * self.corners[b]])
        try:
            hull = hull_of(points)
        except (QhullError, ValueError):
            return None
        kept = self.own @ n <= d + _ON
        return _Solid(points[hull.vertices], self.own[kept], self.weights[kept], True)


def _different(normals: Array) -> Array:
    """Unit vectors (n, 3), of those alike one."""
    return normals[np.unique(np.round(normals, 4), axis=0, return_index=True)[1]]


def cleared(
    pieces: dict[str, list[Array]],
    surfaces: dict[str, tuple[Array, float]],
    joint: Joint,
    fixed: str,
    tolerance: float,
    least_m: float,
) -> dict[str, list[Array | None]]:
    """Corners of the pieces that are left, in the same order: those given themselves where nothing was cut, None where
    nothing is left.

    Args:
        pieces: corners (k, 3) of the convex pieces of both parts, m, at state zero.
        surfaces: of each part points (n, 3) of its surface, and m^2 that each stands for.
        joint: of the other part against the `fixed` one, in the same frame, with the range to clear.
        fixed: the part whose frame that is.
        tolerance: m by which pieces may be in each other.
        least_m: m; what is left of a piece is thicker, or dropped.
    """
    other = next(name for name in pieces if name != fixed)
    solids: dict[str, list[_Solid | None]] = {name: _solids(pieces[name], *surfaces[name]) for name in pieces}
    for start, stop in _motions(joint):
        Ts = joint.transform(np.array([start, stop]))
        boxes = _boxes([None if s is None else s.corners for s in solids[fixed]])
        swept = [None if s is None else _along(s.corners, Ts) for s in solids[other]]
        for k, box in enumerate(_boxes(swept)):
            near = ((boxes[:, 0] < box[1] - tolerance) & (box[0] + tolerance < boxes[:, 1])).all(-1)
            for i in np.flatnonzero(near):
                still, moves = solids[fixed][i], solids[other][k]
                if still is not None and moves is not None:
                    solids[fixed][i], solids[other][k] = _parted(still, moves, Ts, tolerance, least_m)
    return {
        name: [
            None if new is None else new.corners if new.cut else old
            for old, new in zip(pieces[name], solids[name], strict=True)
        ]
        for name in pieces
    }


def _motions(joint: Joint) -> Iterator[tuple[float, float]]:
    """Pieces of the joint's range over which a convex piece sweeps nearly the hull of both its ends."""
    turn = joint.upper - joint.lower if joint.type == "revolute" else 0.0
    states = np.linspace(joint.lower, joint.upper, int(np.clip(np.ceil(turn / ARC), 1, _MOST_ARCS)) + 1)
    return zip(states[:-1].tolist(), states[1:].tolist(), strict=True)


def _solids(pieces: list[Array], points: Array, area: float) -> list[_Solid | None]:
    inside, times = [], np.zeros(len(points))
    for corners in pieces:
        hull = hull_of(corners)
        near = np.flatnonzero(((points >= corners.min(0) - _ON) & (points <= corners.max(0) + _ON)).all(1))
        beyond = points[near] @ hull.equations[:, :3].T + hull.equations[:, 3]
        inside.append(near[(beyond <= _ON).all(1)])
        times[inside[-1]] += 1
    return [_Solid(corners, points[own], area / times[own]) for corners, own in zip(pieces, inside, strict=True)]


def _along(corners: Array, Ts: Array) -> Array:
    return se3.transform(Ts, np.broadcast_to(corners, (len(Ts), *corners.shape))).reshape(-1, 3)


def _boxes(pieces: list[Array | None]) -> Array:
    """(n, 2, 3) lowest and highest corner of each, of none an empty one."""
    empty = np.array([np.full(3, np.inf), np.full(3, -np.inf)])
    return np.array([empty if p is None else [p.min(0), p.max(0)] for p in pieces]).reshape(-1, 2, 3)


def _parted(
    still: _Solid, moves: _Solid, Ts: Array, tolerance: float, least_m: float
) -> tuple[_Solid | None, _Solid | None]:
    """Two pieces, cut along a plane if the second, moved from Ts[0] to Ts[1], gets into the first."""
    swept = _along(moves.corners, Ts)
    normals = np.concatenate([still.normals, *(-moves.normals @ T[:3, :3].T for T in Ts)])
    for more in (False, True):  # most pairs are clear by a plane of one of them
        normals = np.concatenate([normals, _flanks(normals, Ts)]) if more else normals
        top, bottom = (still.corners @ normals.T).max(0), (swept @ normals.T).min(0)
        depth = top - bottom
        if depth.min() <= tolerance:
            return still, moves
    # Where n x = d parts them: the first keeps what is below, the second what is above wherever it is.
    mine = still.own @ normals.T
    theirs = np.min([se3.transform(T, moves.own) @ normals.T for T in Ts], axis=0)
    least = (still.corners @ normals.T).min(0) + least_m
    most = np.min([(se3.transform(T, moves.corners) @ normals.T).max(0) for T in Ts], axis=0) - least_m
    cost, best, d = np.inf, 0, 0.0
    for k in np.argsort(depth):
        if _SLAB * depth[k] >= cost:
            break
        lost, offset = _offset(
            (mine[:, k] - _ON, still.weights),
            (theirs[:, k] + _ON, moves.weights),
            (bottom[k], top[k]),
            (least[k], most[k]),
        )
        if lost + _SLAB * depth[k] < cost:
            cost, best, d = lost + _SLAB * depth[k], int(k), offset
    n = normals[best]
    planes = [(-T[:3, :3].T @ n, float(T[:3, 3] @ n - d)) for T in Ts]
    return still.without([(n, d)], least_m), moves.without(planes, least_m)


def _offset(
    below: tuple[Array, Array], above: tuple[Array, Array], ends: tuple[float, float], room: tuple[float, float]
) -> tuple[float, float]:
    """Least m^2 that is lost to a plane between `ends`, and where that is, in the middle of all that lose as little.

    Points, heights (n,) and m^2 (n,) each, are kept `below` it and `above` it. Below the first of `room` nothing is
    left of what is below, beyond the second nothing of what is above.
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


def _flanks(normals: Array, Ts: Array) -> Array:
    """(n, 3) the directions turned across the way of what moves: those of the sides of what it sweeps."""
    slide = Ts[-1, :3, 3] - Ts[0, :3, 3]
    length = float(np.linalg.norm(slide))
    if length == 0:
        return np.zeros((0, 3))
    way = slide / length
    across = normals - (normals @ way)[:, None] * way
    size = np.linalg.norm(across, axis=1)
    return _different(across[size > _ASIDE] / size[size > _ASIDE, None])
