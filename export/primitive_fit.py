"""Boxes, cylinders and balls in the place of convex pieces that are as good as such."""

from __future__ import annotations

import numpy as np
import trimesh
from scipy.spatial import ConvexHull

from export.outside import Outside, even_points
from export.primitives import Box, Cylinder, Primitive, Sphere
from freeart21 import se3
from freeart21.se3 import Array

_LOOKS = 1500
"""Points on a shape that are looked at."""


def primitive_of(corners: Array, outside: Outside, worst_m: float) -> Primitive | None:
    """The shape round a convex piece of corners (k, 3), if it stands out of the part by no more than `worst_m`, and of
    the piece by no more than half of that; of several that of least volume, None of none."""
    hull = ConvexHull(corners)
    found: list[tuple[float, Primitive]] = []
    for shape in shapes_round(corners):
        mesh = shape.mesh()
        solid = trimesh.Trimesh(mesh.vertices, mesh.faces, process=False)
        points = even_points(solid, solid.area / _LOOKS)[0]
        beyond = float((points @ hull.equations[:, :3].T + hull.equations[:, 3]).max())
        if beyond <= worst_m / 2 and outside.excess(points).max() <= worst_m:
            found.append((float(solid.volume), shape))
    return min(found, key=lambda each: each[0])[1] if found else None


def shapes_round(points: Array) -> list[Primitive]:
    """Box, cylinders and ball round points (k, 3), all about the middle and along the axes of their least box."""
    T_box_points, size = trimesh.bounds.oriented_bounds(points)
    T = se3.inverse(T_box_points)
    local = se3.transform(T_box_points, points)
    shapes: list[Primitive] = [Box(np.asarray(size), T), Sphere(float(np.linalg.norm(local, axis=1).max()), T)]
    for axis in range(3):
        across = np.delete(local, axis, axis=1)
        R = np.eye(3)[:, [(axis + 1) % 3, (axis + 2) % 3, axis]]  # its z is that axis
        radius = float(np.linalg.norm(across, axis=1).max())
        shapes.append(Cylinder(radius, float(size[axis]), T @ se3.pose(R, np.zeros(3))))
    return shapes
