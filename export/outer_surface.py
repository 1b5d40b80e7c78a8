"""The surface of a part that can be touched, and how far points extend beyond it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import trimesh
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from export.winding_number import Winding
from freeart21.errors import FreeArtError
from freeart21.mesh import Mesh
from freeart21.se3 import Array

DENSE = 60_000
"""Surface points for distances."""
CELLS = 70
"""Cells along the part, of at least a millimetre: one point per cell and normal direction is used in the
decomposition."""
NEIGHBOURS = 8
RAYS = 48
"""Directions in the half space in front of a point that are searched for a way out."""


@dataclass(frozen=True)
class OuterSurface:
    """The outer surface of a part, closed or open, as points with outward normals.

    Inside is whatever lies behind the nearest reachable point: unreachable cavities, and what is behind an open sheet.
    """

    points: Array
    """(n, 3) m: reachable corners of the mesh and points between them."""
    normals: Array
    """(n, 3)."""
    depth: Array
    """(n,) m from the point through the part to its other side; infinite without one."""
    opposite: NDArray[np.int64]
    """(n,) the point nearest to that other side, or -1."""
    around: NDArray[np.int64]
    """(n, 8) the nearest points."""
    dense: Array
    """(m, 3) m: more points."""
    dense_normals: Array
    spacing: float
    """m between dense points."""
    size: float
    """m: diagonal of the bounding box."""
    tree: Any
    """k-d tree of the dense points."""
    winding: Winding
    """Of the whole mesh."""

    @property
    def area(self) -> float:
        """m^2 of the reachable surface."""
        return len(self.dense) * self.spacing**2

    def excess(self, x: Array) -> Array:
        """(k,) m by which points `x` (k, 3) are outside the part; 0 inside.

        Outside is in front of the nearest point. At edges and corners, where adjacent faces can disagree, the winding
        number decides.
        """
        distance, nearest = self.tree.query(x)
        away = x - self.dense[nearest]
        ahead = np.einsum("ij,ij->i", away, self.dense_normals[nearest])
        aside = np.sqrt(np.maximum(distance**2 - ahead**2, 0.0))
        out = ahead > 0
        edge = np.flatnonzero(out & (aside > 2 * self.spacing))
        if len(edge):
            out[edge] = self.winding.number(x[edge]) < 0.5
        beyond = np.maximum(aside - self.spacing, 0.0)  # the surface goes on between its points
        return np.where(out, np.hypot(ahead, beyond), 0.0)


def sample_outer_surface(mesh: Mesh, count: int = DENSE) -> OuterSurface:
    """The outer surface of a mesh, with about `count` points; FreeArtError when it has no area."""
    solid = trimesh.Trimesh(mesh.vertices, mesh.faces, process=False)
    area = float(mesh.areas().sum())
    if not area > 0:
        raise FreeArtError("mesh has no triangle of any area")
    size = float(np.linalg.norm(np.ptp(mesh.vertices[np.unique(mesh.faces)], axis=0)))
    dense, faces = sample_evenly(solid, area / count)
    dense_normals = solid.face_normals[faces]
    points, normals = _select_points(solid, dense, dense_normals, max(size / CELLS, 1e-3))
    dense, dense_normals = np.concatenate([dense, points]), np.concatenate([dense_normals, normals])
    rays = _ray_intersector(solid)
    step = 1e-5 * size
    seen = _find_reachable(rays, points, normals, step, size)
    if not seen.any():
        seen[:] = True  # inside out
    scale = 0.02 * size
    near = cKDTree(np.hstack([points, scale * normals]))
    k = min(4, len(points))
    votes = seen[near.query(np.hstack([dense, scale * dense_normals]), k=k)[1].reshape(len(dense), k)].mean(1)
    reachable = votes == 1
    torn = np.flatnonzero((votes > 0) & (votes < 1))
    reachable[torn] = _find_reachable(rays, dense[torn], dense_normals[torn], step, size)
    if not reachable.any():
        reachable[:] = True
    dense, dense_normals = dense[reachable], dense_normals[reachable]
    points, normals = points[seen], normals[seen]
    spacing = float(np.sqrt(area / count))
    own = cKDTree(points)
    winding = Winding(Mesh(mesh.vertices, mesh.faces[mesh.areas() > 0]))
    k = min(NEIGHBOURS + 1, len(points))
    around = own.query(points, k=k)[1].reshape(len(points), k)[:, 1:]
    depth, there = _measure_depth(rays, points, normals, step)
    opposite = np.full(len(points), -1)
    hit = np.isfinite(depth)
    if hit.any():
        opposite[hit] = own.query(there[hit])[1]
    return OuterSurface(
        points, normals, depth, opposite, around, dense, dense_normals, spacing, size, cKDTree(dense), winding
    )


def _select_points(solid: trimesh.Trimesh, dense: Array, dense_normals: Array, cell: float) -> tuple[Array, Array]:
    """Of the mesh's corners and dense points one per cell and direction: the sharpest corner, if there is one."""
    turn = np.where(np.isfinite(solid.face_angles), solid.face_angles, 0.0).ravel()
    points = np.concatenate([solid.vertices[solid.faces.ravel()], dense])
    normals = np.concatenate([np.repeat(solid.face_normals, 3, axis=0), dense_normals])
    angle = np.full(len(solid.vertices), 0.0)
    np.add.at(angle, solid.faces.ravel(), turn)
    rank = np.concatenate([angle[solid.faces.ravel()], np.full(len(dense), 2 * np.pi)])
    order = np.argsort(rank, kind="stable")
    key = np.hstack([np.floor(points / cell), np.rint(normals)]).astype(np.int64)[order]
    _, first = np.unique(key, axis=0, return_index=True)
    chosen = order[np.sort(first)]
    return points[chosen], normals[chosen]


def _ray_intersector(solid: trimesh.Trimesh) -> Any:
    from trimesh.ray.ray_pyembree import RayMeshIntersector

    return RayMeshIntersector(solid)


def _find_reachable(rays: Any, points: Array, normals: Array, step: float, size: float) -> NDArray[np.bool_]:
    """(n,) whether a ray from the point escapes."""
    found = np.zeros(len(points), bool)
    start = points + step * normals
    for direction in even_directions(2 * RAYS):
        way = np.where((normals @ direction)[:, None] < 0, -direction, direction)
        open_ = ~found & (np.abs(normals @ direction) > 0.02)
        if open_.any():
            where = np.flatnonzero(open_)
            found[where[~rays.intersects_any(start[where], way[where])]] = True
    return found


def _measure_depth(rays: Any, points: Array, normals: Array, step: float) -> tuple[Array, Array]:
    """(n,) m inwards to the other side, inf without one, and (n, 3) that place."""
    start = points - step * normals
    depth, there = np.full(len(points), np.inf), points.copy()
    where, ray, _ = rays.intersects_location(start, -normals, multiple_hits=False)
    distance = np.linalg.norm(where - points[ray], axis=1)
    depth[ray], there[ray] = distance, where
    return depth, there


def sample_evenly(solid: trimesh.Trimesh, area: float) -> tuple[Array, NDArray[np.int64]]:
    """(n, 3) points on the surface, at least one per triangle and one per `area`, m^2; and their triangles.

    The R2 sequence (Roberts 2018), folded into the triangle, leaves no gaps as random points do.
    """
    counts = np.maximum(1, np.ceil(solid.area_faces / area - 0.5)).astype(int)
    faces = np.repeat(np.arange(len(counts)), counts)
    k = np.arange(len(faces)) - np.repeat(np.cumsum(counts) - counts, counts)
    u, v = np.modf(1 / 3 + 0.7548776662466927 * k)[0], np.modf(1 / 3 + 0.5698402909980532 * k)[0]
    over = u + v > 1
    u, v = np.where(over, 1 - u, u)[:, None], np.where(over, 1 - v, v)[:, None]
    a, b, c = (solid.triangles[faces, i] for i in range(3))
    return np.asarray((1 - u - v) * a + u * b + v * c), faces


def even_directions(n: int) -> Array:
    """(n, 3) unit vectors on the Fibonacci sphere."""
    z = 1 - (2 * np.arange(n) + 1) / n
    angle = np.pi * (3 - np.sqrt(5)) * np.arange(n)
    return np.stack([np.sqrt(1 - z**2) * np.cos(angle), np.sqrt(1 - z**2) * np.sin(angle), z], -1)
