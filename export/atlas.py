"""Texture atlases: a part's surface unwrapped onto an image by xatlas."""

from __future__ import annotations

import ctypes
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import distance_transform_edt

from freeart21.errors import FreeArtError
from freeart21.mesh import Mesh, bounding_diagonal
from freeart21.z_buffer import draw_triangles

MAX_SIDE = 4096
"""Most pixels along a texture: every engine takes that many."""
_GUTTER = 4
"""Empty pixels around a chart: two per mipmap level, for two levels."""
_FILLED = 0.7
"""Fraction of a texture that xatlas fills at least (0.72 to 0.85 on two parts)."""
_COARSEST = 1 / 64
"""Largest texel size over the part's diagonal, for parts that were far away in all frames."""


@dataclass(frozen=True)
class Atlas:
    """Texture coordinates of every corner of every triangle. Vertices at a seam share a position, not a texture
    coordinate."""

    pixels: NDArray[np.float64]
    """(n, 2) column and row from the upper left; the first pixel's centre is (0.5, 0.5)."""
    corners: NDArray[np.int64]
    """(F, 3) rows of `pixels`."""
    width: int
    """Columns."""
    height: int
    """Rows."""
    texel_m: float
    """Side of a texel on the surface, m."""

    @property
    def uv(self) -> NDArray[np.float64]:
        """(n, 2) texture coordinates with the origin at the lower left, as in OBJ."""
        return self.pixels / [self.width, -self.height] + [0, 1]


@dataclass(frozen=True)
class Texture:
    """An atlas and its image."""

    atlas: Atlas
    image: NDArray[np.uint8]
    """(height, width, 3) RGB."""


@dataclass(frozen=True)
class Texels:
    """n texels that lie on triangles."""

    row: NDArray[np.int64]
    """(n,)."""
    column: NDArray[np.int64]
    """(n,)."""
    face: NDArray[np.int64]
    """(n,) triangle."""
    weights: NDArray[np.float32]
    """(n, 3) barycentric coordinates of the texel's centre."""

    def interpolate(self, mesh: Mesh, values: NDArray[np.float64]) -> NDArray[np.float32]:
        """(n, 3) `values` (V, 3) of the vertices, interpolated at the texels, in single precision."""
        corners = values.astype(np.float32)[mesh.faces[self.face]]
        return np.asarray(np.einsum("nk,nki->ni", self.weights, corners))


def unwrap(mesh: Mesh, texel_m: float) -> Atlas:
    """The atlas of a mesh with texels of about `texel_m`, or larger where the texture would exceed `MAX_SIDE`."""
    import xatlas

    size = bounding_diagonal(mesh)
    least = float(np.sqrt(mesh.areas().sum() / _FILLED)) / MAX_SIDE
    texel_m = min(max(texel_m, least), _COARSEST * size)
    for _ in range(8):
        atlas = xatlas.Atlas()
        # never freed: its destructor joins its threads, and was seen to wait for one of them for ever
        ctypes.pythonapi.Py_IncRef(ctypes.py_object(atlas))
        middle = mesh.vertices.mean(0)  # xatlas takes single precision: centre and scale first
        atlas.add_mesh(((mesh.vertices - middle) / size).astype(np.float32), mesh.faces.astype(np.uint32))
        options = xatlas.PackOptions()
        options.padding, options.texels_per_unit, options.create_image = _GUTTER, size / texel_m, False
        options.bilinear = True
        atlas.generate(xatlas.ChartOptions(), options)
        if max(atlas.width, atlas.height) <= MAX_SIDE and atlas.atlas_count == 1:
            break
        texel_m *= 1.25
    else:
        raise FreeArtError(f"a surface of {len(mesh.faces)} triangles does not unfold onto {MAX_SIDE} pixels")
    _, corners, uv = atlas[0]
    places = uv.astype(float) * [atlas.width, atlas.height]
    return Atlas(places, corners.astype(np.int64), int(atlas.width), int(atlas.height), texel_m)


def find_texels(atlas: Atlas) -> Texels:
    """The texels whose centres lie on a triangle, row by row."""
    # a pixel that several triangles share belongs to the last one; the z-buffer gives it to the first
    size, last = (atlas.height, atlas.width), len(atlas.corners) - 1
    face, weights = np.full(size, -1), np.zeros((*size, 3))
    flat = np.ones(len(atlas.pixels))
    draw_triangles(atlas.pixels, flat, atlas.corners[::-1], np.full(size, np.inf), face, weights)
    row, column = np.nonzero(face >= 0)
    inside = np.clip(weights[row, column], 0, 1)
    inside /= inside.sum(1, keepdims=True)
    return Texels(row, column, last - face[row, column], inside.astype(np.float32))


def paint_texture(atlas: Atlas, texels: Texels, colours: NDArray[np.floating]) -> NDArray[np.uint8]:
    """(height, width, 3) image with `colours` (n, 3), 0 to 255, at the texels; other pixels take the nearest
    texel's."""
    image = np.zeros((atlas.height, atlas.width, 3), np.uint8)
    image[texels.row, texels.column] = np.clip(np.rint(colours), 0, 255)
    empty = np.ones((atlas.height, atlas.width), bool)
    empty[texels.row, texels.column] = False
    if empty.all():
        return image
    rows, columns = distance_transform_edt(empty, return_distances=False, return_indices=True)
    return np.asarray(image[rows, columns])
