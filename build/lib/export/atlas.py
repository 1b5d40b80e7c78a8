"""A part's surface unfolded onto a picture, by xatlas: charts with gutters between them, one vertex on each side of a
seam sharing its place in space."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy.ndimage import distance_transform_edt

from freeart21.errors import FreeArtError
from freeart21.mesh import Mesh, bounding_diagonal

MAX_SIDE = 4096
"""Pixels along a texture at most: what every engine takes."""
_GUTTER = 4
"""Empty pixels round a chart: two for each of two mipmap levels."""
_FILLED = 0.7
"""Part of a texture that xatlas fills at least (0.72 to 0.85 on two parts)."""
_COARSEST = 1 / 64
"""Texel size over the part's diagonal at most: a part whose frames were all far away still has some texels."""


@dataclass(frozen=True)
class Atlas:
    """Where every corner of every triangle lies on a texture."""

    places: NDArray[np.float64]
    """(n, 2) pixels, column and row from the upper left; the first pixel's centre is (0.5, 0.5)."""
    corners: NDArray[np.int64]
    """(F, 3) rows of `places`."""
    width: int
    """Columns."""
    height: int
    """Rows."""
    texel_m: float
    """Side of a texel on the surface, metres."""

    @property
    def uv(self) -> NDArray[np.float64]:
        """(n, 2) texture coordinates, origin at the picture's lower left, as OBJ wants."""
        return self.places / [self.width, -self.height] + [0, 1]


@dataclass(frozen=True)
class Skin:
    """What a part wears."""

    atlas: Atlas
    image: NDArray[np.uint8]
    """(height, width, 3) RGB."""


@dataclass(frozen=True)
class Texels:
    """The texels that lie on triangles, n of them."""

    row: NDArray[np.int64]
    """(n,)."""
    column: NDArray[np.int64]
    """(n,)."""
    face: NDArray[np.int64]
    """(n,) triangle."""
    weights: NDArray[np.float32]
    """(n, 3) barycentric coordinates of the texel's centre in it."""

    def of_corners(self, mesh: Mesh, values: NDArray[np.float64]) -> NDArray[np.float32]:
        """(n, 3) values at the texels of what `values` (V, 3) has at vertices, in single precision."""
        corners = values.astype(np.float32)[mesh.faces[self.face]]
        return np.einsum("nk,nki->ni", self.weights, corners)


def unfolded(mesh: Mesh, texel_m: float) -> Atlas:
    """The atlas of a mesh with texels of about `texel_m`; larger ones where the texture would pass `MAX_SIDE`."""
    import xatlas

    size = bounding_diagonal(mesh)
    least = float(np.sqrt(mesh.areas().sum() / _FILLED)) / MAX_SIDE
    texel_m = min(max(texel_m, least), _COARSEST * size)
    for _ in range(8):
        atlas = xatlas.Atlas()
        middle = mesh.vertices.mean(0)  # single precision: about the middle, in units of the size
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


def texels_of(atlas: Atlas) -> Texels:
    """The texels whose centres lie on a triangle, row by row."""
    owner = np.full((atlas.height, atlas.width), -1, np.int64)
    _mark(owner, atlas.places, atlas.corners)
    row, column = np.nonzero(owner >= 0)
    face = owner[row, column]
    a, b, c = (atlas.places[atlas.corners[face, k]] for k in range(3))
    p = np.stack([column + 0.5, row + 0.5], -1)
    whole = _cross(b - a, c - a)
    whole = np.where(whole == 0, 1.0, whole)
    weights = np.stack([_cross(b - p, c - p), _cross(c - p, a - p), _cross(a - p, b - p)], -1) / whole[:, None]
    weights = np.clip(weights, 0, 1)
    return Texels(row, column, face, (weights / weights.sum(1, keepdims=True)).astype(np.float32))


def painted(atlas: Atlas, texels: Texels, colours: NDArray[np.floating]) -> NDArray[np.uint8]:
    """(height, width, 3) picture with `colours` (n, 3), 0 to 255, of the texels; all others have the nearest one's."""
    image = np.zeros((atlas.height, atlas.width, 3), np.uint8)
    image[texels.row, texels.column] = np.clip(np.rint(colours), 0, 255)
    empty = np.ones((atlas.height, atlas.width), bool)
    empty[texels.row, texels.column] = False
    if empty.all():
        return image
    rows, columns = distance_transform_edt(empty, return_distances=False, return_indices=True)
    return image[rows, columns]


def _cross(a: NDArray[np.float64], b: NDArray[np.float64]) -> NDArray[np.float64]:
    return a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]


@njit(cache=True)
def _mark(owner, places, corners):
    """Write into `owner` (height, width) the triangle on which each pixel's centre lies."""
    height, width = owner.shape
    for f in range(len(corners)):
        a, b, c = places[corners[f, 0]], places[corners[f, 1]], places[corners[f, 2]]
        whole = (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])
        if whole == 0:
            continue
        left, right = min(a[0], b[0], c[0]), max(a[0], b[0], c[0])
        top, bottom = min(a[1], b[1], c[1]), max(a[1], b[1], c[1])
        for y in range(max(0, int(np.ceil(top - 0.5))), min(height - 1, int(np.floor(bottom - 0.5))) + 1):
            for x in range(max(0, int(np.ceil(left - 0.5))), min(width - 1, int(np.floor(right - 0.5))) + 1):
                px, py = x + 0.5, y + 0.5
                u = ((b[0] - px) * (c[1] - py) - (b[1] - py) * (c[0] - px)) / whole
                v = ((c[0] - px) * (a[1] - py) - (c[1] - py) * (a[0] - px)) / whole
                if u >= -1e-9 and v >= -1e-9 and u + v <= 1 + 1e-9:
                    owner[y, x] = f
