"""Force on a joint from a logged motion of its base."""

from __future__ import annotations

import math
from bisect import bisect_right
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from freeart21 import se3
from freeart21.base_motion import FrameMotion, base_motion_terms
from freeart21.errors import FreeArtError
from freeart21.measured import BaseAxis, BaseSeries
from freeart21.mechanics import JointMechanics
from freeart21.se3 import Array
from simgap.measure.noise import estimate_noise

_ORDER = 4
"""Order of the local polynomials that are differentiated (Savitzky and Golay 1964)."""
_WINDOWS = (7, 11, 17, 25, 37, 55, 81, 121, 181, 271)
"""Window lengths of these polynomials, rows."""
_MAX_RMS_RATIO, _MAX_PEAK_RATIO = 1.15, 3.0
"""Largest residual of a polynomial over the sensor's noise: RMS, and 99th percentile (2.6 for white noise). Not
measured."""
_ROWS_PER_WINDOW = 8
"""Samples per window at which derivatives are evaluated; they vary no faster."""


@dataclass(frozen=True)
class BaseForce:
    """Force of a moving base, linear between its times, constant beyond."""

    times_s: Array
    """(b,)"""
    terms: Array
    """(8, b) for `freeart21.base_motion.base_motion_force`."""

    def at(self, times_s: Array | float) -> Array:
        """(8, n) terms at times (n,)."""
        return np.stack([np.interp(times_s, self.times_s, row) for row in self.terms])

    def function(self, begin_s: float) -> Callable[[float, float], float]:
        """A function of position and time since `begin_s` to the force, N*m or N, for simulators."""
        times, rows = self.times_s.tolist(), self.terms.T.tolist()

        def force(q: float, t: float) -> float:  # `base_motion_force` on floats, 10 times faster
            t += begin_s
            i = min(max(bisect_right(times, t) - 1, 0), len(times) - 2)
            share = min(max((t - times[i]) / (times[i + 1] - times[i]), 0.0), 1.0)
            a, b, k, c1, s1, c2, s2, n = (x + share * (y - x) for x, y in zip(rows[i], rows[i + 1], strict=True))
            c, s = math.cos(q), math.sin(q)
            own = k + c1 * c + s1 * s + c2 * (c * c - s * s) + 2 * s2 * s * c + n * q
            return a * c + b * s + own

        return force


def make_base_force(
    times_s: Array,
    base: BaseSeries,
    turns: BaseAxis | None,
    mechanics: JointMechanics,
    T_parent_canonical: Array,
    base_is_parent: bool = True,
) -> BaseForce:
    """The force of a base that moves.

    Args:
        times_s: (n,) of the rows of `base`.
        base: its motion.
        turns: its rotation axis, where it has an angle.
        mechanics: the joint, in the frame of its parent link, with the base at rest.
        T_parent_canonical: (4, 4) pose of the canonical frame.
        base_is_parent: whether the base is on the joint's parent side.

    Raises FreeArtError when it is not: it then carries another part.
    """
    if not base_is_parent:
        raise FreeArtError(f"the base of joint '{mechanics.joint.name}' moves, but it is on the joint's child side")
    rows = [r for r in (base.position, base.acceleration, base.angle) if r is not None]
    window = min((_choose_window(times_s, r) for r in _position_columns(base)), default=_WINDOWS[0])
    step = float(np.median(np.diff(times_s))) * max(1, window // _ROWS_PER_WINDOW)
    at = np.arange(times_s[0], times_s[-1] + 0.5 * step, step) if rows else times_s[[0, -1]]
    zero = np.zeros((len(at), 3))
    pushed, angle, rate, change = zero, *(np.zeros(len(at)) for _ in range(3))
    if base.position is not None:
        pushed = np.stack([_differentiate(times_s, column, at)[2] for column in base.position.T], 1)
    if base.acceleration is not None:
        pushed = np.stack([_interpolate(times_s, column, at) for column in base.acceleration.T], 1)
    axis, point = (np.array([0.0, 0.0, 1.0]), np.zeros(3)) if turns is None else (turns.axis, turns.point)
    if base.angle is not None:
        angle, rate, change = _differentiate(times_s, base.angle, at)
    back = se3.exp_so3(-angle[:, None] * axis)  # from the directions at rest to the base's
    to = T_parent_canonical[:3, :3]
    g = np.einsum("nij,j->ni", back, to.T @ mechanics.gravity)
    w, dw = np.outer(rate, axis), np.outer(change, axis)
    arm = se3.inverse(T_parent_canonical)[:3, 3] - point
    a = np.einsum("nij,nj->ni", back, pushed) + np.cross(dw, arm) + np.cross(w, np.cross(w, arm))
    return BaseForce(at, base_motion_terms(mechanics, FrameMotion(*(series @ to.T for series in (a, w, dw, g)))))


def _position_columns(base: BaseSeries) -> list[Array]:
    """Series that have to be differentiated."""
    found = [] if base.position is None else list(base.position.T)
    return found + ([] if base.angle is None else [base.angle])


def _interpolate(times: Array, values: Array, at: Array) -> Array:
    known = np.isfinite(values)
    return np.interp(at, times[known], values[known])


def _resample(times: Array, values: Array) -> tuple[Array, Array, float]:
    """Even times, values there, and their step."""
    step = float(np.median(np.diff(times)))
    even = times[0] + step * np.arange(int(np.floor((times[-1] - times[0]) / step + 1e-6)) + 1)
    return even, _interpolate(times, values, even), step


def _choose_window(times: Array, values: Array) -> int:
    """Length, rows, of the longest window whose polynomials leave no more than noise and quantisation."""
    from scipy.signal import savgol_filter

    even, x, _ = _resample(times, values)
    noise = estimate_noise([(even, x)]).sigma_at_rest
    widest = _WINDOWS[0]
    for w in (w for w in _WINDOWS if w < len(x) // 2):
        left = x - savgol_filter(x, w, _ORDER)
        if w > widest and (
            np.sqrt(np.mean(left**2)) > _MAX_RMS_RATIO * noise
            or np.quantile(np.abs(left), 0.99) > _MAX_PEAK_RATIO * noise
        ):
            break
        widest = w
    return widest


def _differentiate(times: Array, values: Array, at: Array) -> tuple[Array, Array, Array]:
    """(m,) values, first and second derivatives at times `at`."""
    from scipy.signal import savgol_filter

    even, x, step = _resample(times, values)
    w = _choose_window(times, values)
    if len(x) <= w:
        raise FreeArtError(f"the base's motion has {len(x)} rows, expected more than {w} for its accelerations")
    found = [savgol_filter(x, w, _ORDER, deriv=k, delta=step) for k in range(3)]
    value, rate, change = (np.interp(at, even, series) for series in found)
    return value, rate, change
