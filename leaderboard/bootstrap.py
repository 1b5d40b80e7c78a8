"""Bootstrap confidence intervals of the mean difference between two methods on the same sequences."""

from __future__ import annotations

import functools
import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

LEVEL = 0.95
RESAMPLES = 10_000
SEED = 0
KIND = "bootstrap over sequences, paired; percentiles, widened for few sequences as Student's t is (Hesterberg 2015)"


@dataclass(frozen=True)
class Interval:
    """Mean of paired differences, in the metric's unit, with its confidence interval."""

    mean: float
    low: float | None
    """Ends of the interval; None when there are too few sequences."""
    high: float | None
    sequences: int
    """Number of sequences for which both methods have a value."""

    @property
    def significant(self) -> bool:
        """Whether 0 lies outside the interval."""
        return self.low is not None and self.high is not None and not self.low <= 0 <= self.high


def min_sequences(level: float = LEVEL) -> int:
    """Fewest sequences for an interval of `level`.

    All n differences lie on one side of their true median with probability 2^(1-n), which a bootstrap cannot see.
    """
    return math.ceil(1 - math.log2(1 - level))


def describe() -> dict[str, Any]:
    """How intervals are made, for a file."""
    settings = {"level": LEVEL, "resamples": RESAMPLES, "seed": SEED}
    return {"kind": KIND, **settings, "fewest_sequences": min_sequences()}


def bootstrap_intervals(
    differences: ArrayLike, level: float = LEVEL, resamples: int = RESAMPLES, seed: int = SEED
) -> list[Interval | None]:
    """An interval for each column of `differences` (n, k), rows are sequences; NaN where a method has no value.

    None for a column without values. The ends are percentiles of the means of `resamples` resamples of the sequences.
    As plain percentiles cover too rarely for few sequences, the level is widened as Student's t with n - 1 degrees of
    freedom widens an interval of normal quantiles (T. Hesterberg, What Teachers Should Know about the Bootstrap, 2015,
    section 5.3).
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
    """Fraction of the resamples below the interval."""
    from scipy.stats import norm, t

    return float(norm.cdf(-math.sqrt(n / (n - 1)) * t.ppf((1 + level) / 2, n - 1)))


@functools.lru_cache(maxsize=32)
def _counts(n: int, resamples: int, seed: int) -> NDArray[np.float64]:
    """(resamples, n) number of times that each of n sequences is drawn."""
    rng = np.random.default_rng([seed, n])
    return rng.multinomial(n, np.full(n, 1 / n), size=resamples).astype(float)
