"""Output-error fits: parameters are recovered with free initial states, a superset fits no worse, shapes are found."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from gap_case import INERTIA, measured_of, problem_of

from freeart21.measured import Measured
from simgap.fit.fit import (
    Model,
    fit_from_small_effects,
    fit_model,
    linearise_runs,
    predict_readings,
    refit_starts,
)
from simgap.fit.parts import extend_to_all, select_parts
from simgap.measure.noise import estimate_noise


def test_hidden_parameters_are_recovered_with_free_initial_states(tmp_path: Path):
    measured = measured_of(1, viscous=0.12, exact=True)
    setup, runs = problem_of(tmp_path, measured)
    fit = fit_model(Model(setup, ("viscous_damping",)), runs, np.array([0.0, 0.05]))
    assert fit.effects[0].coefficient == pytest.approx(0.12, rel=0.01)
    assert max(fit.run_rms(run.name) for run in runs) < 1.1
    spread = np.sqrt(np.linalg.inv(fit.normal)[-1, -1])
    assert abs(fit.theta[-1] - 0.12) < 4 * spread and spread < 0.01 * 0.12
    wrong = fit_model(Model(setup, ()), runs)
    assert min(wrong.run_rms(run.name) for run in runs) > 10


def test_asset_uncertainty_is_fitted_within_bounds(tmp_path: Path):
    measured = measured_of(2, inertia=1.3 * INERTIA, seconds=4.0)
    setup, runs = problem_of(tmp_path, measured)
    fit = fit_model(Model(setup, ()), runs)
    names = [r.name for r in fit.model.ranges()]
    assert names == ["inertia", "weight", "lean"]
    assert all(r.lower <= x <= r.upper for r, x in zip(fit.model.ranges(), fit.theta, strict=True))
    assert fit.theta[0] == pytest.approx(1.1) and min(fit.run_rms(run.name) for run in runs) > 5
    armed = fit_model(Model(setup, ("armature",)), runs, np.array([1.1, 1.0, 0.0, 0.05]))
    assert max(armed.run_rms(run.name) for run in runs) < 1.1


def test_a_held_out_run_fits_only_its_initial_state(tmp_path: Path):
    setup, runs = problem_of(tmp_path, measured_of(3, viscous=0.12))
    fit = fit_model(Model(setup, ("viscous_damping",)), runs[:3])
    there = refit_starts(fit, runs[3:])
    np.testing.assert_array_equal(there.theta, fit.theta)
    assert max(there.run_rms(run.name) for run in runs[3:]) < 1.3
    np.testing.assert_allclose(
        (runs[4].q - predict_readings(there, runs[4])) / runs[4].sigma, there.residuals[runs[4].name], atol=1e-9
    )


def test_slopes_match_finite_differences(tmp_path: Path):
    setup, runs = problem_of(tmp_path, measured_of(4, viscous=0.12, dry=0.05))
    model = Model(setup, ("coulomb_friction", "viscous_damping"), instant_friction=True)
    fit = fit_model(model, runs[:1], np.array([1.0, 1.0, 0.0, 0.05, 0.1]))
    _, starts, parameters = linearise_runs(fit, runs[:1])
    run, j = runs[0], len(fit.theta) - 1
    more, less = (
        predict_readings(type(fit)(**{**vars(fit), "theta": fit.theta + d * np.eye(j + 1)[j]}), run)
        for d in (1e-3, -1e-3)
    )
    expected = (more - less) / 2e-3 / run.sigma
    assert np.abs(parameters[0][j] - expected).max() < 0.02 * np.abs(expected).max()
    assert starts[0].shape == (2, len(run.q))


def test_noise_floor_is_the_sensors(tmp_path: Path):
    rng = np.random.default_rng(0)
    times = np.cumsum(rng.uniform(0.004, 0.006, 4000))
    true, speed = np.sin(3 * times), 3 * np.cos(3 * times)
    assert estimate_noise([(times, true + rng.normal(0, 2e-3, 4000))]).sigma_at_rest == pytest.approx(2e-3, rel=0.1)
    assert estimate_noise([(times, np.round(true / 0.01) * 0.01)]).sigma_at_rest == pytest.approx(
        0.01 / np.sqrt(12), rel=0.25
    )
    steps = 0.01 * np.round(np.interp(times, [0, 10, 20], [0, 0.5, 0]) / 0.01)  # long at rest on each step
    assert estimate_noise([(times, steps)]).sigma_at_rest >= 0.99 * 0.01 / np.sqrt(12)
    noise = estimate_noise([(times, true + rng.normal(0, 2e-3, 4000) + speed * rng.normal(0, 2e-3, 4000))])
    assert noise.time_jitter_s == pytest.approx(2e-3, rel=0.25) and noise.sigma_at_rest == pytest.approx(2e-3, rel=0.4)


# --- long runs, searched on segments ----------------------------------------------------------------------------------


def long_runs(seconds: float) -> Measured:
    """Eight runs of a pendulum with viscous damping."""
    return measured_of(3, runs=8, seconds=seconds, marked=False, viscous=0.06)


def test_a_search_on_segments_holds_on_whole_runs(tmp_path: Path):
    problem, runs = problem_of(tmp_path, long_runs(60.0))
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


# --- presliding friction, and forces and frictions of any shape over position -----------------------------------------
