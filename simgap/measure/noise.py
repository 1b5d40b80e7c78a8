"""Sensor noise: white noise, quantisation, and jitter of time stamps."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.stats import chi2

from freeart21.se3 import Array

_WINDOWS = ((5, 3), (11, 4))
"""Window length (readings) and order of the local polynomials."""
_MOST = 1000
"""Windows of a run that are used."""
_BINS = 6
_FAR = 8
"""Readings on either side that give the speed."""


@dataclass(frozen=True)
class SensorNoise:
    """Standard deviation of a reading: sqrt(sigma_at_rest^2 + (time_jitter_s * speed)^2)."""

    sigma_at_rest: float
    """rad or m."""
    time_jitter_s: float
    """Standard deviation of time stamps."""

    def sigma(self, speed: Array) -> Array:
        """(n,) standard deviations at speeds (n,), rad/s or m/s."""
        return np.asarray(np.hypot(self.sigma_at_rest, self.time_jitter_s * speed))


def estimate_noise(series: list[tuple[Array, Array]]) -> SensorNoise:
    """Noise of one sensor from its runs (times (n,), readings (n,), both finite).

    Residuals of local polynomials, robustly and as a function of speed, are the noise; quantisation is at least step^2
    / 12. Short windows take slow motion over quantisation steps for noise, long ones take fast turns for it, so the
    smaller estimate is used.
    """
    readings = np.concatenate([q for _, q in series])
    step = _quantisation_step(readings)
    smallest = 1e-7 * max(float(np.ptp(readings)), 1e-9)
    found = [_fit_noise(series, *window, step) for window in _WINDOWS]
    still2, stamp2 = min(found, key=lambda f: f[0] + f[2] * f[1])[:2]
    return SensorNoise(float(np.sqrt(max(still2, step**2 / 12, smallest**2))), float(np.sqrt(stamp2)))


def _fit_noise(series: list[tuple[Array, Array]], points: int, order: int, step: float) -> tuple[float, float, float]:
    """Variance at rest, its growth with speed squared, and the mean square of speed."""
    parts = [_local_residuals(t, q, points, order) for t, q in series if len(q) >= points]
    if not parts:
        return np.inf, 0.0, 0.0
    left2, speed, ways = (np.concatenate(column) for column in zip(*parts, strict=True))
    moving = ways > step  # at rest quantisation hides the noise
    if moving.sum() > max(100, 0.05 * len(moving)):
        left2, speed = left2[moving], speed[moving]
    free = points - order - 1
    bins = [part for part in np.array_split(np.argsort(speed), _BINS) if len(part)]
    variance = np.array([np.median(left2[part]) for part in bins]) / chi2.median(free)
    squares = np.array([np.mean(speed[part] ** 2) for part in bins])
    return (*_fit_line(squares, variance), float(np.mean(squares)))


def _local_residuals(times: Array, q: Array, points: int, order: int) -> tuple[Array, Array, Array]:
    """Per window: sum of squared residuals of a polynomial, speed, and displacement over five readings; (n - points +
    1,) each."""
    n = len(times) - points + 1
    at = np.arange(n)[:: -(-n // _MOST)]
    t, values = times[at[:, None] + np.arange(points)], q[at[:, None] + np.arange(points)]
    long = np.maximum(t[:, -1:] - t[:, :1], 1e-12)
    basis = np.linalg.qr(((t - t.mean(1, keepdims=True)) / long)[..., None] ** np.arange(order + 1))[0]
    around = values - values.mean(1, keepdims=True)
    left = around - (basis @ (basis.transpose(0, 2, 1) @ around[..., None]))[..., 0]
    first, last = np.maximum(at - _FAR, 0), np.minimum(at + points - 1 + _FAR, len(q) - 1)
    return (
        (left**2).sum(1),
        np.abs(values[:, -1] - values[:, 0]) / long[:, 0],
        np.abs(q[last] - q[first]) * 4 / (last - first),
    )


def _fit_line(x: Array, y: Array) -> tuple[float, float]:
    """Intercept and slope, both 0 or more, of y over x by relative least squares."""
    weight = 1 / np.maximum(y, 1e-3 * y.max() + 1e-300)
    A = np.stack([np.ones_like(x), x], 1) * weight[:, None]
    if np.linalg.matrix_rank(A) == 2:
        still, stamp = np.linalg.lstsq(A, y * weight, rcond=None)[0]
        if still >= 0 and stamp >= 0:
            return float(still), float(stamp)
        if still < 0 and stamp > 0:
            return float(y[0]), float(max(y[-1] - y[0], 0.0) / x[-1])
    return float(np.mean(y)), 0.0


def _quantisation_step(q: Array) -> float:
    """Step between values where readings are few distinct ones, else 0."""
    values = np.unique(np.round(q, 12))
    if len(values) > 0.5 * len(q) or len(values) < 2:
        return 0.0
    return float(np.median(np.diff(values)))
