"""Output-error fits: parameters are recovered with free initial states, a superset fits no worse, shapes are found."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from gap_case import INERTIA, measured_of, problem_of

from freeart21.effects import EFFECTS
from freeart21.effects.latch import Latch
from freeart21.measured import Measured
from simgap.fit.fit import (
    Model,
    ParameterMap,
    cut_stretches,
    fit_from_small_effects,
    fit_model,
    linearise_runs,
    predict_readings,
    refit_starts,
)
from simgap.fit.force_guess import guess_places, sample_missing_force
from simgap.fit.least_squares import robust_loss, robust_weight
from simgap.fit.model import repeats_family
from simgap.fit.parts import drop_poor_fits, extend_to_all, select_parts
from simgap.fit.search import Search, list_candidates, simplify
from simgap.measure.noise import estimate_noise
from simgap.models import kernel
from simgap.models.surrogate import simulate
from simgap.select.choose import choose_hypotheses
from simgap.select.split import split_runs
from simgap.settings import GapSettings


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


def test_a_superset_of_effects_fits_no_worse(tmp_path: Path):
    setup, runs = problem_of(tmp_path, measured_of(5, dry=0.1, drag=0.05))
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


def test_an_effect_that_vanishes_is_removed(tmp_path: Path):
    setup, runs = problem_of(tmp_path, measured_of(5, dry=0.1))
    pair = Model(setup, ("coulomb_friction", "viscous_damping"), instant_friction=True)
    theta = np.array([{"level": 0.1, "coefficient": 0.0}.get(r.name, r.neutral) for r in pair.ranges()])
    fit = fit_model(pair, runs, theta, iterations=0)
    assert simplify(fit, runs).model.names == ("coulomb_friction",)
    small = replace(fit, theta=theta + np.array([r.name == "coefficient" for r in pair.ranges()]) * 1e-3)
    assert simplify(small, runs).model.names == pair.names


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
    setup, runs = problem_of(tmp_path, measured_of(3, viscous=0.12))
    broken = replace(runs[0], name="broken", q=runs[0].q + np.where(runs[0].times_s > 1.0, 0.8, 0.0))
    model = Model(setup, ("viscous_damping",))
    cut = cut_stretches((*runs, broken), 1.5)
    fit = fit_model(model, cut, np.array([0.9, 0.9, 0.0, 0.02]))
    assert fit.effects[0].coefficient == pytest.approx(0.12, rel=0.15)


def test_missing_force_locates_a_catch(tmp_path: Path):
    """Runs that stay inside it: a simulation without it leaves, so its gradient is uninformative."""
    setup, runs = problem_of(tmp_path, measured_of(6, exact=True, seconds=4.0))
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
    together = np.full(4, 1e4)  # where all are missed equally none is held back
    assert robust_loss(together).tolist() == together.tolist() and robust_weight(together).tolist() == [1.0] * 4


def test_one_diverging_run_moves_no_parameter(tmp_path: Path):
    setup, runs = problem_of(tmp_path, measured_of(26, viscous=0.12, seconds=4.0))
    model = Model(setup, ("viscous_damping",))
    astray = (replace(runs[0], q=runs[0].q + 0.4 * (runs[0].times_s > 2)), *runs[1:])
    right, held = fit_model(model, runs), fit_model(model, astray)
    spread = np.sqrt(np.diag(np.linalg.inv(right.normal)))
    assert np.abs((held.theta - right.theta) / spread).max() < 4
    assert held.run_rms(runs[0].name) > 50


# --- long runs, searched on segments ----------------------------------------------------------------------------------


def long_runs(seconds: float) -> Measured:
    """Eight runs of a pendulum with viscous damping."""
    return measured_of(3, runs=8, seconds=seconds, marked=False, viscous=0.06)


def test_short_runs_are_searched_whole(tmp_path: Path):
    problem, runs = problem_of(tmp_path, long_runs(4.0))
    assert select_parts(problem, runs) is runs


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


def test_components_of_near_fits_are_near():
    def fit(cost: float, *names: str) -> SimpleNamespace:
        return SimpleNamespace(cost=cost, model=SimpleNamespace(names=names))

    best, part, far, near = fit(10.0, "a", "b"), fit(900.0, "a"), fit(61.0, "c"), fit(59.0, "d")
    assert drop_poor_fits([best, part, far, near], 6.0) == [best, part, near]


# --- presliding friction, and forces and frictions of any shape over position -----------------------------------------

HIDDEN = {
    "presliding_friction": {"level": 0.15, "travel": 0.08},
    "force_over_position": {f"force_{k + 1}": x for k, x in enumerate((-0.3, 0.1, 0.4, 0.5, 0.2, 0.3, 0.6, 0.1))},
    "friction_over_position": {f"level_{k + 1}": 0.02 + 0.3 * (k in (2, 5)) for k in range(8)},
}


def test_presliding_friction_dissipates_only_sliding():
    """Loss per cycle is 4 * level * (amplitude - travel), zero within the travel (Dupont et al. 2002)."""
    law, remember, level, travel = *(getattr(EFFECTS["presliding_friction"], k) for k in ("law", "remember")), 0.3, 0.02
    for amplitude, expected in ((0.1, 4 * 0.3 * 0.08), (0.019, 0.0)):
        q = amplitude * np.sin(np.linspace(0, 4 * np.pi, 40_001))
        anchor, work = remember(0.0, 0.0, level, travel), []
        for a, b in pairwise(q):
            work.append(-law(0.5 * (a + b), 0.0, 0.0, anchor, level, travel) * (b - a))
            anchor = remember(b, anchor, level, travel)
        assert sum(work[20_000:]) == pytest.approx(expected, abs=1e-5)


@pytest.mark.parametrize(("name", "expected"), list(zip(HIDDEN, [*list(HIDDEN)[:2], "coulomb_friction"], strict=True)))
def test_a_shape_over_position_is_named(tmp_path: Path, name: str, expected: str):
    """Common effects come first: friction that varies with position is dry friction, in part."""
    problem, runs = problem_of(tmp_path, measured_of(5, exact=True, marked=False))
    model = Model(problem, (name,), instant_friction=True)
    theta = np.array([HIDDEN[name].get(r.name, x) for r, x in zip(model.ranges(), model.neutral(), strict=True)])
    true = fit_model(model, runs, theta, iterations=0)
    rng = np.random.default_rng(0)
    runs = tuple(replace(run, q=predict_readings(true, run) + run.sigma * rng.normal(size=len(run.q))) for run in runs)
    split = split_runs(runs)
    search = Search(problem, split.train_runs, list_candidates(problem, split.train_runs))
    choice = choose_hypotheses(search, split.folds, GapSettings().judgement)
    assert choice.accepted and choice.accepted[0].names == (expected,) and choice.in_part == (expected != name), choice
    assert not any(repeats_family(names) for names in search.fits)


def test_presliding_friction_starts_where_that_of_bearings_ends(tmp_path: Path):
    """The effect's own travel starts where that of all dry friction ends."""
    problem, _ = problem_of(tmp_path, measured_of(5, exact=True, marked=False))
    model = Model(problem, ("coulomb_friction",))
    theta = np.array([r.upper if r.name == "travel_root" else r.neutral for r in model.ranges()])
    own = Model(model.problem, ("presliding_friction",)).ranges()
    least = next(r.lower for r in own if (r.owner, r.name) == ("presliding_friction", "travel"))
    assert least == pytest.approx(ParameterMap(model).vector(theta)[0][kernel.TRAVEL])


def test_a_set_has_one_effect_of_a_family():
    assert repeats_family(("coulomb_friction", "presliding_friction"))
    assert repeats_family(("presliding_friction", "stribeck_friction", "viscous_damping"))
    assert not repeats_family(("load_friction", "presliding_friction"))
