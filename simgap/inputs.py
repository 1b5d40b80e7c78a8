"""What drove a run, as the kernel takes it: values that last until the next one, however the logged ones go on.

A straight line between two rows becomes two values, each for half of the time: the mean and, before and after, a third
of the rise less and more. They have the line's impulse and move a free
part as far, so that only the way between differs.
"""

from __future__ import annotations

import numpy as np

from freeart21.measured import Interpolation, Measured, Run
from freeart21.se3 import Array
from simgap.surrogate import Inputs

_THIRD = 1 / 3
"""Of the rise: -x and x, each for half of a time h, move a free part by -x h^2 / 4 more than their mean does; a line
that rises by r, by -r h^2 / 12."""


def inputs_of(run: Run, measured: Measured, longest_s: float = np.inf) -> Inputs:
    """What drove a run; no value lasts longer than `longest_s` where a line is to be followed."""
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


def _as_held(times: Array, logged: Array, how: Interpolation, longest_s: float) -> tuple[Array, Array, Array]:
    """Times (i,), the (3, i) values that last from each to the next, and what these have besides if the `logged` ones
    (3, n) are held."""
    if how == "held" or len(times) < 2:
        return times, logged, np.zeros_like(logged)
    spans, rises = np.diff(times), np.diff(logged)
    changes = (rises != 0).any(0)
    parts = np.where(changes, np.ceil(spans / (2 * longest_s)), 1).astype(int)  # of two values each
    parts = np.maximum(parts, 1)
    row = np.repeat(np.arange(len(spans)), 2 * parts)
    begins = np.cumsum(2 * parts) - 2 * parts
    k = np.arange(len(row)) - begins[row]
    share = (k // 2 + 0.5 + np.where(k % 2, _THIRD, -_THIRD)) / parts[row]
    series = logged[:, row] + share * rises[:, row]
    beside = logged[:, row] - series if how == "unknown" else np.zeros_like(series)
    at = times[row] + spans[row] * k / (2 * parts[row])
    last = logged[:, -1:]
    return np.append(at, times[-1]), np.append(series, last, 1), np.append(beside, np.zeros_like(last), 1)
