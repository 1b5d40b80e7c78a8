"""Simplified meshes for display, and the solids of axis arrows and URDF primitives."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from freeart21.mesh import Mesh


def simplified(mesh: Mesh, max_faces: int) -> Mesh:
    """`mesh` with at most `max_faces` triangles, for display only.

    Vertex clustering on a uniform grid with one optimal vertex per cell (Lindstrom, "Out-of-core simplification of
    large polygonal models", 2000): flat faces stay flat and edges sharp. Degenerate and repeated triangles are dropped.
    A vertex gets the colour of the nearest one that it replaces. Cells are enlarged until the result is small enough.
    """
    if len(mesh.faces) <= max_faces:
        return mesh
    used = np.zeros(len(mesh.vertices), bool)
    used[mesh.faces] = True
    low, size = mesh.vertices[used].min(0), np.ptp(mesh.vertices[used], axis=0).max()
    if size == 0:
        return Mesh(np.zeros((0, 3)), np.zeros((0, 3), int))
    places = np.where(used[:, None], mesh.vertices - low, 0.0)  # unused vertices can be anywhere
    key = np.array([1, 1 << 21, 1 << 42])
    cell = size * np.sqrt(1.0 / max_faces)
    while True:
        cells = np.floor(places / cell).astype(np.int64)
        cluster = np.unique(cells @ key, return_inverse=True)[1].reshape(-1)
        faces = cluster[mesh.faces]
        faces = faces[(faces != np.roll(faces, 1, axis=1)).all(1)]
        faces = faces[np.sort(np.unique(np.sort(faces, axis=1) @ key, return_index=True)[1])]
        if len(faces) <= max_faces:
            return _clustered(mesh, cluster, faces, cell)
        cell *= max(1.03, np.sqrt(len(faces) / max_faces))


def _clustered(mesh: Mesh, cluster: NDArray[np.int64], faces: NDArray[np.int64], cell: float) -> Mesh:
    """The mesh of `faces` over clusters, each vertex nearest to the planes of the triangles in its cell."""
    n = int(cluster.max()) + 1
    corners = mesh.faces.reshape(-1)
    counts = np.maximum(np.bincount(cluster[corners], minlength=n), 1)

    def total(values: NDArray[np.float64]) -> NDArray[np.float64]:
        return np.stack([np.bincount(cluster[corners], column, n) for column in values.reshape(len(corners), -1).T], -1)

    mean = total(mesh.vertices[corners]) / counts[:, None]
    a, b, c = (mesh.vertices[mesh.faces[:, k]] for k in range(3))
    normal = np.repeat(np.cross(b - a, c - a) / cell**2, 3, axis=0)
    offset = np.einsum("ij,ij->i", normal, mesh.vertices[corners] - mean[cluster[corners]])
    A = total(normal[:, :, None] * normal[:, None, :]).reshape(-1, 3, 3)
    weight = (
        1e-3 * np.trace(A, axis1=1, axis2=2) + 1e-12
    )  # the mean decides along directions that the planes leave free
    step = np.linalg.solve(A + weight[:, None, None] * np.eye(3), total(normal * offset[:, None])[..., None])[..., 0]
    vertices = mean + np.clip(step, -cell, cell)
    colours = None
    if mesh.colours is not None:
        distance = np.linalg.norm(mesh.vertices[corners] - vertices[cluster[corners]], axis=1)
        order = np.lexsort((distance, cluster[corners]))
        groups, first = np.unique(cluster[corners][order], return_index=True)
        colours = np.zeros((n, 3), np.uint8)
        colours[groups] = mesh.colours[corners[order[first]]]
    used = np.unique(faces)
    index = np.zeros(n, np.int64)
    index[used] = np.arange(len(used))
    return Mesh(vertices[used], index[faces], None if colours is None else colours[used])


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
