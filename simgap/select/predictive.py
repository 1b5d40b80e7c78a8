"""Log predictive density of runs under a model that is not exact.

A reading has white sensor noise of 1 sigma and the error of the model, an Ornstein-Uhlenbeck process whose scale is a
share of the run's motion. Share and correlation time are the most likely ones of the training runs. The covariance of a
run has an unknown factor, so its readings follow Student's t (a Student-t process: Shah, Wilson and Ghahramani 2014).

    log p(y) = lgamma((v + n) / 2) - lgamma(v / 2) - n/2 log(v pi) - 1/2 log |K| - (v + n)/2 log(1 + y' K^-1 y / v)
    K = I + s^2 exp(-|t - t'| / T)

It takes n steps of the Kalman filter of that process (Hartikainen and Sarkka 2010).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numba import njit
from scipy.special import gammaln

from freeart21.effects import EFFECTS
from freeart21.se3 import Array
from simgap.measure.data import FitRun

DEGREES_OF_FREEDOM = 4.0
"""v: the smallest integer but for which runs would have no finite kurtosis. Not measured."""
_SHARES = np.geomspace(1e-5, 1.0, 26)
"""Grid of the model error's scale, as share of the run's motion."""
_TIMES = np.geomspace(2.0, 2000.0, 10)
"""Grid of its correlation time, in readings."""


@dataclass(frozen=True)
class ModelError:
    """Error of a model beyond the sensor's noise."""

    share: float
    """Standard deviation, as a share of that of the run's motion."""
    seconds: float
    """Correlation time."""


@njit(cache=True)
def _log_likelihoods(
    residuals: Array, times: Array, begins: Array, motions: Array, least: Array, shares: Array, seconds: float
) -> Array:  # pragma: no cover
    """(k,) log density of all runs, up to constants, for model errors of `shares` (k,) of the runs' `motions`, and at
    least `least` sigmas. Readings of run r are at begins[r] to begins[r + 1]."""
    found, v = np.zeros(len(shares)), DEGREES_OF_FREEDOM
    for r in range(len(motions)):
        a, b = begins[r], begins[r + 1]
        decay = np.exp(-np.diff(times[a:b]) / seconds)
        for k in range(len(shares)):
            power = (shares[k] * motions[r]) ** 2 + least[r] ** 2
            mean, variance, square, log, factor = 0.0, power, 0.0, 0.0, 1.0
            for i in range(b - a):
                if i:
                    c = decay[i - 1]
                    mean, variance = c * mean, power + c * c * (variance - power)
                spread, innovation = variance + 1.0, residuals[a + i] - mean
                square += innovation * innovation / spread
                factor *= spread
                if factor > 1e200:
                    log, factor = log + np.log(factor), 1.0
                mean += variance / spread * innovation
                variance /= spread
            log += np.log(factor)
            found[k] -= 0.5 * log + 0.5 * (v + b - a) * np.log1p(square / v)
    return found


@njit(cache=True)
def _filter(residuals: Array, times: Array, scale: float, seconds: float) -> tuple[Array, Array]:  # pragma: no cover
    """(n,) y' K^-1 y and log |K| of the first 1, 2, ... n readings, with white noise of 1."""
    squares, logs = np.empty(len(residuals)), np.empty(len(residuals))
    mean, variance, square, log = 0.0, scale * scale, 0.0, 0.0
    for i in range(len(residuals)):
        if i:
            decay = np.exp(-(times[i] - times[i - 1]) / seconds)
            mean, variance = decay * mean, decay * decay * variance + scale * scale * (1.0 - decay * decay)
        spread, innovation = variance + 1.0, residuals[i] - mean
        square += innovation * innovation / spread
        log += np.log(spread)
        squares[i], logs[i] = square, log
        mean += variance / spread * innovation
        variance -= variance * variance / spread
    return squares, logs


def log_densities(residuals: Array, times_s: Array, scale: float, seconds: float) -> Array:
    """(n,) log density of the first 1, 2, ... n readings.

    Args:
        residuals: (n,) normalised.
        times_s: (n,)
        scale: standard deviation of the model's error, sigmas.
        seconds: its correlation time.
    """
    squares, logs = _filter(np.asarray(residuals, float), np.asarray(times_s, float), float(scale), float(seconds))
    return _log_student(squares, logs, np.arange(1, len(residuals) + 1))


def _log_student(squares: Any, logs: Any, n: Any) -> Any:
    whole = (
        gammaln((DEGREES_OF_FREEDOM + n) / 2)
        - gammaln(DEGREES_OF_FREEDOM / 2)
        - n / 2 * np.log(DEGREES_OF_FREEDOM * np.pi)
    )
    return whole - 0.5 * logs - (DEGREES_OF_FREEDOM + n) / 2 * np.log1p(squares / DEGREES_OF_FREEDOM)


def motion_scale(run: FitRun) -> float:
    """Size of a run's readings, in noise sigmas."""
    return run.reading_scale / float(np.sqrt(np.mean(run.sigma**2)))


def estimate_model_error(
    residuals: dict[str, Array], runs: Sequence[FitRun], least: dict[str, float] | None = None
) -> ModelError:
    """The most likely model error of normalised `residuals` (by run), of those `runs` that they name. `least` is a
    known lower bound of its scale, sigmas, by run."""
    seen = [run for run in runs if run.name in residuals]
    step = float(np.median(np.concatenate([np.diff(run.times_s) for run in seen])))
    flat = np.concatenate([residuals[run.name] for run in seen]).astype(float)
    times = np.concatenate([run.times_s for run in seen]).astype(float)
    begins = np.cumsum([0, *(len(run.q) for run in seen)])
    motions = np.array([motion_scale(run) for run in seen])
    known = np.array([(least or {}).get(run.name, 0.0) for run in seen])
    tried = np.array([_log_likelihoods(flat, times, begins, motions, known, _SHARES, n * step) for n in _TIMES])
    n, share = np.unravel_index(int(np.argmax(tried)), tried.shape)
    return ModelError(float(_SHARES[share]), float(_TIMES[n] * step))


def stretch_densities(residuals: Array, run: FitRun, error: ModelError, count: int, least: float = 0.0) -> Array:
    """(count,) log density of each stretch of a run given the stretches before it; they add up to the run's. The model
    error is at least `least` sigmas."""
    scale = float(np.hypot(error.share * motion_scale(run), least))
    sums = log_densities(residuals, run.times_s, scale, error.seconds)
    ends = np.array([len(residuals) * (k + 1) // count for k in range(count)]) - 1
    return np.diff(sums[ends], prepend=0.0)


DECISIVE_LOG_ODDS = float(np.log(20.0))
"""Least difference of log probabilities to distinguish two sets, where all runs agree: odds of twenty to one are strong
evidence (Kass and Raftery 1995)."""


@dataclass(frozen=True)
class Score:
    """Log predictive densities of a model."""

    names: tuple[str, ...]
    parts: Array
    """(k,) log density of each stretch, the same stretches for all models."""
    penalty: float = 0.0
    """Optimism of the training stretches among them."""

    @property
    def size(self) -> int:
        """Number of effects; free shapes count for several."""
        return sum(EFFECTS[name].complexity if name in EFFECTS else 1 for name in self.names)

    @property
    def total(self) -> float:
        """Penalised log density of all runs."""
        return float(self.parts.sum()) - self.penalty


def score_difference(score: Score, other: Score) -> tuple[float, float]:
    """Difference of two models' log densities and its standard error. Stretches are paired, since they are hard or easy
    for both. The error is at least DECISIVE_LOG_ODDS."""
    more = score.parts - other.parts
    error = float(np.sqrt(len(more)) * np.std(more, ddof=1)) if len(more) > 1 else float("inf")
    return score.total - other.total, max(error, DECISIVE_LOG_ODDS)


def select_smallest(scores: Sequence[Score]) -> tuple[Score, ...]:
    """The smallest models within one standard error of the best, the most probable first (Breiman's rule). Among models
    of one size penalties do not count: two that predict the same are indistinguishable."""
    best = max(scores, key=lambda s: s.total)
    near = []
    for score in scores:
        behind, error = score_difference(best, score)
        dearer = score.penalty - best.penalty if score.size == best.size else 0.0
        if score is best or behind - max(dearer, 0.0) <= error:
            near.append(score)
    fewest = min(s.size for s in near)
    return tuple(sorted((s for s in near if s.size == fewest), key=lambda s: -s.total))
