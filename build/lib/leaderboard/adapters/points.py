"""A cloud of points as a surface that the scorer can measure: a small triangle at each point.

Nothing is invented between the points: no holes are closed, no surface is fitted. Each triangle lies in the plane of
the point's neighbours, with the point at its middle, so that samples of the triangles are samples of the cloud, and a
cloud of noisy points stays one. docs/adapters.md says what that costs in Chamfer distance.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from freeart21.errors import FreeArtError
from freeart21.mesh import Mesh
from freeart21.se3 import Array

NEIGHBOURS = 8
"""Of a point, which tell the plane of its triangle."""
SIDE = 2.0
"""Side of the triangles in median spacings (distances to the nearest other point)."""
LARGEST = 2_000_000
"""Points beyond which a cloud is refused: the scorer holds 4 million faces."""


def mesh_of_points(points: Array, colours: NDArray[np.uint8] | None = None) -> Mesh:
    """Equilateral triangles, SIDE median spacings wide, centred at `points` (n, 3), metres; `colours` (n, 3) go along.

    Points that coincide with others count once for the spacing. Raises FreeArtError when there are too few or many.
    """
    points = np.asarray(points, float).reshape(-1, 3)
    if not 4 <= len(points) <= LARGEST:
        raise FreeArtError(f"a cloud has {len(points)} points, expected 4 to {LARGEST}")
    tree = cKDTree(points)
    distances, neighbours = tree.query(points, k=min(NEIGHBOURS + 1, len(points)))
    apart = distances[:, 1:]
    nearest = np.where(apart > 0, apart, np.inf).min(1)
    spacing = float(np.median(nearest[np.isfinite(nearest)])) if np.isfinite(nearest).any() else 0.0
    if spacing <= 0:
        raise FreeArtError("a cloud has all its points in one place")
    around = points[neighbours] - points[neighbours].mean(1, keepdims=True)
    _, directions = np.linalg.eigh(np.einsum("nki,nkj->nij", around, around))
    u, v = directions[:, :, 2], directions[:, :, 1]  # the plane of the two largest spreads
    radius = SIDE * spacing / np.sqrt(3)
    turns = 2 * np.pi * np.arange(3) / 3
    corners = points[:, None] + radius * (
        np.cos(turns)[None, :, None] * u[:, None] + np.sin(turns)[None, :, None] * v[:, None]
    )
    painted = None if colours is None else np.repeat(colours, 3, 0)
    return Mesh(corners.reshape(-1, 3), np.arange(3 * len(points)).reshape(-1, 3), painted)
