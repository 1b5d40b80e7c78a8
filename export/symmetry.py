"""Symmetries of the seen surface of a part: what stands on a seen side is supposed on the side that nobody saw.

Two kinds are looked for: turning about an axis, by line geometry (the normals of a surface of revolution meet its axis,
Pottmann and Randrup, Computing 60, 1998), and mirroring in a plane. Each is tested: moved points of the seen surface
lie on the seen surface, or where they cannot be, or where nobody looked. Those that lie where nobody looked are
returned, each with the odds that it is right, in bits: what it weighs when the part is closed (`export.surface`).
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from export.free_space import INSIDE, SEEN_THROUGH, UNKNOWN, SpaceGrid
from export.planes import PLANE_TOLERANCE
from export.winding_number import Winding
from freeart21.effects import perpendiculars
from freeart21.mesh import Mesh
from freeart21.se3 import Array

_NEAR = 2.0
"""Tolerances within which a moved point lies on the seen surface: one for each of the two."""
_AGREE = 0.9
"""Least cosine of its normal and the one there, 26 degrees; set by hand, as the two that follow."""
_LEAST_BITS = 1.0
"""Log odds that a copy must exceed: what its area costs as a boundary (`export.surface`), so that less never counts."""
_MIRRORED = 0.2
"""Least share of the points that say where a mirror plane is (`_ACROSS`) whose images lie on seen surface: fewer are
chance. Tested on all points, a drawer seen from the front was mirrored to a back 8.5 mm off: walls alone agreed."""
_ROUND = 0.15
"""Least share of the points that lie on the surface of revolution, and least share of a ring that was seen; set
by hand."""
_ACROSS = 0.3
"""Sine between a normal and an axis, or cosine of it and a mirror plane's, from which a point says where that is: caps
and floors do not say where the axis is, and a mirror plane slides along walls."""
_SAME = 0.98
"""Cosine, 11 degrees, from which two directions count as one: fitting turns a plane further than that. It and the rest
are set by hand."""
_OFFSETS = 41
"""Mirror planes tried along a direction."""
_FEW, _MANY = 2_000, 10_000
"""Points that mirror planes are tried with, and that are looked at and mirrored."""
_FAR = 8.0
"""Distance at which a mirrored point finds a partner at first, over that at last."""
_STIFF = 1e-6
"""Of the trace that is added to the normal equations: a plane that may slide stays."""
_ROUNDS = 12
"""Of fitting an axis, and of fitting a mirror plane."""


@dataclass(frozen=True)
class Supposed:
    """Oriented points of surface that a symmetry puts where nobody looked."""

    points: Array = field(default_factory=lambda: np.zeros((0, 3)))
    """(m, 3)."""
    normals: Array = field(default_factory=lambda: np.zeros((0, 3)))
    """(m, 3) outwards, of unit length."""
    sources: Array = field(default_factory=lambda: np.zeros((0, 3)))
    """(m, 3) the seen points that they are copies of."""
    bits: Array = field(default_factory=lambda: np.zeros(0))
    """(m,) log odds, above `_LEAST_BITS`, that they are right: by how many of their symmetry's images are."""


def suppose_by_symmetry(
    seen: Mesh, points: Array, normals: Array, axes: Array, space: SpaceGrid, spacing: float
) -> Supposed:
    """What the symmetries of a seen surface suppose: points about `spacing`, m, apart, all further than that from seen
    ones. `points` (n, 3) are even on the surface, with outward unit normals (n, 3); `axes` (3, 3), columns, are the
    part's (`planes.plane_axes`). Nothing where no frame looked through any space: then nothing could speak against a
    symmetry."""
    if len(points) < 100 or not (space.state == SEEN_THROUGH).any():
        return Supposed()
    tolerance = PLANE_TOLERANCE * float(np.linalg.norm(np.ptp(points, axis=0)))
    surface = _SeenSurface(
        points, normals, cKDTree(points), space, Winding(seen), _NEAR * max(tolerance, 0.5 * spacing)
    )
    moved = [*_turned(surface, tolerance, spacing), *_mirrored(surface, axes)]
    if not moved:
        return Supposed()
    moved.sort(key=lambda copies: -copies[3][0])  # where two suppose the same, the better one counts
    at, facing, sources, bits = (np.concatenate(its) for its in zip(*moved, strict=True))
    unseen = np.flatnonzero(surface.sort(at, facing)[2])
    one = unseen[np.unique(np.floor(at[unseen] / spacing).astype(np.int64), axis=0, return_index=True)[1]]
    return Supposed(at[one], facing[one], sources[one], bits[one])


_Copies = tuple[Array, Array, Array, Array]
"""Points, their normals, and the seen points that they are copies of, each (m, 3); and the `Supposed.bits`, (m,)."""


@dataclass(frozen=True)
class _SeenSurface:
    """The seen surface, and what speaks against more of it."""

    points: Array
    normals: Array
    tree: cKDTree
    space: SpaceGrid
    winding: Winding
    near: float
    """m within which a point lies on it."""

    def judge(self, points: Array, normals: Array) -> tuple[NDArray[np.bool_], NDArray[np.bool_], NDArray[np.bool_]]:
        """(m,) whether points lie on the seen surface and face as it does, whether they are away from it, and whether
        they are in known empty space there, or so far off that nobody knows."""
        distance, nearest = self.tree.query(points, distance_upper_bound=self.near + self.space.voxel)
        away = np.isinf(distance)
        own = self.normals[np.where(away, 0, nearest)]
        on = (distance < self.near) & (np.einsum("ij,ij->i", normals, own) > _AGREE)
        return on, away, away & ((self.space.look_up(points) != UNKNOWN) | ~self.space.holds(points))

    def sort(self, points: Array, normals: Array) -> tuple[NDArray[np.bool_], NDArray[np.bool_], NDArray[np.bool_]]:
        """(m,) whether points lie on the seen surface and face as it does, whether they lie where they cannot be, in
        known empty space or inside one of the parts, and whether they lie where nobody looked."""
        on, away, wrong = self.judge(points, normals)
        rest = np.flatnonzero(away & ~wrong)
        wrong[rest] = self.winding.number(points[rest]) > INSIDE
        rest = rest[~wrong[rest]]
        if self.space.other is not None:
            wrong[rest] = self.space.other.holds(points[rest])
        return on, wrong, away & ~wrong

    def weigh(self, points: Array, normals: Array, least: float) -> float:
        """Log odds, in bits, that an image is right where at least a share of `least` lies on seen surface, else 0:
        by the images there and those that lie where they cannot be (rule of succession)."""
        on, wrong, _ = self.sort(points, normals)
        return float(np.log2((on.sum() + 1) / (wrong.sum() + 1))) if on.mean() >= least else 0.0


def _turned(seen: _SeenSurface, tolerance: float, spacing: float) -> list[_Copies]:
    """The rings of the surface of revolution that pass the test, points `spacing`, m, apart: rings that were seen over
    at least `_ROUND` of their way, and that next to nothing speaks against."""
    many = _thin_out(len(seen.points), _MANY)
    starts = (None, *np.linalg.eigh(np.cov(seen.points.T))[1].T)
    axis, pivot, on = max(
        (_fit_axis(seen.points[many], seen.normals[many], tolerance, s) for s in starts), key=lambda a: a[2].sum()
    )
    if on.mean() < _ROUND:
        return []
    p, n = seen.points[many][on] - pivot, seen.normals[many][on]
    along, across = p @ axis, p - (p @ axis)[:, None] * axis
    away = np.linalg.norm(across, axis=1)
    kept = (away > spacing) & (away < np.linalg.norm(np.ptp(seen.points, axis=0)))  # a wall is no part of a huge ring
    p, along, across, away, n = p[kept], along[kept], across[kept], away[kept], n[kept]
    profile = np.stack([along, away, n @ axis, np.einsum("ij,ij->i", n, across) / away], -1)
    inwards = profile[:, 3] < 0
    cells = np.column_stack([np.floor(profile[:, :2] / spacing), inwards]).astype(np.int64)
    _, cell, count = np.unique(cells, axis=0, return_inverse=True, return_counts=True)
    rings = np.stack([np.bincount(cell.ravel(), column) for column in profile.T], -1) / count[:, None]
    x, y = perpendiculars(axis)
    found = []
    for k, (height, radius, rise, out) in enumerate(rings):
        angle = np.arange(0, 2 * np.pi, spacing / radius)[:, None]
        spoke = np.cos(angle) * x + np.sin(angle) * y
        points, normals = pivot + height * axis + radius * spoke, (rise * axis + out * spoke) / np.hypot(rise, out)
        bits = seen.weigh(points, normals, _ROUND)
        if bits > _LEAST_BITS:
            own = pivot + p[cell.ravel() == k]
            found.append((points, normals, np.resize(own, points.shape), np.full(len(points), bits)))
    return found


def _fit_axis(
    points: Array, normals: Array, tolerance: float, start: Array | None
) -> tuple[Array, Array, NDArray[np.bool_]]:
    """The axis that most normals meet: its direction (3,), a point (3,) on it, and (n,) which points lie on the surface
    of revolution about it: those whose normals pass the axis within twice `tolerance`, m, and are not along it.

    Robust least squares from the direction `start` through the middle, or from all points with equal weights; the
    scale of the weights falls from a fifth of the size to `tolerance`.
    """
    middle = points.mean(0)
    p = points - middle
    size = float(np.linalg.norm(np.ptp(points, axis=0)))
    rows = np.hstack([np.cross(p, normals), normals])
    axis, moment = (np.zeros(3), np.zeros(3)) if start is None else (start, np.zeros(3))
    weight, passes = np.ones(len(p)), np.full(len(p), np.inf)
    for scale in np.geomspace(0.2 * size, tolerance, _ROUNDS):
        if axis.any():
            sine = np.linalg.norm(np.cross(normals, axis), axis=1)
            passes = np.abs(rows @ np.append(axis, moment)) / np.maximum(sine, 1e-9)
            weight = sine**2 / (1 + (passes / scale) ** 2) ** 2
        M = (rows * weight[:, None]).T @ rows
        solved = np.linalg.solve(M[3:, 3:] + 1e-9 * np.trace(M[3:, 3:]) * np.eye(3), M[3:, :3])
        axis = np.linalg.eigh(M[:3, :3] - M[:3, 3:] @ solved)[1][:, 0]
        moment = -solved @ axis
    sine = np.linalg.norm(np.cross(normals, axis), axis=1)
    passes = np.abs(rows @ np.append(axis, moment)) / np.maximum(sine, 1e-9)
    return axis, middle + np.cross(axis, moment), (passes < _NEAR * tolerance) & (sine > _ACROSS)


def _mirrored(seen: _SeenSurface, axes: Array) -> list[_Copies]:
    """The seen points mirrored in every plane that passes the test, of those across the part's `axes` and its principal
    axes, fitted."""
    few, many = _thin_out(len(seen.points), _FEW), _thin_out(len(seen.points), _MANY)
    principal = np.linalg.eigh(np.cov(seen.points.T))[1].T
    found = []
    for n in [*axes.T, *(n for n in principal if np.abs(n @ axes).max() < _SAME)]:
        low, high = np.quantile(seen.points @ n, [0.2, 0.8])
        best = max(np.linspace(low, high, _OFFSETS), key=lambda d: _agreement(seen, few, n, d))
        n, d = _fit_mirror(seen, few, n, float(best))
        across = many[np.abs(seen.normals[many] @ n) > _ACROSS]
        bits = seen.weigh(*_mirror(seen, across, n, d), _MIRRORED) if len(across) else 0.0
        if bits > _LEAST_BITS:
            found.append((*_mirror(seen, many, n, d), seen.points[many], np.full(len(many), bits)))
    return found


def _thin_out(count: int, most: int) -> NDArray[np.int64]:
    """At most `most` indices of `count`, evenly."""
    return np.arange(0, count, count // most + 1)


def _mirror(seen: _SeenSurface, chosen: NDArray[np.int64], n: Array, d: float) -> tuple[Array, Array]:
    """Chosen seen points and their normals, mirrored in the plane n . x = d."""
    p, m = seen.points[chosen], seen.normals[chosen]
    return p - 2 * ((p @ n) - d)[:, None] * n, m - 2 * (m @ n)[:, None] * n


def _agreement(seen: _SeenSurface, chosen: NDArray[np.int64], n: Array, d: float) -> float:
    """The share of mirrored points on the seen surface less that in known empty space."""
    there, _, empty = seen.judge(*_mirror(seen, chosen, n, d))
    return float(there.mean() - empty.mean())


def _fit_mirror(seen: _SeenSurface, chosen: NDArray[np.int64], n: Array, d: float) -> tuple[Array, float]:
    """The plane in which the chosen points' mirror images lie best on the seen surface, from the one given: distances
    along the normals of the nearest seen points, by Gauss-Newton."""
    middle = seen.points.mean(0)
    for reach in np.geomspace(_FAR * seen.near, seen.near, _ROUNDS):
        moved, facing = _mirror(seen, chosen, n, d)
        distance, nearest = seen.tree.query(moved, distance_upper_bound=reach)
        on = np.flatnonzero(np.isfinite(distance))
        normals = seen.normals[nearest[on]]
        kept = np.einsum("ij,ij->i", facing[on], normals) > _AGREE
        on, normals = on[kept], normals[kept]
        if len(on) < 10:
            break
        p, q = seen.points[chosen[on]], seen.points[nearest[np.isfinite(distance)][kept]]
        off = np.einsum("ij,ij->i", normals, moved[on] - q)
        sides = np.stack(perpendiculars(n), -1)
        # the image p - 2 (n . p - d) n, differentiated by turns of the plane about the middle, and by its shift
        turns = (normals @ n)[:, None] * ((p - middle) @ sides) + (p @ n - d)[:, None] * (normals @ sides)
        J = -2 * np.column_stack([turns, -(normals @ n)])
        M = J.T @ J
        a, b, shift = np.linalg.solve(M + _STIFF * np.trace(M) * np.eye(3), -J.T @ off)
        turned = n + sides @ np.array([a, b])
        turned /= np.linalg.norm(turned)
        n, d = turned, d + float(shift + middle @ (turned - n))
    return n, d
