"""Nonparametric discrepancies: each is found where it acts, as its own kind."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from gap_case import measured_of, problem_of

from simgap.fit.fit import Fit, Model, fit_model, predict_readings
from simgap.measure.data import FitRun
from simgap.select.discrepancy import Discrepancy, find_discrepancies
from simgap.select.hypotheses import evaluate_set
from simgap.select.split import split_runs


@pytest.fixture(scope="module")
def alone(tmp_path_factory: pytest.TempPathFactory) -> tuple[Fit, tuple[FitRun, ...]]:
    """The unchanged asset and runs that it explains, none marked held out."""
    problem, runs = problem_of(tmp_path_factory.mktemp("asset"), measured_of(5, marked=False, exact=True))
    return fit_model(Model(problem, ()), runs), runs


def find_kinds(fit: Fit, runs: tuple[FitRun, ...]) -> dict[str, Discrepancy]:
    folds = split_runs(runs).folds
    tested = tuple(run for fold in folds for run in fold.test)
    hypothesis = evaluate_set(fit_model(fit.model, tested, fit.theta, fit.starts), folds)
    return {rival.kind: rival for rival in find_discrepancies(hypothesis, folds)}


def read(run: FitRun, q: np.ndarray, seed: int) -> FitRun:
    return replace(run, q=q + run.sigma * np.random.default_rng(seed).normal(size=len(q)))


def test_a_force_over_time_is_found(alone: tuple[Fit, tuple[FitRun, ...]]):
    fit, runs = alone
    made = []
    for i, run in enumerate(runs):
        t = run.times_s - run.times_s[0]
        pushed = replace(run, inputs=run.inputs.with_rows(run.times_s).pushed(run.times_s, 0.02 * t / t[-1]))
        made.append(read(run, predict_readings(fit, pushed), i))
    rivals = find_kinds(fit, tuple(made))
    assert rivals["time"].gain > rivals["time"].error and rivals["time"].rms < 1.1 < rivals["time"].rms_alone
    assert all(rivals["time"].gain > rival.gain for kind, rival in rivals.items() if kind != "time")


def test_noise_needs_no_discrepancy(alone: tuple[Fit, tuple[FitRun, ...]]):
    fit, runs = alone
    made = tuple(read(run, predict_readings(fit, run), i) for i, run in enumerate(runs))
    assert all(rival.gain < rival.error for rival in find_kinds(fit, made).values())
