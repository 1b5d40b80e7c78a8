"""Inputs of a run as the kernel takes them: piecewise constant, whatever the interpolation of the log.

A curve between two rows becomes two constant values, each for half of the time, with the same impulse and the same
displacement of a free body.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from freeart21.measured import Interpolation, Measured, Run
from freeart21.mechanics import DriveLaw, interpolation_terms
from freeart21.se3 import Array
from simgap.measure.base_motion import BaseForce, make_base_force
from simgap.models.surrogate import Inputs, Plant

_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(3)
"""Gauss-Legendre on [-1, 1]: exact for the cubics of the curves, and for their first moments."""
_MERGE_DENSITY = 4.0
"""Values per longest step above which they are merged: a log of 10 kHz would need a hundred times as many steps as the
simulation."""
_STEP_SHARE = 0.05
"""Jump between two values, as a share of the series' range, that is a step and not merged."""
_LIMIT_REFINEMENT = 4.0
"""Refinement of the longest step for a drive with limits or a dead band, which means do not represent."""
DEFAULT_HOLDING = 0.5
"""Share of zero-order hold for inputs of unknown interpolation, where it is not fitted."""


def make_inputs(run: Run, measured: Measured, longest_s: float = np.inf, plant: Plant | None = None) -> Inputs:
    """The inputs of a run; curves are resolved to `longest_s`. A moving base needs the `plant` that stands on it."""
    driven = _actuator_inputs(run, measured, longest_s)
    if run.base is None or plant is None:
        return driven
    return _add_base_motion(driven, base_force_of(run, measured, plant), longest_s)


def base_force_of(run: Run, measured: Measured, plant: Plant) -> BaseForce:
    """Force of the base on the joint in a run with base motion."""
    assert run.base is not None
    T, side = plant.T_parent_canonical, plant.base_is_parent
    return make_base_force(run.times_s, run.base, measured.base_axis, plant.mechanics, T, side)


def _add_base_motion(driven: Inputs, base_force: BaseForce, longest_s: float) -> Inputs:
    """The inputs with the force of a moving base, linear between its times."""
    own, terms, _ = _hold_values(base_force.times_s, base_force.terms, "linear", longest_s)
    own, terms = _merge_dense(own, terms, longest_s, np.zeros(0))
    times = np.union1d(own, driven.times_s)

    def lasting(values: Array, since: Array, none: float) -> Array:
        if not len(since):
            return np.full((*values.shape[:-1], len(times)), none)
        return np.asarray(values[..., np.clip(np.searchsorted(since, times, side="right") - 1, 0, len(since) - 1)])

    d, on = driven, None
    if d.on is not None or not len(d.times_s):
        on = lasting(np.ones(0) if d.on is None else d.on.astype(float), d.times_s, 0.0) > 0
    return Inputs(
        times,
        lasting(d.command, d.times_s, np.nan),
        lasting(d.effort, d.times_s, 0.0),
        lasting(d.push, d.times_s, 0.0),
        None if d.hold_difference is None else lasting(d.hold_difference, d.times_s, 0.0),
        on,
        np.ascontiguousarray(lasting(terms, own, 0.0)),
    )


def _actuator_inputs(run: Run, measured: Measured, longest_s: float) -> Inputs:
    """Inputs of an actuator or a push."""
    if run.effort is None and run.q_command is None and run.voltage is None:
        return Inputs()
    nothing = np.zeros(len(run.times_s))
    commanded, push = split_efforts(run, measured)
    command = nothing if run.q_command is None else run.q_command
    logged = np.stack([command, nothing if commanded is None else commanded, nothing if push is None else push])
    times, series, hold_difference = _hold_values(run.times_s, logged, measured.interpolation, longest_s)
    switched = np.zeros(0) if run.enabled is None else run.times_s[1:][np.diff(run.enabled > 0)]
    law = DriveLaw() if measured.actuator is None else measured.actuator.law
    limited = law.dead_band > 0 or min(law.max_force, law.max_commanded) < np.inf
    lasts = longest_s / _LIMIT_REFINEMENT if limited else longest_s
    times, both = _merge_dense(times, np.concatenate([series, hold_difference]), lasts, switched)
    series, hold_difference = both[:3], both[3:]
    on = enabled_at(run, times, commanded is not None)
    stacked = np.concatenate([series, hold_difference, [on]])
    new = np.append(True, (np.diff(stacked) != 0).any(0))  # only changes matter
    follows = np.full(int(new.sum()), np.nan) if run.q_command is None else series[0, new]
    extra = np.ascontiguousarray(hold_difference[:, new]) if hold_difference.any() else None
    drives = None if on.all() else on[new]
    return Inputs(
        np.ascontiguousarray(times[new]), follows, series[1, new].copy(), series[2, new].copy(), extra, drives
    )


def split_efforts(run: Run, measured: Measured) -> tuple[Array | None, Array | None]:
    """(n,) commanded effort of the actuator, voltage included, and effort that acts on the part; None for none."""
    commanded = run.effort if measured.effort_kind == "commanded" else None
    motor = measured.actuator.motor if measured.actuator is not None else None
    if run.voltage is not None and motor is not None:
        volts = motor.per_volt * run.voltage
        commanded = volts if commanded is None else commanded + volts
    return commanded, run.effort if measured.effort_kind == "external" else None


def enabled_at(run: Run, at: Array, commanded: bool) -> NDArray[np.bool_]:
    """(m,) whether the actuator is on at times `at`; `commanded` is whether it had commanded efforts."""
    if not commanded and run.q_command is None:
        return np.zeros(len(at), bool)
    if run.enabled is None:
        return np.ones(len(at), bool)
    known = np.isfinite(run.enabled)
    return np.asarray(logged_at(run.times_s[known], run.enabled[known], "held", at) > 0)


def logged_at(times: Array, values: Array, how: Interpolation, at: Array) -> Array:
    """(m,) a logged series (n,) at times `at` (m,)."""
    base, moved = _Logged(times, values, how)(at, at)
    return np.asarray(base + (1 - DEFAULT_HOLDING if how == "unknown" else 1.0) * (moved - base))


class _Logged:
    """A series (n,) with its interpolation; NaN rows were not logged."""

    def __init__(self, times: Array, values: Array, how: Interpolation):
        known = np.isfinite(values)
        self.times = times[known]
        self.terms = interpolation_terms(self.times, values[known], how)

    def row(self, at: Array) -> NDArray[np.int64]:
        """(m,) the last row before the times `at`."""
        return np.clip(np.searchsorted(self.times, at, side="right") - 1, 0, len(self.times) - 1)

    def __call__(self, begin: Array, at: Array) -> tuple[Array, Array]:
        """(m, ...) values held at the times `begin`, and of the curve from there at the times `at`."""
        row = self.row(begin)
        since = np.maximum(at - self.times[row], 0.0)
        a, b, c, d = self.terms[row].T
        return a, a + since * (b + since * (c + since * d))


def _merge_dense(times: Array, values: Array, longest_s: float, cuts: Array) -> tuple[Array, Array]:
    """Values (k, i) from `times` (i,) on, merged where far denser than `longest_s`, but not across `cuts`: two per
    step, with the same impulse and displacement of a free body."""
    begin, end = times[0], times[-1]
    if not np.isfinite(longest_s) or (end - begin) / len(times) > longest_s / _MERGE_DENSITY:
        return times, values
    edges = begin + longest_s * np.arange(int((end - begin) / longest_s) + 1)
    leaps = times[1:][(np.abs(np.diff(values)) > _STEP_SHARE * np.ptp(values, axis=1, keepdims=True)).any(0)]
    cuts = np.append(cuts, leaps) if len(leaps) < len(edges) else cuts
    edges = np.unique(np.clip(np.concatenate([edges, cuts, [end]]), begin, end))
    spans, at = np.diff(edges), edges - begin
    impulse, moment = np.diff(_integrals(times - begin, values, at), axis=-1)
    tilt = 4 * (moment - impulse * 0.5 * (at[1:] + at[:-1])) / spans**2
    pairs = np.stack([impulse / spans - tilt, impulse / spans + tilt], -1).reshape(len(values), -1)
    halves = (edges[:-1, None] + spans[:, None] * np.array([0.0, 0.5])).ravel()
    return np.append(halves, end), np.append(pairs, values[:, -1:], 1)


def _integrals(since: Array, values: Array, at: Array) -> Array:
    """(2, k, m) integrals up to the times `at` (m,) of piecewise constant values (k, i), and of these times time."""
    row = np.clip(np.searchsorted(since, at, side="right") - 1, 0, len(since) - 1)
    ahead, zero = at - since[row], np.zeros((len(values), 1))
    whole = values[:, :-1] * np.diff(since)
    sums = [np.cumsum(part, 1) for part in (whole, whole * 0.5 * (since[1:] + since[:-1]))]
    before = np.stack([np.concatenate([zero, part], 1)[:, row] for part in sums])
    own = values[:, row] * ahead
    return before + np.stack([own, own * 0.5 * (at + since[row])])


def _hold_values(times: Array, logged: Array, how: Interpolation, longest_s: float) -> tuple[Array, Array, Array]:
    """Times (i,), piecewise constant values (k, i), and their change under zero-order hold of the `logged` ones (k,
    n)."""
    channels = [_Logged(times, values, how) for values in logged]
    if how == "held" or len(times) < 2:
        series = np.stack([channel(times, times)[0] for channel in channels])
        return times, series, np.zeros_like(series)
    spans = np.diff(times)
    moves = np.any([(c.terms[c.row(times[:-1]), 1:] != 0).any(1) for c in channels], 0)
    parts = np.where(moves, np.maximum(np.ceil(spans / (2 * longest_s)), 1), 1).astype(int)
    row = np.repeat(np.arange(len(spans)), parts)  # of each part
    span = spans[row] / parts[row]
    begin = times[row] + span * (np.arange(len(row)) - (np.cumsum(parts) - parts)[row])
    nodes = begin + 0.5 * span * (1 + _NODES[:, None])
    stacked = [channel(times[row], nodes) for channel in channels]
    mean, tilt = (np.stack([weights @ curve for _, curve in stacked]) for weights in (_WEIGHTS / 2, _WEIGHTS * _NODES))
    series = np.stack([mean - tilt, mean + tilt], -1).reshape(len(logged), -1)
    at = begin[:, None] + span[:, None] * np.array([0.0, 0.5])
    last = np.stack([channel(times[-1:], times[-1:])[1] for channel in channels])
    base = np.repeat(np.stack([held for held, _ in stacked]), 2, axis=1)
    hold_difference = base - series if how == "unknown" else np.zeros_like(series)
    return (
        np.append(at.ravel(), times[-1]),
        np.append(series, last, 1),
        np.append(hold_difference, np.zeros_like(last), 1),
    )
