"""Convex decomposition of a part with a bound, in metres, on how far hulls extend beyond it.

The outer surface is split into patches of one orientation, each with depth behind it, until the hull of each stays
within the bound. Neighbouring hulls are then merged, the best first, while their common hull does, too. A thin wall
becomes one plate, a solid one hull, and openings stay open: a hull across one would exceed the bound. Bottom-up merging
follows HACD (Mamou and Ghorbel, ICIP 2009), whose cost is relative instead of metric.
"""

from __future__ import annotations

import heapq
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import ConvexHull, QhullError

from export.outer_surface import OuterSurface, even_directions
from freeart21.mesh import triangle_normals
from freeart21.se3 import Array

_FACING = 0.6
"""Cosine to the mean normal within which a point faces the same way: walls and floors are separate patches."""
_SAME_FACE = 0.8
"""Cosine between the normals of neighbouring points on one face."""
_FACING_SHARE = 0.85
"""Fraction of a patch's points that must face the same way."""
_SMALL_PATCH = 3.0
"""Patches smaller than this many tolerances may face any way."""
_QUICK_SAMPLES = 40
"""Points of the first test: it rejects most hulls that are rejected."""
_FULL_SAMPLES = 2500
"""Points tested before a hull is accepted."""
_LENGTH_COST = 0.002
"""Excess, m, that a metre of a merged hull's diagonal counts as: of equal merges the smaller come first."""
MAX_VERTICES = 48
"""Of a hull. PhysX takes at most 255; MuJoCo is faster with few."""
MIN_THICKNESS_M = 1e-3
"""m: thinner hulls are thickened, as simulators reject flat solids."""


_ROUGHNESS = 4.0
"""Tolerances that roughness stands out of what lies below it. With 6 the wall behind a drawer was 14 mm from any shape,
with this and `_ROUGH_LIMIT` 8 mm; with 3 it took a quarter more shapes."""
_ROUGH_LIMIT = 2.0
"""Times its bound that a hull of roughness may extend beyond the part: what too little covers alone is merged so far,
before what then still covers too little goes."""


@dataclass(frozen=True)
class Tolerance:
    """Bounds of a decomposition."""

    max_excess_m: float
    """m that a hull may extend beyond the part."""
    simplify_m: float
    """m by which corners may be omitted from a hull."""
    max_pairs: int
    """Most pairs of hulls tested for merging; bounds the time."""


@dataclass
class _Hull:
    """A convex hull during decomposition."""

    corners: Array
    """(k, 3) vertices, m."""
    members: NDArray[np.int64]
    """Points of the outer surface that it covers."""
    worst: float
    """Excess, m, at the points tested."""


def decompose(
    part: OuterSurface, tolerance: Tolerance, max_hulls: int, boxes: Sequence[Array] = (), min_share: float = 0.0
) -> list[Array]:
    """Corners (k, 3) of at most `max_hulls` convex hulls; the bound is widened where more would be needed.

    A part that is convex itself gives one hull with all its corners. Else `boxes`, corners (8, 3), come first, and
    hulls cover the rest of the surface. A hull goes when it alone covers less than `min_share` of the surface's points;
    those that would go are merged within a wider bound first.
    """
    tests = _HullTests(part, tolerance)
    everything = np.arange(len(part.points))
    filled = add_depth(part, everything, tolerance, rim=False)
    whole = tests.make_hull(filled, everything, tolerance.max_excess_m, _FULL_SAMPLES)
    if whole is not None:
        return [whole.corners]
    limit = tolerance.max_excess_m
    given = [_Hull(corners, np.zeros(0, np.int64), 0.0) for corners in boxes]
    bare = _find_uncovered(part, boxes, limit)
    hulls = _merge_hulls(tests, _split_into_patches(tests, bare), limit, 0)
    if not boxes:
        hulls = drop_redundant(part, hulls, tolerance.simplify_m)
        uncovered = _find_uncovered(part, [hull.corners for hull in hulls], limit)
        hulls += _merge_hulls(tests, _split_into_patches(tests, uncovered, last=True), limit, 0)
    if min_share > 0:
        given, kept = _drop_rough(tests, given, hulls, min_share)
        left = {id(hull) for hull in kept}
        tests.pairs = 0
        rough = _merge_hulls(tests, [hull for hull in hulls if id(hull) not in left], _ROUGH_LIMIT * limit, 0)
        given, hulls = _drop_rough(tests, given, kept + rough, min_share)
    return [hull.corners for hull in _widen(tests, given, hulls, max_hulls, min_share)]


def _drop_rough(
    tests: _HullTests, boxes: list[_Hull], hulls: list[_Hull], min_share: float
) -> tuple[list[_Hull], list[_Hull]]:
    """The boxes and the hulls without roughness (`drop_redundant`)."""
    chosen = drop_redundant(tests.part, boxes + hulls, tests.tolerance.max_excess_m, min_share)
    return [hull for hull in chosen if not len(hull.members)], [hull for hull in chosen if len(hull.members)]


def _widen(tests: _HullTests, boxes: list[_Hull], hulls: list[_Hull], max_hulls: int, min_share: float) -> list[_Hull]:
    """At most `max_hulls` boxes and hulls: dropped by a share, then merged with a bound, and both double."""
    limit = tests.tolerance.max_excess_m
    while len(boxes) + len(hulls) > max_hulls and limit < tests.part.size:
        limit, min_share = 2 * limit, 2 * min_share
        if min_share > 0:
            boxes, hulls = _drop_rough(tests, boxes, hulls, min_share)
        tests.pairs = 0
        hulls = _merge_hulls(tests, hulls, limit, max_hulls - len(boxes))
    return boxes + hulls


class _HullTests:
    """Tests of how far hulls extend beyond the part."""

    def __init__(self, part: OuterSurface, tolerance: Tolerance) -> None:
        self.part, self.tolerance = part, tolerance
        self.pairs = 0
        rng = np.random.default_rng(0)
        self._weights = rng.dirichlet([1, 1, 1], _FULL_SAMPLES)
        self._picks = rng.integers(0, 1 << 20, (2, _QUICK_SAMPLES))
        self._step = float(np.clip(part.size / 100, 0.7e-3, 3e-3))

    def between(self, hull: Array, others: list[Array]) -> Array:
        """(n,) excess, m, at some points between corners of `hull` (k, 3) and of each of `others`."""
        a, b = self._picks
        t = np.linspace(0.2, 0.8, _QUICK_SAMPLES)[:, None]
        start = (1 - t) * hull[a % len(hull)]
        points = np.concatenate([start + t * other[b % len(other)] for other in others])
        self.pairs += len(others)
        return np.asarray(self.part.excess(points).reshape(len(others), -1).max(1))

    def make_hull(self, points: Array, members: NDArray[np.int64], limit: float, most: int = 200) -> _Hull | None:
        """The hull of points; None when its excess is above `limit` at one of `most` sampled points."""
        qhull = robust_hull(points)
        worst = self.stands_out(qhull, limit, most)
        return None if worst > limit else _Hull(qhull.points[qhull.vertices], members, worst)

    def fit_patch(self, members: NDArray[np.int64]) -> _Hull | None:
        """The hull of a patch with depth, and with its rim if that fits; None when it exceeds the bound."""
        limit = self.tolerance.max_excess_m / 2
        for rim in (True, False):
            points = add_depth(self.part, members, self.tolerance, rim)
            if self.between(points, [points])[0] <= limit:
                few = simplify_points(points, self.tolerance, limit)
                hull = None if few is None else self.make_hull(few, members, limit, _FULL_SAMPLES)
                if hull is not None:
                    return hull
        return None

    def stands_out(self, qhull: ConvexHull, limit: float, most: int) -> float:
        """Excess of a hull, m; a lower bound when it is above `limit`."""
        corners = qhull.points[qhull.simplices]
        area = 0.5 * np.linalg.norm(triangle_normals(qhull.points, qhull.simplices), axis=1)
        n = int(np.clip(area.sum() / self._step**2, 2 * _QUICK_SAMPLES, most))
        worst = 0.0
        for count in (_QUICK_SAMPLES, n):
            at = (np.arange(count) + 0.5) / count
            face = np.searchsorted(np.cumsum(area) / area.sum(), at).clip(max=len(area) - 1)
            x = np.einsum("ij,ijk->ik", self._weights[:count], corners[face])
            worst = max(worst, float(self.part.excess(x).max()))
            if worst > limit:
                break
        return worst


def simplify_points(points: Array, tolerance: Tolerance, max_omission: float) -> Array | None:
    """Few of the points (n, 3), thickened to `MIN_THICKNESS_M`; None when that fails.

    Omitted points are at most `simplify_m` outside their hull or, once there are `MAX_VERTICES`, at most
    `max_omission`, m.
    """
    points = thicken(points, MIN_THICKNESS_M)
    if len(points) <= 12:
        return points
    chosen = np.unique(np.argmax(points @ _DIRECTIONS.T, axis=0))
    if len(chosen) < 4:
        return points
    while True:
        qhull = robust_hull(points[chosen])
        beyond = points @ qhull.equations[:, :3].T + qhull.equations[:, 3]
        out = beyond.max(0)
        if out.max() <= tolerance.simplify_m:
            return np.asarray(points[chosen])
        room = MAX_VERTICES - len(chosen)
        if room <= 0:
            return np.asarray(points[chosen]) if out.max() <= max_omission else None
        furthest = np.argmax(beyond, axis=0)[np.argsort(-out)]
        new = [k for k in dict.fromkeys(furthest.tolist()) if k not in set(chosen.tolist())][: min(room, 8)]
        if not new:
            return np.asarray(points[chosen])
        chosen = np.concatenate([chosen, new])


_DIRECTIONS = even_directions(26)


def robust_hull(points: Array) -> ConvexHull:
    """The convex hull of points (n, 3); coplanar points are joggled."""
    try:
        return ConvexHull(points)
    except QhullError:
        return ConvexHull(points, qhull_options="QJ Pp")


def thicken(points: Array, min_thickness_m: float) -> Array:
    """The points, with copies on both sides along every principal axis along which they are less than `min_thickness_m`
    wide."""
    centre = points.mean(0)
    axes = np.linalg.eigh(np.cov((points - centre).T) if len(points) > 1 else np.zeros((3, 3)))[1].T
    for axis in axes:
        lack = min_thickness_m - np.ptp(points @ axis)
        if lack > 0:
            points = np.concatenate([points + 0.5 * lack * axis, points - 0.5 * lack * axis])
    return points


def _find_uncovered(part: OuterSurface, hulls: Sequence[Array], limit: float) -> NDArray[np.int64]:
    """Points of the outer surface that are more than `limit`, m, outside every hull, corners (k, 3)."""
    bare = np.arange(len(part.points))
    for corners in hulls:
        planes = robust_hull(corners).equations
        beyond = part.points[bare] @ planes[:, :3].T + planes[:, 3]
        bare = bare[beyond.max(1) > limit]
    return bare


def _split_into_patches(tests: _HullTests, members: NDArray[np.int64], last: bool = False) -> list[_Hull]:
    """Hulls of patches that face one way and stay within the bound.

    A few points without a shape are skipped, as neighbours usually cover them; the `last` time each becomes a small
    cube.
    """
    part, tolerance = tests.part, tests.tolerance
    pending = [members] if len(members) else []
    done: list[_Hull] = []
    while pending:
        members = pending.pop()
        small = len(members) < (2 if last else 4)
        extent = float(np.linalg.norm(np.ptp(part.points[members], axis=0)))
        hull = None
        if small or extent < _SMALL_PATCH * tolerance.max_excess_m or _face_one_way(part.normals[members]):
            hull = tests.fit_patch(members)
        if hull is None and small and last:
            hull = tests.make_hull(thicken(part.points[members], MIN_THICKNESS_M / 2), members, np.inf)
        if hull is not None:
            done.append(hull)
        elif not small:
            pending += _split_patch(part, members)
    return done


def _face_one_way(normals: Array) -> bool:
    mean = normals.mean(0)
    length = float(np.linalg.norm(mean))
    return length > 0.1 and float((normals @ mean / length > _FACING).mean()) > _FACING_SHARE


def add_depth(part: OuterSurface, members: NDArray[np.int64], tolerance: Tolerance, rim: bool) -> Array:
    """Points of a patch, with points halfway through the part behind them; with `rim` also neighbouring points of its
    face, so that neighbouring hulls overlap."""
    depth = 0.5 * float(part.depth[members].min())
    length = float(np.linalg.norm(np.ptp(part.points[members], axis=0)))
    behind = min(depth, max(length, MIN_THICKNESS_M)) if np.isfinite(depth) else MIN_THICKNESS_M
    points, normals = part.points[members], part.normals[members]
    out = [points, points - behind * normals]
    if rim:
        around = part.around[members]
        away = part.points[around] - points[:, None]
        ahead = np.abs(np.einsum("ijk,ik->ij", away, normals))
        same_face = np.einsum("ijk,ik->ij", part.normals[around], normals) > _SAME_FACE
        out.append(part.points[np.unique(around[same_face & (ahead < 0.25 * np.linalg.norm(away, axis=-1))])])
    return np.concatenate(out)


def _split_patch(part: OuterSurface, members: NDArray[np.int64]) -> list[NDArray[np.int64]]:
    """Two halves of a patch by position and normal (2-means)."""
    points, normals = part.points[members], part.normals[members]
    spread = float(np.sqrt(((points - points.mean(0)) ** 2).sum(1).mean())) or 1.0
    x = np.hstack([points / spread, 1.5 * normals])
    a = x[np.argmax(((x - x.mean(0)) ** 2).sum(1))]
    b = x[np.argmax(((x - a) ** 2).sum(1))]
    for _ in range(8):
        first = ((x - a) ** 2).sum(1) < ((x - b) ** 2).sum(1)
        if first.all() or not first.any():
            break
        a, b = x[first].mean(0), x[~first].mean(0)
    if first.all() or not first.any():
        first = np.arange(len(members)) < len(members) // 2
    return [members[first], members[~first]]


def _merge_hulls(tests: _HullTests, hulls: list[_Hull], limit: float, least: int) -> list[_Hull]:
    """Neighbours merged, the best first, while the excess of their common hull is at most `limit` and more than `least`
    remain."""
    alive: dict[int, _Hull] = dict(enumerate(hulls))
    near = _find_neighbours(tests.part, hulls)
    heap: list[tuple[float, int, int, _Hull | None]] = []

    def cost(worst: float, low: Array, high: Array) -> float:
        return worst + _LENGTH_COST * float(np.linalg.norm(high - low))

    def consider(a: int, others: list[int]) -> None:
        if not others or tests.pairs >= tests.tolerance.max_pairs:
            return
        first = alive[a].corners
        for b, worst in zip(others, tests.between(first, [alive[b].corners for b in others]).tolist(), strict=True):
            if worst <= limit:
                other = alive[b].corners
                low, high = np.minimum(first.min(0), other.min(0)), np.maximum(first.max(0), other.max(0))
                heapq.heappush(heap, (cost(worst, low, high), a, b, None))

    for a in sorted(near):
        consider(a, [b for b in sorted(near[a]) if a < b])
    serial = len(hulls)
    while heap and len(alive) > least:
        _, a, b, merged = heapq.heappop(heap)
        if a not in alive or b not in alive:
            continue
        if merged is None:  # its excess is unknown so far
            first, second = alive[a], alive[b]
            points = np.concatenate([first.corners, second.corners])
            merged = tests.make_hull(points, np.concatenate([first.members, second.members]), limit)
            if merged is None:
                continue
            true = cost(merged.worst, merged.corners.min(0), merged.corners.max(0))
            if heap and true > heap[0][0]:
                heapq.heappush(heap, (true, a, b, merged))
                continue
        few = simplify_points(merged.corners, tests.tolerance, limit / 2)
        merged = None if few is None else tests.make_hull(few, merged.members, limit, _FULL_SAMPLES)
        if merged is None:
            continue
        del alive[a], alive[b]
        alive[serial] = merged
        near[serial] = ((near.pop(a) | near.pop(b)) - {a, b}) & set(alive)
        for c in near[serial]:
            near[c] = (near[c] - {a, b}) | {serial}
        consider(serial, sorted(near[serial]))
        serial += 1
    return list(alive.values())


def drop_redundant(part: OuterSurface, hulls: list[_Hull], near: float, min_share: float = 0.0) -> list[_Hull]:
    """The hulls without those, smallest first, that alone cover at most `min_share` of the points of the surface, all
    of them within `_ROUGHNESS` times `near` of another one; a hull covers what is in it or within `near`, m.

    What alone covers a corner of the part's convex hull stays: on such points it stands, and they touch first.
    """
    outermost = np.zeros(len(part.points), bool)
    outermost[robust_hull(part.points).vertices] = True
    covers = np.zeros((2, len(hulls), len(part.points)), bool)
    volume, far = np.zeros(len(hulls)), _ROUGHNESS * near
    for k, hull in enumerate(hulls):
        qhull = robust_hull(hull.corners)
        low, high = hull.corners.min(0) - far, hull.corners.max(0) + far
        at = np.flatnonzero(((part.points >= low) & (part.points <= high)).all(1))
        beyond = (part.points[at] @ qhull.equations[:, :3].T + qhull.equations[:, 3]).max(1)
        covers[0, k, at], covers[1, k, at] = beyond <= near, beyond <= far
        volume[k] = qhull.volume
    times = covers.sum(1)
    chosen = []
    for k in np.argsort(volume):
        alone = covers[0, k] & (times[0] <= 1)
        rough = alone.sum() <= min_share * len(part.points) and (times[1, alone] > 1).all()
        if rough and not (alone & outermost).any():
            times -= covers[:, k]
        else:
            chosen.append(int(k))
    return [hulls[k] for k in sorted(chosen)]


def _find_neighbours(part: OuterSurface, hulls: Iterable[_Hull]) -> dict[int, set[int]]:
    """Hulls whose points are adjacent, or on opposite sides of a wall."""
    label = np.full(len(part.points), -1)
    near: dict[int, set[int]] = {}
    for k, hull in enumerate(hulls):
        label[hull.members] = k
        near[k] = set()
    next_to = part.around
    own = np.repeat(np.arange(len(part.points)), next_to.shape[1])
    through = np.flatnonzero(part.opposite >= 0)
    pairs = np.concatenate([np.stack([own, next_to.ravel()], -1), np.stack([through, part.opposite[through]], -1)])
    pairs = np.unique(np.sort(label[pairs], axis=1), axis=0)
    for a, b in pairs.tolist():
        if a != b and a >= 0:
            near[a].add(b)
            near[b].add(a)
    return near
