"""How sure the difference between two methods is: bootstrap intervals of the mean difference on the same sequences."""

from __future__ import annotations

import functools
import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

LEVEL = 0.95
RESAMPLES = 10_000
SEED = 0
KIND = "bootstrap over sequences, paired; percentiles, widened for few sequences as Student's t is (Hesterberg 2015)"


@dataclass(frozen=True)
class Interval:
    """The mean of paired differences, in the unit of the metric, and how far it may be off."""

    mean: float
    low: float | None
    """Ends of the interval at the level asked for; None where there are too few sequences for one."""
    high: float | None
    sequences: int
    """How many both have a number for."""

    @property
    def sure(self) -> bool:
        """Whether 0 lies outside."""
        return self.low is not None and self.high is not None and not self.low <= 0 <= self.high


def min_sequences(level: float = LEVEL) -> int:
    """How many sequences an interval needs: all n differences lie on one side of their true median by a chance of
    2^(1-n), and no bootstrap looks beyond the differences that it has."""
    return math.ceil(1 - math.log2(1 - level))


def bootstrap_intervals(
    differences: ArrayLike, level: float = LEVEL, resamples: int = RESAMPLES, seed: int = SEED
) -> list[Interval | None]:
    """An interval for each column of `differences` (n, k): a row a sequence, NaN where one of the two has no number.

    None for a column without any number. Percentiles of the means of `resamples` resamples of the sequences. As plain
    percentiles hold too seldom for few sequences, they are those of the level at which an interval of normal quantiles
    would be as wide as Student's t with n - 1 degrees of freedom makes it (T. Hesterberg, What Teachers Should Know
    about the Bootstrap, 2015, section 5.3).
    """
    table = np.asarray(differences, dtype=float)
    known = np.isfinite(table)
    found: list[Interval | None] = [None] * table.shape[1]
    for rows in np.unique(known, axis=1).T:
        columns = np.flatnonzero((known == rows[:, None]).all(0))
        n = int(rows.sum())
        if n == 0:
            continue
        chosen = table[np.ix_(rows, columns)]
        means = chosen.mean(0)
        ends: NDArray[np.float64] | None = None
        if n >= min_sequences(level):
            tail = _tail(n, level)
            ends = np.quantile(_counts(n, resamples, seed) @ chosen / n, [tail, 1 - tail], axis=0)
        for k, column in enumerate(columns):
            low, high = (None, None) if ends is None else (float(ends[0, k]), float(ends[1, k]))
            found[column] = Interval(float(means[k]), low, high, n)
    return found


def _tail(n: int, level: float) -> float:
    """The share of resamples below the interval."""
    from scipy.stats import norm, t

    return float(norm.cdf(-math.sqrt(n / (n - 1)) * t.ppf((1 + level) / 2, n - 1)))


@functools.lru_cache(maxsize=32)
def _counts(n: int, resamples: int, seed: int) -> NDArray[np.float64]:
    """(resamples, n) how often each of n sequences is drawn."""
    rng = np.random.default_rng([seed, n])
    return rng.multinomial(n, np.full(n, 1 / n), size=resamples).astype(float)
