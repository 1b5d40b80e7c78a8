"""Initial guesses: the size of each effect that explains the residuals of a smaller set, to first order.

Each effect is switched on a little at every point of a coarse grid of its places, widths and speeds. The response of
the readings is regressed on the residuals, with start states and the smaller set's parameters free.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import product

import numpy as np

from freeart21.effects import EFFECTS
from freeart21.effects.base import PLACES
from freeart21.se3 import Array
from simgap.fit.fit import (
    Fit,
    Model,
    ParameterMap,
    ParameterRange,
    Problem,
    initial_theta,
    linearise_runs,
)
from simgap.fit.force_predictor import ForcePredictor
from simgap.measure.data import FitRun
from simgap.models import kernel
from simgap.models.surrogate import apply_sensing, effect_terms, sweep, time_steps

_MILD = 0.05
"""Size at which a force is switched on, as a share of the RMS force."""


@dataclass(frozen=True)
class Guess:
    """Initial guess of one added effect."""

    name: str
    """The added effect."""
    point: dict[str, float]
    cost: float
    """Sum of squares left, to first order."""


def neutral_point(problem: Problem, name: str) -> dict[str, float]:
    """Parameters at which an effect does next to nothing."""
    own = [r for r in Model(problem, (name,)).ranges() if r.owner == name]
    value = EFFECTS[name].neutral
    middles = {
        r.name: float(np.clip(0.0 if is_linear_parameter(r, own) else 3 * r.size, r.lower, r.upper)) for r in own
    }
    return {**middles, own[0].name: float(np.clip(value, own[0].lower, own[0].upper))}


def first_guesses(fit: Fit, runs: tuple[FitRun, ...], names: tuple[str, ...]) -> list[Guess]:
    """Guesses of all effects of `names` that are not in `fit`, most promising first; the fit must have starts of
    `runs`."""
    about = linearise(fit, runs)
    found = [guess for name in names if name not in fit.model.names for guess in about.guesses(name)]
    return sorted(found, key=lambda guess: guess.cost)


@dataclass(frozen=True)
class _Grid:
    """All places, widths and speeds of an effect."""

    model: Model
    own: list[ParameterRange]
    """Its parameters."""
    sizes: list[ParameterRange]
    """Parameters that the effect is linear in."""
    others: list[str]
    grid: list[tuple[float, ...]]
    """Values of the others."""
    zero: dict[str, float]
    """The effect switched off."""


class Linearisation:
    """The readings about a fit, with start states and parameters projected out."""

    def __init__(self, fit: Fit, runs: tuple[FitRun, ...]):
        self.fit, self.runs, self.problem = fit, runs, fit.model.problem
        self._columns: dict[str, Array] = {}
        residuals, starts, parameters = linearise_runs(fit, runs)
        self.predicted = [run.q - r * run.sigma for run, r in zip(runs, residuals, strict=True)]
        self.start_bases = [np.linalg.qr(J.T)[0] for J in starts]
        self.free_residual = left = np.concatenate(
            [self._project_out_start(i, r[None])[0] for i, r in enumerate(residuals)]
        )
        rest = np.concatenate([self._project_out_start(i, J) for i, J in enumerate(parameters)], 1)
        self.parameters = rest
        """(p, N) response of all readings to a unit of every parameter; starts free."""
        self.nuisance_columns = rest = rest[self._can_move(rest @ left)]
        size = np.linalg.norm(rest, axis=1) if len(rest) else np.zeros(0)
        self.nuisance_basis = np.linalg.qr(rest[size > 1e-9].T)[0] if (size > 1e-9).any() else np.zeros((len(left), 0))
        self.residual = left - self.nuisance_basis @ (self.nuisance_basis.T @ left)
        self.cost = float(self.residual @ self.residual)

    def _can_move(self, downhill: Array) -> Array:
        """(p,) whether a parameter is free to move downhill, not clamped at a bound."""
        ranges, theta = self.fit.model.ranges(), self.fit.theta
        near = 1e-6 * np.array([r.upper - r.lower for r in ranges])
        low = theta <= np.array([r.lower for r in ranges]) + near
        high = theta >= np.array([r.upper for r in ranges]) - near
        return np.asarray(~((low & (downhill < 0)) | (high & (downhill > 0))))

    def _project_out_start(self, i: int, rows: Array) -> Array:
        """(m, n) changes of run i, its start state projected out."""
        return np.asarray(rows - (rows @ self.start_bases[i]) @ self.start_bases[i].T)

    def unit_responses(self, name: str) -> Array:
        """(m, N) response of all readings to a unit of the effect's sizes, at all points of its grid."""
        if name not in self._columns:
            self._columns[name] = self._respond_on_grid(name, self._grid_of(name))
        return self._columns[name]

    def force_response(self, forces: Array) -> Array:
        """(m, N) response of the readings to forces (m, N), N*m or N, given at their times; starts free."""
        mapping, done, parts = ParameterMap(self.fit.model), 0, []
        numbers, effects = mapping.vector(self.fit.theta)
        terms = effect_terms(effects)
        for i, run in enumerate(self.runs):
            numbers[kernel.Q0], numbers[kernel.QD0] = self.fit.starts[run.name]
            step = time_steps(self.problem.plant, effects, run.inputs.has_position_law)
            inputs = run.inputs.with_rows(run.times_s)
            rows = []
            for force in (np.zeros(len(run.q)), *forces[:, done : done + len(run.q)]):
                small = _MILD * self.problem.force / max(float(np.abs(force).max()), 1e-12)
                q = sweep(numbers[None], terms, run.times_s, inputs.pushed(run.times_s, small * force), step)[0]
                rows.append((apply_sensing(effects, q), small))
            changes = np.array([(q - rows[0][0]) / small / run.sigma for q, small in rows[1:]])
            parts.append(self._project_out_start(i, changes))
            done += len(run.q)
        return np.concatenate(parts, 1)

    def reading_response(self, errors: Array) -> Array:
        """(m, N) normalised errors of the readings, rad or m; starts free."""
        ends = np.cumsum([0, *(len(run.q) for run in self.runs)])
        rows = [errors[:, a:b] / run.sigma for run, a, b in zip(self.runs, ends[:-1], ends[1:], strict=True)]
        return np.concatenate([self._project_out_start(i, row) for i, row in enumerate(rows)], 1)

    def _grid_of(self, name: str) -> _Grid:
        model = replace(self.fit.model, names=tuple(sorted((*self.fit.model.names, name))))
        own = [r for r in model.ranges() if r.owner == name]
        sizes = [r for r in own if is_linear_parameter(r, own)]
        at = self.problem.operating_point
        grid = list(product(*[EFFECTS[name].trial_values(r.name, at) for r in own if r not in sizes]))
        return _Grid(
            model, own, sizes, [r.name for r in own if r not in sizes], grid, neutral_point(self.problem, name)
        )

    def _respond_on_grid(self, name: str, at: _Grid) -> Array:
        """(grid x sizes, N) response per unit size at all points of the grid."""
        trials: list[tuple[dict[str, float], float]] = []
        for places in at.grid:
            point = {**at.zero, **dict(zip(at.others, map(float, places), strict=True))}
            for r in at.sizes:
                step = self._step(name, point, r)
                trials.append(({**point, r.name: point[r.name] + step}, step))
        made = self._responses(at.model, name, [point for point, _ in trials])
        return np.asarray(made / np.array([s for _, s in trials])[:, None])

    def guesses(self, name: str) -> list[Guess]:
        """Guesses at all points of the effect's grid."""
        at = self._grid_of(name)
        columns = self._respond_on_grid(name, at)
        model, own, sizes, others, grid, zero = at.model, at.own, at.sizes, at.others, at.grid, at.zero
        columns = columns - (columns @ self.nuisance_basis) @ self.nuisance_basis.T
        found = []
        for i in range(len(grid)):
            rows = slice(i * len(sizes), (i + 1) * len(sizes))
            A = columns[rows].T
            if np.linalg.norm(A) < 1e-9:
                continue
            moves = np.linalg.lstsq(A, self.residual, rcond=1e-6)[0]
            point = {**zero, **dict(zip(others, map(float, grid[i]), strict=True))}
            values = {
                r.name: float(np.clip(point[r.name] + m, r.lower, r.upper)) for r, m in zip(sizes, moves, strict=True)
            }
            taken = self.residual - A @ np.array([values[r.name] - point[r.name] for r in sizes])
            found.append(Guess(name, {**point, **values}, float(taken @ taken)))
        if EFFECTS[name].trial_sizes:
            trials = [{**zero, sizes[0].name: value} for value in EFFECTS[name].trial_sizes]
            found += self._guess_at(model, name, trials)
        elif len(own) == 2 and len(sizes) == 1 and len(grid) == PLACES:
            found += self._interpolate_place(name, own, columns[0], columns[-1], float(grid[0][0]), float(grid[-1][0]))
        found.sort(key=lambda guess: guess.cost)
        return [self._nudge(guess, sizes) for guess in found]

    def _guess_at(self, model: Model, name: str, points: list[dict[str, float]]) -> list[Guess]:
        """Guesses at given points."""
        taken = self._responses(model, name, points)
        taken = self.residual - (taken - (taken @ self.nuisance_basis) @ self.nuisance_basis.T)
        return [Guess(name, point, float(row @ row)) for point, row in zip(points, taken, strict=True)]

    def _interpolate_place(
        self, name: str, own: list[ParameterRange], first: Array, last: Array, low: float, high: float
    ) -> list[Guess]:
        """The guess of a law that is linear in its place as well, such as a spring's."""
        a, b = np.linalg.lstsq(np.stack([first, last], 1), self.residual, rcond=1e-6)[0]
        size, place = own
        if not size.lower < a + b < size.upper:
            return []
        at = float(np.clip(low + b / (a + b) * (high - low), place.lower, place.upper))
        share = (at - low) / (high - low)
        taken = self.residual - (a + b) * ((1 - share) * first + share * last)
        return [Guess(name, {size.name: float(a + b), place.name: at}, float(taken @ taken))]

    def _nudge(self, guess: Guess, sizes: list[ParameterRange]) -> Guess:
        """The guess with a size above 0, where a fit has a gradient."""
        if all(guess.point[r.name] == max(r.lower, EFFECTS[guess.name].neutral) for r in sizes):
            r = sizes[0]
            step = 0.2 * self._step(guess.name, guess.point, r)
            return Guess(guess.name, {**guess.point, r.name: guess.point[r.name] + step}, guess.cost)
        return guess

    def _step(self, name: str, point: dict[str, float], r: ParameterRange) -> float:
        """Size at which the effect is switched on."""
        cls = EFFECTS[name]
        if cls.acts not in ("force", "drive"):
            return min(r.size, 0.1) if cls.acts != "inertia" else r.size
        q = np.concatenate([run.joint_position[::5] for run in self.runs])
        v = np.concatenate([run.speed[::5] for run in self.runs])
        unit = {**point, **self.problem.range_ends(cls), r.name: 1.0}
        values = [unit.get(n, 0.0) for n in cls.parameters()]
        force = cls.law(q, v, self.problem.reference_load(cls), 1.0, *values) * np.ones(len(q))
        size = float(np.sqrt(np.mean(np.square(force))))
        return float(min(_MILD * self.problem.force / max(size, 1e-9), 1e-2 * r.upper))

    def _responses(self, model: Model, name: str, points: list[dict[str, float]]) -> Array:
        """(m, N) normalised changes of all readings at these points; starts free."""
        mapping = ParameterMap(model)
        made = [mapping.vector(initial_theta(model, self.fit, {name: point})) for point in points]
        table = np.array([numbers for numbers, _ in made])
        steps = {held: time_steps(self.problem.plant, made[0][1], held) for held in (True, False)}
        terms, parts = effect_terms(made[0][1]), []
        for i, run in enumerate(self.runs):
            table[:, kernel.Q0], table[:, kernel.QD0] = self.fit.starts[run.name]
            q = sweep(table, terms, run.times_s, run.inputs, steps[run.inputs.has_position_law])
            if mapping.sensing:
                q = np.stack([apply_sensing(effects, row) for (_, effects), row in zip(made, q, strict=True)])
            parts.append(self._project_out_start(i, (q - self.predicted[i]) / run.sigma))
        return np.concatenate(parts, 1)


class ForceLinearisation(Linearisation):
    """The same for inverse dynamics."""

    def force_response(self, forces: Array) -> Array:
        """(m, N) normalised decrease of the drive's force."""
        return np.asarray(forces / np.concatenate([run.sigma for run in self.runs]))

    def _responses(self, model: Model, name: str, points: list[dict[str, float]]) -> Array:
        """(m, N) normalised changes of the required force."""
        predictor, every = ForcePredictor(model, self.runs), np.arange(len(self.runs))
        none, rows = np.zeros((len(self.runs), 2)), []
        before = [(run.q - now) / run.sigma for run, now in zip(self.runs, self.predicted, strict=True)]
        for point in points:
            left = predictor.evaluate(every, none, initial_theta(model, self.fit, {name: point}))
            rows.append(np.concatenate([b - after for b, after in zip(before, left, strict=True)]))
        return np.array(rows)


def linearise(fit: Fit, runs: tuple[FitRun, ...]) -> Linearisation:
    """The linearisation about a fit, of positions or of force."""
    return (ForceLinearisation if fit.model.problem.inverse_dynamics else Linearisation)(fit, runs)


def is_linear_parameter(r: ParameterRange, own: list[ParameterRange]) -> bool:
    """Whether the effect is about linear in this parameter: its first one, and other forces."""
    if r is own[0] or r.name == own[0].name:
        return True
    spec = EFFECTS[r.owner].parameters()[r.name]
    return spec.revolute_unit == "N*m" or spec.prismatic_unit == "N"
