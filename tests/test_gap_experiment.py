"""Experiment design from the predictions of the rivals."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from gap_case import ARM, INERTIA, MASS, G, asset_of, measured_of

from freeart21.files.asset import read_asset
from simgap.fit.fit import Fit
from simgap.fit.model import Model
from simgap.fit.problem import Problem, make_problem, without_asset_error
from simgap.measure.data import make_fit_runs
from simgap.models.surrogate import make_plant
from simgap.select.experiment import NO_EXPERIMENT, next_experiment


@pytest.fixture
def problem(tmp_path: Path) -> Problem:
    """A free pendulum without asset uncertainty."""
    measured = measured_of(3, runs=2)
    plant = make_plant(read_asset(asset_of(tmp_path)), measured)
    return without_asset_error(make_problem(plant, measured, *make_fit_runs(measured, plant)))


def fit(problem: Problem, name: str, *values: float) -> Fit:
    """A fit of one effect with known parameters."""
    model = Model(problem, (name,))
    count = len(model.ranges())
    assert count == len(values)
    return Fit(model, np.array(values), {}, {}, 0.0, np.eye(count))


def test_an_experiment_separates_all_rivals(problem: Problem):
    """10 % more inertia swings as weaker gravity; a known push separates them, and both from damping."""
    heavier = fit(problem, "armature", 0.1 * INERTIA)
    weaker = fit(problem, "gravity_offset", 0.0, MASS * G * ARM / 11)
    damped = fit(problem, "viscous_damping", 0.06)
    assert next_experiment([heavier, weaker]).startswith("Push it to and fro with a known")
    assert "the explanations then differ by at least" in next_experiment([heavier, weaker, damped])


def test_rivals_that_no_experiment_separates_are_reported(problem: Problem):
    damped, more = fit(problem, "viscous_damping", 0.06), fit(problem, "viscous_damping", 0.2)
    assert next_experiment([damped, damped]) == NO_EXPERIMENT
    assert "the first two explanations then differ by" in next_experiment([damped, more, damped])
