"""Sets of effects evaluated on runs that they were not fitted to."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from freeart21.se3 import Array
from simgap.fit.fit import (
    Fit,
    bic_penalty,
    fit_model,
    fit_stretches,
    information_matrix,
    refit_starts,
    residual_dispersion,
    robust_residuals,
)
from simgap.measure.data import FitRun
from simgap.select.predictive import Score, estimate_model_error, stretch_densities
from simgap.select.split import Fold

FORM_ERROR = 0.06
"""Share of the gap that even the right effect with its model error leaves: real effects deviate by more than a slope
and a bend. With .02 the verdicts of the tried cases of a second simulated world are the same."""
_EXPLAINED = 0.4
"""Share of the gap that the formulas leave at most for model error to explain the rest: it is a fifth of the force by
one standard deviation (`Effect.model_error`), and this is two."""
_CROSSINGS = 5.0
"""Length of the stretches that model error is first fitted on, in crossings of the range at top speed. Of 0.5, 1.5 and
5 the last two led a hardening spring to the same optimum."""
_STRETCHES = 8
"""Least number of stretches whose densities are compared in pairs; fewer give no standard error."""


@dataclass(frozen=True)
class Hypothesis:
    """A set of effects with its predictions of test runs."""

    fit: Fit
    """To all training runs, by the effects' formulas."""
    trained: tuple[Fit, ...]
    """Fit to the training runs of each fold."""
    predicted: tuple[Fit, ...]
    """The same parameters on the test runs of each fold; only their start states are fitted."""
    score: Score

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the effects."""
        return self.fit.model.names

    @property
    def has_model_error(self) -> bool:
        """Whether the effects may deviate from their formulas."""
        return bool(self.trained[0].model.model_error)

    @cached_property
    def test_residuals(self) -> dict[str, Array]:
        """Run name to (n,) normalised residuals of the test runs."""
        return {run: r for fit in self.predicted for run, r in fit.residuals.items()}

    @property
    def rms(self) -> float:
        """Normalised RMS over the test runs."""
        return pooled_rms(list(self.test_residuals.values()))

    @property
    def median_rms(self) -> float:
        """Normalised RMS of the median run."""
        return float(np.median(list(self.rms_by_run.values())))

    @cached_property
    def rms_by_run(self) -> dict[str, float]:
        """Normalised RMS of every run, test or training."""
        everything = {run: r for fit in self.trained for run, r in fit.residuals.items()} | self.test_residuals
        return {run: pooled_rms([r]) for run, r in everything.items()}


def evaluate_set(fit: Fit, folds: tuple[Fold, ...], base: Hypothesis | None = None) -> Hypothesis:
    """The set, by its effects' formulas, on the test runs; `base` is the asset alone, None when that is evaluated."""
    return _predict_folds(fit, tuple(_refit(fit, fold) for fold in folds), folds, base)


def evaluate_with_model_error(hypothesis: Hypothesis, folds: tuple[Fold, ...], base: Hypothesis) -> Hypothesis:
    """The set with model error allowed; unchanged when it explains too little for that to matter."""
    fit = hypothesis.fit
    if not hypothesis.names or fit.rms > _EXPLAINED * base.fit.rms:
        return hypothesis
    model = replace(fit.model, model_error=tuple((effect.name, effect.values()[0]) for effect in fit.effects))
    more = len(model.ranges()) - len(fit.theta)
    if not more:
        return hypothesis
    trained = []
    for fold in folds:
        theta, starts = np.append(fit.theta, np.zeros(more)), fit.starts
        if not model.problem.inverse_dynamics:
            # formula and model error form a narrow valley, curved on whole runs, straight on stretches
            theta, starts = fit_stretches(model, fold.train, theta, _CROSSINGS, 8)
        trained.append(fit_model(model, fold.train, theta, starts, iterations=8))
    return _predict_folds(fit, tuple(trained), folds, base)


def _refit(fit: Fit, fold: Fold) -> Fit:
    """The set fitted to the training runs of a fold."""
    if set(fit.starts) == {run.name for run in fold.train}:
        return fit
    return fit_model(fit.model, fold.train, fit.theta, fit.starts, iterations=8)


def _predict_folds(fit: Fit, trained: tuple[Fit, ...], folds: tuple[Fold, ...], base: Hypothesis | None) -> Hypothesis:
    """Predictions of the test runs of all folds by fits to the others."""
    predicted = tuple(refit_starts(own, fold.test) for own, fold in zip(trained, folds, strict=True))
    parts = [
        score_parts(own.residuals, seen.residuals, fold, len(folds), base)
        for own, seen, fold in zip(trained, predicted, folds, strict=True)
    ]
    penalty = _penalty(fit, trained[0], count_readings(folds[0].train)) if len(folds) == 1 else 0.0
    return Hypothesis(fit, trained, predicted, Score(fit.model.names, np.concatenate(parts), penalty))


def _penalty(fit: Fit, departed: Fit, count: int) -> float:
    """Optimism of the log density of training runs: Schwarz for the formulas' parameters, Laplace (gain of precision
    over the prior) for model error."""
    ranges, more = departed.model.ranges(), len(fit.theta)
    known = np.array([r.prior for r in ranges[more:]])
    information = information_matrix(departed, residual_dispersion(robust_residuals(departed.residuals)))[
        more:, more:
    ] * np.outer(known, known)
    return bic_penalty(len(fit.theta), count) + 0.5 * float(np.linalg.slogdet(information)[1] if len(known) else 0.0)


def score_parts(
    train: dict[str, Array],
    test: dict[str, Array],
    fold: Fold,
    folds: int,
    base: Hypothesis | None = None,
) -> Array:
    """(k,) log densities of stretches of a fold's test runs. With a single fold the training runs count as well: marked
    test runs may be of one kind of motion, which tells little about another.

    Args:
        train: run name to normalised residuals of the training runs.
        test: the same of the test runs.
        fold: the runs.
        folds: number of folds.
        base: the asset alone; formulas are off by a share of the gap at least (`FORM_ERROR`).
    """
    off = {} if base is None else {run: FORM_ERROR * excess(floors) for run, floors in base.rms_by_run.items()}
    error = estimate_model_error(train, fold.train, off)
    each = -(-_STRETCHES // (folds * len(fold.test)))
    parts = [stretch_densities(test[run.name], run, error, each, off.get(run.name, 0.0)) for run in fold.test]
    if folds == 1:
        count = -(-_STRETCHES // len(fold.train))
        parts += [stretch_densities(train[run.name], run, error, count, off.get(run.name, 0.0)) for run in fold.train]
    return np.concatenate(parts)


def count_readings(runs: tuple[FitRun, ...]) -> int:
    """Of all runs."""
    return sum(len(run.q) for run in runs)


def pooled_rms(residuals: list[Array]) -> float:
    """RMS over all arrays."""
    return float(np.sqrt(np.mean(np.concatenate(residuals) ** 2)))


def excess(floors: float) -> float:
    """Normalised RMS less the noise's, as root of the difference of squares."""
    return float(np.sqrt(max(floors**2 - 1.0, 0.0)))
