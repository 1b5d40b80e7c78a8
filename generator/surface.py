"""A textured triangle surface that can be subdivided until its vertices carry the colours."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from freeart21 import se3
from freeart21.camera_faults import srgb_encode
from freeart21.errors import FreeArtError
from freeart21.mesh import Mesh, triangle_normals
from freeart21.se3 import Array

_CREASE = np.cos(np.radians(40.0))


@dataclass(frozen=True)
class Paint:
    """A plain colour, or a picture that repeats."""

    colour: NDArray[np.uint8]
    """(3,) RGB."""
    picture: NDArray[np.uint8] | None = None
    """(h, w, 3) RGB, multiplied by the colour; v = 0 is its lowest row."""

    def at(self, uv: Array) -> NDArray[np.uint8]:
        """Colours (n, 3) at texture coordinates (n, 2): the nearest texel."""
        if self.picture is None:
            return np.broadcast_to(self.colour, (len(uv), 3))
        h, w = self.picture.shape[:2]
        column = np.floor((uv[:, 0] % 1.0) * w).astype(int).clip(0, w - 1)
        row = np.floor((1.0 - uv[:, 1] % 1.0) * h).astype(int).clip(0, h - 1)
        return np.asarray(np.rint(self.picture[row, column] * (self.colour / 255.0)).astype(np.uint8))


@dataclass(frozen=True)
class Surface:
    """Triangles with texture coordinates and a paint at each vertex."""

    vertices: Array
    """(V, 3) metres."""
    faces: NDArray[np.int64]
    """(F, 3)."""
    uv: Array
    """(V, 2)."""
    paint: NDArray[np.int64]
    """(V,) index into `paints`."""
    paints: tuple[Paint, ...]

    @classmethod
    def joined(cls, surfaces: Sequence[Surface]) -> Surface:
        """Concatenate surfaces."""
        if not surfaces:
            return cls(np.zeros((0, 3)), np.zeros((0, 3), np.int64), np.zeros((0, 2)), np.zeros(0, np.int64), ())
        first_vertex = np.cumsum([0, *(len(s.vertices) for s in surfaces)])
        first_paint = np.cumsum([0, *(len(s.paints) for s in surfaces)])
        return cls(
            np.concatenate([s.vertices for s in surfaces]),
            np.concatenate([s.faces + first_vertex[k] for k, s in enumerate(surfaces)]),
            np.concatenate([s.uv for s in surfaces]),
            np.concatenate([s.paint + first_paint[k] for k, s in enumerate(surfaces)]),
            tuple(paint for s in surfaces for paint in s.paints),
        )

    def moved(self, T_new_old: Array, scale: ArrayLike = 1.0) -> Surface:
        """The surface scaled about its origin, then mapped by `T_new_old` (4, 4)."""
        scale = np.broadcast_to(np.asarray(scale, float), (3,))
        faces = self.faces[:, ::-1] if np.prod(scale) < 0 else self.faces
        return replace(self, vertices=se3.transform(T_new_old, self.vertices * scale), faces=faces)

    def subdivided(self, longest: float) -> Surface:
        """The same surface with edges of at most `longest` metres: longer edges are halved, the longest first.

        An edge is halved on both of its faces or on neither, so that no gap opens. Raises FreeArtError when the result
        would have more than 20 million triangles.
        """
        vertices, uv, paint, todo = self.vertices, self.uv, self.paint, self.faces
        done: list[NDArray[np.int64]] = []
        while len(todo):
            corners = vertices[todo]
            lengths = np.linalg.norm(corners - np.roll(corners, -1, axis=1), axis=2)
            k = lengths.argmax(1)
            fine = lengths[np.arange(len(todo)), k] <= longest
            done.append(todo[fine])
            todo, k = todo[~fine], k[~fine]
            if len(todo) == 0:
                break
            if len(todo) + sum(map(len, done)) > 20_000_000:
                raise FreeArtError(
                    f"cannot divide a surface of {len(self.faces)} triangles to edges of {longest:.3g} m"
                )
            rows = np.arange(len(todo))
            a, b, c = todo[rows, k], todo[rows, (k + 1) % 3], todo[rows, (k + 2) % 3]
            edges, at = np.unique(np.sort(np.stack([a, b], 1), axis=1), axis=0, return_inverse=True)
            m = len(vertices) + at.reshape(-1)
            vertices = np.concatenate([vertices, vertices[edges].mean(1)])
            uv = np.concatenate([uv, uv[edges].mean(1)])
            paint = np.concatenate([paint, paint[edges[:, 0]]])
            todo = np.concatenate([np.stack([a, m, c], 1), np.stack([m, b, c], 1)])
        return replace(self, vertices=vertices, uv=uv, paint=paint, faces=np.concatenate(done) if done else self.faces)

    def mesh(self) -> Mesh:
        """The mesh with colours at its vertices, without triangles of zero area."""
        colours = np.zeros((len(self.vertices), 3), np.uint8)
        for k, paint in enumerate(self.paints):
            here = self.paint == k
            colours[here] = paint.at(self.uv[here])
        area = np.linalg.norm(triangle_normals(self.vertices, self.faces), axis=1)
        return Mesh(self.vertices, self.faces[area > 0], colours)


def srgb_bytes(linear: Array) -> NDArray[np.uint8]:
    """sRGB bytes of linear light, 0 to 1, such as an MTL file's Kd (IEC 61966-2-1)."""
    return np.asarray(np.rint(255 * srgb_encode(linear)).astype(np.uint8))


def crease_normals(vertices: Array, faces: NDArray[np.int64]) -> Array:
    """Corner normals (F, 3, 3): at each vertex the area-weighted mean over the faces within 40 degrees of this one."""
    area_normal = triangle_normals(vertices, faces)
    unit = area_normal / np.maximum(np.linalg.norm(area_normal, axis=1, keepdims=True), 1e-20)
    order = np.argsort(faces.reshape(-1), kind="stable")
    counts = np.bincount(faces.reshape(-1), minlength=len(vertices))
    starts = np.concatenate([[0], np.cumsum(counts)[:-1]])
    vertex = faces.reshape(-1)[order]
    repeats = counts[vertex]
    mine = np.repeat(order, repeats)  # every corner, once for each corner that shares its vertex
    offset = np.arange(len(mine)) - np.repeat(np.cumsum(repeats) - repeats, repeats)
    other = order[np.repeat(starts[vertex], repeats) + offset]
    near = np.einsum("ij,ij->i", unit[mine // 3], unit[other // 3]) >= _CREASE
    total = np.zeros((faces.size, 3))
    np.add.at(total, mine[near], area_normal[other[near] // 3])
    return np.asarray((total / np.maximum(np.linalg.norm(total, axis=1, keepdims=True), 1e-20)).reshape(-1, 3, 3))
