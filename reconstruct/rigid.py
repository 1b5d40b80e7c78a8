"""Rigid transforms from corresponding points: closed form, robust, and RANSAC (supplement, Transformation Init.)."""

from __future__ import annotations

import numpy as np

from freeart21 import se3
from freeart21.se3 import Array


def rigid_fit(source: Array, target: Array, weights: Array | None = None) -> Array:
    """T (..., 4, 4) that takes points `source` (..., m, 3) to `target`, least squares (Arun et al. 1987)."""
    w = np.ones(source.shape[:-1]) if weights is None else weights
    source, target = np.broadcast_to(source, (*w.shape, 3)), np.broadcast_to(target, (*w.shape, 3))
    w = w / np.maximum(w.sum(-1, keepdims=True), 1e-300)
    a, b = (w[..., None] * source).sum(-2), (w[..., None] * target).sum(-2)
    M = np.swapaxes(w[..., None] * (target - b[..., None, :]), -1, -2) @ (source - a[..., None, :])
    R = se3.project_so3(M)
    return se3.pose(R, b - np.einsum("...ij,...j->...i", R, a))


def distances(T: Array, source: Array, target: Array) -> Array:
    """(..., m) distances |T X - Y|."""
    return np.linalg.norm(se3.transform(T, source) - target, axis=-1)


def tukey_weights(residuals: Array, cutoff: float) -> Array:
    """Weights of Tukey's loss: (1 - (r / cutoff)^2)^2 within the cut-off, 0 beyond."""
    r = residuals / cutoff
    return np.where(r < 1, (1 - r**2) ** 2, 0.0)


def tukey_fit(T: Array, source: Array, target: Array, scale: float, rounds: int = 5) -> Array:
    """`T` refined under Tukey's weight with cut-off 2 * scale, metres."""
    for _ in range(rounds):
        weights = tukey_weights(distances(T, source, target), 2 * scale)
        if (weights > 0).sum() < 6:
            break
        T = rigid_fit(source, target, weights)
    return T


def ransac_fit(
    source: Array, target: Array, scale: float, rng: np.random.Generator, tries: int = 150, sample: int = 6
) -> Array | None:
    """The transform that most tracks agree with to `scale`, metres, refined under Tukey's weight; None for too few
    tracks."""
    if len(source) < sample:
        return None
    picks = rng.integers(0, len(source), (tries, sample))
    Ts = rigid_fit(source[picks], target[picks])
    some = rng.permutation(len(source))[:800]
    score = np.minimum(distances(Ts, source[some][None], target[some][None]) / scale, 1).sum(1)
    return tukey_fit(Ts[score.argmin()], source, target, scale)


def view_angle(Rs: Array, R: Array) -> Array:
    """Radians (...) between the directions from which a part is seen under rotations Rs (..., 3, 3) and R (3, 3).

    A roll about the optical axis changes no view: the same surfaces are visible.
    """
    return np.arccos(np.clip(Rs[..., 2, :] @ R[2], -1, 1))
