"""Rigid motions of points: RANSAC, and poses of one body from its tracks."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from freeart21 import se3
from freeart21.se3 import Array, Bools, Ints

LEAST_POINTS = 6
"""Least tracks that give a pose: twice the three that determine one."""
_TRIALS = 200
"""Of RANSAC: with 99 % one of them has three inliers where a third of the points are."""
_ROUNDS = 4
"""Of landmarks and poses in turn."""


def find_motion(a: Array, b: Array, tolerance: float, rng: np.random.Generator) -> tuple[Array, Bools]:
    """The motion T_b_a with most points of `a` (P, 3) within `tolerance`, metres, of `b`, and its inliers (P,).

    RANSAC (Fischler and Bolles 1981) of three points, all trials at once, then least squares over the inliers.
    """
    if len(a) < 3:
        return np.eye(4), np.zeros(len(a), bool)
    trials = rng.integers(0, len(a), (_TRIALS, 3))
    Ts = se3.fit_rigid(a[trials], b[trials])
    distance = np.linalg.norm(se3.transform(Ts, a[None]) - b, axis=2)
    best = int((distance < tolerance).sum(1).argmax())
    inliers, T = distance[best] < tolerance, Ts[best]
    for _ in range(3):
        if inliers.sum() < 3:
            break
        T = se3.fit_rigid(a[inliers], b[inliers])
        inliers = np.linalg.norm(se3.transform(T, a) - b, axis=1) < tolerance
    return T, inliers


def estimate_poses(points: Array, tolerance: float, rng: np.random.Generator) -> tuple[Array, Bools]:
    """Poses (F, 4, 4), camera from body, and in which frames (F,) they were found, of tracks (P, F, 3), NaN where lost.

    The body's frame is the camera's in the frame from which most tracks go on to a neighbour. Then the frame that shows
    most of the landmarks known so far is added, again and again; last, landmarks (medians over frames) and poses are
    estimated in turn (generalised Procrustes). Where the body was not found, the pose is interpolated.
    """
    there: Bools = np.isfinite(points[..., 0])
    count = points.shape[1]
    Ts, found, refused = np.tile(np.eye(4), (count, 1, 1)), np.zeros(count, bool), np.zeros(count, np.int64)
    landmarks = np.full((len(points), 3), np.nan)
    if count > 1 and len(points):
        home = int((there[:, 1:] & there[:, :-1]).sum(0).argmax())
        found[home] = True
        landmarks[there[:, home]] = points[there[:, home], home]
    while True:
        common = (there & np.isfinite(landmarks[:, :1])).sum(0)
        open_frames = ~found & (common >= LEAST_POINTS) & (common > refused)  # again only with more landmarks
        if not open_frames.any():
            break
        f = int(np.where(open_frames, common, -1).argmax())
        known = np.flatnonzero(there[:, f] & np.isfinite(landmarks[:, 0]))
        T, inliers = find_motion(landmarks[known], points[known, f], tolerance, rng)
        if inliers.sum() < LEAST_POINTS:
            refused[f] = common[f]
            continue
        Ts[f], found[f] = T, True
        fresh = there[:, f] & ~np.isfinite(landmarks[:, 0])
        landmarks[fresh] = se3.transform(se3.inverse(T), points[fresh, f])
    for _ in range(_ROUNDS if found.any() else 0):
        back = np.stack([se3.transform(se3.inverse(Ts[f]), points[:, f]) for f in np.flatnonzero(found)], 1)
        used = np.isfinite(back[..., 0]).any(1)
        landmarks = np.full((len(points), 3), np.nan)
        landmarks[used] = np.nanmedian(back[used], axis=1)
        for f in map(int, np.flatnonzero(found)):
            known = np.flatnonzero(there[:, f] & used)
            distance = np.linalg.norm(se3.transform(Ts[f], landmarks[known]) - points[known, f], axis=1)
            if (distance < tolerance).sum() >= LEAST_POINTS:
                near = known[distance < tolerance]
                Ts[f] = se3.fit_rigid(landmarks[near], points[near, f])
    return interpolate_poses(np.flatnonzero(found), Ts[found], np.arange(count)) if found.any() else Ts, found


def assign_tracks(points: Array, parts: Ints, Ts: Array, found: Bools, tolerance: float) -> Ints:
    """The part (P,) of tracks (P, F, 3) by which of two motions `Ts` (2, F, 4, 4), known in the frames `found` (2, F),
    keeps them in one place within `tolerance`, metres. Those that both keep, or neither, keep their part of before."""
    spread = np.full((2, len(points)), np.nan)
    for part in range(2):
        frames = np.flatnonzero(found.all(0))
        back = np.stack([se3.transform(se3.inverse(Ts[part, f]), points[:, f]) for f in frames], 1)
        there = np.isfinite(back[..., 0])
        count = there.sum(1)
        centre = np.where(there[..., None], back, 0.0).sum(1) / np.maximum(count, 1)[:, None]
        off = np.where(there[..., None], back - centre[:, None], 0.0)
        spread[part] = np.where(count >= 2, np.sqrt((off**2).sum((1, 2)) / np.maximum(count, 1)), np.nan)
    best = np.where(np.isfinite(spread).all(0), np.nan_to_num(spread, nan=np.inf).argmin(0), 0)
    low, high = np.sort(spread, axis=0)
    clear = (low < tolerance) & (high > 2 * low) & (high > tolerance / 2)
    return np.where(clear, best, parts)


def interpolate_poses(at: NDArray[np.integer], Ts: Array, wanted: NDArray[np.integer]) -> Array:
    """Poses (W, 4, 4) at frames `wanted` from poses `Ts` (F, 4, 4) at frames `at`, along the screw between neighbours;
    the nearest one outside."""
    right = np.clip(np.searchsorted(at, wanted, side="left"), 0, len(at) - 1)
    left = np.clip(np.searchsorted(at, wanted, side="right") - 1, 0, len(at) - 1)
    span = np.where(at[right] > at[left], at[right] - at[left], 1)
    share = np.where(at[right] > at[left], (wanted - at[left]) / span, 0.0)
    twist = se3.log_se3(se3.inverse(Ts[left]) @ Ts[right])
    return se3.orthonormalised(Ts[left] @ se3.exp_se3(share[:, None] * twist))
