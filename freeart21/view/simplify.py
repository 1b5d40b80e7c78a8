"""Simplified meshes for display, and the solids of axis arrows and URDF primitives."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from freeart21.mesh import Mesh


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


def joined(*meshes: Mesh) -> Mesh:
    """All meshes as one, without colours."""
    starts = np.cumsum([0, *(len(mesh.vertices) for mesh in meshes)])
    return Mesh(
        np.concatenate([mesh.vertices for mesh in meshes]),
        np.concatenate([mesh.faces + start for mesh, start in zip(meshes, starts, strict=False)]),
    )


def revolved(profile: ArrayLike, segments: int = 32) -> Mesh:
    """The surface of revolution about z of a `profile` (n, 2) of radius and height, from bottom to top, metres."""
    profile = np.asarray(profile, float)
    angle = np.linspace(0, 2 * np.pi, segments, endpoint=False)
    ring = np.stack([np.cos(angle), np.sin(angle)], -1)
    vertices = np.concatenate([np.column_stack([radius * ring, np.full(segments, z)]) for radius, z in profile])
    return Mesh(vertices, _grid_faces(len(profile), segments))


def cylinder(radius: float, length: float) -> Mesh:
    """A closed cylinder about z, centred at the origin, metres."""
    return revolved([(0, -length / 2), (radius, -length / 2), (radius, length / 2), (0, length / 2)])


def sphere(radius: float) -> Mesh:
    """A sphere at the origin, metres."""
    angle = np.linspace(-np.pi / 2, np.pi / 2, 17)
    return revolved(radius * np.stack([np.cos(angle), np.sin(angle)], -1))


def capsule(radius: float, length: float) -> Mesh:
    """A cylinder of `length` about z, centred at the origin, with half a sphere on either end, metres."""
    angle = np.linspace(-np.pi / 2, np.pi / 2, 18)
    ends = np.where(angle < 0, -length / 2, length / 2)
    return revolved(np.stack([radius * np.cos(angle), radius * np.sin(angle) + ends], -1))


def box(size: ArrayLike) -> Mesh:
    """A box of `size` (3,) metres, centred at the origin."""
    corners = np.array([[x, y, z] for x in (-0.5, 0.5) for y in (-0.5, 0.5) for z in (-0.5, 0.5)]) * np.asarray(size)
    quads = np.array([[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3]])
    return Mesh(corners, np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]]))


def arrow(length: float, radius: float, segments: int = 32) -> Mesh:
    """An arrow along z, centred at the origin, metres."""
    tip, half = 5 * radius, length / 2
    profile = [(0, -half), (radius, -half), (radius, half - tip), (2.4 * radius, half - tip), (0, half)]
    return revolved(profile, segments)


def turning_arrow(ring: float, radius: float, height: float, segments: int = 12) -> Mesh:
    """An arrow round z by the right-hand rule, three quarters of a turn of radius `ring` at `height`, metres.

    Its tube has `segments` corners.
    """
    angle = np.linspace(0, 1.5 * np.pi, 4 * segments + 1)
    shaft = np.full(len(angle), radius)
    head = np.linspace(1.5 * np.pi, 1.5 * np.pi + 5 * radius / ring, 7)
    sizes = np.concatenate([[0.0], shaft, np.linspace(2.4 * radius, 0.0, len(head))])
    angles = np.concatenate([[0.0], angle, head])
    around = np.linspace(0, 2 * np.pi, segments, endpoint=False)
    out = ring + sizes[:, None] * np.cos(around)
    vertices = np.stack(
        [out * np.cos(angles)[:, None], out * np.sin(angles)[:, None], height + sizes[:, None] * np.sin(around)], -1
    ).reshape(-1, 3)
    return Mesh(vertices, _grid_faces(len(angles), len(around))[:, ::-1])


def _grid_faces(rows: int, columns: int) -> NDArray[np.int64]:
    """Triangles of a tube of `rows` rings with `columns` corners each, counter-clockwise seen from outside."""
    row, column = (a.reshape(-1) for a in np.meshgrid(np.arange(rows - 1), np.arange(columns), indexing="ij"))
    after = (column + 1) % columns
    a, b, c, d = (
        row * columns + column,
        row * columns + after,
        (row + 1) * columns + after,
        (row + 1) * columns + column,
    )
    return np.concatenate([np.stack([a, b, c], -1), np.stack([a, c, d], -1)])
