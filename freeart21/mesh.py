"""A triangle mesh as plain arrays: the surface of one rigid part."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from freeart21 import se3
from freeart21.errors import FreeArtError


@dataclass(frozen=True)
class Mesh:
    """Triangles with optional vertex colours."""

    vertices: NDArray[np.float64]
    """(V, 3) metres."""
    faces: NDArray[np.int64]
    """(F, 3) vertex indices, counter-clockwise seen from outside."""
    colours: NDArray[np.uint8] | None = None
    """(V, 3) RGB, or None."""

    def __post_init__(self) -> None:
        vertices = np.array(self.vertices, np.float64).reshape(-1, 3)
        faces = np.array(self.faces, np.int64).reshape(-1, 3)
        if not np.isfinite(vertices).all():
            raise FreeArtError("mesh has vertices that are not finite")
        if len(faces) and (faces.min() < 0 or faces.max() >= len(vertices)):
            raise FreeArtError(f"mesh faces name vertex {int(faces.max())}, expected 0 to {len(vertices) - 1}")
        colours = self.colours
        if colours is not None:
            colours = np.array(colours, np.uint8).reshape(-1, 3)
            if len(colours) != len(vertices):
                raise FreeArtError(f"mesh has {len(colours)} colours for {len(vertices)} vertices")
        for name, array in (("vertices", vertices), ("faces", faces), ("colours", colours)):
            if array is not None:
                array.flags.writeable = False
            object.__setattr__(self, name, array)

    @property
    def empty(self) -> bool:
        """Whether the mesh has no triangle."""
        return len(self.faces) == 0

    def moved(self, T_new_old: ArrayLike) -> Mesh:
        """The mesh with its vertices mapped by `T_new_old` (4, 4)."""
        return replace(self, vertices=se3.transform(T_new_old, self.vertices))

    def with_faces(self, is_member: NDArray[np.bool_]) -> Mesh:
        """The mesh of the faces where `is_member` (F,) is true, without unused vertices."""
        faces = self.faces[is_member]
        used, new = np.unique(faces, return_inverse=True)
        return Mesh(self.vertices[used], new.reshape(-1, 3), None if self.colours is None else self.colours[used])

    def areas(self) -> NDArray[np.float64]:
        """(F,) triangle areas, m^2."""
        return np.asarray(0.5 * np.linalg.norm(triangle_normals(self.vertices, self.faces), axis=1))


def triangle_normals(vertices: NDArray[np.float64], faces: NDArray[np.integer]) -> NDArray[np.float64]:
    """(..., 3) normals of triangles `faces` (..., 3) of vertices (V, 3), as long as twice the triangles' areas."""
    a, b, c = (vertices[faces[..., k]] for k in range(3))
    return np.asarray(np.cross(b - a, c - a))


def bounding_diagonal(*meshes: Mesh) -> float:
    """Diagonal, metres, of the axis-aligned box around all meshes; 0 when all are empty."""
    points = [used_vertices(mesh).T for mesh in meshes if not mesh.empty]
    if not points:
        return 0.0
    low, high = np.min([p.min(1) for p in points], axis=0), np.max([p.max(1) for p in points], axis=0)
    return float(np.linalg.norm(high - low))


def used_vertices(mesh: Mesh) -> NDArray[np.float64]:
    """(n, 3) vertices of a mesh that a face has, in their order."""
    used = np.zeros(len(mesh.vertices), bool)
    used[mesh.faces] = True
    return mesh.vertices[used]


def join_meshes(meshes: Sequence[Mesh]) -> Mesh:
    """All meshes as one, with colours when every mesh has them."""
    if len(meshes) == 1:
        return meshes[0]
    starts = np.cumsum([0, *(len(mesh.vertices) for mesh in meshes)])
    vertices = np.concatenate([np.zeros((0, 3)), *(mesh.vertices for mesh in meshes)])
    faces = np.concatenate([np.zeros((0, 3), np.int64), *(m.faces + at for m, at in zip(meshes, starts, strict=False))])
    colours = [mesh.colours for mesh in meshes if mesh.colours is not None]
    return Mesh(vertices, faces, np.concatenate(colours) if colours and len(colours) == len(meshes) else None)


def box_centre(mesh: Mesh) -> NDArray[np.float64]:
    """(3,) centre of the axis-aligned box around a mesh, metres; the origin when it is empty."""
    if mesh.empty:
        return np.zeros(3)
    used = used_vertices(mesh)
    return np.asarray((used.min(0) + used.max(0)) / 2)
