"""Rigid transforms from corresponding points: robust, and RANSAC (supplement, Transformation Init.)."""

from __future__ import annotations

import numpy as np

from freeart21 import se3
from freeart21.se3 import Array


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
        T = se3.fit_rigid(source, target, weights)
    return T


def ransac_fit(
    source: Array, target: Array, scale: float, rng: np.random.Generator, tries: int = 150, sample: int = 6
) -> Array | None:
    """The transform that most tracks agree with to `scale`, metres, refined under Tukey's weight; None for too few
    tracks."""
    if len(source) < sample:
        return None
    picks = rng.integers(0, len(source), (tries, sample))
    Ts = se3.fit_rigid(source[picks], target[picks])
    some = rng.permutation(len(source))[:800]
    score = np.minimum(distances(Ts, source[some][None], target[some][None]) / scale, 1).sum(1)
    return tukey_fit(Ts[score.argmin()], source, target, scale)


def view_angle(Rs: Array, R: Array) -> Array:
    """Radians (...) between the directions from which a part is seen under rotations Rs (..., 3, 3) and R (3, 3).

    A roll about the optical axis changes no view: the same surfaces are visible.
    """
    return np.arccos(np.clip(Rs[..., 2, :] @ R[2], -1, 1))
