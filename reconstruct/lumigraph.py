"""How much a frame of the video has to say of a place in a new view: the more, the more alike it was seen.

Lamps stand in the world while the object turns: what a place looks like depends on how it is turned, to the lamps and
to the camera (unstructured lumigraph: Buehler et al. 2001, with the normal as a further coordinate).
"""

from __future__ import annotations

import math

from numba import njit

SAME_NORMAL, SAME_VIEW, SHARPNESS = 0.01, 0.02, 2.0
"""1 - cosine of the angle at which a frame's normal, or its view direction, halves the base of its weight; and the
power of that base."""
FACING = 0.1
"""Cosine of the angle between normal and view up to which a frame does not see a place."""


@njit(nogil=True, cache=True)
def view_similarity_weight(T, point, normal, lit, view, fx, fy, cx, cy):  # pragma: no cover
    """Weight, column, row and depth, metres, of a place in the frame to whose camera T (4, 4) takes its part, and how
    much depth changes there from pixel to pixel; weight 0 where it shows its back or lies behind the camera.

    `point`, `normal` and `view`, the direction to the new camera, are in the part's frame; `lit` is the normal in the
    recording camera's frame of the new view, with which the lamps stand.
    """
    x, y, z = point[0], point[1], point[2]
    px = T[0, 0] * x + T[0, 1] * y + T[0, 2] * z + T[0, 3]
    py = T[1, 0] * x + T[1, 1] * y + T[1, 2] * z + T[1, 3]
    pz = T[2, 0] * x + T[2, 1] * y + T[2, 2] * z + T[2, 3]
    if pz <= 0:
        return 0.0, 0.0, 0.0, 0.0, 0.0
    x, y, z = normal[0], normal[1], normal[2]
    nx = T[0, 0] * x + T[0, 1] * y + T[0, 2] * z
    ny = T[1, 0] * x + T[1, 1] * y + T[1, 2] * z
    nz = T[2, 0] * x + T[2, 1] * y + T[2, 2] * z
    length = math.sqrt(px * px + py * py + pz * pz)
    facing = -(nx * px + ny * py + nz * pz) / length
    if facing < FACING:
        return 0.0, 0.0, 0.0, 0.0, 0.0
    shade = 1 - (nx * lit[0] + ny * lit[1] + nz * lit[2])
    away = 1.0
    for d in range(3):
        away += (T[0, d] * px + T[1, d] * py + T[2, d] * pz) / length * view[d]
    weight = facing * facing / (1 + shade / SAME_NORMAL + away / SAME_VIEW) ** SHARPNESS
    slope = (pz / fx) * math.sqrt(max(0.0, 1 - facing * facing)) / facing
    return weight, fx * px / pz + cx, fy * py / pz + cy, pz, slope
