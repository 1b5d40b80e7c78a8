"""Output-error fits: a set of effects, the asset's own doubts and a free start of every run, against all readings.

The noise is in the readings and nowhere else, so the simulation runs free and is compared with them. Far from the
answer a run that is simulated whole meets its stops and turns in another order than the real one; so a fit begins with
short stretches, each with a start of its own, and goes on to longer ones (multiple shooting: Bock 1983).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from freeart21.effects import Effect
from freeart21.se3 import Array
from simgap.fit.force_model import ForceModel
from simgap.fit.least_squares import Prior, charge, solve
from simgap.fit.theory import Problem as Problem
from simgap.fit.theory import Range as Range
from simgap.fit.theory import Reader as Reader
from simgap.fit.theory import Theory as Theory
from simgap.measure.data import FitRun
from simgap.models import kernel
from simgap.models.surrogate import Batch, creeping, readings_of, step_of, sweep, terms_of

_PROBE = 1e-4
"""Part of a parameter's size by which it is changed to see what it does."""
_SEEN_S = 0.3
"""Of a run that decides where its start is looked for."""
_SPEEDS = (0.0, *(s * part for part in (0.05, 0.1, 0.2, 0.3, 1.0) for s in (-1, 1)))
"""Parts of the largest speed by which a start may differ from its first guess."""

_MET = 2.0
"""Floors of error up to which a run is met, wherever it begins."""

_SHORT, _LONG = 1.5, 5.0
"""Crossings of its range, at its top speed, that a stretch lasts for."""
_STRETCHES, _LONGER, _MILD, _MILD_STEPS = 4, 3.0, 0.02, 6
"""Into which a run that hardly crosses its range is cut, and each of them again; times by which stretches of long runs
grow; part of the forces at work that a loss begins with; iterations on stretches."""

Starts = dict[str, tuple[float, float]]


@dataclass(frozen=True)
class Fit:
    """A theory at its best."""

    theory: Theory
    theta: Array
    """(p,) in the order of `theory.ranges()`."""
    starts: Starts
    """State at the first reading of every run that was fitted, by name."""
    residuals: dict[str, Array]
    """Reading less simulation over the floor, by run."""
    cost: float
    """Of all residuals, those of runs that are missed by far for less than their squares, and of what was known
    beforehand."""
    normal: Array
    """(p, p) information of the parameters, the starts being free."""

    @property
    def values(self) -> dict[tuple[str, str], float]:
        """Parameters by owner and name."""
        return {(r.owner, r.name): float(x) for r, x in zip(self.theory.ranges(), self.theta, strict=True)}

    @property
    def effects(self) -> tuple[Effect, ...]:
        """The added effects."""
        return self.theory.effects(self.theta)

    @property
    def rss(self) -> float:
        """Sum of squared residuals."""
        return float(sum((r * r).sum() for r in self.residuals.values()))

    @property
    def tempered(self) -> dict[str, Array]:
        """Residuals, those of runs that are missed by far made less: their squares are what they cost."""
        return tempered(self.residuals)

    @property
    def level(self) -> float:
        """Root mean square of all residuals, in floors."""
        return float(np.sqrt(self.rss / sum(len(r) for r in self.residuals.values())))

    def floors(self, run: str) -> float:
        """Root mean square residual of a run, in floors."""
        return float(np.sqrt(np.mean(self.residuals[run] ** 2)))


class _Model:
    """A theory before runs, as the solver asks of it."""

    def __init__(self, theory: Theory, runs: tuple[FitRun, ...], at: Array):
        self.reader, self.runs = Reader(theory), runs
        self.problem = theory.problem
        self.batch = Batch.of([(run.times_s, run.inputs) for run in runs])
        self.q, self.sigma = (np.concatenate([getattr(run, k) for run in runs]) for k in ("q", "sigma"))
        self.lengths = np.diff(self.batch.begins)
        self._kept: tuple[bytes, Array, tuple[Effect, ...]] | None = None
        self._chosen: tuple[bytes, NDArray[np.int64]] | None = None
        effects, settings = self.numbers(at)[1], theory.problem.surrogate
        self.terms = terms_of(effects)
        self.step = {held: step_of(self.problem.plant, effects, settings, held) for held in (True, False)}

    def numbers(self, theta: Array) -> tuple[Array, tuple[Effect, ...]]:
        """Vector and effects at parameters (p,); the last ones are kept."""
        key = theta.tobytes()
        if self._kept is None or self._kept[0] != key:
            self._kept = (key, *self.reader.numbers(theta))
        return self._kept[1], self._kept[2]

    def steps(self, effects: tuple[Effect, ...]) -> Array:
        """(r, 2) s; the same for all parameters but where they make the joint creep."""
        plant, settings = self.problem.plant, self.problem.surrogate
        held, loose = (creeping(plant, effects, self.step[it], settings) for it in (True, False))
        return np.where(self.batch.held[:, None], held, loose)

    def look(self, which: NDArray[np.int64], starts: Array, theta: Array) -> list[Array]:
        """Residuals of the runs `which` (m,) from starts (m, 2)."""
        table, effects = self._table(starts, theta)
        q = self.batch.sweep(table, self.terms, which, self.steps(effects))
        q = readings_of(effects, q) if self.reader.sensing else q
        at = self._readings(which)
        flat, ends = (self.q[at] - q) / self.sigma[at], np.cumsum(self.lengths[which])
        return [flat[end - n : end] for end, n in zip(ends, self.lengths[which], strict=True)]

    def begun(self, which: NDArray[np.int64], starts: Array, theta: Array) -> Array:
        """(m,) mean squared residuals of the first readings of the runs `which` (m,) from starts (m, 2)."""
        table, effects = self._table(starts, theta)
        cut = [run.between(0, _seen(run)) for run in self.runs]
        batch = Batch.of([(run.times_s, run.inputs) for run in cut])
        q = batch.sweep(table, self.terms, which, self.steps(effects))
        q = readings_of(effects, q) if self.reader.sensing else q
        lengths = np.diff(batch.begins)[which]
        flat = np.concatenate([cut[i].q for i in which]) - q
        square = (flat / np.concatenate([cut[i].sigma for i in which])) ** 2
        return np.asarray(np.add.reduceat(square, np.cumsum(lengths) - lengths) / lengths)

    def _table(self, starts: Array, theta: Array) -> tuple[Array, tuple[Effect, ...]]:
        """(m, n) vectors of numbers that differ in their starts (m, 2), and all effects."""
        numbers, effects = self.numbers(theta)
        table = np.repeat(numbers[None], len(starts), 0)
        table[:, kernel.Q0], table[:, kernel.QD0] = starts[:, 0], starts[:, 1]
        return table, effects

    def _readings(self, which: NDArray[np.int64]) -> NDArray[np.int64]:
        """Where the readings of these runs lie, one behind the other; the last ones are kept."""
        key = which.tobytes()
        if self._chosen is None or self._chosen[0] != key:
            begins = self.batch.begins
            self._chosen = (key, np.concatenate([np.arange(begins[i], begins[i + 1]) for i in which]))
        return self._chosen[1]

    def slopes(self, starts: Array, theta: Array, parts: list[Array], free: bool) -> list[Array]:
        """Of every run (2 + p, n): what a unit of its start and of every parameter does to its readings, in floors."""
        problem, ranges = self.problem, self.reader.ranges[: len(theta) if free else 0]
        deltas = np.array([_PROBE * max(0.1 * abs(x), r.size) for x, r in zip(theta, ranges, strict=False)])
        deltas = np.array([-d if x + d > r.upper else d for x, d, r in zip(theta, deltas, ranges, strict=False)])
        numbers, effects = self.numbers(theta)
        made = [(numbers, effects), (numbers, effects)]
        for j, delta in enumerate(deltas):
            moved = theta.copy()
            moved[j] += delta
            made.append(self.reader.numbers(moved))
        count, rows = len(self.runs), len(made)
        of_starts = (_PROBE * 0.1 * problem.reference[2], _PROBE * 0.1 * problem.speed)
        moves = np.tile(np.append(of_starts, deltas), (count, 1))
        moves[starts[:, 0] + moves[:, 0] > problem.plant.upper, 0] *= -1.0
        table = np.tile(np.array([row for row, _ in made]), (count, 1, 1))
        table[:, :, kernel.Q0], table[:, :, kernel.QD0] = starts[:, :1], starts[:, 1:]
        table[:, 0, kernel.Q0] += moves[:, 0]
        table[:, 1, kernel.QD0] += moves[:, 1]
        which = np.repeat(np.arange(count), rows)
        flat = self.batch.sweep(table.reshape(count * rows, -1), self.terms, which, self.steps(effects))
        found, done = [], 0
        for run, part, move, n in zip(self.runs, parts, moves, self.lengths, strict=True):
            q = flat[done : done + rows * n].reshape(rows, n)
            done += rows * n
            if self.reader.sensing:
                q = np.stack([readings_of(its, row) for (_, its), row in zip(made, q, strict=True)])
            found.append((q - (run.q - part * run.sigma)) / run.sigma / move[:, None])
        return found


def fitted(
    theory: Theory,
    runs: tuple[FitRun, ...],
    theta: Array | None = None,
    starts: Starts | None = None,
    iterations: int | None = None,
    free: bool = True,
) -> Fit:
    """The theory fitted to the runs from `theta` (p,) within its bounds.

    Args:
        theory: what is fitted.
        runs: what to.
        theta: first guess; the neutral point when not given.
        starts: first guesses of start states; looked for in the readings where not given.
        iterations: at most; as the settings say when not given.
        free: whether the parameters move; without, only the starts do.
    """
    ranges, plant = theory.ranges(), theory.problem.plant
    low, high = (np.array([getattr(r, k) for r in ranges]) for k in ("lower", "upper"))
    neutral, spread = (np.array([getattr(r, k) for r in ranges]) for k in ("neutral", "prior"))
    weight = np.diag(1 / spread**2)
    at = np.clip(theory.neutral() if theta is None else theta, low, high)
    model, begin = _begun(theory, runs, at, starts or {})
    begin[:, 0] = np.clip(begin[:, 0], plant.lower, plant.upper)
    most = theory.problem.fit.max_iterations if iterations is None else iterations
    prior = Prior(low, high, neutral, weight)
    state = solve(at, begin, model.look, model.slopes, prior, plant.lower, plant.upper, most, free)
    return Fit(
        theory,
        state.theta,
        {run.name: (float(q), float(v)) for run, (q, v) in zip(runs, state.starts, strict=True)},
        {run.name: part for run, part in zip(runs, state.parts, strict=True)},
        state.cost,
        state.normal,
    )


def _begun(theory: Theory, runs: tuple[FitRun, ...], at: Array, known: Starts) -> tuple[_Model | ForceModel, Array]:
    """The theory before the runs, and (r, 2) their starts, looked for where they are not known; where the force is read
    there are none."""
    if theory.problem.force_read:
        return ForceModel(theory, runs), np.zeros((len(runs), 2))
    model = _Model(theory, runs, at)
    starts = np.array([known.get(run.name, (0.0, 0.0)) for run in runs])
    unknown = np.array([i for i, run in enumerate(runs) if run.name not in known], dtype=int)
    if len(unknown):
        starts[unknown] = _starts(model, unknown, at)
    return model, starts


def left_by(theory: Theory, runs: tuple[FitRun, ...], theta: Array, starts: Starts) -> Array:
    """(N,) residuals of all runs in a row, of these very parameters and starts."""
    model, known = _begun(theory, runs, theta, starts)
    return np.concatenate(model.look(np.arange(len(runs)), known, theta))


def misfit(theory: Theory, runs: tuple[FitRun, ...], theta: Array, starts: Starts) -> float:
    """Sum of squared residuals of these very parameters and starts."""
    left = left_by(theory, runs, theta, starts)
    return float(left @ left)


def _seen(run: FitRun) -> int:
    """Readings of a run that decide where its start is looked for."""
    return max(8, int(np.searchsorted(run.times_s, run.times_s[0] + _SEEN_S)))


def _starts(model: _Model, which: NDArray[np.int64], theta: Array) -> Array:
    """(m, 2) the starts, of those about the first guesses, from which the runs `which` (m,) begin most like their
    readings."""
    plant, speed = model.problem.plant, model.problem.speed
    sensing = [effect for effect in model.numbers(theta)[1] if effect.kind == "sensing"]
    rows = []
    for i in which:
        run, told = model.runs[i], model.runs[i].starts
        speeds = (*(told[0][1] + speed * np.array(_SPEEDS)), *(qd0 for _, qd0 in told[1:]), 0.0)
        rows.append([*told[1:], *((q, v) for q in (told[0][0], run.q[0]) for v in speeds)])
    starts = np.array(rows)  # (m, ways, 2)
    starts[..., 0] -= sum((effect.reading_error(starts[..., 0]) for effect in sensing), np.zeros(starts.shape[:2]))
    starts[..., 0] = np.clip(starts[..., 0], plant.lower, plant.upper)
    ways = starts.shape[1]
    left = model.begun(np.repeat(which, ways), starts.reshape(-1, 2), theta).reshape(-1, ways)
    return np.asarray(starts[np.arange(len(which)), left.argmin(1)])


def grown(theory: Theory, runs: tuple[FitRun, ...], theta: Array | None = None, iterations: int = 6) -> Fit:
    """The theory fitted to short stretches first, then to longer ones, then to whole runs."""
    at, known = stretched(theory, runs, theta, _SHORT, iterations)
    at, known = stretched(theory, runs, at, _LONG, iterations, known)
    return resettled(fitted(theory, runs, at, known), runs)


def grown_mild(theory: Theory, runs: tuple[FitRun, ...]) -> Fit:
    """The theory fitted from the asset as it is told, its effects mild beside the forces at work, to ever longer
    stretches: as `grown`, but those of a motion that takes its whole run to cross the range are parts of that."""
    longest = max(float(run.times_s[-1] - run.times_s[0]) for run in runs)
    crossings = longest / theory.problem.crossing_s
    ways = [_SHORT, _LONG] if crossings > _STRETCHES * _SHORT else [crossings / _STRETCHES**2, crossings / _STRETCHES]
    while _LONGER * _STRETCHES / 2 * ways[-1] < crossings:
        ways.append(_LONGER * ways[-1])
    at, known = _mild(theory, runs), None
    for way in ways:
        at, known = stretched(theory, runs, at, way, _MILD_STEPS, known)
    return resettled(fitted(theory, runs, at, known), runs)


def _mild(theory: Theory, runs: tuple[FitRun, ...]) -> Array:
    """(p,) the neutral point, the first size of every force a small part of the forces at work."""
    problem, theta = theory.problem, theory.neutral()
    q, v = (np.concatenate([getattr(run, k)[::5] for run in runs]) for k in ("q", "speed"))
    for cls in theory.classes:
        if cls.acts not in ("force", "drive"):
            continue
        i = next(i for i, r in enumerate(theory.ranges()) if r.owner == cls.name)
        others = [*(theta[i + k] for k in range(1, len(theory.fitted_of(cls)))), *problem.ends(cls).values()]
        unit = float(np.sqrt(np.mean((cls.law(q, v, problem.presses(cls), 1.0, 1.0, *others) * np.ones(len(q))) ** 2)))
        theta[i] = _MILD * problem.force / max(unit, 1e-12)
    low, high = (np.array([getattr(r, k) for r in theory.ranges()]) for k in ("lower", "upper"))
    return np.asarray(np.clip(theta, low, high))


def stretched(
    theory: Theory,
    runs: tuple[FitRun, ...],
    theta: Array | None,
    crossings: float,
    iterations: int,
    known: Starts | None = None,
) -> tuple[Array, Starts]:
    """Parameters from stretches of the runs, and the starts of stretches and of runs."""
    cut = pieces(runs, crossings * theory.problem.crossing_s)
    rough = fitted(theory, cut, theta, known, iterations)
    return rough.theta, {**rough.starts, **{run.name: rough.starts[f"{run.name}#0"] for run in runs}}


def placed(fit: Fit, runs: tuple[FitRun, ...], starts: Starts | None = None) -> Fit:
    """The same parameters on other runs: only the start states are fitted."""
    return fit_starts(fit.theory, fit.theta, runs, starts)


def fit_starts(theory: Theory, theta: Array, runs: tuple[FitRun, ...], starts: Starts | None = None) -> Fit:
    """A theory at parameters (p,) before runs: only the start states are fitted."""
    starts = settled(theory, theta, runs) if starts is None else starts
    return fitted(theory, runs, theta, starts, iterations=12, free=False)


def information(fit: Fit, unit: float) -> Array:
    """(p, p) of the parameters, the starts being free: what the readings say is counted in units of noise, what was
    known before in full."""
    known = np.diag([1 / r.prior**2 for r in fit.theory.ranges()])
    return np.asarray((fit.normal - known) / unit + known)


def tempered(residuals: dict[str, Array]) -> dict[str, Array]:
    """Residuals in floors, by run, with sums of squares that are what the runs cost (`least_squares.charge`)."""
    powers = np.array([max(float(np.mean(r * r)), 1e-12) for r in residuals.values()])
    factors = np.sqrt(charge(powers) / powers)
    return {run: factor * r for factor, (run, r) in zip(factors, residuals.items(), strict=True)}


def unit_of(left: dict[str, Array]) -> float:
    """Variance of a sum of squares' independent part: what is left (residuals in floors, by run), times how far it is
    correlated."""
    power = max(np.mean([np.mean(r * r) for r in left.values()]), 1e-12)
    summed = 0.0
    for r in left.values():
        for lag in range(1, min(len(r) // 4, 200)):
            c = float(r[:-lag] @ r[lag:]) / len(r) / power / len(left)
            if c < 0.02:
                break
            summed += c
    return float(max(power, 1.0) * (1 + 2 * summed))


def priced(free: int, readings: int) -> float:
    """What the log density of the very readings that `free` numbers were fitted to is too large by (Schwarz 1978)."""
    return 0.5 * free * float(np.log(readings))


def settled(theory: Theory, theta: Array, runs: tuple[FitRun, ...]) -> Starts:
    """Start states that make the simulation follow each run ever longer: a far impact misleads a first guess."""
    starts: Starts = {}
    if theory.problem.force_read:
        return starts
    for part in (0.08, 0.2, 0.45):
        cut = tuple(run.between(0, max(8, round(part * len(run.q)))) for run in runs)
        starts = fitted(theory, cut, theta, starts, iterations=6, free=False).starts
    return starts


def resettled(fit: Fit, runs: tuple[FitRun, ...]) -> Fit:
    """The fit after a new look at the starts of runs that it misses: an impact may have led them astray."""
    usual = float(np.median([fit.floors(run.name) for run in runs]))
    missed = tuple(run for run in runs if fit.floors(run.name) > max(_MET, 1.5 * usual))
    if not missed:
        return fit
    again = placed(fit, missed)
    better = {run.name: again.starts[run.name] for run in missed if again.floors(run.name) < 0.9 * fit.floors(run.name)}
    return fitted(fit.theory, runs, fit.theta, {**fit.starts, **better}) if better else fit


def predicted(fit: Fit, run: FitRun, times_s: Array | None = None) -> Array:
    """(n,) readings that the fit predicts of a run that it has a start for."""
    reader = Reader(fit.theory)
    numbers, effects = reader.numbers(fit.theta)
    numbers[kernel.Q0], numbers[kernel.QD0] = fit.starts[run.name]
    times = run.times_s if times_s is None else times_s
    step = step_of(fit.theory.problem.plant, effects, fit.theory.problem.surrogate, run.inputs.held)
    return readings_of(effects, sweep(numbers[None], terms_of(effects), times, run.inputs, step)[0])


@lru_cache(maxsize=32)
def pieces(runs: tuple[FitRun, ...], seconds: float) -> tuple[FitRun, ...]:
    """The runs cut into stretches of about `seconds`, each with a start of its own, named by their first readings."""
    found = []
    for run in runs:
        duration = float(run.times_s[-1] - run.times_s[0])
        count = max(1, min(round(duration / seconds), len(run.q) // 12))
        bounds = [len(run.q) * k // count for k in range(count + 1)]
        found += [replace(run.between(a, b), name=f"{run.name}#{a}") for a, b in pairwise(bounds)]
    return tuple(found)


def tangent(fit: Fit, runs: tuple[FitRun, ...]) -> tuple[list[Array], list[Array], list[Array]]:
    """Of every run: residuals (n,), and what a unit of start (2, n) and of each parameter (p, n) does to the readings,
    all in floors. The fit must have starts for the runs.
    """
    model, starts = _begun(fit.theory, runs, fit.theta, fit.starts)
    parts = model.look(np.arange(len(runs)), starts, fit.theta)
    slopes = model.slopes(starts, fit.theta, parts, True)
    first = 2 if fit.theory.problem.force_read else 0
    return parts, [J[first:2] for J in slopes], [J[2:] for J in slopes]


def joined(theory: Theory, parent: Fit, points: dict[str, dict[str, float]]) -> Array:
    """(p,) start of a theory: what the parent has, and `points` for effects that it has not."""
    values = parent.values
    for owner, point in points.items():
        values.update({(owner, name): value for name, value in point.items()})
    return np.array([values.get((r.owner, r.name), r.neutral) for r in theory.ranges()])
