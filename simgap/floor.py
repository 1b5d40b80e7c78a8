"""What the sensor itself leaves: noise, quantisation, and time stamps that are a little off."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from freeart21.se3 import Array

_POINTS = 5
_BINS = 6


@dataclass(frozen=True)
class Floor:
    """Standard deviation of a reading: sqrt(still^2 + (stamp * speed)^2)."""

    still: float
    """rad or m, at rest."""
    stamp_s: float
    """Seconds by which time stamps scatter."""

    def sigma(self, speed: Array) -> Array:
        """(n,) standard deviations at speeds (n,), rad/s or m/s."""
        return np.asarray(np.hypot(self.still, self.stamp_s * speed))


def floor_of(series: list[tuple[Array, Array]]) -> Floor:
    """The floor of one sensor from its runs (times (n,), readings (n,), both finite).

    Five neighbouring readings leave one number that no cubic through them explains (a fourth divided difference). Its
    size, robustly and as a function of speed, is the noise; quantisation is at least a twelfth of its step squared.
    """
    left, speed = (np.concatenate(parts) for parts in zip(*(_left(t, q) for t, q in series), strict=True))
    step = _quantum(np.concatenate([q for _, q in series]))
    order = np.argsort(speed)
    bins = [part for part in np.array_split(order, _BINS) if len(part)]
    variance = np.array([(1.4826 * np.median(np.abs(left[part]))) ** 2 for part in bins])
    squares = np.array([np.mean(speed[part] ** 2) for part in bins])
    still2, stamp2 = _line(squares, variance)
    smallest = 1e-7 * max(float(np.ptp(np.concatenate([q for _, q in series]))), 1e-9)
    return Floor(float(np.sqrt(max(still2, step**2 / 12, smallest**2))), float(np.sqrt(stamp2)))


def _left(times: Array, q: Array) -> tuple[Array, Array]:
    """What five neighbours leave, scaled to one reading's noise, and their speed; (n - 4,) each."""
    n = len(times) - _POINTS + 1
    t = np.stack([times[i : i + n] for i in range(_POINTS)])
    t = (t - t[2]) / np.maximum(t[4] - t[0], 1e-12)
    values = np.stack([q[i : i + n] for i in range(_POINTS)])
    weights = np.stack([1 / np.prod([t[i] - t[j] for j in range(_POINTS) if j != i], axis=0) for i in range(_POINTS)])
    weights /= np.linalg.norm(weights, axis=0)
    speed = np.abs(q[_POINTS - 1 :] - q[:n]) / (times[_POINTS - 1 :] - times[:n])
    return (weights * values).sum(0), speed


def _line(x: Array, y: Array) -> tuple[float, float]:
    """Intercept and slope, neither below 0, of y over x by relative least squares."""
    weight = 1 / np.maximum(y, 1e-3 * y.max() + 1e-300)
    A = np.stack([np.ones_like(x), x], 1) * weight[:, None]
    if np.linalg.matrix_rank(A) == 2:
        still, stamp = np.linalg.lstsq(A, y * weight, rcond=None)[0]
        if still >= 0 and stamp >= 0:
            return float(still), float(stamp)
        if still < 0 and stamp > 0:
            return float(y[0]), float(max(y[-1] - y[0], 0.0) / x[-1])
    return float(np.mean(y)), 0.0


def _quantum(q: Array) -> float:
    """Step between neighbouring values where readings are few distinct ones, else 0."""
    values = np.unique(np.round(q, 12))
    if len(values) > 0.5 * len(q) or len(values) < 2:
        return 0.0
    return float(np.median(np.diff(values)))
