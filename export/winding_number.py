"""Generalised winding number (Jacobson et al. 2013) of a surface that may be open, and distance to it."""

from __future__ import annotations

import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor

import numpy as np
from numba import njit
from numpy.typing import NDArray

from freeart21.mesh import Mesh
from freeart21.se3 import Array

Ints = NDArray[np.int64]
LEAF_TRIANGLES = 8
"""Most triangles in a leaf of the tree."""
THREADED_POINTS = 2_000
"""Points from which on threads are used."""
FAR_RADII = 2.0
"""Radii from a node's centre beyond which its triangles are approximated by one dipole (Barill et al. 2018, who take
2)."""
_SLACK = 1e-9
"""Relative, above the rounding of distances: a bound that the nearest triangle itself is below."""


class Winding:
    """Winding number of a mesh at points: 1 inside a closed surface, 0 outside, in between when the surface is open."""

    def __init__(self, mesh: Mesh) -> None:
        """`mesh` in any frame; its triangles face outwards."""
        corners = mesh.vertices[mesh.faces]
        order, self._first, self._count, self._right = _build_tree(
            np.ascontiguousarray(corners.mean(1)), LEAF_TRIANGLES
        )
        self._order = order
        self._corners = np.ascontiguousarray(corners[order])
        a, b, c = np.moveaxis(self._corners, 1, 0)
        self._nodes = _node_dipoles(self._corners, 0.5 * np.cross(b - a, c - a), self._first, self._count)

    def number(self, points: Array) -> Array:
        """(n,) winding numbers at points (n, 3)."""
        return self._each(_winding_numbers, points, FAR_RADII)

    def distance(self, points: Array) -> Array:
        """(n,) distances from points (n, 3) to the nearest triangle."""
        return self.nearest(points)[0]

    def nearest(self, points: Array) -> tuple[Array, NDArray[np.int64]]:
        """(n,) distances from points (n, 3) to the nearest triangle, and (n,) its index in the mesh."""
        found = self._each(_nearest_triangles, points)
        return found[:, 0], self._order[found[:, 1].astype(np.int64)]

    def _each(self, kernel: Callable[..., Array], points: Array, *more: float) -> Array:
        """(n, ...) a kernel's values at points (n, 3), on all cores when there are many."""
        points = np.ascontiguousarray(points, float)

        def of(some: Array) -> Array:
            return kernel(some, self._corners, self._nodes, self._first, self._count, self._right, *more)

        if len(points) < THREADED_POINTS:
            return of(points)
        with ThreadPoolExecutor() as pool:
            return np.concatenate(list(pool.map(of, np.array_split(points, os.cpu_count() or 1))))


@njit(cache=True, nogil=True)
def _build_tree(middles: Array, leaf: int) -> tuple[Ints, Ints, Ints, Ints]:
    """Order of the triangles; per node its first triangle, their count, and its right child (0 in a leaf).

    Nodes are in preorder, so a left child follows its parent. A node is split at the median of its longest side.
    """
    order = np.arange(len(middles))
    most = 2 * max(len(middles), 1)
    first, count, right = np.zeros(most, np.int64), np.zeros(most, np.int64), np.zeros(most, np.int64)
    waiting = np.zeros((128, 3), np.int64)
    waiting[0] = 0, len(middles), -1
    top, here = 1, 0
    while top > 0:
        top -= 1
        start, stop, parent = waiting[top]
        if parent >= 0:
            right[parent] = here
        first[here], count[here] = start, stop - start
        if stop - start > leaf:
            own = order[start:stop].copy()
            side, longest = 0, -1.0
            for k in range(3):
                along = middles[own, k]
                if along.max() - along.min() > longest:
                    side, longest = k, along.max() - along.min()
            half = (stop - start) // 2
            order[start:stop] = own[np.argpartition(middles[own, side], half)]
            waiting[top] = start + half, stop, here
            waiting[top + 1] = start, start + half, -1
            top += 2
        here += 1
    return order, first[:here].copy(), count[:here].copy(), right[:here].copy()


@njit(cache=True, nogil=True)
def _node_dipoles(corners: Array, normals: Array, first: Ints, count: Ints) -> Array:
    """(N, 7) per node: area centroid, radius, and sum of the triangles' area vectors."""
    nodes = np.zeros((len(first), 7))
    for k in range(len(first)):
        total, square = 0.0, 0.0
        for f in range(first[k], first[k] + count[k]):
            area = max(np.sqrt((normals[f] ** 2).sum()), 1e-300)
            total += area
            for i in range(3):
                nodes[k, i] += area * (corners[f, 0, i] + corners[f, 1, i] + corners[f, 2, i]) / 3
                nodes[k, 4 + i] += normals[f, i]
        nodes[k, :3] /= total
        for f in range(first[k], first[k] + count[k]):
            for j in range(3):
                away = 0.0
                for i in range(3):
                    away += (corners[f, j, i] - nodes[k, i]) ** 2
                square = max(square, away)
        nodes[k, 3] = np.sqrt(square)
    return nodes


@njit(cache=True, nogil=True)
def _winding_numbers(
    points: Array, corners: Array, nodes: Array, first: Ints, count: Ints, right: Ints, far: float
) -> Array:
    found = np.zeros(len(points))
    stack = np.empty(128, np.int64)
    for i in range(len(points)):
        x, y, z = points[i, 0], points[i, 1], points[i, 2]
        total, top = 0.0, 1
        stack[0] = 0
        while top > 0:
            top -= 1
            k = stack[top]
            dx, dy, dz = nodes[k, 0] - x, nodes[k, 1] - y, nodes[k, 2] - z
            square = dx * dx + dy * dy + dz * dz
            if square > (far * nodes[k, 3]) ** 2:
                total += (nodes[k, 4] * dx + nodes[k, 5] * dy + nodes[k, 6] * dz) / (square * np.sqrt(square))
            elif right[k] > 0:
                stack[top], stack[top + 1] = k + 1, right[k]
                top += 2
            else:
                for f in range(first[k], first[k] + count[k]):
                    total += _solid_angle(corners, f, x, y, z)
        found[i] = total / (4 * np.pi)
    return found


@njit(cache=True, nogil=True)
def _nearest_triangles(points: Array, corners: Array, nodes: Array, first: Ints, count: Ints, right: Ints) -> Array:
    """(n, 2) distance and index in `corners` of the nearest triangle.

    The triangle nearest to the point before bounds the search: neighbouring points come one after the other.
    """
    found = np.empty((len(points), 2))
    stack, bounds = np.empty(128, np.int64), np.empty(128)
    which = 0
    for i in range(len(points)):
        x, y, z = points[i, 0], points[i, 1], points[i, 2]
        best, top = _triangle_distance(x, y, z, corners, which) * (1 + _SLACK) + 1e-300, 1
        stack[0], bounds[0] = 0, 0.0
        while top > 0:
            top -= 1
            k = stack[top]
            if bounds[top] >= best:
                continue
            if right[k] > 0:
                near, far = k + 1, right[k]
                ahead, behind = _lower_bound(nodes, near, x, y, z), _lower_bound(nodes, far, x, y, z)
                if behind < ahead:
                    near, far, ahead, behind = far, near, behind, ahead
                stack[top], bounds[top] = far, behind
                stack[top + 1], bounds[top + 1] = near, ahead
                top += 2
            else:
                for f in range(first[k], first[k] + count[k]):
                    away = _triangle_distance(x, y, z, corners, f)
                    if away < best:
                        best, which = away, f
        found[i, 0], found[i, 1] = best, which
    return found


@njit(cache=True, nogil=True)
def _lower_bound(nodes: Array, k: int, x: float, y: float, z: float) -> float:
    """Lower bound of the distance from a point to the triangles of node `k`."""
    x, y, z = nodes[k, 0] - x, nodes[k, 1] - y, nodes[k, 2] - z
    return np.sqrt(x * x + y * y + z * z) - nodes[k, 3]


@njit(cache=True, nogil=True)
def _dot(ax: float, ay: float, az: float, bx: float, by: float, bz: float) -> float:
    return ax * bx + ay * by + az * bz


@njit(cache=True, nogil=True)
def _triangle_distance(px: float, py: float, pz: float, corners: Array, f: int) -> float:
    """Distance from a point to triangle `f` (Ericson 2005, 5.1.5)."""
    ox, oy, oz = corners[f, 0, 0], corners[f, 0, 1], corners[f, 0, 2]
    ux, uy, uz = corners[f, 1, 0] - ox, corners[f, 1, 1] - oy, corners[f, 1, 2] - oz
    vx, vy, vz = corners[f, 2, 0] - ox, corners[f, 2, 1] - oy, corners[f, 2, 2] - oz
    x, y, z = px - ox, py - oy, pz - oz
    uu, uv, vv = _dot(ux, uy, uz, ux, uy, uz), _dot(ux, uy, uz, vx, vy, vz), _dot(vx, vy, vz, vx, vy, vz)
    d1, d2 = _dot(ux, uy, uz, x, y, z), _dot(vx, vy, vz, x, y, z)
    s, t = _closest_barycentric(d1, d2, d1 - uu, d2 - uv, d1 - uv, d2 - vv)
    x, y, z = x - s * ux - t * vx, y - s * uy - t * vy, z - s * uz - t * vz
    return np.sqrt(x * x + y * y + z * z)


@njit(cache=True, nogil=True)
def _closest_barycentric(d1: float, d2: float, d3: float, d4: float, d5: float, d6: float) -> tuple[float, float]:
    """Barycentric coordinates (second, third corner) of the point of a triangle nearest to a point, from the products
    of both edges at the first corner with the way from each corner to the point (Ericson 2005, 5.1.5)."""
    if d1 <= 0 and d2 <= 0:
        return 0.0, 0.0
    if d3 >= 0 and d4 <= d3:
        return 1.0, 0.0
    vc = d1 * d4 - d3 * d2
    if vc <= 0 and d1 >= 0 and d3 <= 0:
        return d1 / (d1 - d3), 0.0
    if d6 >= 0 and d5 <= d6:
        return 0.0, 1.0
    vb = d5 * d2 - d1 * d6
    if vb <= 0 and d2 >= 0 and d6 <= 0:
        return 0.0, d2 / (d2 - d6)
    va = d3 * d6 - d5 * d4
    if va <= 0 and d4 - d3 >= 0 and d5 - d6 >= 0:
        w = (d4 - d3) / ((d4 - d3) + (d5 - d6))
        return 1 - w, w
    total = va + vb + vc
    return vb / total, vc / total


@njit(cache=True, nogil=True)
def _solid_angle(corners: Array, f: int, x: float, y: float, z: float) -> float:
    """Solid angle of triangle `f` from a point (van Oosterom and Strackee 1983)."""
    ax, ay, az = corners[f, 0, 0] - x, corners[f, 0, 1] - y, corners[f, 0, 2] - z
    bx, by, bz = corners[f, 1, 0] - x, corners[f, 1, 1] - y, corners[f, 1, 2] - z
    cx, cy, cz = corners[f, 2, 0] - x, corners[f, 2, 1] - y, corners[f, 2, 2] - z
    a, b, c = (
        np.sqrt(ax * ax + ay * ay + az * az),
        np.sqrt(bx * bx + by * by + bz * bz),
        np.sqrt(cx * cx + cy * cy + cz * cz),
    )
    volume = ax * (by * cz - bz * cy) + ay * (bz * cx - bx * cz) + az * (bx * cy - by * cx)
    ab, bc, ca = ax * bx + ay * by + az * bz, bx * cx + by * cy + bz * cz, cx * ax + cy * ay + cz * az
    return 2 * np.arctan2(volume, a * b * c + ab * c + bc * a + ca * b)
