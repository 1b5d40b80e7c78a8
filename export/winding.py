"""Inside and outside of a surface that may be open: the generalised winding number (Jacobson et al. 2013)."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from freeart21.mesh import Mesh
from freeart21.se3 import Array

LEAF = 8
"""Triangles that a leaf of the tree may hold."""
FAR = 2.0
"""Radii of a node from its middle beyond which all its triangles are one dipole (Barill et al. 2018, who take 2)."""


class Winding:
    """How often the triangles of a mesh wind round a point: 1 inside a closed surface, 0 outside, between when open."""

    def __init__(self, mesh: Mesh) -> None:
        """`mesh` in any frame; its triangles face outwards."""
        corners = mesh.vertices[mesh.faces]
        order, self._first, self._count, self._right = _tree(np.ascontiguousarray(corners.mean(1)), LEAF)
        self._corners = np.ascontiguousarray(corners[order])
        a, b, c = np.moveaxis(self._corners, 1, 0)
        self._nodes = _dipoles(self._corners, 0.5 * np.cross(b - a, c - a), self._first, self._count)

    def number(self, points: Array) -> Array:
        """(n,) winding number at points (n, 3)."""
        points = np.ascontiguousarray(points, float)
        number: Array = _number(points, self._corners, self._nodes, self._first, self._count, self._right, FAR)
        return number


def _tree(
    middles: Array, leaf: int
) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.int64], NDArray[np.int64]]:
    """Order of the triangles; of each node its first triangle, their count, and its right child (0 in a leaf).

    Nodes stand in preorder, so that the left child follows its parent; each is cut at the median of its longest side.
    """
    order = np.arange(len(middles))
    first, count, right = [], [], []
    waiting = [(0, len(middles), -1)]
    while waiting:
        start, stop, parent = waiting.pop()
        if parent >= 0:
            right[parent] = len(first)
        first.append(start)
        count.append(stop - start)
        right.append(0)
        if stop - start > leaf:
            own = order[start:stop]
            side = int(np.argmax(np.ptp(middles[own], axis=0)))
            half = (stop - start) // 2
            order[start:stop] = own[np.argpartition(middles[own, side], half)]
            here = len(first) - 1
            waiting += [(start + half, stop, here), (start, start + half, -1)]
    return order, np.array(first), np.array(count), np.array(right)


def _dipoles(corners: Array, normals: Array, first: NDArray[np.int64], count: NDArray[np.int64]) -> Array:
    """(N, 7) of each node: its area's middle, its radius, and the sum of its triangles' area vectors."""
    nodes = np.zeros((len(first), 7))
    areas = np.maximum(np.linalg.norm(normals, axis=1), 1e-300)
    middles = corners.mean(1)
    for k, (start, n) in enumerate(zip(first, count, strict=True)):
        own = slice(start, start + n)
        middle = areas[own] @ middles[own] / areas[own].sum()
        radius = np.sqrt(((corners[own] - middle) ** 2).sum(-1).max())
        nodes[k] = (*middle, radius, *normals[own].sum(0))
    return nodes


@njit(cache=True)  # type: ignore[untyped-decorator]
def _number(points, corners, nodes, first, count, right, far):  # type: ignore[no-untyped-def]
    found = np.zeros(len(points))
    stack = np.empty(128, np.int64)
    for i in range(len(points)):
        x, y, z = points[i]
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
                    total += _solid_angle(corners[f], x, y, z)
        found[i] = total / (4 * np.pi)
    return found


@njit(cache=True)  # type: ignore[untyped-decorator]
def _solid_angle(triangle, x, y, z):  # type: ignore[no-untyped-def]
    """Of a triangle (3, 3) seen from a point (van Oosterom and Strackee 1983)."""
    ax, ay, az = triangle[0, 0] - x, triangle[0, 1] - y, triangle[0, 2] - z
    bx, by, bz = triangle[1, 0] - x, triangle[1, 1] - y, triangle[1, 2] - z
    cx, cy, cz = triangle[2, 0] - x, triangle[2, 1] - y, triangle[2, 2] - z
    a, b, c = (
        np.sqrt(ax * ax + ay * ay + az * az),
        np.sqrt(bx * bx + by * by + bz * bz),
        np.sqrt(cx * cx + cy * cy + cz * cz),
    )
    volume = ax * (by * cz - bz * cy) + ay * (bz * cx - bx * cz) + az * (bx * cy - by * cx)
    ab, bc, ca = ax * bx + ay * by + az * bz, bx * cx + by * cy + bz * cz, cx * ax + cy * ay + cz * az
    return 2 * np.arctan2(volume, a * b * c + ab * c + bc * a + ca * b)
