"""Nonparametric discrepancies: forces of free shape added to a set of effects.

A set that stands in for something else leaves what a free force explains: a function of position, friction over speed,
friction of two levels (one for each direction), a function of time since the run began, flexing parts (two masses and a
spring, to first order), or sizes that change over the session (warming, wear). Each is fitted to first order about the
set with a ridge prior, whose size is chosen by leaving out runs, and scored as sets are. A discrepancy names nothing
but shows that something is missing (Brynjarsdottir and O'Hagan 2014).
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from freeart21.effects import EFFECTS
from freeart21.se3 import Array
from simgap.fit.fit import Fit, residual_dispersion, robust_residuals
from simgap.fit.guess import Linearisation, linearise
from simgap.fit.model import ParameterRange
from simgap.measure.data import FitRun
from simgap.select.hypotheses import Hypothesis, pooled_rms, score_parts
from simgap.select.predictive import Score, score_difference
from simgap.select.split import Fold

KINDS = ("position", "velocity", "direction", "time", "flexing", "session")
_MOMENTS = 6
"""Knots of a force over time."""
_TIGHT = np.geomspace(1e-4, 1e4, 9)
"""Grid of the ridge, relative to columns that explain the whole residual."""
_SESSION = 6
"""Runs of a session that show a change of size over it; a line through fewer is hardly tested."""


@dataclass(frozen=True)
class Discrepancy:
    """A free force added to a set."""

    kind: str
    """One of KINDS."""
    gain: float
    """Gain of log predictive density over the set alone, to the same order."""
    error: float
    """Its standard error."""
    rms: float
    """Normalised RMS of the test runs with it,"""
    rms_alone: float
    """... and of the set alone."""
    changes: dict[str, float]
    """For kind "session": effect to the relative change of its size over the session."""
    numbers: int
    """Number of parameters."""
    more: Array
    """(k,) gain of log density of each stretch."""

    @property
    def rms_removed(self) -> float:
        """Normalised RMS that it removes."""
        return float(np.sqrt(max(self.rms_alone**2 - self.rms**2, 0.0)))


def find_discrepancies(
    hypothesis: Hypothesis, folds: tuple[Fold, ...], kinds: tuple[str, ...] = KINDS
) -> tuple[Discrepancy, ...]:
    """The discrepancies of a set."""
    linear_folds = [
        _LinearFold(trained, there, fold)
        for trained, there, fold in zip(hypothesis.trained, hypothesis.predicted, folds, strict=True)
    ]
    alone, left = _score_folds([(one.fit.free_residual, one.new.free_residual) for one in linear_folds], folds)
    found = []
    for kind in kinds:
        fits = [one.fit_kind(kind) for one in linear_folds]
        if any(each is None for each in fits):
            continue
        rows = [each for each in fits if each is not None]
        score, floors = _score_folds([(first, second) for first, second, _ in rows], folds)
        ahead, error = score_difference(score, alone)
        sizes, more = rows[0][2], score.parts - alone.parts
        changes = _session_changes(hypothesis.fit, sizes, kind)
        found.append(Discrepancy(kind, ahead, error, floors, left, changes, len(sizes), more))
    return tuple(found)


class _LinearFold:
    """One fold, linearised about a fit: training and test runs."""

    def __init__(self, trained: Fit, there: Fit, fold: Fold):
        self.fold, self.trained = fold, trained
        self.fit, self.new = linearise(trained, fold.train), linearise(there, fold.test)

    def fit_kind(self, kind: str) -> tuple[Array, Array, Array] | None:
        """Residuals (training, test) with the discrepancy fitted, and its coefficients; None where there is none."""
        if kind == "session" and len({run.order for run in self.fold.train}) < _SESSION:
            return None
        first, second = (self._columns(at, runs, kind) for at, runs in self._both())
        if not len(first):
            return None
        own = len(self.fit.parameters)
        columns = np.concatenate([self.fit.parameters, first]), np.concatenate([self.new.parameters, second])
        known = np.array([1 / r.prior**2 for r in self.trained.model.ranges()])
        known = np.append(residual_dispersion(robust_residuals(self.trained.residuals)) * known, np.zeros(len(first)))
        sizes = _fit_ridge(columns[0], self.fit.free_residual, _run_bounds(self.fold.train), known)
        return self.fit.free_residual - sizes @ columns[0], self.new.free_residual - sizes @ columns[1], sizes[own:]

    def _both(self) -> tuple[tuple[Linearisation, tuple[FitRun, ...]], ...]:
        return (self.fit, self.fold.train), (self.new, self.fold.test)

    def _columns(self, at: Linearisation, runs: tuple[FitRun, ...], kind: str) -> Array:
        """(m, N) response of all readings to a unit of each parameter."""
        if kind == "flexing" and at.problem.inverse_dynamics:
            return np.zeros((0, 0))
        if kind == "flexing":  # a shaft twists in proportion to its load
            return at.reading_response(
                np.concatenate(
                    [_flex_columns(now, run.times_s) for now, run in zip(at.predicted, runs, strict=True)], 1
                )
            )
        if kind == "time":
            return at.force_response(np.concatenate([self._hat_functions(run) for run in runs], 1))
        if kind == "session":
            turns = np.concatenate([np.full(len(run.q), float(run.order)) for run in runs])
            return at.parameters[self._sizes()] * ((turns - self._begin()) / self._span() - 0.5)
        names = self._names(kind)
        if kind == "direction":  # a constant force; with friction it makes two levels
            pairs = [at.unit_responses(name) for name in names]
            return np.concatenate([rows[-1:] - rows[:1] for rows in pairs]) if pairs else np.zeros((0, 0))
        return np.concatenate([at.unit_responses(name) for name in names]) if names else np.zeros((0, 0))

    def _names(self, kind: str) -> list[str]:
        """Effects that are the basis functions."""
        names = [name for name, cls in EFFECTS.items() if kind in cls.basis_of and name not in self.trained.model.names]
        return [name for name in names if self.fit.problem.plant.joint_type in EFFECTS[name].joint_types]

    def _hat_functions(self, run: FitRun) -> Array:
        """(m, n) hat functions over time since the run began."""
        last = max(float(one.times_s[-1] - one.times_s[0]) for one in (*self.fold.train, *self.fold.test))
        parts = (run.times_s - run.times_s[0]) / last
        return np.maximum(1 - np.abs(parts * (_MOMENTS - 1) - np.arange(_MOMENTS)[:, None]), 0.0)

    def _begin(self) -> int:
        return min(run.order for run in (*self.fold.train, *self.fold.test))

    def _span(self) -> int:
        return max(run.order for run in (*self.fold.train, *self.fold.test)) - self._begin()

    def _sizes(self) -> list[int]:
        """Index of the first parameter of every effect."""
        ranges = self.trained.model.ranges()
        return [next(i for i, r in enumerate(ranges) if r.owner == name) for name in self.trained.model.names]


def _flex_columns(q: Array, times_s: Array) -> Array:
    """(2, n) second and third derivative of a motion."""
    qdd = np.gradient(np.gradient(q, times_s), times_s)
    return np.stack([qdd, np.gradient(qdd, times_s)])


def _score_folds(rows: list[tuple[Array, Array]], folds: tuple[Fold, ...]) -> tuple[Score, float]:
    """Score of the residuals (training, test) of all folds, and the RMS of the test runs."""
    parts = []
    for (first, second), fold in zip(rows, folds, strict=True):
        own, predicted = _split_by_run(first, fold.train), _split_by_run(second, fold.test)
        parts.append(score_parts(own, predicted, fold, len(folds)))
    return Score((), np.concatenate(parts)), pooled_rms([second for _, second in rows])


def _split_by_run(rows: Array, runs: tuple[FitRun, ...]) -> dict[str, Array]:
    bounds = _run_bounds(runs)
    return {run.name: rows[a:b] for run, (a, b) in zip(runs, pairwise(bounds), strict=True)}


def _run_bounds(runs: tuple[FitRun, ...]) -> list[int]:
    return [0, *np.cumsum([len(run.q) for run in runs]).tolist()]


def _fit_ridge(columns: Array, left: Array, bounds: list[int], known: Array) -> Array:
    """(m,) coefficients of the columns (m, N) in the residuals (N,), by ridge regression. The ridge predicts runs that
    are left out in turn (between `bounds`) best. `known` (m,) are prior precisions."""
    size = np.maximum(np.linalg.norm(columns, axis=1), 1e-9)
    scaled = columns / size[:, None]
    cuts = list(pairwise(bounds))
    normals = [scaled[:, a:b] @ scaled[:, a:b].T for a, b in cuts]
    sides = [scaled[:, a:b] @ left[a:b] for a, b in cuts]
    whole, side = sum(normals) + np.diag(known / size**2), sum(sides)
    unit = len(columns) / max(float(left @ left), 1e-12)
    folds_left_out = [(_eigen(whole - normal), normal, own) for normal, own in zip(normals, sides, strict=True)]

    def missed(ridge: float) -> float:
        total = 0.0
        for axes, normal, own in folds_left_out:
            x = _solve_ridge(axes, side - own, ridge)
            total += float(x @ normal @ x - 2 * x @ own)
        return total

    ridge = min((unit * float(tight) for tight in _TIGHT), key=missed)
    return _solve_ridge(_eigen(whole), side, ridge) / size


def _eigen(normal: Array) -> tuple[Array, Array]:
    """Eigenvalues (m,), at least rounding error, and eigenvectors (m, m) of a normal matrix. Without the one run that
    excites it, a column is zero."""
    values, vectors = np.linalg.eigh(normal)
    return np.maximum(values, len(values) * np.finfo(float).eps * values[-1]), vectors


def _solve_ridge(axes: tuple[Array, Array], side: Array, ridge: float) -> Array:
    """(m,) solution of (normal + ridge) x = side."""
    values, vectors = axes
    return np.asarray(vectors @ ((vectors.T @ side) / (values + ridge)))


def _session_changes(fit: Fit, sizes: Array, kind: str) -> dict[str, float]:
    """Effect to the relative change of its size, relative to a tenth of its scale for small ones."""
    if kind != "session":
        return {}
    first = {r.owner: max(abs(float(x)), 0.1 * r.size) for r, x in _backwards(fit)}
    return {name: float(s) / first[name] for name, s in zip(fit.model.names, sizes, strict=True)}


def _backwards(fit: Fit) -> list[tuple[ParameterRange, float]]:
    """Parameters and values of a fit in reverse order."""
    return list(zip(fit.model.ranges(), fit.theta, strict=True))[::-1]
