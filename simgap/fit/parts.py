"""Long runs: sets are searched on parts of them, and the best are fitted to all."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from simgap.fit.fit import Fit, Problem, fit_model, refit_missed_starts
from simgap.measure.data import FitRun

_LONG, _SEARCHED = 400.0, 100.0
"""Total duration, in crossings of the range at top speed, above which the search uses parts, and the duration of these.
Real sets had 1 to 362: parts of those from 200 on took half the time, and two of 12 verdicts got worse."""
_FEWEST = 100
"""Readings of a part at least."""
_GROWTH, _ITERATIONS = 3, 4
"""Factor by which parts are extended, and iterations on each length."""


def select_parts(problem: Problem, runs: tuple[FitRun, ...]) -> tuple[FitRun, ...]:
    """The runs; of long ones the beginning and as much from the middle on, named by their first readings."""
    duration = sum(float(run.times_s[-1] - run.times_s[0]) for run in runs)
    if duration < _LONG * problem.crossing_s:
        return runs
    seconds, found = 0.5 * _SEARCHED * problem.crossing_s / len(runs), []
    for run in runs:
        n = len(run.q)
        count = max(int(np.searchsorted(run.times_s, run.times_s[0] + seconds)), _FEWEST)
        begins = (0, n // 2) if 2 * count < n else (0,)
        found += [replace(run.between(a, a + count), name=f"{run.name}#{a}") for a in begins]
    return tuple(found)


def drop_poor_fits(fits: list[Fit], times: float) -> list[Fit]:
    """The fits within a factor `times` of the least cost, and all fits of their subsets."""
    most = times * min((fit.cost for fit in fits), default=0.0)
    near = [set(fit.model.names) for fit in fits if fit.cost <= most]
    return [fit for fit in fits if any(set(fit.model.names) <= names for names in near)]


def extend_to_all(fit: Fit, runs: tuple[FitRun, ...]) -> Fit:
    """A fit to parts, extended to ever longer beginnings of the runs and then to all of them."""
    count = {run.name: len(fit.residuals[f"{run.name}#0"]) for run in runs}
    theta, starts = fit.theta, {run.name: fit.starts[f"{run.name}#0"] for run in runs}
    while any(_GROWTH * count[run.name] < len(run.q) for run in runs):
        count = {name: _GROWTH * n for name, n in count.items()}
        longer = tuple(run.between(0, count[run.name]) for run in runs)
        on_these = fit_model(fit.model, longer, theta, starts, _ITERATIONS)
        theta, starts = on_these.theta, on_these.starts
    return refit_missed_starts(fit_model(fit.model, runs, theta, starts), runs)
