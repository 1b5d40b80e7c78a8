"""What drove a run, as the kernel takes it: values that last until the next one, however the logged ones go on.

A curve between two rows becomes two values, each for half of the time, with the impulse of the curve and the way that
it moves a free part by.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from freeart21.measured import Interpolation, Measured, Run
from freeart21.mechanics import course
from freeart21.se3 import Array
from simgap.motion.surrogate import Inputs

_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(3)
"""Of a stretch as -1 to 1: exact for the cubics that curves are, and for their first moments."""
HALFWAY = 0.5
"""Part that is taken to be held of what nobody knows, where that is not fitted."""


def inputs_of(run: Run, measured: Measured, longest_s: float = np.inf) -> Inputs:
    """What drove a run; no value lasts longer than `longest_s` where a curve is to be followed."""
    if run.effort is None and run.q_command is None:
        return Inputs()
    nothing = np.zeros(len(run.times_s))
    effort = nothing if run.effort is None else run.effort
    command = nothing if run.q_command is None else run.q_command
    commanded = measured.effort_kind == "commanded"
    logged = np.stack([command, effort if commanded else nothing, nothing if commanded else effort])
    times, series, beside = _as_held(run.times_s, logged, measured.interpolation, longest_s)
    told = np.concatenate([series, beside])
    new = np.append(True, (np.diff(told) != 0).any(0))  # a value lasts: only where it changes matters
    asked = np.full(int(new.sum()), np.nan) if run.q_command is None else series[0, new]
    extra = np.ascontiguousarray(beside[:, new]) if beside.any() else None
    return Inputs(np.ascontiguousarray(times[new]), asked, series[1, new].copy(), series[2, new].copy(), extra)


def logged_at(times: Array, values: Array, how: Interpolation, at: Array) -> Array:
    """(m,) a logged series (n,) at the times `at` (m,)."""
    base, moved = _Logged(times, values, how)(at, at)
    return np.asarray(base + (1 - HALFWAY if how == "unknown" else 1.0) * (moved - base))


class _Logged:
    """A series (n,) as it goes on from the rows in which it was logged, not NaN."""

    def __init__(self, times: Array, values: Array, how: Interpolation):
        known = np.isfinite(values)
        self.times = times[known]
        self.terms = course(self.times, values[known], how)

    def row(self, at: Array) -> NDArray[np.int64]:
        """(m,) the last one by the times `at`."""
        return np.clip(np.searchsorted(self.times, at, side="right") - 1, 0, len(self.times) - 1)

    def __call__(self, begin: Array, at: Array) -> tuple[Array, Array]:
        """Values of the rows that last at the times `begin`, and of their curves at the times `at`, (m, ...) each."""
        row = self.row(begin)
        since = np.maximum(at - self.times[row], 0.0)
        a, b, c, d = self.terms[row].T
        return a, a + since * (b + since * (c + since * d))


def _as_held(times: Array, logged: Array, how: Interpolation, longest_s: float) -> tuple[Array, Array, Array]:
    """Times (i,), the (3, i) values that last from each to the next, and what these have besides if the `logged` ones
    (3, n) are held."""
    channels = [_Logged(times, values, how) for values in logged]
    if how == "held" or len(times) < 2:
        series = np.stack([channel(times, times)[0] for channel in channels])
        return times, series, np.zeros_like(series)
    spans = np.diff(times)
    moves = np.any([(c.terms[c.row(times[:-1]), 1:] != 0).any(1) for c in channels], 0)
    parts = np.where(moves, np.maximum(np.ceil(spans / (2 * longest_s)), 1), 1).astype(int)
    row = np.repeat(np.arange(len(spans)), parts)  # of every part of a row's time
    span = spans[row] / parts[row]
    begin = times[row] + span * (np.arange(len(row)) - (np.cumsum(parts) - parts)[row])
    nodes = begin + 0.5 * span * (1 + _NODES[:, None])
    told = [channel(times[row], nodes) for channel in channels]
    mean, tilt = (np.stack([weights @ curve for _, curve in told]) for weights in (_WEIGHTS / 2, _WEIGHTS * _NODES))
    series = np.stack([mean - tilt, mean + tilt], -1).reshape(3, -1)
    at = begin[:, None] + span[:, None] * np.array([0.0, 0.5])
    last = np.stack([channel(times[-1:], times[-1:])[1] for channel in channels])
    base = np.repeat(np.stack([held for held, _ in told]), 2, axis=1)
    beside = base - series if how == "unknown" else np.zeros_like(series)
    return np.append(at.ravel(), times[-1]), np.append(series, last, 1), np.append(beside, np.zeros_like(last), 1)
