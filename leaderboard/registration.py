"""Rigid registration of two point clouds by iterated closest points, coarse to fine.

The steps are those of FreeArtGS's released evaluator (there with Open3D): voxel sizes of a 50th, a 100th and a 200th of
the target's diagonal, matches within three voxels, point to point twice (Besl and McKay 1992), then point to plane
(Chen and Medioni 1991).
"""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree

from freeart21 import se3
from freeart21.se3 import Array

SHARES = (50.0, 100.0, 200.0)
"""Voxels per diagonal, level by level."""
STEPS = (100, 200, 500)
"""Most iterations per level."""
LEAST_VOXEL = 1e-3
"""Smallest voxel, metres."""
REACH = 3.0
"""Largest distance of matched points, in voxels."""
STILL = 1e-6
"""A level ends when matched share and RMS distance (metres) change by less, or repeat."""
NEIGHBOURS = 30
"""Most points, within four voxels, that a normal is fitted to."""


def register_clouds(source: Array, target: Array) -> Array:
    """T_target_source (4, 4), the local registration of the points `source` (n, 3) to `target` (m, 3), metres.

    Starts at the identity, and returns it when no points lie within reach.
    """
    T = np.eye(4)
    diagonal = float(np.linalg.norm(np.ptp(target, axis=0)))
    for share, steps, to_plane in zip(SHARES, STEPS, (False, False, True), strict=True):
        voxel = max(diagonal / share, LEAST_VOXEL)
        moving, fixed = voxel_means(source, voxel), voxel_means(target, voxel)
        normals = _normals(fixed, 4 * voxel) if to_plane else None
        T = _iterate(moving, fixed, normals, T, REACH * voxel, steps)
    return T


def voxel_means(points: Array, voxel: float) -> Array:
    """Means (k, 3) of the `points` (n, 3) in each occupied cube of edge `voxel`, metres."""
    cells = np.floor((points - points.min(0)) / voxel + 0.5).astype(np.int64)
    _, which, counts = np.unique(cells, axis=0, return_inverse=True, return_counts=True)
    sums = np.zeros((len(counts), 3))
    np.add.at(sums, which.reshape(-1), points)
    return sums / counts[:, None]


def _iterate(source: Array, target: Array, normals: Array | None, T: Array, reach: float, steps: int) -> Array:
    """One level from the pose `T`; point to plane where `normals` (m, 3) of the target are given."""
    tree, before = cKDTree(target), (np.inf, np.inf)
    visited: set[tuple[int, float]] = set()  # the matches can cycle near the end
    for _ in range(steps):
        here = se3.transform(T, source)
        distances, nearest = tree.query(here, distance_upper_bound=reach)
        matched = np.isfinite(distances)
        if not matched.any():
            return T
        now = float(matched.mean()), float(np.sqrt(np.mean(distances[matched] ** 2)))
        if abs(now[0] - before[0]) < STILL and abs(now[1] - before[1]) < STILL:
            return T
        if (state := (int(matched.sum()), round(now[1], 9))) in visited:
            return T
        visited.add(state)
        before = now
        a, b = here[matched], target[nearest[matched]]
        step = _point_to_point(a, b) if normals is None else _point_to_plane(a, b, normals[nearest[matched]])
        T = se3.orthonormalised(step @ T)
    return T


def _point_to_point(a: Array, b: Array) -> Array:
    """Least-squares pose (4, 4) from `a` (n, 3) to `b` (n, 3) (Arun et al. 1987)."""
    centre_a, centre_b = a.mean(0), b.mean(0)
    R = se3.project_so3((b - centre_b).T @ (a - centre_a))
    return se3.pose(R, centre_b - R @ centre_a)


def _point_to_plane(a: Array, b: Array, normals: Array) -> Array:
    """Linearised pose (4, 4) from `a` (n, 3) to the planes through `b` (n, 3) with `normals` (n, 3)."""
    A = np.concatenate([np.cross(a, normals), normals], axis=1)
    turn_shift, *_ = np.linalg.lstsq(A.T @ A, A.T @ np.sum((b - a) * normals, axis=1), rcond=1e-12)
    return se3.pose(se3.exp_so3(turn_shift[:3]), turn_shift[3:])


def _normals(points: Array, radius: float) -> Array:
    """Unit normals (n, 3), sign arbitrary, of planes fitted to each point's NEIGHBOURS nearest within `radius`."""
    distances, nearest = cKDTree(points).query(points, k=min(NEIGHBOURS, len(points)), distance_upper_bound=radius)
    distances, nearest = distances.reshape(len(points), -1), nearest.reshape(len(points), -1)
    weights = np.isfinite(distances)[..., None].astype(float)
    around = points[np.where(np.isfinite(distances), nearest, 0)]
    centred = (around - (weights * around).sum(1, keepdims=True) / weights.sum(1, keepdims=True)) * weights
    return np.linalg.eigh(np.swapaxes(centred, 1, 2) @ centred)[1][:, :, 0]
