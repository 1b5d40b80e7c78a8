"""Rigid registration of two clouds of points by iterated closest points, coarse to fine.

Ours, on SciPy's k-d tree; the steps are those that FreeArtGS's released evaluator asks of Open3D: clouds voxel_means to
voxels of a 50th, a 100th and a 200th of the target's diagonal, matches within three voxels, point to point twice (Besl
and McKay 1992), then point to plane (Chen and Medioni 1991).
"""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree

from freeart21 import se3
from freeart21.se3 import Array

SHARES = (50.0, 100.0, 200.0)
"""Voxels to the diagonal, level by level."""
STEPS = (100, 200, 500)
"""Most iterations a level."""
LEAST_VOXEL = 1e-3
"""Metres."""
REACH = 3.0
"""Voxels within which points may be matched."""
STILL = 1e-6
"""A level ends when neither the matched share nor the root mean square (metres) changes by more, or they come again."""
NEIGHBOURS = 30
"""Points, within four voxels, that a normal is fitted to."""


def register_clouds(source: Array, target: Array) -> Array:
    """T_target_source (4, 4) that lays the points `source` (n, 3) on `target` (m, 3), metres, from where they are.

    The identity where nothing lies within reach: it finds the nearest fit, not the best.
    """
    T = np.eye(4)
    diagonal = float(np.linalg.norm(np.ptp(target, axis=0)))
    for share, steps, to_plane in zip(SHARES, STEPS, (False, False, True), strict=True):
        voxel = max(diagonal / share, LEAST_VOXEL)
        moving, fixed = voxel_means(source, voxel), voxel_means(target, voxel)
        normals = _normals(fixed, 4 * voxel) if to_plane else None
        T = _level(moving, fixed, normals, T, REACH * voxel, steps)
    return T


def voxel_means(points: Array, voxel: float) -> Array:
    """The mean (k, 3) of the `points` (n, 3) in each cube of edge `voxel`, metres, that holds any."""
    cells = np.floor((points - points.min(0)) / voxel + 0.5).astype(np.int64)
    _, which, counts = np.unique(cells, axis=0, return_inverse=True, return_counts=True)
    sums = np.zeros((len(counts), 3))
    np.add.at(sums, which.reshape(-1), points)
    return sums / counts[:, None]


def _level(source: Array, target: Array, normals: Array | None, T: Array, reach: float, steps: int) -> Array:
    """One level: match, move, until still; to the planes of `normals` (m, 3) where they are given."""
    tree, before = cKDTree(target), (np.inf, np.inf)
    known: set[tuple[int, float]] = set()  # near the end the matches may go in circles: it is still then, too
    for _ in range(steps):
        here = se3.transform(T, source)
        distances, nearest = tree.query(here, distance_upper_bound=reach)
        matched = np.isfinite(distances)
        if not matched.any():
            return T
        now = float(matched.mean()), float(np.sqrt(np.mean(distances[matched] ** 2)))
        if abs(now[0] - before[0]) < STILL and abs(now[1] - before[1]) < STILL:
            return T
        if (state := (int(matched.sum()), round(now[1], 9))) in known:
            return T
        known.add(state)
        before = now
        a, b = here[matched], target[nearest[matched]]
        step = _to_points(a, b) if normals is None else _to_planes(a, b, normals[nearest[matched]])
        T = se3.orthonormalised(step @ T)
    return T


def _to_points(a: Array, b: Array) -> Array:
    """The pose (4, 4) that lays `a` (n, 3) on `b` (n, 3) by least squares (Arun et al. 1987)."""
    centre_a, centre_b = a.mean(0), b.mean(0)
    R = se3.project_so3((b - centre_b).T @ (a - centre_a))
    return se3.pose(R, centre_b - R @ centre_a)


def _to_planes(a: Array, b: Array, normals: Array) -> Array:
    """The small motion (4, 4) that lays `a` (n, 3) on the planes through `b` (n, 3) across `normals` (n, 3)."""
    A = np.concatenate([np.cross(a, normals), normals], axis=1)
    turn_shift, *_ = np.linalg.lstsq(A.T @ A, A.T @ np.sum((b - a) * normals, axis=1), rcond=1e-12)
    return se3.pose(se3.exp_so3(turn_shift[:3]), turn_shift[3:])


def _normals(points: Array, radius: float) -> Array:
    """Unit normals (n, 3), of either sign, of the planes through each point's NEIGHBOURS nearest within `radius`."""
    distances, nearest = cKDTree(points).query(points, k=min(NEIGHBOURS, len(points)), distance_upper_bound=radius)
    distances, nearest = distances.reshape(len(points), -1), nearest.reshape(len(points), -1)
    weights = np.isfinite(distances)[..., None].astype(float)
    around = points[np.where(np.isfinite(distances), nearest, 0)]
    centred = (around - (weights * around).sum(1, keepdims=True) / weights.sum(1, keepdims=True)) * weights
    return np.linalg.eigh(np.swapaxes(centred, 1, 2) @ centred)[1][:, :, 0]
