"""A part as convex pieces none of which stands out of it by more than a tolerance: split small, then merge.

The outside is cut into patches that face one way, each with the matter behind it, until the hull of none stands out too
far; then neighbours are joined, the best first, for as long as the hull of both does not either. So a thin wall becomes
one plate of its two sides, a solid one piece, and an opening stays one: whatever would fill it stands out. Bottom-up
joining of hulls is that of HACD (Mamou and Ghorbel, ICIP 2009); its cost there is relative, here it is in metres.
"""

from __future__ import annotations

import heapq
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import ConvexHull, QhullError

from export.outside import Outside, even_directions
from freeart21.se3 import Array

_FACING = 0.6
"""Cosine to its mean normal that every point of a patch has: walls and floors do not share one."""
_SAME_FACE = 0.8
"""Cosine between the normals of neighbouring points of one face."""
_MOST = 0.85
"""Part of a patch's points that face so."""
_TINY = 3.0
"""A patch of less than so many tolerances may face anywhere."""
_FIRST_LOOK = 40
"""Points that are looked at first: most hulls that are refused are refused by these."""
_LAST_LOOK = 2500
"""Points that are looked at before a hull is taken."""
_PREFERS_SMALL = 0.002
"""m that a metre of a joined piece's length counts as standing out: of equals the smaller are joined first."""


@dataclass(frozen=True)
class Tolerance:
    """How far convex pieces may be from a part."""

    worst_m: float
    """m by which a piece may stand out of the part."""
    simple_m: float
    """m by which corners of a piece may be left out, so that it has few."""
    least_m: float
    """m: pieces are made this thick where the part's other side is not known."""
    patches: int
    """Patches at most."""
    pairs: int
    """Pairs of pieces at most that are thought of."""
    max_vertices: int
    """Of a piece."""


@dataclass
class _Piece:
    """A convex piece on its way."""

    corners: Array
    """(k, 3) of its hull, m."""
    members: NDArray[np.int64]
    """Points of the outside that it is there for."""
    worst: float
    """m by which it stands out, as far as it was looked at."""


def convex_pieces(outside: Outside, tolerance: Tolerance, most: int) -> list[Array]:
    """Corners (k, 3) of at most `most` convex pieces; beyond the tolerance where there would be more of them.

    A part that is convex as it stands is one piece with all its corners, however many.
    """
    looks = _Looks(outside, tolerance)
    everything = np.arange(len(outside.points))
    filled = with_matter(outside, everything, tolerance, rim=False)
    whole = looks.piece(filled, everything, tolerance.worst_m, _LAST_LOOK)
    if whole is not None:
        return [whole.corners]
    pieces = needed(outside, _joined(looks, _patches(looks, everything), tolerance.worst_m, 0), tolerance)
    bare = _bare(outside, pieces, tolerance.worst_m)
    pieces += _joined(looks, _patches(looks, bare, last=True), tolerance.worst_m, 0)
    limit = tolerance.worst_m
    while len(pieces) > most and limit < outside.size:
        limit *= 2
        looks.pairs = 0
        pieces = _joined(looks, pieces, limit, most)
    return [piece.corners for piece in pieces]


class _Looks:
    """Hulls of points, and how far they stand out."""

    def __init__(self, outside: Outside, tolerance: Tolerance) -> None:
        self.outside, self.tolerance = outside, tolerance
        self.count = self.pairs = 0
        rng = np.random.default_rng(0)
        self._weights = rng.dirichlet([1, 1, 1], _LAST_LOOK)
        self._picks = rng.integers(0, 1 << 20, (2, _FIRST_LOOK))
        self._step = float(np.clip(outside.size / 100, 0.7e-3, 3e-3))

    def between(self, piece: Array, others: list[Array]) -> Array:
        """(n,) m by which some points between corners of `piece` (k, 3) and each of `others` stand out."""
        a, b = self._picks
        t = np.linspace(0.2, 0.8, _FIRST_LOOK)[:, None]
        start = (1 - t) * piece[a % len(piece)]
        points = np.concatenate([start + t * other[b % len(other)] for other in others])
        self.pairs += len(others)
        return self.outside.excess(points).reshape(len(others), -1).max(1)

    def piece(self, points: Array, members: NDArray[np.int64], limit: float, most: int = 200) -> _Piece | None:
        """The hull of points as a piece; None when it stands out by more than `limit` at one of `most` points."""
        self.count += 1
        hull = hull_of(points)
        worst = self.stands_out(hull, limit, most)
        return None if worst > limit else _Piece(hull.points[hull.vertices], members, worst)

    def patch(self, members: NDArray[np.int64]) -> _Piece | None:
        """A patch with the matter behind it, and its rim if that does not stand out; None when even without it does."""
        limit = self.tolerance.worst_m / 2
        for rim in (True, False):
            points = with_matter(self.outside, members, self.tolerance, rim)
            if self.between(points, [points])[0] <= limit:
                few = simplified(points, self.tolerance, limit)
                piece = None if few is None else self.piece(few, members, limit, _LAST_LOOK)
                if piece is not None:
                    return piece
        return None

    def stands_out(self, hull: ConvexHull, limit: float, most: int) -> float:
        """m by which a hull stands out; less than the true number when that is beyond `limit`."""
        corners = hull.points[hull.simplices]
        area = 0.5 * np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
        n = int(np.clip(area.sum() / self._step**2, 2 * _FIRST_LOOK, most))
        worst = 0.0
        for count in (_FIRST_LOOK, n):
            at = (np.arange(count) + 0.5) / count
            face = np.searchsorted(np.cumsum(area) / area.sum(), at).clip(max=len(area) - 1)
            x = np.einsum("ij,ijk->ik", self._weights[:count], corners[face])
            worst = max(worst, float(self.outside.excess(x).max()))
            if worst > limit:
                break
        return worst


def simplified(points: Array, tolerance: Tolerance, left_out: float) -> Array | None:
    """Few of the points (n, 3): no other stands out of their hull by more than `simple_m`, or where `max_vertices` are
    reached by `left_out`, m; None when that cannot be. Flat ones are made `least_m` thick."""
    points = thickened(points, tolerance.least_m)
    if len(points) <= 12:
        return points
    kept = np.unique(np.argmax(points @ _DIRECTIONS.T, axis=0))
    if len(kept) < 4:
        return points
    while True:
        hull = hull_of(points[kept])
        beyond = points @ hull.equations[:, :3].T + hull.equations[:, 3]
        out = beyond.max(0)
        if out.max() <= tolerance.simple_m:
            return points[kept]
        room = tolerance.max_vertices - len(kept)
        if room <= 0:
            return points[kept] if out.max() <= left_out else None
        furthest = np.argmax(beyond, axis=0)[np.argsort(-out)]
        new = [k for k in dict.fromkeys(furthest.tolist()) if k not in set(kept.tolist())][: min(room, 8)]
        if not new:
            return points[kept]
        kept = np.concatenate([kept, new])


_DIRECTIONS = even_directions(26)


def hull_of(points: Array) -> ConvexHull:
    """The hull of points (n, 3); of what lies in a plane, of the points jogged a little."""
    try:
        return ConvexHull(points)
    except QhullError:
        return ConvexHull(points, qhull_options="QJ Pp")


def thickened(points: Array, least_m: float) -> Array:
    """The points, with more beside them along every principal axis along which they are less than `least_m` wide."""
    centre = points.mean(0)
    axes = np.linalg.eigh(np.cov((points - centre).T) if len(points) > 1 else np.zeros((3, 3)))[1].T
    for axis in axes:
        lack = least_m - np.ptp(points @ axis)
        if lack > 0:
            points = np.concatenate([points + 0.5 * lack * axis, points - 0.5 * lack * axis])
    return points


def _bare(outside: Outside, pieces: list[_Piece], limit: float) -> NDArray[np.int64]:
    """The points of the outside that are beyond a plane of every piece by more than `limit`, m."""
    bare = np.arange(len(outside.points))
    for piece in pieces:
        planes = hull_of(piece.corners).equations
        beyond = outside.points[bare] @ planes[:, :3].T + planes[:, 3]
        bare = bare[beyond.max(1) > limit]
    return bare


def _patches(looks: _Looks, members: NDArray[np.int64], last: bool = False) -> list[_Piece]:
    """Pieces that face one way and do not stand out: the largest is split for as long as there may be more.

    A few points of no shape are left to what covers their neighbours; the `last` time each becomes a small cube.
    """
    outside, tolerance = looks.outside, looks.tolerance
    waiting: list[tuple[float, int, NDArray[np.int64]]] = [(-outside.size, 0, members)] if len(members) else []
    done: list[_Piece] = []
    serial = 0
    while waiting:
        extent, _, members = heapq.heappop(waiting)
        small = len(members) < (2 if last else 4)
        full = len(done) + len(waiting) + 1 >= tolerance.patches
        piece = None
        if small or full or -extent < _TINY * tolerance.worst_m or _coherent(outside.normals[members]):
            piece = looks.patch(members)
        if piece is None and (last if small else full):
            piece = looks.piece(thickened(outside.points[members], tolerance.least_m / 2), members, np.inf)
        if piece is not None:
            done.append(piece)
        if piece is not None or small:
            continue
        for half in _halves(outside, members):
            serial += 1
            length = float(np.linalg.norm(np.ptp(outside.points[half], axis=0)))
            heapq.heappush(waiting, (-length, serial, half))
    return done


def _coherent(normals: Array) -> bool:
    mean = normals.mean(0)
    length = float(np.linalg.norm(mean))
    return length > 0.1 and float((normals @ mean / length > _FACING).mean()) > _MOST


def with_matter(outside: Outside, members: NDArray[np.int64], tolerance: Tolerance, rim: bool) -> Array:
    """Points of a patch, with `rim` those of its face next to it, so that neighbours overlap, and points behind the
    patch, halfway through the part."""
    depth = 0.5 * float(outside.depth[members].min())
    length = float(np.linalg.norm(np.ptp(outside.points[members], axis=0)))
    behind = min(depth, max(length, tolerance.least_m)) if np.isfinite(depth) else tolerance.least_m
    points, normals = outside.points[members], outside.normals[members]
    out = [points, points - behind * normals]
    if rim:
        around = outside.around[members]
        away = outside.points[around] - points[:, None]
        ahead = np.abs(np.einsum("ijk,ik->ij", away, normals))
        alike = np.einsum("ijk,ik->ij", outside.normals[around], normals) > _SAME_FACE
        out.append(outside.points[np.unique(around[alike & (ahead < 0.25 * np.linalg.norm(away, axis=-1))])])
    return np.concatenate(out)


def _halves(outside: Outside, members: NDArray[np.int64]) -> list[NDArray[np.int64]]:
    """Two halves of a patch, by place and by facing (two means)."""
    points, normals = outside.points[members], outside.normals[members]
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


def _joined(looks: _Looks, pieces: list[_Piece], limit: float, least: int) -> list[_Piece]:
    """Neighbours joined, the best first, while the hull of both stands out by no more than `limit`."""
    alive: dict[int, _Piece] = dict(enumerate(pieces))
    near = _neighbours(looks.outside, pieces)
    heap: list[tuple[float, int, int, _Piece | None]] = []

    def cost(worst: float, low: Array, high: Array) -> float:
        return worst + _PREFERS_SMALL * float(np.linalg.norm(high - low))

    def consider(a: int, others: list[int]) -> None:
        if not others or looks.pairs >= looks.tolerance.pairs:
            return
        first = alive[a].corners
        for b, worst in zip(others, looks.between(first, [alive[b].corners for b in others]).tolist(), strict=True):
            if worst <= limit:
                other = alive[b].corners
                low, high = np.minimum(first.min(0), other.min(0)), np.maximum(first.max(0), other.max(0))
                heapq.heappush(heap, (cost(worst, low, high), a, b, None))

    for a in sorted(near):
        consider(a, [b for b in sorted(near[a]) if a < b])
    serial = len(pieces)
    while heap and len(alive) > least:
        _, a, b, both = heapq.heappop(heap)
        if a not in alive or b not in alive:
            continue
        if both is None:  # how far it stands out is not known yet
            first, second = alive[a], alive[b]
            points = np.concatenate([first.corners, second.corners])
            both = looks.piece(points, np.concatenate([first.members, second.members]), limit)
            if both is None:
                continue
            true = cost(both.worst, both.corners.min(0), both.corners.max(0))
            if heap and true > heap[0][0]:
                heapq.heappush(heap, (true, a, b, both))
                continue
        few = simplified(both.corners, looks.tolerance, limit / 2)
        both = None if few is None else looks.piece(few, both.members, limit, _LAST_LOOK)
        if both is None:
            continue
        del alive[a], alive[b]
        alive[serial] = both
        near[serial] = ((near.pop(a) | near.pop(b)) - {a, b}) & set(alive)
        for c in near[serial]:
            near[c] = (near[c] - {a, b}) | {serial}
        consider(serial, sorted(near[serial]))
        serial += 1
    return list(alive.values())


def needed(outside: Outside, pieces: list[_Piece], tolerance: Tolerance) -> list[_Piece]:
    """The pieces without those, the smallest first, whose part of the surface others cover as well."""
    covers = np.zeros((len(pieces), len(outside.points)), bool)
    volume = np.zeros(len(pieces))
    for k, piece in enumerate(pieces):
        hull = hull_of(piece.corners)
        low, high = piece.corners.min(0) - tolerance.simple_m, piece.corners.max(0) + tolerance.simple_m
        near = np.flatnonzero(((outside.points >= low) & (outside.points <= high)).all(1))
        beyond = outside.points[near] @ hull.equations[:, :3].T + hull.equations[:, 3]
        covers[k, near] = (beyond <= tolerance.simple_m).all(1)
        volume[k] = hull.volume
    times = covers.sum(0)
    kept = []
    for k in np.argsort(volume):
        if (times[covers[k]] > 1).all():
            times -= covers[k]
        else:
            kept.append(int(k))
    return [pieces[k] for k in sorted(kept)]


def _neighbours(outside: Outside, pieces: Iterable[_Piece]) -> dict[int, set[int]]:
    """Pieces of which points are next to each other, or on the two sides of a wall."""
    label = np.full(len(outside.points), -1)
    near: dict[int, set[int]] = {}
    for k, piece in enumerate(pieces):
        label[piece.members] = k
        near[k] = set()
    next_to = outside.around
    own = np.repeat(np.arange(len(outside.points)), next_to.shape[1])
    through = np.flatnonzero(outside.opposite >= 0)
    pairs = np.concatenate([np.stack([own, next_to.ravel()], -1), np.stack([through, outside.opposite[through]], -1)])
    pairs = np.unique(np.sort(label[pairs], axis=1), axis=0)
    for a, b in pairs.tolist():
        if a != b and a >= 0:
            near[a].add(b)
            near[b].add(a)
    return near
