"""Which of two parts each track belongs to: votes of pairs or windows of keyframes, and the split that agrees best."""

from __future__ import annotations

import numpy as np
from scipy.sparse import csr_array, diags_array
from scipy.sparse.linalg import svds

from baselines.rigid import LEAST_POINTS, find_motion
from baselines.tracks import GAPS
from baselines.video import UnsolvableError
from freeart21 import se3
from freeart21.se3 import Array, Ints

LEAST_SHARE = 0.05
"""Least share of the tracks of a pair that makes a second motion."""
WINDOWS = (4, 8)
"""Keyframes of the windows in which tracks are clustered."""
_MOST_TRACKS = 400
"""In a window, drawn at random."""


def vote_by_motions(points: Array, tolerance: float, rng: np.random.Generator) -> Array:
    """Votes (P, V) of pairs of keyframes: +1 and -1 for tracks of the first and the second motion, 0 for others.

    RANSAC finds the motion with most tracks, then that of the others; a pair with one motion alone does not vote.
    """
    votes = []
    there = np.isfinite(points[..., 0])
    for gap in GAPS:
        for i in range(points.shape[1] - gap):
            both = np.flatnonzero(there[:, i] & there[:, i + gap])
            if vote := split_motions(points[both, i], points[both, i + gap], tolerance, rng):
                column = np.zeros(len(points))
                column[both[vote[0]]], column[both[vote[1]]] = 1, -1
                votes.append(column)
    return np.stack(votes, 1) if votes else np.zeros((len(points), 0))


def split_motions(a: Array, b: Array, tolerance: float, rng: np.random.Generator) -> tuple[Ints, Ints] | None:
    """The numbers of the points of two different motions from `a` (P, 3) to `b`, or None when there are not two."""
    first, inliers = find_motion(a, b, tolerance, rng)
    rest = np.flatnonzero(np.linalg.norm(a @ first[:3, :3].T + first[:3, 3] - b, axis=1) > 2 * tolerance)
    least = max(LEAST_POINTS, LEAST_SHARE * len(a))
    if inliers.sum() < least or len(rest) < least:
        return None
    _, second = find_motion(a[rest], b[rest], tolerance, rng)
    return (np.flatnonzero(inliers), rest[second]) if second.sum() >= least else None


def vote_by_distances(points: Array, tolerance: float, rng: np.random.Generator) -> Array:
    """Votes (P, V) of windows of keyframes: the tracks that last through a window, cut in two by spectral clustering of
    how well each two keep their distance.

    A window votes when each half moves rigidly and the first's motion does not explain the second.
    """
    from sklearn.cluster import SpectralClustering

    votes = []
    there = np.isfinite(points[..., 0])
    for length in WINDOWS:
        for begin in range(0, points.shape[1] - length + 1, length // 2):
            window = slice(begin, begin + length)
            whole = np.flatnonzero(there[:, window].all(1))
            if len(whole) > _MOST_TRACKS:
                whole = np.sort(rng.choice(whole, _MOST_TRACKS, replace=False))
            if len(whole) < 2 * LEAST_POINTS:
                continue
            own = points[whole, window]
            distance = np.linalg.norm(own[:, None] - own[None], axis=3)
            affinity = np.exp(-((np.ptp(distance, axis=2) / (2 * tolerance)) ** 2)) + 1e-6
            cut = SpectralClustering(2, affinity="precomputed", random_state=0, assign_labels="cluster_qr")
            sides = cut.fit_predict(affinity)
            if _are_two_motions(own[:, 0], own[:, -1], sides, tolerance, rng):
                column = np.zeros(len(points))
                column[whole] = np.where(sides == 0, 1, -1)
                votes.append(column)
    return np.stack(votes, 1) if votes else np.zeros((len(points), 0))


def _are_two_motions(a: Array, b: Array, sides: Ints, tolerance: float, rng: np.random.Generator) -> bool:
    """Whether each side moves rigidly from `a` (P, 3) to `b`, and neither as the other."""
    for side in range(2):
        own, other = sides == side, sides != side
        T, inliers = find_motion(a[own], b[own], tolerance, rng)
        if inliers.sum() < max(LEAST_POINTS, 0.7 * own.sum()):
            return False
        if np.median(np.linalg.norm(se3.transform(T, a[other]) - b[other], axis=1)) < 2 * tolerance:
            return False
    return True


def agree(votes: Array) -> Ints:
    """The part (P,), 0 or 1, of every track by `votes` (P, V), -1 where nobody voted; part 0 has more tracks.

    Each vote says which tracks go together, not which part they are. The split s of +1 and -1 that agrees best with all
    maximises s' V V' s: relaxed, it is the first left singular vector of V, tracks weighted by their number of votes.
    Raises UnsolvableError when there are not two votes, or one part is empty.
    """
    if votes.shape[1] < 2:
        raise UnsolvableError("grouping", f"two motions were found in {votes.shape[1]} pairs or windows, expected 2")
    counts = (votes != 0).sum(1)
    weights = diags_array(1 / np.sqrt(np.maximum(counts, 1)))
    V = csr_array(weights @ csr_array(votes) @ diags_array(1 / np.sqrt(np.maximum((votes != 0).sum(0), 1))))
    first = svds(V, k=1, v0=np.ones(min(V.shape)), random_state=0)[0][:, 0]
    signs = np.sign(votes @ np.sign(votes.T @ first))  # tracks in few votes follow the votes they are in
    parts = np.where(counts == 0, -1, np.where(signs > 0, 0, 1))
    if (parts == 1).sum() > (parts == 0).sum():
        parts = np.where(parts >= 0, 1 - parts, -1)
    if (parts == 1).sum() < LEAST_POINTS:
        raise UnsolvableError("grouping", f"{(parts == 1).sum()} tracks are of a second part, expected {LEAST_POINTS}")
    return parts
