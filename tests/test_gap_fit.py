"""Output-error fits: parameters are recovered with free initial states, and a superset fits no worse."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from gap_case import INERTIA, asset_of, measured_of

from freeart21.effects.latch import Latch
from freeart21.files.asset import read_asset
from freeart21.measured import Measured
from simgap.fit.fit import (
    Model,
    Problem,
    cut_stretches,
    fit_model,
    linearise_runs,
    predict_readings,
    refit_starts,
)
from simgap.fit.force_guess import guess_places, sample_missing_force
from simgap.fit.least_squares import robust_loss, robust_weight
from simgap.fit.problem import make_problem
from simgap.fit.search import Search, list_candidates
from simgap.measure.data import make_fit_runs
from simgap.measure.noise import estimate_noise
from simgap.models.surrogate import make_plant, simulate
from simgap.select.split import split_runs


def problem(folder: Path, measured: Measured) -> tuple[Problem, tuple]:
    plant = make_plant(read_asset(asset_of(folder), "j"), measured)
    runs, noise = make_fit_runs(measured, plant)
    return make_problem(plant, measured, runs, noise), runs


def test_hidden_parameters_are_recovered_with_free_initial_states(tmp_path: Path):
    measured = measured_of(1, viscous=0.12, exact=True)
    setup, runs = problem(tmp_path, measured)
    fit = fit_model(Model(setup, ("viscous_damping",)), runs, np.array([0.0, 0.05]))
    assert fit.effects[0].coefficient == pytest.approx(0.12, rel=0.01)
    assert max(fit.run_rms(run.name) for run in runs) < 1.1
    spread = np.sqrt(np.linalg.inv(fit.normal)[-1, -1])
    assert abs(fit.theta[-1] - 0.12) < 4 * spread and spread < 0.01 * 0.12
    wrong = fit_model(Model(setup, ()), runs)
    assert min(wrong.run_rms(run.name) for run in runs) > 10


def test_asset_uncertainty_is_fitted_within_bounds(tmp_path: Path):
    measured = measured_of(2, inertia=1.3 * INERTIA, seconds=4.0)
    setup, runs = problem(tmp_path, measured)
    fit = fit_model(Model(setup, ()), runs)
    names = [r.name for r in fit.model.ranges()]
    assert names == ["inertia", "gravity", "lean_1"]
    assert all(r.lower <= x <= r.upper for r, x in zip(fit.model.ranges(), fit.theta, strict=True))
    assert fit.theta[0] == pytest.approx(1.1) and min(fit.run_rms(run.name) for run in runs) > 5
    armed = fit_model(Model(setup, ("armature",)), runs, np.array([1.1, 1.0, 0.0, 0.05]))
    assert max(armed.run_rms(run.name) for run in runs) < 1.1


def test_a_held_out_run_fits_only_its_initial_state(tmp_path: Path):
    setup, runs = problem(tmp_path, measured_of(3, viscous=0.12))
    fit = fit_model(Model(setup, ("viscous_damping",)), runs[:3])
    there = refit_starts(fit, runs[3:])
    np.testing.assert_array_equal(there.theta, fit.theta)
    assert max(there.run_rms(run.name) for run in runs[3:]) < 1.3
    np.testing.assert_allclose(
        (runs[4].q - predict_readings(there, runs[4])) / runs[4].sigma, there.residuals[runs[4].name], atol=1e-9
    )


def test_slopes_match_finite_differences(tmp_path: Path):
    setup, runs = problem(tmp_path, measured_of(4, viscous=0.12, dry=0.05))
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


def test_a_superset_of_effects_fits_no_worse(tmp_path: Path):
    setup, runs = problem(tmp_path, measured_of(5, dry=0.1, drag=0.05))
    train = split_runs(runs).folds[0].train
    search = Search(setup, train, list_candidates(setup, train))
    level = search.fit_singles()
    pairs = search.fit_larger(level[:3])
    assert {"coulomb_friction", "quadratic_drag"} in [set(fit.model.names) for fit in pairs]
    assert len(search.fits) > len(level)
    for names, fit in search.fits.items():
        for name in names:
            smaller = search.fits.get(tuple(n for n in names if n != name))
            assert smaller is None or fit.cost <= smaller.cost * (1 + 1e-6) + 1e-2, names


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


def test_a_quantised_rest_does_not_hide_the_noise():
    rng = np.random.default_rng(1)
    times = np.arange(3000) / 100
    true = np.where(times < 12, 0.5 * np.sin(3 * times), 0.5 * np.sin(36) + 0.0002)
    readings = 1.5e-3 * np.round((true + rng.normal(0, 0.5e-3, 3000)) / 1.5e-3)
    assert estimate_noise([(times, readings)]).sigma_at_rest == pytest.approx(
        np.hypot(0.5e-3, 1.5e-3 / np.sqrt(12)), rel=0.12
    )


def test_one_unreachable_segment_does_not_block_the_fit(tmp_path: Path):
    setup, runs = problem(tmp_path, measured_of(3, viscous=0.12))
    broken = replace(runs[0], name="broken", q=runs[0].q + np.where(runs[0].times_s > 1.0, 0.8, 0.0))
    model = Model(setup, ("viscous_damping",))
    cut = cut_stretches((*runs, broken), 1.5)
    fit = fit_model(model, cut, np.array([0.9, 0.9, 0.0, 0.02]))
    assert fit.effects[0].coefficient == pytest.approx(0.12, rel=0.15)


def test_missing_force_locates_a_catch(tmp_path: Path):
    """Runs that stay inside it: a simulation without it leaves, so its gradient is uninformative."""
    setup, runs = problem(tmp_path, measured_of(6, exact=True, seconds=4.0))
    catch, rng = Latch(9.0, 0.3, 0.12, 0.5), np.random.default_rng(6)
    starts = ((0.27, 0.3), (1.1, 0.0), (0.33, -0.2), (-0.9, 0.0), (0.34, 0.1))
    caught = tuple(
        replace(run, q=simulate(setup.plant, (catch,), run.times_s, *start) + rng.normal(0, 7e-4, len(run.q)))
        for run, start in zip(runs, starts, strict=True)
    )
    found = guess_places(setup, sample_missing_force(setup, caught), "latch", 2)
    assert len(found) == 2
    assert found[0]["position"] == pytest.approx(0.3, abs=0.03)
    assert found[0]["travel"] == pytest.approx(0.12, rel=0.25)
    assert found[0]["hold"] / found[0]["travel"] == pytest.approx(9.0 / 0.12, rel=0.15)
    places = guess_places(setup, sample_missing_force(setup, caught, (catch,)), "latch", 1)
    assert not places or places[0]["hold"] < 0.2 * 9.0  # nothing is missing with it
    assert guess_places(setup, sample_missing_force(setup, caught), "viscous_damping", 2) == []


def test_run_cost_is_a_robust_likelihood():
    """Quadratic up to a multiple of the usual error, logarithmic beyond; the weights are its slope."""
    powers = np.array([0.5, 0.7, 0.8, 1.0, 8.99, 9.01, 100.0])
    for i in range(len(powers)):
        moved = powers * (1 + 1e-4 * (np.arange(len(powers)) == i))
        slope = (robust_loss(moved)[i] - robust_loss(powers)[i]) / (1e-4 * powers[i])
        assert slope == pytest.approx(robust_weight(powers)[i], rel=1e-3)
    assert robust_loss(powers)[:5].tolist() == powers[:5].tolist()
    far = np.array([1.0, 1.0, 1.0, 9e2]), np.array([1.0, 1.0, 1.0, 9e4])
    assert robust_loss(far[1])[-1] - robust_loss(far[0])[-1] == pytest.approx(9 * np.log(100))
    together = np.full(4, 1e4)  # where all are missed alike none is held back
    assert robust_loss(together).tolist() == together.tolist() and robust_weight(together).tolist() == [1.0] * 4


def test_one_diverging_run_moves_no_parameter(tmp_path: Path):
    setup, runs = problem(tmp_path, measured_of(26, viscous=0.12, seconds=4.0))
    model = Model(setup, ("viscous_damping",))
    astray = (replace(runs[0], q=runs[0].q + 0.4 * (runs[0].times_s > 2)), *runs[1:])
    right, held = fit_model(model, runs), fit_model(model, astray)
    spread = np.sqrt(np.diag(np.linalg.inv(right.normal)))
    assert np.abs((held.theta - right.theta) / spread).max() < 4
    assert held.run_rms(runs[0].name) > 50
