"""Sets of effects before frames that they were not fitted to: the smallest within one standard error of the best."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from freeart21.se3 import Array

FLIPS = 1999
LEAST_SHARE = 0.01
"""Of what the best set gains, that a further effect must bring: less is what a straight line misses of a curve, and
columns are of first order. Not measured."""


@dataclass(frozen=True)
class Tried:
    """One set of effects, or a nameless rival, before the frames that choose."""

    names: tuple[str, ...]
    """Keys of effects; none for the asset's film as it is."""
    size: int
    """Parameters."""
    densities: Array
    """(frames,) log predictive density of each."""
    nameless: bool = False

    @property
    def mean(self) -> float:
        """Over the frames."""
        return float(self.densities.mean())


def standard_error(values: Array) -> float:
    """Of the mean of `values` (n,) in the order of time: frames next to each other say partly the same."""
    n = len(values)
    if n < 3:
        return float("inf")
    d = values - values.mean()
    variance = float((d**2).mean())
    along = float((d[1:] * d[:-1]).mean()) / variance if variance > 0 else 0.0
    return float(np.sqrt(variance / (n - 1) * max(1.0, 1 + 2 * along)))


def smallest(tried: Sequence[Tried], least_share: float = 0.0) -> tuple[Tried, tuple[Tried, ...]]:
    """The smallest set within one standard error of the best, and all sets of as many effects that are, too.

    A set with fewer effects, but some, is as good within `least_share` of what the best gains.
    """
    named = [t for t in tried if not t.nameless]
    best = max(named, key=lambda t: t.mean)
    none = next((t for t in named if not t.names), best)
    spare = least_share * (best.mean - none.mean)
    within = [
        t
        for t in named
        if best.mean - t.mean
        <= max(standard_error(best.densities - t.densities), spare if 0 < len(t.names) < len(best.names) else 0.0)
        or t is best
    ]
    first = min(within, key=lambda t: (len(t.names), t.size, -t.mean))
    alike = sorted((t for t in within if len(t.names) == len(first.names)), key=lambda t: -t.mean)
    return first, tuple(alike)


def sign_flip_p(gains: Array, seed: int = 0) -> float:
    """Chance that frames which gain nothing on average gain as much: the signs of their gains flipped at random.

    Gains are capped at three times their median size, so that one frame does not decide.
    """
    if not len(gains) or not gains.any():
        return 1.0
    cap = 3 * max(float(np.median(np.abs(gains))), 1e-12)
    g = np.clip(gains, -cap, cap)
    rng = np.random.default_rng([seed, 13])
    signs = rng.choice([-1.0, 1.0], size=(FLIPS, len(g)))
    return float((1 + ((signs @ g) >= g.sum() - 1e-12).sum()) / (FLIPS + 1))


def benjamini_hochberg(p: NDArray[np.float64]) -> Array:
    """(n,) p-values corrected for their number (Benjamini and Hochberg 1995)."""
    order, n = np.argsort(p), len(p)
    stepped = np.minimum.accumulate((p[order] * n / np.arange(1, n + 1))[::-1])[::-1]
    out = np.empty(n)
    out[order] = np.minimum(stepped, 1.0)
    return out
