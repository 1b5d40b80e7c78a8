"""Sets of effects before runs that they were not fitted to: what they leave of those by their plain formulas, and with
their sizes free within the form tolerance."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import pairwise

import numpy as np
from scipy.stats import norm

from freeart21.se3 import Array
from simgap.fitting.fit import Fit, Starts, fitted, foretold, tempered, unit_of
from simgap.fitting.search import relaxed
from simgap.measure.data import FitRun
from simgap.settings import ChoiceSettings

RUNS = 4
"""Runs of which one may be missed."""


@dataclass(frozen=True)
class Fold:
    """Runs to fit, and runs to predict."""

    train: tuple[FitRun, ...]
    test: tuple[FitRun, ...]


@dataclass(frozen=True)
class Judged:
    """A set of effects before runs it never saw."""

    fit: Fit
    strict: dict[str, Array]
    """Held-out residuals over the floor by run, by the plain formulas."""
    loose: dict[str, Array] | None = None
    """The same with the sizes free within the form tolerance."""
    free: Fit | None = None
    """To the runs that were fitted, with the sizes free so."""
    starts: Starts = field(default_factory=dict)
    """Of held-out runs, by the plain formulas."""

    @property
    def names(self) -> tuple[str, ...]:
        """Of the effects."""
        return self.fit.theory.names

    @property
    def floors(self) -> float:
        """Root mean square of the held-out residuals, in floors."""
        return rms(self.strict)

    @cached_property
    def error(self) -> float:
        """The same, runs that are missed by far counting for less: what sets are compared by."""
        return rms(tempered(self.strict))

    @cached_property
    def learned(self) -> float:
        """The same of the runs that it was fitted to."""
        return rms(self.fit.tempered)

    @cached_property
    def reach(self) -> float:
        """The error with the sizes free, or without, whichever is less."""
        return rms(tempered(self.left))

    @property
    def borne(self) -> float:
        """What is left in floors, without the run that is met worst, of four or more: what grazes a stop or just passes
        a notch hangs on a hair, and no formula is that near."""
        return rms(but_worst(self.left))

    @property
    def left(self) -> dict[str, Array]:
        """What is left with the sizes free, or without, whichever is less: form that is explained is no noise."""
        return self.strict if self.loose is None or rms(tempered(self.loose)) > self.error else self.loose


def folds_of(runs: tuple[FitRun, ...]) -> tuple[Fold, ...]:
    """Held-out runs as marked; without marks each run is held out in turn, at most four groups of like size of motion.

    A single run is cut into three stretches.
    """
    if any(run.held_out for run in runs):
        return (Fold(tuple(r for r in runs if not r.held_out), tuple(r for r in runs if r.held_out)),)
    if len(runs) == 1:
        bounds = np.linspace(0, len(runs[0].q), 4).astype(int)
        runs = tuple(_stretch(runs[0], int(a), int(b)) for a, b in pairwise(bounds))
    order = np.argsort([np.mean(run.speed**2) for run in runs], kind="stable")
    groups = [set(map(int, g)) for g in np.array_split(order, min(len(runs), 4))]
    return tuple(
        Fold(tuple(r for i, r in enumerate(runs) if i not in g), tuple(r for i, r in enumerate(runs) if i in g))
        for g in groups
    )


def _stretch(run: FitRun, begin: int, end: int) -> FitRun:
    return replace(run.between(begin, end), name=f"{run.name}#{begin}")


def judged(fit: Fit, folds: tuple[Fold, ...]) -> Judged:
    """How the set predicts what it was not fitted to."""
    there = [foretold(_refitted(fit, fold), fold.test) for fold in folds]
    residuals = {run: r for fit in there for run, r in fit.residuals.items()}
    return Judged(fit, residuals, starts={run: at for fit in there for run, at in fit.starts.items()})


def loosened(judgement: Judged, folds: tuple[Fold, ...], bent: bool = False) -> Judged:
    """The same with the sizes of the effects free within the form tolerance; if `bent`, springs by far more."""
    residuals: dict[str, Array] = {}
    free = [relaxed(_refitted(judgement.fit, fold), fold.train, bent) for fold in folds]
    for fold, fit in zip(folds, free, strict=True):
        residuals.update(foretold(fit, fold.test, judgement.starts).residuals)
    return replace(judgement, loose=residuals, free=free[0])


def _refitted(fit: Fit, fold: Fold) -> Fit:
    if set(fit.starts) == {run.name for run in fold.train}:
        return fit
    return fitted(fit.theory, fold.train, fit.theta, fit.starts, iterations=8)


def p_value(base: Judged, best: Judged, tried: int) -> float:
    """That noise alone makes the best of `tried` sets, chosen on other runs, predict held-out runs so much better.

    For a fixed change of the prediction, noise of standard deviation 1 makes the sum of squares fall by x or more with
    a probability of at most that of a normal number above sqrt(x) (the likelihood ratio of two points); times the
    number of sets. x is counted in what the better set leaves, and in independent readings.
    """
    before, after = tempered(base.strict), tempered(best.strict)
    fall = sum(float((before[run] ** 2).sum() - (after[run] ** 2).sum()) for run in before)
    return float(min(1.0, tried * norm.sf(np.sqrt(max(fall, 0.0) / unit_of(after)))))


def excess(floors: float) -> float:
    """What of an error, in floors, is more than noise."""
    return float(np.sqrt(max(floors**2 - 1.0, 0.0)))


def beats(floors: float, others: float, settings: ChoiceSettings) -> bool:
    """Whether an error, in floors, is much less than another's, both beyond noise."""
    return excess(floors) < settings.much_better * excess(others)


def but_worst(residuals: dict[str, Array], out: int = 1) -> dict[str, Array]:
    """Residuals by run without those of the `out` runs that are met worst, of four or more."""
    runs = sorted(residuals.items(), key=lambda item: float(np.mean(item[1] ** 2)))
    return dict(runs[: len(runs) - out] if len(runs) >= RUNS else runs)


def rms(residuals: dict[str, Array]) -> float:
    """Root mean square of residuals by run."""
    return float(np.sqrt(np.mean(np.concatenate(list(residuals.values())) ** 2)))
