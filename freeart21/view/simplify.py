"""Simplified meshes for display, and axis arrows."""

from __future__ import annotations

from typing import Any

import numpy as np

from freeart21 import se3
from freeart21.mesh import Mesh, join_meshes


def simplified(mesh: Mesh, max_faces: int) -> Mesh:
    """`mesh` with at most `max_faces` triangles, for display only.

    By quadric errors (Garland and Heckbert 1997); where many small pieces keep it above, the largest triangles stay. A
    vertex gets the colour of the nearest one.
    """
    if len(mesh.faces) <= max_faces:
        return mesh
    from fast_simplification import simplify
    from scipy.spatial import cKDTree

    used, faces = np.unique(mesh.faces, return_inverse=True)
    faces = faces.reshape(-1, 3)
    points = mesh.vertices[used].astype(np.float32)
    vertices, faces = simplify(points, faces.astype(np.int32), target_count=max_faces, agg=7.0)
    if len(faces) > max_faces:
        a, b, c = (vertices[faces[:, k]] for k in range(3))
        area = np.linalg.norm(np.cross(b - a, c - a), axis=1)
        faces = faces[np.sort(np.argsort(-area, kind="stable")[:max_faces])]
    colours = None if mesh.colours is None else mesh.colours[used[cKDTree(points).query(vertices)[1]]]
    return Mesh(vertices.astype(float), faces.astype(np.int64), colours)


def arrow(length: float, radius: float) -> Mesh:
    """An arrow along z, centred at the origin, metres."""
    from trimesh.creation import revolve

    r = radius / length
    profile = [(0, -0.5), (r, -0.5), (r, 0.5 - 5 * r), (2.4 * r, 0.5 - 5 * r), (0, 0.5)]
    return of_trimesh(revolve(profile), length)


def turning_arrow(ring: float, radius: float, height: float) -> Mesh:
    """An arrow round z by the right-hand rule, three quarters of a turn of radius `ring` at `height`, metres."""
    from trimesh.creation import cone, revolve

    around = np.linspace(0, 2 * np.pi, 13)
    circle = np.stack([ring + radius * np.cos(around), height + radius * np.sin(around)], -1)
    tail = of_trimesh(revolve(circle / ring, angle=1.5 * np.pi, sections=48), ring)
    along_x = se3.pose(np.array([[0.0, 0, 1], [0, 1, 0], [-1, 0, 0]]), [0, -ring, height])
    return join_meshes([tail, of_trimesh(cone(2.4, 5), radius).moved(along_x)])


def of_trimesh(mesh: Any, scale: float = 1.0) -> Mesh:
    """A trimesh's surface, without colours, times `scale`: trimesh drops faces of its solids that are very small."""
    return Mesh(scale * np.asarray(mesh.vertices, float), np.asarray(mesh.faces, np.int64))
