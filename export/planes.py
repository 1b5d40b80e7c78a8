"""Planes in a part's surface, the largest first, each with the points that lie on it; and planes that are supposed
where nobody saw."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from export.outer_surface import even_directions
from freeart21.effects import perpendiculars
from freeart21.se3 import Array

PLANE_TOLERANCE = 1 / 250
"""m over the part's diagonal within which points are on a plane: 1.7 mm for a drawer unit of 43 cm."""
_DIRECTIONS = 400
"""Directions on the sphere, 6 degrees apart, whose points are counted."""
_TRIED = 6
"""Directions with most points whose best offsets are compared."""
_CONE = 0.95
"""Cosine, 18 degrees, between a point's normal and its plane's: fused surfaces are rough."""
_MIN_SHARE = 0.015
"""Fraction of all points from which a plane counts."""
_MAX_PLANES = 40
_SAME = 0.98
"""Cosine, 11 degrees, from which two planes that meet the same points count as one."""
_BOUND = 0.999
"""Quantile of the points along a direction at which a plane bounds them: few stand out of a rough fused surface."""
_ROUNDS = 3
"""Of fitting a plane to its points."""


@dataclass(frozen=True)
class Planes:
    """n . x = d, and which of the points lie on which."""

    normals: Array
    """(p, 3) outwards."""
    offsets: Array
    """(p,) m."""
    label: NDArray[np.int64]
    """(n,) plane of each point; -1 on none."""

    def __len__(self) -> int:
        return len(self.offsets)


def fit_planes(points: Array, normals: Array, tolerance: float) -> Planes:
    """Planes of even points (n, 3) with outward normals (n, 3), to within `tolerance`, m: from the one with most points
    down to one with `_MIN_SHARE` of all."""
    directions = even_directions(_DIRECTIONS)
    label = np.full(len(points), -1)
    found_n: list[Array] = []
    found_d: list[float] = []
    while len(found_d) < _MAX_PLANES:
        rest = np.flatnonzero(label < 0)
        if len(rest) < _MIN_SHARE * len(points):
            break
        few = rest[:: len(rest) // 10_000 + 1]
        near = (normals[few] @ directions.T > _CONE).sum(0)
        best: tuple[int, Array, float] = (0, np.zeros(3), 0.0)
        for k in np.argsort(-near, kind="stable")[:_TRIED]:
            own = few[normals[few] @ directions[k] > _CONE]
            if not len(own):
                continue
            n = normals[own].mean(0)
            n /= np.linalg.norm(n)
            along = points[own] @ n
            bins = np.floor((along - along.min()) / (2 * tolerance)).astype(np.int64)
            count = np.bincount(bins)
            if count.max() > best[0]:
                best = int(count.max()), n, float(along[bins == count.argmax()].mean())
        _, n, d = best
        on = np.zeros(0, np.int64)
        for _ in range(_ROUNDS):
            on = rest[(np.abs(points[rest] @ n - d) < tolerance) & (normals[rest] @ n > _CONE)]
            if len(on) < max(_MIN_SHARE * len(points), 3):
                break
            middle = points[on].mean(0)
            axis = np.linalg.eigh(np.cov((points[on] - middle).T))[1][:, 0]
            n = axis * np.sign(axis @ n)
            d = float(n @ middle)
        if len(on) < max(_MIN_SHARE * len(points), 3):
            break
        label[on] = len(found_d)
        found_n.append(n)
        found_d.append(d)
    return Planes(np.array(found_n).reshape(-1, 3), np.array(found_d), label)


def plane_axes(planes: Planes, points: Array) -> Array:
    """(3, 3) columns: right-handed axes of a box around points (n, 3): the normals of the two largest planes that are
    across each other; principal axes of the points without such planes."""
    for k in range(len(planes)):
        across = np.flatnonzero(np.abs(planes.normals @ planes.normals[k]) < 0.3)
        if len(across):
            x = planes.normals[k]
            y = planes.normals[across[0]] - x * (x @ planes.normals[across[0]])
            y /= np.linalg.norm(y)
            return np.stack([x, y, np.cross(x, y)], -1)
    axes = np.linalg.eigh(np.cov(points.T))[1]
    return np.asarray(axes * np.array([1.0, 1.0, np.sign(np.linalg.det(axes))]))


def suppose_planes(points: Array, planes: Planes) -> tuple[Array, Array]:
    """Normals (k, 3), outwards, and offsets (k,), m, of planes on which unseen surface may lie: those that were seen,
    continued, and where none was seen, those that bound all points (n, 3) of the seen surface.

    Bounds face along and against the normals of seen planes, and along the axes of the part (`plane_axes`).
    """
    normals, offsets = list(planes.normals), list(planes.offsets)
    directions = np.concatenate([-planes.normals, plane_axes(planes, points).T, -plane_axes(planes, points).T])
    tolerance = PLANE_TOLERANCE * float(np.linalg.norm(np.ptp(points, axis=0)))
    for n in directions:
        d = float(np.quantile(points @ n, _BOUND))
        if not any(m @ n > _SAME and abs(e - d) < 4 * tolerance for m, e in zip(normals, offsets, strict=True)):
            normals.append(n)
            offsets.append(d)
    return np.array(normals).reshape(-1, 3), np.array(offsets)


def sample_planes(normals: Array, offsets: Array, points: Array, axes: Array, spacing: float, most: int) -> Array:
    """(m, 3) points on planes, on the lines where two meet, and where three meet, within the box of points (n, 3) along
    `axes` (3, 3), columns; `spacing` m apart, or further so that there are about `most`.

    Points on a plane form triangles of equal sides.
    """
    along = points @ axes
    low, high = np.quantile(along, [1 - _BOUND, _BOUND], axis=0)
    size = float(np.linalg.norm(high - low))
    slack = PLANE_TOLERANCE * size
    n, d = normals @ axes, offsets

    def clip(p: Array) -> Array:
        return p[((p >= low - slack) & (p <= high + slack)).all(1)]

    def lattice(k: int, step: float) -> Array:
        u, v = perpendiculars(n[k])
        count = int(np.ceil(size / step))
        i, j = np.meshgrid(np.arange(-count, count + 1), np.arange(-count, count + 1), indexing="ij")
        x, y = step * (i + 0.5 * j).ravel(), step * np.sqrt(0.75) * j.ravel()
        middle = 0.5 * (low + high)
        return clip(middle + (d[k] - middle @ n[k]) * n[k] + x[:, None] * u + y[:, None] * v)

    step = spacing
    area = sum(len(lattice(k, size / 50)) for k in range(len(d))) * np.sqrt(0.75) * (size / 50) ** 2
    step = max(spacing, float(np.sqrt(area / (np.sqrt(0.75) * most))))
    found = [lattice(k, step) for k in range(len(d))]
    for a in range(len(d)):
        for b in range(a):
            way = np.cross(n[a], n[b])
            if np.linalg.norm(way) < 0.3:
                continue
            foot = np.linalg.lstsq(np.stack([n[a], n[b], way]), np.array([d[a], d[b], way @ (0.5 * (low + high))]))[0]
            t = np.arange(-size, size, step)[:, None]
            found.append(clip(foot + t * way / np.linalg.norm(way)))
            for c in range(b):
                if abs(way @ n[c]) > 0.3:
                    found.append(clip(np.linalg.solve(np.stack([n[a], n[b], n[c]]), d[[a, b, c]])[None]))
    return np.concatenate([np.zeros((0, 3)), *found]) @ axes.T
