"""Turns a point cloud into a surface that the scorer can measure: a small triangle at each point.

No holes are closed and no surface is fitted. Each triangle lies in the plane of the point's neighbours and is centred
at the point, so that samples of the triangles are samples of the cloud, noise included. docs/adapters.md has the effect
on Chamfer distances.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from freeart21.errors import FreeArtError
from freeart21.mesh import Mesh
from freeart21.se3 import Array

NEIGHBOURS = 8
"""Neighbours that define the plane of a point's triangle."""
SIDE = 2.0
"""Side of the triangles in median distances to the nearest other point."""
LARGEST = 2_000_000
"""Most points of a cloud; the scorer holds 4 million faces."""


def mesh_from_points(points: Array, colours: NDArray[np.uint8] | None = None) -> Mesh:
    """Equilateral triangles of side SIDE median spacings, centred at `points` (n, 3), metres, with `colours` (n, 3).

    Coincident points are ignored for the spacing. Raises FreeArtError for too few or too many points.
    """
    points = np.asarray(points, float).reshape(-1, 3)
    if not 4 <= len(points) <= LARGEST:
        raise FreeArtError(f"a cloud has {len(points)} points, expected 4 to {LARGEST}")
    tree = cKDTree(points)
    distances, neighbours = tree.query(points, k=min(NEIGHBOURS + 1, len(points)))
    others = distances[:, 1:]
    nearest = np.where(others > 0, others, np.inf).min(1)
    spacing = float(np.median(nearest[np.isfinite(nearest)])) if np.isfinite(nearest).any() else 0.0
    if spacing <= 0:
        raise FreeArtError("a cloud has all its points in one place")
    centred = points[neighbours] - points[neighbours].mean(1, keepdims=True)
    _, directions = np.linalg.eigh(np.einsum("nki,nkj->nij", centred, centred))
    u, v = directions[:, :, 2], directions[:, :, 1]  # the plane of the two largest spreads
    radius = SIDE * spacing / np.sqrt(3)
    turns = 2 * np.pi * np.arange(3) / 3
    corners = points[:, None] + radius * (
        np.cos(turns)[None, :, None] * u[:, None] + np.sin(turns)[None, :, None] * v[:, None]
    )
    repeated = None if colours is None else np.repeat(colours, 3, 0)
    return Mesh(corners.reshape(-1, 3), np.arange(3 * len(points)).reshape(-1, 3), repeated)
