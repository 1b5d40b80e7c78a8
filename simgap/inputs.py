"""What drove a run, as the kernel takes it: values that last until the next one, however the logged ones go on.

A curve between two rows becomes two values, each for half of the time, with the impulse of the curve and the way that
it moves a free part by.
"""

from __future__ import annotations

import numpy as np

from freeart21.measured import Interpolation, Measured, Run
from freeart21.mechanics import course
from freeart21.se3 import Array
from simgap.surrogate import Inputs

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
    row = np.clip(np.searchsorted(times, at, side="right") - 1, 0, len(times) - 1)
    terms = course(times, values, how)[row]
    since = np.maximum(at - times[row], 0.0)
    moved = since * (terms[:, 1] + since * (terms[:, 2] + since * terms[:, 3]))
    return np.asarray(terms[:, 0] + (1 - HALFWAY if how == "unknown" else 1.0) * moved)


def _as_held(times: Array, logged: Array, how: Interpolation, longest_s: float) -> tuple[Array, Array, Array]:
    """Times (i,), the (3, i) values that last from each to the next, and what these have besides if the `logged` ones
    (3, n) are held."""
    if how == "held" or len(times) < 2:
        return times, logged, np.zeros_like(logged)
    terms = np.stack([course(times, series, how) for series in logged])[:, :-1]
    spans = np.diff(times)
    moves = (terms[:, :, 1:] != 0).any((0, 2))
    parts = np.where(moves, np.maximum(np.ceil(spans / (2 * longest_s)), 1), 1).astype(int)
    row = np.repeat(np.arange(len(spans)), parts)  # of every part of a row's time
    span = spans[row] / parts[row]
    begin = span * (np.arange(len(row)) - (np.cumsum(parts) - parts)[row])
    since = begin[:, None] + 0.5 * span[:, None] * (1 + _NODES)
    a, b, c, d = (terms[:, row, k, None] for k in range(4))
    curve = a + since * (b + since * (c + since * d))
    mean, tilt = curve @ _WEIGHTS / 2, curve @ (_WEIGHTS * _NODES)
    series = np.stack([mean - tilt, mean + tilt], -1).reshape(3, -1)
    at = (times[row] + begin)[:, None] + span[:, None] * np.array([0.0, 0.5])
    last = logged[:, -1:]
    beside = np.repeat(logged[:, row], 2, axis=1) - series if how == "unknown" else np.zeros_like(series)
    return np.append(at.ravel(), times[-1]), np.append(series, last, 1), np.append(beside, np.zeros_like(last), 1)
