"""Z-buffer on the CPU: the triangles that the rays through the pixels' centres hit first."""

from __future__ import annotations

import math
from functools import cache
from typing import Any

from freeart21.se3 import Array, Ints

BEHIND = 1e-6
"""Depth, m, up to which a corner counts as behind the camera. Not measured."""


def draw_triangles(at: Any, depth: Any, faces: Any, nearest: Any, face: Any, weights: Any) -> None:
    """Draw triangles `faces` (F, 3), from both sides; corners at pixels `at` (V, 2), z-depths `depth` (V,) in metres.

    Where a triangle is nearer than `nearest` (h, w), writes its depth there, its number into `face` (h, w) and its
    barycentric weights into `weights` (h, w, 3). Inverse depth is interpolated linearly. Triangles that reach behind
    the camera are skipped.
    """
    _compiled()(at, depth, faces, nearest, face, weights)


@cache
def _compiled() -> Any:
    from numba import njit

    return njit(nogil=True, cache=True)(_draw_triangles)


def _draw_triangles(
    at: Array, depth: Array, faces: Ints, nearest: Array, face: Ints, weights: Array
) -> None:  # pragma: no cover
    h, w = nearest.shape
    for f in range(faces.shape[0]):
        a, b, c = faces[f, 0], faces[f, 1], faces[f, 2]
        if depth[a] <= BEHIND or depth[b] <= BEHIND or depth[c] <= BEHIND:
            continue
        ax, ay, bx, by, cx, cy = at[a, 0], at[a, 1], at[b, 0], at[b, 1], at[c, 0], at[c, 1]
        area = (bx - ax) * (cy - ay) - (by - ay) * (cx - ax)
        if area == 0:
            continue
        left, right = max(0, math.ceil(min(ax, bx, cx) - 0.5)), min(w - 1, math.floor(max(ax, bx, cx) - 0.5))
        top, bottom = max(0, math.ceil(min(ay, by, cy) - 0.5)), min(h - 1, math.floor(max(ay, by, cy) - 0.5))
        for y in range(top, bottom + 1):
            for x in range(left, right + 1):
                u, v = x + 0.5, y + 0.5
                p = ((bx - u) * (cy - v) - (by - v) * (cx - u)) / area
                q = ((cx - u) * (ay - v) - (cy - v) * (ax - u)) / area
                r = 1 - p - q
                if p < -1e-9 or q < -1e-9 or r < -1e-9:
                    continue
                z = 1 / (p / depth[a] + q / depth[b] + r / depth[c])
                if z < nearest[y, x]:
                    nearest[y, x], face[y, x] = z, f
                    weights[y, x, 0], weights[y, x, 1] = p * z / depth[a], q * z / depth[b]
                    weights[y, x, 2] = r * z / depth[c]
