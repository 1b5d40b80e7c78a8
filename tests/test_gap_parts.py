"""Long runs are searched on segments, and the result holds on the whole runs; about 5 s."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from gap_case import asset_of, measured_of

from freeart21.files.asset import read_asset
from simgap.fit.fit import Model, Problem, fit_from_small_effects
from simgap.fit.parts import drop_poor_fits, extend_to_all, select_parts
from simgap.fit.problem import make_problem
from simgap.measure.data import FitRun, make_fit_runs
from simgap.models.surrogate import make_plant


def case(folder: Path, seconds: float) -> tuple[Problem, tuple[FitRun, ...]]:
    """Eight runs of a pendulum with viscous damping."""
    measured = measured_of(3, runs=8, seconds=seconds, marked=False, viscous=0.06)
    plant = make_plant(read_asset(asset_of(folder), "j"), measured)
    runs, noise = make_fit_runs(measured, plant)
    return make_problem(plant, measured, runs, noise), runs


def test_short_runs_are_searched_whole(tmp_path: Path):
    problem, runs = case(tmp_path, 4.0)
    assert select_parts(problem, runs) is runs


def test_a_search_on_segments_holds_on_whole_runs(tmp_path: Path):
    problem, runs = case(tmp_path, 60.0)
    parts = select_parts(problem, runs)
    duration = sum(float(part.times_s[-1] - part.times_s[0]) for part in parts)
    assert duration == pytest.approx(100 * problem.crossing_s, rel=0.15)
    assert duration < 0.5 * sum(float(run.times_s[-1] - run.times_s[0]) for run in runs)
    for part in parts:
        run = next(run for run in runs if part.name.split("#")[0] == run.name)
        begin = int(part.name.split("#")[1])
        np.testing.assert_array_equal(part.q, run.q[begin : begin + len(part.q)])
    fit = extend_to_all(fit_from_small_effects(Model(problem, ("viscous_damping",)), parts), runs)
    assert set(fit.residuals) == {run.name for run in runs} and fit.rms < 1.2
    assert all(len(fit.residuals[run.name]) == len(run.q) for run in runs)
    inertia = fit.values["asset", "inertia"]
    assert fit.values["viscous_damping", "coefficient"] / inertia == pytest.approx(0.06, rel=0.12)


def test_components_of_near_fits_are_near():
    def fit(cost: float, *names: str) -> SimpleNamespace:
        return SimpleNamespace(cost=cost, model=SimpleNamespace(names=names))

    best, part, far, near = fit(10.0, "a", "b"), fit(900.0, "a"), fit(61.0, "c"), fit(59.0, "d")
    assert drop_poor_fits([best, part, far, near], 6.0) == [best, part, near]
