"""Replaces convex hulls by boxes, cylinders and spheres that fit as well."""

from __future__ import annotations

import numpy as np
import trimesh

from export.decomposition import robust_hull
from export.outer_surface import OuterSurface, sample_evenly
from export.primitives import Box, Cylinder, Primitive, Sphere
from freeart21 import se3
from freeart21.mesh import triangle_normals
from freeart21.se3 import Array

_SAMPLES, _QUICK_SAMPLES = 1500, 40
"""Points on a shape that are tested, and of these, first."""
_SAME_DIRECTION = 0.999
"""Cosine between normals of one direction, 2.6 degrees: omitted corners tilt faces. Not measured."""
_MIN_SINE = 0.9
"""Sine of the angle to the first axis, 64 degrees, from which a face counts for the second. Not measured."""


def fit_primitive(corners: Array, part: OuterSurface, max_excess_m: float) -> Primitive | None:
    """The smallest primitive around a convex hull of corners (k, 3) that extends beyond the part by at most
    `max_excess_m`, or None.

    It may extend beyond the hull within the part.
    """
    fitted: list[tuple[float, Primitive]] = []
    for shape in enclosing_primitives(corners):
        mesh = shape.mesh()
        solid = trimesh.Trimesh(mesh.vertices, mesh.faces, process=False)
        points = sample_evenly(solid, solid.area / _SAMPLES)[0]
        few = points[:: max(len(points) // _QUICK_SAMPLES, 1)]  # they reject most
        if part.excess(few).max() <= max_excess_m and part.excess(points).max() <= max_excess_m:
            fitted.append((float(np.linalg.det(solid.triangles).sum()), shape))  # six times its volume
    return min(fitted, key=lambda each: each[0])[1] if fitted else None


def enclosing_primitives(points: Array) -> list[Primitive]:
    """Box, cylinders and sphere around points (k, 3), centred, along the `dominant_axes` of their hull."""
    R_axes = dominant_axes(points)
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


def dominant_axes(points: Array) -> Array:
    """(3, 3) columns: the direction most of the hull's area faces, that most of the area across it faces, and their
    cross product.

    The caps of a cylinder and the sides of a box face these directions even when corners are cut off.
    """
    hull = robust_hull(points)
    normals = hull.equations[:, :3]
    areas = np.linalg.norm(triangle_normals(points, hull.simplices), axis=1)
    first = _dominant_direction(normals, areas)
    aside = normals - (normals @ first)[:, None] * first
    length = np.linalg.norm(aside, axis=1)
    flank = length > _MIN_SINE
    if not flank.any():  # a plate with sharp rims
        flank = length >= length.max()
    second = _dominant_direction(aside[flank] / length[flank, None], areas[flank])
    second -= first * (first @ second)
    second /= np.linalg.norm(second)
    return np.stack([first, second, np.cross(first, second)], -1)


def _dominant_direction(normals: Array, areas: Array) -> Array:
    """(3,) mean of the normals (n, 3) around the one near which, on either side, most area faces."""
    cosine = normals @ normals.T
    like = np.abs(cosine) > _SAME_DIRECTION
    best = int(np.argmax(like @ areas))
    turned = np.sign(cosine[best])[:, None] * normals
    mean = (turned * (areas * like[best])[:, None]).sum(0)
    return np.asarray(mean / np.linalg.norm(mean))
