"""How probable a theory makes runs that it never saw, when it is not quite right: one formula for every theory.

A reading is off by the sensor's white noise, 1 floor, and by the model's own error, an Ornstein-Uhlenbeck process whose
scale is a share of the run's own motion; share and correlation time are the likeliest on the runs that were fitted. A
run may be worse altogether than others are: its covariance has an unknown factor, so that its readings are Student's t
(a Student-t process: Shah, Wilson and Ghahramani 2014).

    log p(y) = lgamma((v + n) / 2) - lgamma(v / 2) - n/2 log(v pi) - 1/2 log |K| - (v + n)/2 log(1 + y' K^-1 y / v)
    K = I + s^2 exp(-|t - t'| / T)

in n steps, by the Kalman filter of that process (Hartikainen and Sarkka 2010).
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
"""v: the fewest whole degrees of freedom but for which runs would have no finite kurtosis at all. Not measured."""
_SHARES = np.geomspace(1e-5, 1.0, 26)
"""Of a run's own motion that the model's error is tried at."""
_TIMES = np.geomspace(2.0, 2000.0, 10)
"""Readings that it lasts for, likewise."""


@dataclass(frozen=True)
class ModelError:
    """By how much a theory is off beyond the sensor's noise."""

    share: float
    """Standard deviation, as a part of that of the run's own motion."""
    seconds: float
    """Correlation time."""


@njit(cache=True)
def _log_likelihoods(
    residuals: Array, times: Array, begins: Array, motions: Array, least: Array, shares: Array, seconds: float
) -> Array:  # pragma: no cover
    """(k,) log density of runs, one behind the other from begins[r] to begins[r + 1], by the model's error as `shares`
    (k,) of their motions, `least` floors of it being known: up to what does not hang on it."""
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
    """(n,) of the first 1, 2, ... n readings: y' K^-1 y and log |K|, with white noise of 1."""
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
        left: (n,) reading less prediction, in floors.
        times_s: (n,)
        scale: standard deviation of the model's error, in floors.
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
    """Size of a run's readings, in floors."""
    return run.reading_scale / float(np.sqrt(np.mean(run.sigma**2)))


def estimate_model_error(
    residuals: dict[str, Array], runs: Sequence[FitRun], least: dict[str, float] | None = None
) -> ModelError:
    """The likeliest model error of `residuals` (in floors, by run), those of `runs` that they name; by how many floors
    a model is off at `least`, by run, is known beforehand."""
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
    """(count,) log density of every stretch of a run, given what came before it; the run's own is their sum. The
    model's error is `least` floors at least."""
    scale = float(np.hypot(error.share * motion_scale(run), least))
    sums = log_densities(residuals, run.times_s, scale, error.seconds)
    ends = np.array([len(residuals) * (k + 1) // count for k in range(count)]) - 1
    return np.diff(sums[ends], prepend=0.0)


DECISIVE_LOG_ODDS = float(np.log(20.0))
"""Log probability that sets must differ by to be told apart at all, where all runs agree on it: twenty to one is strong
evidence (Kass and Raftery 1995)."""


@dataclass(frozen=True)
class Score:
    """A theory before runs that it never saw."""

    names: tuple[str, ...]
    parts: Array
    """(k,) log density of every stretch, the same stretches for all theories."""
    penalty: float = 0.0
    """What the fitted ones among them are too large by, for the numbers that were fitted."""

    @property
    def size(self) -> int:
        """How many effects it has, those of very many numbers counting for several."""
        return sum(EFFECTS[name].complexity if name in EFFECTS else 1 for name in self.names)

    @property
    def total(self) -> float:
        """Log density of all runs."""
        return float(self.parts.sum()) - self.penalty


def score_difference(score: Score, other: Score) -> tuple[float, float]:
    """By how much a theory makes the runs more probable than another does, and the standard error of that: stretches
    are paired, since they are hard or easy for both; never less than what is decisive."""
    more = score.parts - other.parts
    error = float(np.sqrt(len(more)) * np.std(more, ddof=1)) if len(more) > 1 else float("inf")
    return score.total - other.total, max(error, DECISIVE_LOG_ODDS)


def select_smallest(scores: Sequence[Score]) -> tuple[Score, ...]:
    """The smallest theories within one standard error of the best, the most probable first (Breiman's rule; those are a
    model confidence set of their size). Of theories of one size the predictions count, and not the price: two that
    predict the same are told apart by nothing."""
    best = max(scores, key=lambda s: s.total)
    near = []
    for score in scores:
        behind, error = score_difference(best, score)
        dearer = score.penalty - best.penalty if score.size == best.size else 0.0
        if score is best or behind - max(dearer, 0.0) <= error:
            near.append(score)
    fewest = min(s.size for s in near)
    return tuple(sorted((s for s in near if s.size == fewest), key=lambda s: -s.total))
