"""Triangle surfaces: area-uniform samples, and exact point-to-triangle distances by libigl."""

from __future__ import annotations

import os
from concurrent.futures import ThreadPoolExecutor
from functools import cached_property

import igl
import numpy as np
from numpy.typing import ArrayLike, NDArray

from freeart21.mesh import Mesh
from freeart21.se3 import Array

FLATTEST = 1e-12
"""Triangles with an area below this share of their longest edge squared are left out as lines."""
SMALLEST = 1e-60
"""m^2: smaller triangles are left out as points; their squares would underflow."""
CELLS = 100
"""Cells along a surface's diagonal, in whose order points are looked up."""


class Surface:
    """The triangles of a mesh, metres, in the mesh's own frame. Can be empty."""

    def __init__(self, mesh: Mesh, faces: NDArray[np.bool_] | None = None) -> None:
        """The surface of `mesh`, or of the faces that `faces` (F,) selects, without degenerate triangles."""
        corners = mesh.vertices[mesh.faces if faces is None else mesh.faces[faces]]
        edges = corners - np.roll(corners, 1, axis=1)
        areas = 0.5 * np.linalg.norm(np.cross(edges[:, 1], edges[:, 2]), axis=1)
        solid = areas > np.maximum(FLATTEST * (edges**2).sum(-1).max(-1, initial=0.0), SMALLEST)
        self.corners: Array = np.ascontiguousarray(corners[solid])
        """(F, 3, 3) corner k of triangle i at [i, k]."""
        self.areas: Array = areas[solid]
        """(F,) m^2."""

    @property
    def empty(self) -> bool:
        """Whether it has no triangle."""
        return len(self.corners) == 0

    @property
    def area(self) -> float:
        """m^2."""
        return float(self.areas.sum())

    @property
    def centre(self) -> Array:
        """(3,) area-weighted centroid."""
        centre: Array = np.average(self.corners.mean(1), axis=0, weights=self.areas)
        return centre

    def sample(self, count: int, seed: tuple[int, ...]) -> Array:
        """(count, 3) independent points, uniform over the area, determined by `seed`; (0, 3) from an empty surface.

        Any first k of them are a uniform sample, too. Barycentric sampling by Osada et al. 2002, eq. 1.
        """
        if self.empty:
            return np.zeros((0, 3))
        u = np.random.default_rng(seed).random((count, 3))
        cumulative = np.cumsum(self.areas)
        chosen = np.searchsorted(cumulative, u[:, 0] * cumulative[-1], side="right")
        a, b, c = np.moveaxis(self.corners[np.minimum(chosen, len(self.corners) - 1)], 1, 0)
        root, share = np.sqrt(u[:, 1:2]), u[:, 2:]
        points: Array = (1 - root) * a + root * (1 - share) * b + root * share * c
        return points

    def distance(self, points: ArrayLike, at_most: ArrayLike | None = None) -> Array:
        """Distance (n,), metres, from `points` (n, 3) to the nearest point of the surface; inf when it is empty.

        `at_most` (n,) caps the distances; points whose cap is below their distance to the surface's box cost nothing.
        """
        points = np.asarray(points, float).reshape(-1, 3)
        distances = np.full(len(points), np.inf) if at_most is None else np.array(at_most, float)
        if self.empty:
            return distances
        tree, (vertices, faces) = self._tree
        low, high = vertices.min(0), vertices.max(0)
        to_box = np.linalg.norm(np.maximum(np.maximum(low - points, points - high), 0), axis=1)
        cells = np.floor(points * (CELLS / np.linalg.norm(high - low)))
        order = np.lexsort(cells.T)  # neighbours in turn find the tree's nodes in the cache: half the time
        order = order[to_box[order] < distances[order]]
        if len(order):
            with ThreadPoolExecutor() as pool:
                chunks = np.array_split(points[order], min(len(order), os.cpu_count() or 1))
                squares = list(pool.map(lambda some: tree.squared_distance(vertices, faces, some)[0], chunks))
            distances[order] = np.minimum(distances[order], np.sqrt(np.concatenate(squares)))
        return distances

    @cached_property
    def _tree(self) -> tuple[igl.AABB, tuple[Array, NDArray[np.int64]]]:
        """The search tree of the triangles, and their vertices and faces."""
        mesh = self.corners.reshape(-1, 3), np.arange(3 * len(self.corners)).reshape(-1, 3)
        tree = igl.AABB()
        tree.init(*mesh)
        return tree, mesh
