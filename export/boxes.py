"""Boxes that fill a part between the planes of its surface: a drawer is five boards, a carcass six.

The planes of the part that face along its three main axes cut its box into a grid. Of all boxes with corners on that
grid that stay within the part, the one that fills most of what is still empty is taken, again and again.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import distance_transform_edt

from export.free_space import SpaceGrid
from export.hollows import fill_inside
from export.outer_surface import OuterSurface
from export.planes import PLANE_TOLERANCE, fit_planes, plane_axes
from export.primitives import Box
from freeart21 import se3
from freeart21.mesh import Mesh
from freeart21.se3 import Array

MAX_VOXELS = 2_000_000
"""Voxels of the grid in which boxes are compared with the part: 1.7 mm in a drawer unit of 26 cm."""
MAX_STEPS = 14
"""Most positions of faces along an axis: those with most points."""
_ALONG = 0.95
"""Cosine, 18 degrees, from which a point of a rough surface faces along an axis."""
_MIN_SHARE = 0.003
"""Share of a part's points at a place along an axis from which faces of boxes may lie there: that of a drawer's rim."""
_MAX_OUTSIDE = 0.03
"""Share of a box that may stand out of the part by more than the tolerance: surfaces are rough."""
_MIN_INSIDE = 0.8
"""Share of a box that must lie in the part."""
_MIN_GAIN = 0.005
"""Share of the part that a box must add."""


def fit_boxes(mesh: Mesh, surface: OuterSurface, tolerance: float, most: int) -> list[Box]:
    """At most `most` boxes, the largest first, that fill a closed part to within `tolerance`, m, where planes bound it.

    They may overlap. A part without planes along its axes gets none.

    Args:
        mesh: closed, in the link's frame.
        surface: of the mesh.
        tolerance: m.
        most: boxes.
    """
    planes = fit_planes(surface.points, surface.normals, PLANE_TOLERANCE * surface.size)
    if len(planes) < 3:
        return []
    axes = plane_axes(planes, surface.points)
    along, facing = surface.points @ axes, surface.normals @ axes
    steps = [_find_steps(along[np.abs(facing[:, k]) > _ALONG, k], len(along), tolerance) for k in range(3)]
    if min(map(len, steps)) < 2:
        return []
    low, high = along.min(0), along.max(0)
    voxel = float(np.prod(high - low) / MAX_VOXELS) ** (1 / 3)
    shape = tuple(int(n) for n in np.ceil((high - low) / voxel) + 3)
    grid = SpaceGrid(se3.pose(axes, axes @ (low - voxel)), voxel, np.zeros(shape, np.uint8))
    inside = fill_inside(mesh, grid)
    outside = voxel * distance_transform_edt(~inside) > tolerance + 0.5 * voxel
    return _choose_boxes(inside, outside, steps, low - voxel, voxel, axes, most)


def _find_steps(at: Array, count: int, tolerance: float) -> Array:
    """(m,) m, increasing: places along an axis where many of the points at (n,) m lie within `tolerance`, m; `count` is
    the number of all points of the part."""
    rest = np.sort(at)
    found: list[float] = []
    while len(found) < MAX_STEPS and len(rest):
        within = np.searchsorted(rest, rest + 2 * tolerance, "right") - np.arange(len(rest))
        first = int(np.argmax(within))
        if within[first] < _MIN_SHARE * count:
            break
        own = rest[first : first + within[first]]
        found.append(float(np.median(own)))
        rest = rest[(rest < own[0] - tolerance) | (rest > own[-1] + tolerance)]
    return np.sort(found)


def _choose_boxes(
    inside: NDArray[np.bool_],
    outside: NDArray[np.bool_],
    steps: list[Array],
    origin: Array,
    voxel: float,
    axes: Array,
    most: int,
) -> list[Box]:
    """Boxes from step to step, m along the axes, the best first.

    Args:
        inside: (X, Y, Z) voxels in the part.
        outside: (X, Y, Z) voxels that no box may fill.
        steps: three times (m,) m.
        origin: (3,) m along the axes, of the centre of voxel (0, 0, 0).
        voxel: m.
        axes: (3, 3) columns.
        most: boxes.
    """
    ends = [
        np.clip(np.ceil((s - o) / voxel).astype(np.int64), 0, n)
        for s, o, n in zip(steps, origin, inside.shape, strict=True)
    ]
    pairs = [np.array([(a, b) for b in range(len(e)) for a in range(b) if e[b] > e[a]]) for e in ends]
    if not all(map(len, pairs)):
        return []
    sizes = [e[p[:, 1]] - e[p[:, 0]] for e, p in zip(ends, pairs, strict=True)]
    volume = sizes[0][:, None, None] * sizes[1][:, None] * sizes[2]
    fits = (_count(outside, ends, pairs) <= _MAX_OUTSIDE * volume) & (
        _count(inside, ends, pairs) >= _MIN_INSIDE * volume
    )
    rest = inside.copy()
    boxes: list[Box] = []
    while len(boxes) < most:
        gain = np.where(fits, _count(rest, ends, pairs), 0)
        best = np.unravel_index(int(np.argmax(gain)), gain.shape)
        if gain[best] < max(_MIN_GAIN * inside.sum(), 1):
            break
        span = np.array([pairs[k][best[k]] for k in range(3)])
        low, high = (np.array([steps[k][span[k, end]] for k in range(3)]) for end in (0, 1))
        boxes.append(Box(high - low, se3.pose(axes, axes @ (0.5 * (low + high)))))
        rest[tuple(slice(ends[k][span[k, 0]], ends[k][span[k, 1]]) for k in range(3))] = False
    return boxes


def _count(
    marked: NDArray[np.bool_], ends: list[NDArray[np.int64]], pairs: list[NDArray[np.int64]]
) -> NDArray[np.int64]:
    """(a, b, c) marked voxels in each box from one of `ends` to another, by the `pairs` (a, 2), (b, 2), (c, 2) of their
    indices."""
    total = marked.astype(np.int64)
    for k in range(3):
        total = np.cumsum(total, axis=k)
        total = np.concatenate([np.zeros_like(total.take([0], axis=k)), total], axis=k).take(ends[k], axis=k)
        total = total.take(pairs[k][:, 1], axis=k) - total.take(pairs[k][:, 0], axis=k)
    return total
