"""Sets of effects before runs that they were not fitted to, all by one score."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from freeart21.se3 import Array
from simgap.fitting.fit import Fit, fitted, placed, priced
from simgap.judgement.predictive import Score, error_of, stretch_densities
from simgap.judgement.split import Fold
from simgap.measure.data import FitRun

FORM = 0.06
"""Part of the gap by which the right effect's formula is off: real ones depart from theirs by a tenth or two of
themselves (`Effect.departs`)."""
_STRETCHES = 8
"""Of the choosing runs, at least, whose densities are paired: fewer tell no standard error."""


@dataclass(frozen=True)
class Hypothesis:
    """A set of effects, by the library's formulas, before runs that it was not fitted to."""

    fit: Fit
    """To all runs that may be fitted."""
    trained: tuple[Fit, ...]
    """Of every fold, to its runs to fit."""
    foretold: tuple[Fit, ...]
    """Of every fold, before its runs to predict: only their starts are free."""
    score: Score

    @property
    def names(self) -> tuple[str, ...]:
        """Of the effects."""
        return self.fit.theory.names

    @cached_property
    def left(self) -> dict[str, Array]:
        """What is left of choosing runs, by run, in floors."""
        return {run: r for fit in self.foretold for run, r in fit.residuals.items()}

    @property
    def floors(self) -> float:
        """Root mean square of that."""
        return rms(list(self.left.values()))

    @property
    def usual(self) -> float:
        """Floors that are left of the run in the middle."""
        return float(np.median(list(self.by_run.values())))

    @cached_property
    def by_run(self) -> dict[str, float]:
        """Floors that are left of every run, choosing or fitted."""
        everything = {**self.fit.residuals, **self.left}
        return {run: rms([r]) for run, r in everything.items()}


def judged(fit: Fit, folds: tuple[Fold, ...], base: Hypothesis | None = None) -> Hypothesis:
    """The set before choosing runs; `base` is the asset as it is, without which nothing is known of the gap."""
    trained = tuple(_refitted(fit, fold) for fold in folds)
    there = tuple(placed(own, fold.test) for own, fold in zip(trained, folds, strict=True))
    parts = [
        score_parts(own.residuals, seen.residuals, fold, len(folds), base)
        for own, seen, fold in zip(trained, there, folds, strict=True)
    ]
    price = priced(len(fit.theta), readings(folds[0].train)) if len(folds) == 1 else 0.0
    return Hypothesis(fit, trained, there, Score(fit.theory.names, np.concatenate(parts), price))


def score_parts(
    fitted_to: dict[str, Array],
    seen: dict[str, Array],
    fold: Fold,
    folds: int,
    base: Hypothesis | None = None,
) -> Array:
    """(k,) log density of stretches of a fold's choosing runs, and, where it is the only one, of those that were
    fitted: what is kept back may be of one kind of motion, which tells little of the other.

    Args:
        fitted_to: what is left of the runs to fit, in floors.
        seen: what is left of the runs to predict.
        fold: these runs.
        folds: how many there are.
        base: the asset as it is. A formula is off by a part of the gap that it explains, whatever runs say.
    """
    off = {} if base is None else {run: FORM * excess(floors) for run, floors in base.by_run.items()}
    error = error_of(fitted_to, fold.train, off)
    each = -(-_STRETCHES // (folds * len(fold.test)))
    parts = [stretch_densities(seen[run.name], run, error, each, off.get(run.name, 0.0)) for run in fold.test]
    if folds == 1:
        count = -(-_STRETCHES // len(fold.train))
        parts += [
            stretch_densities(fitted_to[run.name], run, error, count, off.get(run.name, 0.0)) for run in fold.train
        ]
    return np.concatenate(parts)


def _refitted(fit: Fit, fold: Fold) -> Fit:
    """The set fitted to the fold's runs alone."""
    if set(fit.starts) == {run.name for run in fold.train}:
        return fit
    return fitted(fit.theory, fold.train, fit.theta, fit.starts, iterations=8)


def readings(runs: tuple[FitRun, ...]) -> int:
    """Of all runs together."""
    return sum(len(run.q) for run in runs)


def rms(residuals: list[Array]) -> float:
    """Root mean square of residuals."""
    return float(np.sqrt(np.mean(np.concatenate(residuals) ** 2)))


def excess(floors: float) -> float:
    """What of an error, in floors, is more than noise."""
    return float(np.sqrt(max(floors**2 - 1.0, 0.0)))
