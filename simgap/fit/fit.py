"""Output-error fits: effects, errors of the asset and a start state per run, fitted to all readings.

Noise is in the readings only, so the simulation runs freely and is compared with them. Far from the solution a long
simulation meets stops and turns in another order than the recording. Fits therefore begin with short stretches, each
with its own start state, and continue with longer ones (multiple shooting: Bock 1983).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from freeart21.effects import Effect
from freeart21.se3 import Array
from simgap.fit.force_predictor import ForcePredictor
from simgap.fit.least_squares import Prior, robust_loss, solve
from simgap.fit.model import Model as Model
from simgap.fit.model import ParameterMap as ParameterMap
from simgap.fit.model import ParameterRange as ParameterRange
from simgap.fit.model import Problem as Problem
from simgap.measure.data import FitRun
from simgap.models import kernel
from simgap.models.surrogate import Batch, apply_sensing, effect_terms, limit_creep_steps, sweep, time_steps

_MAX_ITERATIONS = 15
_PROBE = 1e-4
"""Finite-difference step, as a share of a parameter's size."""
_SEEN_S = 0.3
"""First seconds of a run that decide its start state."""
_SPEEDS = (0.0, *(s * part for part in (0.05, 0.1, 0.2, 0.3, 1.0) for s in (-1, 1)))
"""Start speeds that are tried, as shares of the largest speed."""

_MET = 2.0
"""Normalised RMS below which a run's start needs no second search."""

_SHORT, _LONG = 1.5, 5.0
"""Length of stretches, in crossings of the range at top speed."""
_STRETCHES, _LONGER, _MILD, _MILD_STEPS = 4, 3.0, 0.02, 6
"""For slow motion: stretches per run, and stretches per stretch; growth of stretches; initial size of a loss, as a
share of the RMS force; iterations on stretches."""

Starts = dict[str, tuple[float, float]]


@dataclass(frozen=True)
class Fit:
    """A fitted model."""

    model: Model
    theta: Array
    """(p,) in the order of `model.ranges()`."""
    starts: Starts
    """Run name to the state (q, qd) at its first reading."""
    residuals: dict[str, Array]
    """Run name to (n,) normalised residuals, reading less simulation."""
    cost: float
    """Robust loss of all residuals plus the prior's."""
    normal: Array
    """(p, p) information matrix of the parameters, start states eliminated."""

    @property
    def values(self) -> dict[tuple[str, str], float]:
        """Parameters by owner and name."""
        return {(r.owner, r.name): float(x) for r, x in zip(self.model.ranges(), self.theta, strict=True)}

    @property
    def effects(self) -> tuple[Effect, ...]:
        """The added effects."""
        return self.model.effects(self.theta)

    @property
    def rss(self) -> float:
        """Sum of squared residuals."""
        return float(sum((r * r).sum() for r in self.residuals.values()))

    @property
    def rms(self) -> float:
        """Normalised RMS of all residuals."""
        return float(np.sqrt(self.rss / sum(len(r) for r in self.residuals.values())))

    def run_rms(self, run: str) -> float:
        """Normalised RMS of a run."""
        return float(np.sqrt(np.mean(self.residuals[run] ** 2)))


class _PositionPredictor:
    """A model and runs as the solver takes them: residuals of positions and their derivatives."""

    def __init__(self, model: Model, runs: tuple[FitRun, ...], at: Array):
        self.mapping, self.runs = ParameterMap(model), runs
        self.problem = model.problem
        self.batch = Batch.of([(run.times_s, run.inputs) for run in runs])
        self.q, self.sigma = (np.concatenate([getattr(run, k) for run in runs]) for k in ("q", "sigma"))
        self.lengths = np.diff(self.batch.begins)
        self._vector_cache: tuple[bytes, Array, tuple[Effect, ...]] | None = None
        self._rows_cache: tuple[bytes, NDArray[np.int64]] | None = None
        effects = self.vector(at)[1]
        self.terms = effect_terms(effects)
        self.step = {held: time_steps(self.problem.plant, effects, held) for held in (True, False)}

    def vector(self, theta: Array) -> tuple[Array, tuple[Effect, ...]]:
        """Kernel vector and effects at parameters (p,); the last ones are cached."""
        key = theta.tobytes()
        if self._vector_cache is None or self._vector_cache[0] != key:
            self._vector_cache = (key, *self.mapping.vector(theta))
        return self._vector_cache[1], self._vector_cache[2]

    def steps(self, effects: tuple[Effect, ...]) -> Array:
        """(r, 2) time steps, s; the same for all parameters except strong damping."""
        plant = self.problem.plant
        held, loose = (limit_creep_steps(plant, effects, self.step[it]) for it in (True, False))
        return np.where(self.batch.held[:, None], held, loose)

    def evaluate(self, which: NDArray[np.int64], starts: Array, theta: Array) -> list[Array]:
        """Normalised residuals of the runs `which` (m,) from starts (m, 2)."""
        table, effects = self._table(starts, theta)
        q = self.batch.sweep(table, self.terms, which, self.steps(effects))
        q = apply_sensing(effects, q) if self.mapping.sensing else q
        at = self._readings(which)
        flat, ends = (self.q[at] - q) / self.sigma[at], np.cumsum(self.lengths[which])
        return [flat[end - n : end] for end, n in zip(ends, self.lengths[which], strict=True)]

    def first_errors(self, which: NDArray[np.int64], starts: Array, theta: Array) -> Array:
        """(m,) mean squared residuals of the first readings of the runs `which` (m,) from starts (m, 2)."""
        table, effects = self._table(starts, theta)
        cut = [run.between(0, _count_first_readings(run)) for run in self.runs]
        batch = Batch.of([(run.times_s, run.inputs) for run in cut])
        q = batch.sweep(table, self.terms, which, self.steps(effects))
        q = apply_sensing(effects, q) if self.mapping.sensing else q
        lengths = np.diff(batch.begins)[which]
        flat = np.concatenate([cut[i].q for i in which]) - q
        square = (flat / np.concatenate([cut[i].sigma for i in which])) ** 2
        return np.asarray(np.add.reduceat(square, np.cumsum(lengths) - lengths) / lengths)

    def _table(self, starts: Array, theta: Array) -> tuple[Array, tuple[Effect, ...]]:
        """(m, n) kernel vectors that differ in their starts (m, 2), and all effects."""
        numbers, effects = self.vector(theta)
        table = np.repeat(numbers[None], len(starts), 0)
        table[:, kernel.Q0], table[:, kernel.QD0] = starts[:, 0], starts[:, 1]
        return table, effects

    def _readings(self, which: NDArray[np.int64]) -> NDArray[np.int64]:
        """Indices of the readings of these runs; the last ones are cached."""
        key = which.tobytes()
        if self._rows_cache is None or self._rows_cache[0] != key:
            begins = self.batch.begins
            self._rows_cache = (key, np.concatenate([np.arange(begins[i], begins[i + 1]) for i in which]))
        return self._rows_cache[1]

    def differentiate(self, starts: Array, theta: Array, parts: list[Array], free: bool) -> list[Array]:
        """Per run (2 + p, n): response of its normalised readings to a unit of start state and parameter."""
        problem, ranges = self.problem, self.mapping.ranges[: len(theta) if free else 0]
        deltas = np.array([_PROBE * max(0.1 * abs(x), r.size) for x, r in zip(theta, ranges, strict=False)])
        deltas = np.array([-d if x + d > r.upper else d for x, d, r in zip(theta, deltas, ranges, strict=False)])
        numbers, effects = self.vector(theta)
        made = [(numbers, effects), (numbers, effects)]
        for j, delta in enumerate(deltas):
            moved = theta.copy()
            moved[j] += delta
            made.append(self.mapping.vector(moved))
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
            if self.mapping.sensing:
                q = np.stack([apply_sensing(its, row) for (_, its), row in zip(made, q, strict=True)])
            found.append((q - (run.q - part * run.sigma)) / run.sigma / move[:, None])
        return found


def fit_model(
    model: Model,
    runs: tuple[FitRun, ...],
    theta: Array | None = None,
    starts: Starts | None = None,
    iterations: int = _MAX_ITERATIONS,
    free: bool = True,
) -> Fit:
    """The model fitted to the runs within its bounds.

    Args:
        model: what is fitted.
        runs: to these.
        theta: (p,) initial guess; the neutral point when None.
        starts: initial start states; searched where missing.
        iterations: at most.
        free: whether the parameters move; else only start states do.
    """
    ranges, plant = model.ranges(), model.problem.plant
    low, high = (np.array([getattr(r, k) for r in ranges]) for k in ("lower", "upper"))
    neutral, spread = (np.array([getattr(r, k) for r in ranges]) for k in ("neutral", "prior"))
    weight = np.diag(1 / spread**2)
    at = np.clip(model.neutral() if theta is None else theta, low, high)
    predictor, begin = _make_predictor(model, runs, at, starts or {})
    begin[:, 0] = np.clip(begin[:, 0], plant.lower, plant.upper)
    prior = Prior(low, high, neutral, weight)
    state = solve(
        at, begin, predictor.evaluate, predictor.differentiate, prior, plant.lower, plant.upper, iterations, free
    )
    return Fit(
        model,
        state.theta,
        {run.name: (float(q), float(v)) for run, (q, v) in zip(runs, state.starts, strict=True)},
        {run.name: part for run, part in zip(runs, state.parts, strict=True)},
        state.cost,
        state.normal,
    )


def _make_predictor(
    model: Model, runs: tuple[FitRun, ...], at: Array, known: Starts
) -> tuple[_PositionPredictor | ForcePredictor, Array]:
    """The predictor, and (r, 2) start states, searched where unknown; zeros for inverse dynamics."""
    if model.problem.inverse_dynamics:
        return ForcePredictor(model, runs), np.zeros((len(runs), 2))
    predictor = _PositionPredictor(model, runs, at)
    starts = np.array([known.get(run.name, (0.0, 0.0)) for run in runs])
    unknown = np.array([i for i, run in enumerate(runs) if run.name not in known], dtype=int)
    if len(unknown):
        starts[unknown] = _find_starts(predictor, unknown, at)
    return predictor, starts


def residuals_at(model: Model, runs: tuple[FitRun, ...], theta: Array, starts: Starts) -> Array:
    """(N,) normalised residuals of all runs at given parameters and starts."""
    predictor, known = _make_predictor(model, runs, theta, starts)
    return np.concatenate(predictor.evaluate(np.arange(len(runs)), known, theta))


def squared_error(model: Model, runs: tuple[FitRun, ...], theta: Array, starts: Starts) -> float:
    """Sum of squared residuals at given parameters and starts."""
    residuals = residuals_at(model, runs, theta, starts)
    return float(residuals @ residuals)


def _count_first_readings(run: FitRun) -> int:
    """Number of readings that decide a run's start state."""
    return max(8, int(np.searchsorted(run.times_s, run.times_s[0] + _SEEN_S)))


def _find_starts(predictor: _PositionPredictor, which: NDArray[np.int64], theta: Array) -> Array:
    """(m, 2) start states near the first guesses from which the runs `which` (m,) begin with the least error."""
    plant, speed = predictor.problem.plant, predictor.problem.speed
    sensing = [effect for effect in predictor.vector(theta)[1] if effect.kind == "sensing"]
    rows = []
    for i in which:
        run, guesses = predictor.runs[i], predictor.runs[i].starts
        speeds = (*(guesses[0][1] + speed * np.array(_SPEEDS)), *(qd0 for _, qd0 in guesses[1:]), 0.0)
        rows.append([*guesses[1:], *((q, v) for q in (guesses[0][0], run.q[0]) for v in speeds)])
    starts = np.array(rows)  # (m, ways, 2)
    starts[..., 0] -= sum((effect.reading_error(starts[..., 0]) for effect in sensing), np.zeros(starts.shape[:2]))
    starts[..., 0] = np.clip(starts[..., 0], plant.lower, plant.upper)
    ways = starts.shape[1]
    residuals = predictor.first_errors(np.repeat(which, ways), starts.reshape(-1, 2), theta).reshape(-1, ways)
    return np.asarray(starts[np.arange(len(which)), residuals.argmin(1)])


def fit_multiple_shooting(
    model: Model, runs: tuple[FitRun, ...], theta: Array | None = None, iterations: int = 6
) -> Fit:
    """The model fitted to short stretches, then longer ones, then whole runs."""
    at, known = fit_stretches(model, runs, theta, _SHORT, iterations)
    at, known = fit_stretches(model, runs, at, _LONG, iterations, known)
    return refit_missed_starts(fit_model(model, runs, at, known), runs)


def fit_from_small_effects(model: Model, runs: tuple[FitRun, ...]) -> Fit:
    """The model fitted from the asset as given with small effects, to ever longer stretches. Of motions that cross
    their range once, stretches are parts of that."""
    longest = max(float(run.times_s[-1] - run.times_s[0]) for run in runs)
    crossings = longest / model.problem.crossing_s
    ways = [_SHORT, _LONG] if crossings > _STRETCHES * _SHORT else [crossings / _STRETCHES**2, crossings / _STRETCHES]
    while _LONGER * _STRETCHES / 2 * ways[-1] < crossings:
        ways.append(_LONGER * ways[-1])
    at, known = _small_effects(model, runs), None
    for way in ways:
        at, known = fit_stretches(model, runs, at, way, _MILD_STEPS, known)
    return refit_missed_starts(fit_model(model, runs, at, known), runs)


def _small_effects(model: Model, runs: tuple[FitRun, ...]) -> Array:
    """(p,) the neutral point with every force a small share of the RMS force."""
    problem, theta = model.problem, model.neutral()
    q, v = (np.concatenate([getattr(run, k)[::5] for run in runs]) for k in ("q", "speed"))
    for cls in model.classes:
        if cls.acts not in ("force", "drive"):
            continue
        i = next(i for i, r in enumerate(model.ranges()) if r.owner == cls.name)
        others = [*(theta[i + k] for k in range(1, len(model.free_parameters(cls)))), *problem.range_ends(cls).values()]
        unit = float(
            np.sqrt(np.mean((cls.law(q, v, problem.reference_load(cls), 1.0, 1.0, *others) * np.ones(len(q))) ** 2))
        )
        theta[i] = _MILD * problem.force / max(unit, 1e-12)
    low, high = (np.array([getattr(r, k) for r in model.ranges()]) for k in ("lower", "upper"))
    return np.asarray(np.clip(theta, low, high))


def fit_stretches(
    model: Model,
    runs: tuple[FitRun, ...],
    theta: Array | None,
    crossings: float,
    iterations: int,
    known: Starts | None = None,
) -> tuple[Array, Starts]:
    """Parameters from stretches of the runs, and start states of stretches and runs."""
    cut = cut_stretches(runs, crossings * model.problem.crossing_s)
    rough = fit_model(model, cut, theta, known, iterations)
    return rough.theta, {**rough.starts, **{run.name: rough.starts[f"{run.name}#0"] for run in runs}}


def refit_starts(fit: Fit, runs: tuple[FitRun, ...], starts: Starts | None = None) -> Fit:
    """The same parameters on other runs; only start states are fitted."""
    return fit_starts(fit.model, fit.theta, runs, starts)


def fit_starts(model: Model, theta: Array, runs: tuple[FitRun, ...], starts: Starts | None = None) -> Fit:
    """A model at parameters (p,) on runs; only start states are fitted."""
    starts = fit_starts_progressively(model, theta, runs) if starts is None else starts
    return fit_model(model, runs, theta, starts, iterations=12, free=False)


def information_matrix(fit: Fit, unit: float) -> Array:
    """(p, p) with the data term divided by the dispersion `unit`; the prior counts in full."""
    known = np.diag([1 / r.prior**2 for r in fit.model.ranges()])
    return np.asarray((fit.normal - known) / unit + known)


def robust_residuals(residuals: dict[str, Array]) -> dict[str, Array]:
    """Residuals by run, scaled so that their sums of squares are the robust loss (`least_squares.robust_loss`)."""
    powers = np.array([max(float(np.mean(r * r)), 1e-12) for r in residuals.values()])
    factors = np.sqrt(robust_loss(powers) / powers)
    return {run: factor * r for factor, (run, r) in zip(factors, residuals.items(), strict=True)}


def residual_dispersion(residuals: dict[str, Array]) -> float:
    """Variance of the residuals times their integrated autocorrelation time: the unit of a sum of squares, 1 for white
    noise."""
    power = max(np.mean([np.mean(r * r) for r in residuals.values()]), 1e-12)
    summed = 0.0
    for r in residuals.values():
        for lag in range(1, min(len(r) // 4, 200)):
            c = float(r[:-lag] @ r[lag:]) / len(r) / power / len(residuals)
            if c < 0.02:
                break
            summed += c
    return float(max(power, 1.0) * (1 + 2 * summed))


def bic_penalty(free: int, readings: int) -> float:
    """Optimism of the log density of data that `free` parameters were fitted to (Schwarz 1978)."""
    return 0.5 * free * float(np.log(readings))


def fit_starts_progressively(model: Model, theta: Array, runs: tuple[FitRun, ...]) -> Starts:
    """Start states fitted to ever longer parts of each run; a late impact misleads an initial guess."""
    starts: Starts = {}
    if model.problem.inverse_dynamics:
        return starts
    for part in (0.08, 0.2, 0.45):
        cut = tuple(run.between(0, max(8, round(part * len(run.q)))) for run in runs)
        starts = fit_model(model, cut, theta, starts, iterations=6, free=False).starts
    return starts


def refit_missed_starts(fit: Fit, runs: tuple[FitRun, ...]) -> Fit:
    """The fit after a new search of start states of runs with large residuals."""
    median_rms = float(np.median([fit.run_rms(run.name) for run in runs]))
    missed = tuple(run for run in runs if fit.run_rms(run.name) > max(_MET, 1.5 * median_rms))
    if not missed:
        return fit
    again = refit_starts(fit, missed)
    better = {
        run.name: again.starts[run.name] for run in missed if again.run_rms(run.name) < 0.9 * fit.run_rms(run.name)
    }
    return fit_model(fit.model, runs, fit.theta, {**fit.starts, **better}) if better else fit


def predict_readings(fit: Fit, run: FitRun, times_s: Array | None = None) -> Array:
    """(n,) readings predicted by the fit for a run whose start state it has."""
    mapping = ParameterMap(fit.model)
    numbers, effects = mapping.vector(fit.theta)
    numbers[kernel.Q0], numbers[kernel.QD0] = fit.starts[run.name]
    times = run.times_s if times_s is None else times_s
    step = time_steps(fit.model.problem.plant, effects, run.inputs.has_position_law)
    return apply_sensing(effects, sweep(numbers[None], effect_terms(effects), times, run.inputs, step)[0])


@lru_cache(maxsize=32)
def cut_stretches(runs: tuple[FitRun, ...], seconds: float) -> tuple[FitRun, ...]:
    """The runs cut into stretches of about `seconds`, named by their first readings."""
    found = []
    for run in runs:
        duration = float(run.times_s[-1] - run.times_s[0])
        count = max(1, min(round(duration / seconds), len(run.q) // 12))
        bounds = [len(run.q) * k // count for k in range(count + 1)]
        found += [replace(run.between(a, b), name=f"{run.name}#{a}") for a, b in pairwise(bounds)]
    return tuple(found)


def linearise_runs(fit: Fit, runs: tuple[FitRun, ...]) -> tuple[list[Array], list[Array], list[Array]]:
    """Per run: residuals (n,), and responses of the readings to the start state (2, n) and to each parameter (p, n),
    all normalised. The fit must have start states of the runs."""
    predictor, starts = _make_predictor(fit.model, runs, fit.theta, fit.starts)
    parts = predictor.evaluate(np.arange(len(runs)), starts, fit.theta)
    jacobians = predictor.differentiate(starts, fit.theta, parts, True)
    first = 2 if fit.model.problem.inverse_dynamics else 0
    return parts, [J[first:2] for J in jacobians], [J[2:] for J in jacobians]


def initial_theta(model: Model, parent: Fit, points: dict[str, dict[str, float]]) -> Array:
    """(p,) initial guess of a model: values of the parent fit, and `points` for new effects."""
    values = parent.values
    for owner, point in points.items():
        values.update({(owner, name): value for name, value in point.items()})
    return np.array([values.get((r.owner, r.name), r.neutral) for r in model.ranges()])
