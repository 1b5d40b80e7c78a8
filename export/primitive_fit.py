"""Boxes, cylinders and balls in the place of convex pieces that are as good as such."""

from __future__ import annotations

import numpy as np
import trimesh

from export.decomposition import hull_of
from export.outside import Outside, even_points
from export.primitives import Box, Cylinder, Primitive, Sphere
from freeart21 import se3
from freeart21.se3 import Array

_LOOKS = 1500
"""Points on a shape that are looked at."""
_LIKE = 0.999
"""Cosine between normals that face one way, 2.6 degrees: corners that are left out tilt faces. Not measured."""
_ASIDE = 0.9
"""Sine of the angle to the first axis, 64 degrees, from which on a face counts for the second. Not measured."""


def primitive_of(corners: Array, outside: Outside, worst_m: float) -> Primitive | None:
    """The shape round a convex piece of corners (k, 3), if it stands out of the part by no more than `worst_m`, of
    several that of least volume, None of none: beyond the piece, but within the part, does no harm."""
    found: list[tuple[float, Primitive]] = []
    for shape in shapes_round(corners):
        mesh = shape.mesh()
        solid = trimesh.Trimesh(mesh.vertices, mesh.faces, process=False)
        points = even_points(solid, solid.area / _LOOKS)[0]
        if outside.excess(points).max() <= worst_m:
            found.append((float(np.linalg.det(solid.triangles).sum()), shape))  # six times its volume
    return min(found, key=lambda each: each[0])[1] if found else None


def shapes_round(points: Array) -> list[Primitive]:
    """Box, cylinders and ball round points (k, 3), all about the middle and along `axes_of` their hull."""
    R_axes = axes_of(points)
    local = points @ R_axes
    low, high = local.min(0), local.max(0)
    T = se3.pose(R_axes, R_axes @ (0.5 * (low + high)))
    local = local - 0.5 * (low + high)
    shapes: list[Primitive] = [Box(high - low, T), Sphere(float(np.linalg.norm(local, axis=1).max()), T)]
    for axis in range(3):
        across = np.delete(local, axis, axis=1)
        R = np.eye(3)[:, [(axis + 1) % 3, (axis + 2) % 3, axis]]  # its z is that axis
        radius = float(np.linalg.norm(across, axis=1).max())
        shapes.append(Cylinder(radius, float((high - low)[axis]), T @ se3.pose(R, np.zeros(3))))
    return shapes


def axes_of(points: Array) -> Array:
    """(3, 3) whose columns are the way most of the hull's area faces, that most of what faces aside does, and a third.

    The caps of a cylinder and the sides of a box face so, whatever corners are cut off.
    """
    hull = hull_of(points)
    normals = hull.equations[:, :3]
    corners = points[hull.simplices]
    areas = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    first = _most(normals, areas)
    aside = normals - (normals @ first)[:, None] * first
    length = np.linalg.norm(aside, axis=1)
    flank = length > _ASIDE
    if not flank.any():  # a plate of sharp rims
        flank = length >= length.max()
    second = _most(aside[flank] / length[flank, None], areas[flank])
    second -= first * (first @ second)
    second /= np.linalg.norm(second)
    return np.stack([first, second, np.cross(first, second)], -1)


def _most(normals: Array, areas: Array) -> Array:
    """(3,) the mean of the normals (n, 3) about the one round which, on either side, most area faces."""
    cosine = normals @ normals.T
    like = np.abs(cosine) > _LIKE
    best = int(np.argmax(like @ areas))
    turned = np.sign(cosine[best])[:, None] * normals
    mean = (turned * (areas * like[best])[:, None]).sum(0)
    return np.asarray(mean / np.linalg.norm(mean))
