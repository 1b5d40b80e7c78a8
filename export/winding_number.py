"""Generalised winding number (Jacobson et al. 2013) of a surface that may be open, and distance to it, by libigl."""

from __future__ import annotations

import os
from concurrent.futures import ThreadPoolExecutor

import igl
import numpy as np
from numpy.typing import NDArray

from freeart21.mesh import Mesh
from freeart21.se3 import Array


class Winding:
    """Winding number of a mesh at points: 1 inside a closed surface, 0 outside, in between when the surface is open.

    Far triangles are approximated by their Taylor expansion (Barill et al. 2018).
    """

    def __init__(self, mesh: Mesh) -> None:
        """`mesh` in any frame; its triangles face outwards."""
        self._mesh = np.ascontiguousarray(mesh.vertices, float), np.ascontiguousarray(mesh.faces, np.int64)
        self._numbers, self._tree = igl.FastWindingNumberBVH(), igl.AABB()
        if len(mesh.faces):  # of none, libigl dies
            self._numbers.init(*self._mesh)
            self._tree.init(*self._mesh)

    def number(self, points: Array) -> Array:
        """(n,) winding numbers at points (n, 3)."""
        if len(self._mesh[1]) == 0:
            return np.zeros(len(points))
        return self._numbers.winding_number(np.ascontiguousarray(points, float))

    def distance(self, points: Array) -> Array:
        """(n,) distances from points (n, 3) to the nearest triangle."""
        return self.nearest(points)[0]

    def nearest(self, points: Array) -> tuple[Array, NDArray[np.int64]]:
        """(n,) distances from points (n, 3) to the nearest triangle, and (n,) its index in the mesh."""
        points = np.ascontiguousarray(points, float)
        if len(points) == 0 or len(self._mesh[1]) == 0:
            return np.full(len(points), np.inf), np.full(len(points), -1)
        with ThreadPoolExecutor() as pool:
            chunks = np.array_split(points, min(len(points), os.cpu_count() or 1))
            found = list(pool.map(lambda some: self._tree.squared_distance(*self._mesh, some)[:2], chunks))
        squares, nearest = (np.concatenate(values) for values in zip(*found, strict=True))
        return np.sqrt(squares), nearest
