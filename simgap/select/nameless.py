"""Competitors without a name: forces of any shape beside a set, before the runs that choose.

A set that stands for something else leaves what a force without a name takes: any function of position, any friction of
speed, friction of two levels (one each way), any function of the time since a run began, two masses and a spring (as
far as that is stiff: parts that flex), or sizes that change over the session, as of what warms up or wears. Each is
added to first order about the set, its many numbers fitted where the set was and held together by a prior whose size
runs left out in turn tell, and judged by the same score (Brynjarsdottir and O'Hagan 2014: a discrepancy without a name
names nothing, but tells that one is missing).
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from freeart21.effects import EFFECTS
from freeart21.se3 import Array
from simgap.fit.fit import Fit, tempered, unit_of
from simgap.fit.guess import Linear, linear
from simgap.fit.theory import Range
from simgap.measure.data import FitRun
from simgap.select.hypotheses import Hypothesis, rms, score_parts
from simgap.select.predictive import Score, lead
from simgap.select.split import Fold

KINDS = ("position", "velocity", "direction", "time", "flexing", "session")
_MOMENTS = 6
"""Of a run, that a force of time goes straight between."""
_TIGHT = np.geomspace(1e-4, 1e4, 9)
"""Ridges that are tried, times what would make every column as large as all that is left."""
_SESSION = 6
"""Runs of a session that tell whether a size changes over it: a line through fewer is hardly tested."""


@dataclass(frozen=True)
class Nameless:
    """A force without a name beside a set."""

    kind: str
    """One of KINDS."""
    ahead: float
    """By how much it makes the choosing runs more probable than the set alone does, to the same order."""
    error: float
    """Standard error of that."""
    floors: float
    """That are left of choosing runs with it,"""
    without: float
    """... and by the set alone."""
    changes: dict[str, float]
    """Of kind "session": effect to the part of itself that its size changes by over the session."""
    numbers: int
    """How many numbers it has."""
    more: Array
    """(k,) by how much it makes every stretch more probable."""

    @property
    def taken(self) -> float:
        """Floors that it takes."""
        return float(np.sqrt(max(self.without**2 - self.floors**2, 0.0)))


def beside(hypothesis: Hypothesis, folds: tuple[Fold, ...], most: int | None = None) -> tuple[Nameless, ...]:
    """All forces without a name, or those of at most so many numbers, beside a set of effects, or beside none."""
    seen = [
        _Seen(trained, there, fold)
        for trained, there, fold in zip(hypothesis.trained, hypothesis.foretold, folds, strict=True)
    ]
    alone, left = _scored([(one.fit.freed, one.new.freed) for one in seen], folds)
    found = []
    for kind in KINDS:
        if most is not None and seen[0].numbers(kind) > most:
            continue
        told = [one.with_(kind) for one in seen]
        if any(each is None for each in told):
            continue
        rows = [each for each in told if each is not None]
        score, floors = _scored([(first, second) for first, second, _ in rows], folds)
        ahead, error = lead(score, alone)
        sizes, more = rows[0][2], score.parts - alone.parts
        changes = _changes(hypothesis.fit, sizes, kind)
        found.append(Nameless(kind, ahead, error, floors, left, changes, len(sizes), more))
    return tuple(found)


class _Seen:
    """One fold about a fit: what is left, to first order, of runs that were fitted and of others."""

    def __init__(self, trained: Fit, there: Fit, fold: Fold):
        self.fold, self.trained = fold, trained
        self.fit, self.new = linear(trained, fold.train), linear(there, fold.test)

    def with_(self, kind: str) -> tuple[Array, Array, Array] | None:
        """What is left of both with the force beside, and its coefficients; None where it cannot be told."""
        if kind == "session" and len({run.turn for run in self.fold.train}) < _SESSION:
            return None
        first, second = (self._columns(at, runs, kind) for at, runs in self._both())
        if not len(first):
            return None
        own = len(self.fit.parameters)
        columns = np.concatenate([self.fit.parameters, first]), np.concatenate([self.new.parameters, second])
        known = np.array([1 / r.prior**2 for r in self.trained.theory.ranges()])
        known = np.append(unit_of(tempered(self.trained.residuals)) * known, np.zeros(len(first)))
        sizes = _told(columns[0], self.fit.freed, _bounds(self.fold.train), known)
        return self.fit.freed - sizes @ columns[0], self.new.freed - sizes @ columns[1], sizes[own:]

    def _both(self) -> tuple[tuple[Linear, tuple[FitRun, ...]], ...]:
        return (self.fit, self.fold.train), (self.new, self.fold.test)

    def _columns(self, at: Linear, runs: tuple[FitRun, ...], kind: str) -> Array:
        """(m, N) what a unit of each of its numbers does to all readings."""
        if kind == "flexing" and at.problem.force_read:
            return np.zeros((0, 0))
        if kind == "flexing":  # a shaft bends by what it carries
            return at.read(np.concatenate([_bends(now, run.times_s) for now, run in zip(at.now, runs, strict=True)], 1))
        if kind == "time":
            return at.pushed(np.concatenate([self._hats(run) for run in runs], 1))
        if kind == "session":
            turns = np.concatenate([np.full(len(run.q), float(run.turn)) for run in runs])
            return at.parameters[self._sizes()] * ((turns - self._begin()) / self._span() - 0.5)
        names = self._names(kind)
        if kind == "direction":  # a push one way, which with friction is friction of two levels
            pairs = [at.columns(name) for name in names]
            return np.concatenate([rows[-1:] - rows[:1] for rows in pairs]) if pairs else np.zeros((0, 0))
        return np.concatenate([at.columns(name) for name in names]) if names else np.zeros((0, 0))

    def _names(self, kind: str) -> list[str]:
        """Effects that the force is made of."""
        names = [name for name, cls in EFFECTS.items() if kind in cls.spans and name not in self.trained.theory.names]
        return [name for name in names if self.fit.problem.plant.joint_type in EFFECTS[name].joint_types]

    def numbers(self, kind: str) -> int:
        """How many the force has."""
        if kind in ("time", "flexing", "session"):
            return {"time": _MOMENTS, "flexing": 2, "session": len(self._sizes())}[kind]
        names = self._names(kind)
        return len(names) if kind == "direction" else sum(self.fit.count(name) for name in names)

    def _hats(self, run: FitRun) -> Array:
        """(m, n) straight pieces of the time since a run began."""
        last = max(float(one.times_s[-1] - one.times_s[0]) for one in (*self.fold.train, *self.fold.test))
        parts = (run.times_s - run.times_s[0]) / last
        return np.maximum(1 - np.abs(parts * (_MOMENTS - 1) - np.arange(_MOMENTS)[:, None]), 0.0)

    def _begin(self) -> int:
        return min(run.turn for run in (*self.fold.train, *self.fold.test))

    def _span(self) -> int:
        return max(run.turn for run in (*self.fold.train, *self.fold.test)) - self._begin()

    def _sizes(self) -> list[int]:
        """Where the first number of every effect stands among the parameters."""
        ranges = self.trained.theory.ranges()
        return [next(i for i, r in enumerate(ranges) if r.owner == name) for name in self.trained.theory.names]


def _bends(q: Array, times_s: Array) -> Array:
    """(2, n) acceleration of a motion, and how fast that changes."""
    qdd = np.gradient(np.gradient(q, times_s), times_s)
    return np.stack([qdd, np.gradient(qdd, times_s)])


def _scored(rows: list[tuple[Array, Array]], folds: tuple[Fold, ...]) -> tuple[Score, float]:
    """Score of what is left (fitted, choosing) in every fold, and its floors on choosing runs."""
    parts = []
    for (first, second), fold in zip(rows, folds, strict=True):
        own, seen = _by_run(first, fold.train), _by_run(second, fold.test)
        parts.append(score_parts(own, seen, fold, len(folds)))
    return Score((), np.concatenate(parts)), rms([second for _, second in rows])


def _by_run(rows: Array, runs: tuple[FitRun, ...]) -> dict[str, Array]:
    bounds = _bounds(runs)
    return {run.name: rows[a:b] for run, (a, b) in zip(runs, pairwise(bounds), strict=True)}


def _bounds(runs: tuple[FitRun, ...]) -> list[int]:
    return [0, *np.cumsum([len(run.q) for run in runs]).tolist()]


def _told(columns: Array, left: Array, bounds: list[int], known: Array) -> Array:
    """(m,) sizes of columns (m, N) in what is left (N,): ridge regression, its ridge the one by which runs left out in
    turn, between `bounds`, are told best, beside what is `known` of them (m,), in inverse squares."""
    size = np.maximum(np.linalg.norm(columns, axis=1), 1e-9)
    scaled = columns / size[:, None]
    cuts = list(pairwise(bounds))
    normals = [scaled[:, a:b] @ scaled[:, a:b].T for a, b in cuts]
    sides = [scaled[:, a:b] @ left[a:b] for a, b in cuts]
    whole, side = sum(normals) + np.diag(known / size**2), sum(sides)
    unit = len(columns) / max(float(left @ left), 1e-12)
    kept = [(_axes(whole - normal), normal, own) for normal, own in zip(normals, sides, strict=True)]

    def missed(ridge: float) -> float:
        total = 0.0
        for axes, normal, own in kept:
            x = _solved(axes, side - own, ridge)
            total += float(x @ normal @ x - 2 * x @ own)
        return total

    ridge = min((unit * float(tight) for tight in _TIGHT), key=missed)
    return _solved(_axes(whole), side, ridge) / size


def _axes(normal: Array) -> tuple[Array, Array]:
    """Eigenvalues (m,) and vectors (m, m) of a normal matrix. What lies below the lost digits, or below zero by them,
    stands at them: columns of one run are left without any reading when that run is left out."""
    values, vectors = np.linalg.eigh(normal)
    return np.maximum(values, len(values) * np.finfo(float).eps * values[-1]), vectors


def _solved(axes: tuple[Array, Array], side: Array, ridge: float) -> Array:
    """(m,) the solution of (normal + ridge) x = side."""
    values, vectors = axes
    return np.asarray(vectors @ ((vectors.T @ side) / (values + ridge)))


def _changes(fit: Fit, sizes: Array, kind: str) -> dict[str, float]:
    """Effect to the part of itself that its size changes by; of one that is next to nothing, of a usual size."""
    if kind != "session":
        return {}
    first = {r.owner: max(abs(float(x)), 0.1 * r.size) for r, x in _backwards(fit)}
    return {name: float(s) / first[name] for name, s in zip(fit.theory.names, sizes, strict=True)}


def _backwards(fit: Fit) -> list[tuple[Range, float]]:
    """The numbers of a fit, the first ones last."""
    return list(zip(fit.theory.ranges(), fit.theta, strict=True))[::-1]
