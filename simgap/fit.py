"""Output-error fits: a set of effects, the asset's own doubts and a free start of every run, against all readings.

The noise is in the readings and nowhere else, so the simulation runs free and is compared with them. A set of effects
starts from what is known of its subsets: a larger set that fits worse than a smaller one is a failed search, and is
started again from there.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from itertools import pairwise

import numpy as np

from freeart21.effects import EFFECTS, Effect
from freeart21.se3 import Array
from simgap import kernel
from simgap.data import FitRun
from simgap.settings import FitSettings, SurrogateSettings
from simgap.surrogate import Nuisance, Plant, numbers_of, readings_of, step_of, sweep, terms_of

_PROBE = 1e-4
"""Part of a parameter's size by which it is changed to see what it does."""


@dataclass(frozen=True)
class Range:
    """One number that is fitted."""

    owner: str
    """Name of an effect, 'asset', or an effect's name with ' form'."""
    name: str
    lower: float
    upper: float
    size: float
    """A usual size."""
    prior: float = np.inf
    """Standard deviation of what is known of it beforehand, about its neutral value."""
    neutral: float = 0.0


@dataclass(frozen=True)
class Problem:
    """What all fits to one measured set share."""

    plant: Plant
    inertia_relative: float
    gravity_relative: float
    q_low: float
    q_high: float
    speed: float
    """Largest speed of all runs."""
    sigma: float
    """Floor at rest."""
    force: float = 1.0
    """Root mean square of the forces at work, N*m or N."""
    load: float = 1.0
    """A usual force on the bearing, N."""
    fit: FitSettings = field(default_factory=FitSettings)
    surrogate: SurrogateSettings = field(default_factory=SurrogateSettings)

    @property
    def reference(self) -> tuple[float, float, float]:
        """Largest speed, middle and half range of position."""
        return self.speed, 0.5 * (self.q_low + self.q_high), max(0.5 * (self.q_high - self.q_low), 1e-9)


@dataclass(frozen=True)
class Theory:
    """A set of effects that may be missing, and what of it is fitted."""

    problem: Problem
    names: tuple[str, ...]
    relaxed: bool = False
    """Whether the sizes of the effects may depart from their formulas, within the form tolerance."""

    @property
    def classes(self) -> tuple[type[Effect], ...]:
        """Of the added effects."""
        return tuple(EFFECTS[name] for name in self.names)

    def ranges(self) -> tuple[Range, ...]:
        """All that is fitted, but the starts."""
        problem, found = self.problem, []
        if problem.inertia_relative > 0:
            r = problem.inertia_relative
            found.append(Range("asset", "inertia", 1 - r, 1 + r, r, r, 1.0))
        terms = problem.plant.gravity_terms
        if problem.gravity_relative > 0 and np.any(terms[0]):
            r = problem.gravity_relative
            found.append(Range("asset", "gravity", 1 - r, 1 + r, r, r, 1.0))
        size = float(np.linalg.norm(terms[0]))
        for i in (1, 2):
            column = float(np.linalg.norm(terms[i]))
            lean = problem.fit.tilt_rad
            if i == 1 and problem.plant.joint_type == "revolute" and column > 0:
                lean += problem.gravity_relative * size / column  # a centre of mass that is off turns the pull, too
            if lean > 0 and column > 1e-6 * np.linalg.norm(terms):
                found.append(Range("asset", f"lean_{i}", -lean, lean, lean, lean))
        for cls in self.classes:
            found += [self._range(cls, name) for name in cls.parameters(problem.plant.joint_type)]
        if self.relaxed:
            r = problem.fit.form_tolerance
            for cls in self.classes:
                if cls.name in kernel.LAWS:
                    found += [Range(f"{cls.name} form", k, -r, r, r, r) for k in ("speed", "position", "curve")]
        return tuple(found)

    def _range(self, cls: type[Effect], name: str) -> Range:
        """Bounds and size of an effect's parameter on these data: nothing beyond what was moved through."""
        spec, problem = cls.parameters()[name], self.problem
        unit, span = spec.unit(problem.plant.joint_type), problem.q_high - problem.q_low
        low, high, size = spec.lower, spec.upper, spec.scale
        local = any(s.lower >= 0 and s.revolute_unit == "rad" for s in cls.parameters().values())
        if unit in ("rad", "m") and cls.acts == "reading":
            low, high, size = -0.6 * span, 0.6 * span, 0.1 * span
        elif unit in ("rad", "m") and spec.lower < 0:
            reach = 0.1 * span if local else 3 * span
            low, high, size = problem.q_low - reach, problem.q_high + reach, 0.1 * span
        elif unit in ("rad", "m") and cls.acts != "drive":
            low, high, size = max(2 * problem.sigma, 1e-3 * span), 2 * span, 0.05 * span
        elif unit in ("rad/s", "m/s"):
            low, high, size = 0.01 * problem.speed, problem.speed, 0.1 * problem.speed
        elif unit == "s":
            low, high = max(spec.lower, -0.5), 0.5
        elif unit in ("kg*m^2", "kg"):
            size = 0.1 * problem.plant.mechanics.inertia
            low, high = max(spec.lower, 1e-3 * size), 1e3 * size
        elif unit == "1":
            high = min(spec.upper, 10.0)
        return Range(cls.name, name, max(low, spec.lower), min(high, spec.upper), size)

    def neutral(self) -> Array:
        """(p,) a point at which the asset is right; effects are at half their usual size."""
        return np.array(
            [
                np.clip(r.neutral if r.owner == "asset" or "form" in r.owner else 0.5 * r.size, r.lower, r.upper)
                for r in self.ranges()
            ]
        )

    def effects(self, theta: Array) -> tuple[Effect, ...]:
        """The added effects at parameters (p,)."""
        ranges, joint_type = self.ranges(), self.problem.plant.joint_type
        made = []
        for cls in self.classes:
            names = list(cls.parameters(joint_type))
            values = {r.name: float(x) for r, x in zip(ranges, theta, strict=True) if r.owner == cls.name}
            made.append(cls(**{name: values[name] for name in names}))
        return tuple(made)


class Reader:
    """Turns parameters into the kernel's vectors."""

    def __init__(self, theory: Theory):
        self.theory: Theory = theory
        self.ranges = theory.ranges()
        self.base = theory.problem.plant.effects
        self.owners = [r.owner for r in self.ranges]
        self.sensing = any(e.kind == "sensing" for e in self.base) or any(c.kind == "sensing" for c in theory.classes)

    def effects(self, theta: Array) -> tuple[Effect, ...]:
        """The asset's own effects and the added ones."""
        kind = self.theory.problem.plant.joint_type
        made: list[Effect] = []
        for cls in self.theory.classes:
            at = self.owners.index(cls.name)
            names = list(cls.parameters(kind))
            made.append(cls(**dict(zip(names, map(float, theta[at : at + len(names)]), strict=True))))
        return (*self.base, *made)

    def nuisance(self, theta: Array) -> Nuisance:
        """How the asset is off."""
        asset = {r.name: float(x) for r, x in zip(self.ranges, theta, strict=True) if r.owner == "asset"}
        return Nuisance(
            asset.get("inertia", 1.0), asset.get("gravity", 1.0), (asset.get("lean_1", 0.0), asset.get("lean_2", 0.0))
        )

    def numbers(self, theta: Array) -> tuple[Array, tuple[Effect, ...]]:
        """The vector, start left at 0, and all effects."""
        nuisance = self.nuisance(theta)
        forms = {}
        if self.theory.relaxed:
            for cls in self.theory.classes:
                if cls.name in kernel.LAWS:
                    at = self.owners.index(f"{cls.name} form")
                    forms[cls.name] = (float(theta[at]), float(theta[at + 1]), float(theta[at + 2]))
        effects = self.effects(theta)
        problem = self.theory.problem
        return numbers_of(problem.plant, effects, nuisance, forms, problem.reference), effects


@dataclass(frozen=True)
class Fit:
    """A theory at its best."""

    theory: Theory
    theta: Array
    """(p,) in the order of `theory.ranges()`."""
    starts: dict[str, tuple[float, float]]
    """State at the first reading of every run that was fitted, by name."""
    residuals: dict[str, Array]
    """Reading less simulation over the floor, by run."""
    cost: float
    """Sum of squares of all residuals and of what was known beforehand."""
    normal: Array
    """(p, p) information of the parameters, the starts being free."""

    @property
    def effects(self) -> tuple[Effect, ...]:
        """The added effects."""
        return self.theory.effects(self.theta)

    @property
    def rss(self) -> float:
        """Sum of squared residuals."""
        return float(sum((r * r).sum() for r in self.residuals.values()))

    def floors(self, run: str) -> float:
        """Root mean square residual of a run, in floors."""
        return float(np.sqrt(np.mean(self.residuals[run] ** 2)))


def fitted(
    theory: Theory,
    runs: tuple[FitRun, ...],
    theta: Array | None = None,
    starts: dict[str, tuple[float, float]] | None = None,
    iterations: int | None = None,
    free: bool = True,
) -> Fit:
    """The theory fitted to the runs from `theta` (p,) by Levenberg and Marquardt's method within its bounds.

    Args:
        theory: what is fitted.
        runs: what to.
        theta: first guess; the neutral point when not given.
        starts: first guesses of start states; taken from the readings where not given.
        iterations: at most; as the settings say when not given.
        free: whether the parameters move; without, only the starts do.
    """
    reader, ranges = Reader(theory), theory.ranges()
    p = len(ranges)
    low, high = (np.array([getattr(r, k) for r in ranges]) for k in ("lower", "upper"))
    x = np.concatenate(
        [
            np.clip(theory.neutral() if theta is None else theta, low, high),
            *[np.array((starts or {}).get(run.name, run.start)) for run in runs],
        ]
    )
    plant = theory.problem.plant
    low = np.concatenate([low, *[np.array([plant.lower, -np.inf])] * len(runs)])
    high = np.concatenate([high, *[np.array([plant.upper, np.inf])] * len(runs)])
    x = np.clip(x, low, high)
    step = step_of(plant, reader.effects(x[:p]), theory.problem.surrogate)
    parts = _residuals(reader, runs, x, p, step)
    cost = _cost(parts, ranges, x)
    damping, normal = 1e-3, np.zeros((p, p))
    for _ in range(iterations or theory.problem.fit.max_iterations):
        A, g, normal = _normal_equations(reader, runs, x, p, step, parts, free)
        moved = False
        for _ in range(8):
            trial = _step(x, A, g, damping, low, high)
            trial_parts = _residuals(reader, runs, trial, p, step)
            trial_cost = _cost(trial_parts, ranges, trial)
            if trial_cost < cost:
                gain, x, parts, cost = cost - trial_cost, trial, trial_parts, trial_cost
                damping, moved = max(damping / 10, 1e-9), True
                break
            damping *= 8
        if not moved or gain < 1e-4 * cost + 1e-2:
            break
    return Fit(
        theory,
        x[:p],
        {run.name: (float(x[p + 2 * i]), float(x[p + 2 * i + 1])) for i, run in enumerate(runs)},
        {run.name: part for run, part in zip(runs, parts, strict=True)},
        cost,
        normal,
    )


def placed(fit: Fit, runs: tuple[FitRun, ...], starts: dict[str, tuple[float, float]] | None = None) -> Fit:
    """The same parameters on other runs: only the start states are fitted."""
    starts = settled(fit.theory, fit.theta, runs) if starts is None else starts
    return fitted(fit.theory, runs, fit.theta, starts, iterations=12, free=False)


def settled(theory: Theory, theta: Array, runs: tuple[FitRun, ...]) -> dict[str, tuple[float, float]]:
    """Start states that make the simulation follow each run ever longer: a far impact misleads a first guess."""
    starts: dict[str, tuple[float, float]] = {}
    for part in (0.08, 0.2, 0.45, 1.0):
        cut = tuple(run.between(0, max(8, round(part * len(run.q)))) for run in runs)
        for run in cut:
            starts.update(fitted(theory, (run,), theta, starts, iterations=6, free=False).starts)
    return starts


def resettled(fit: Fit, runs: tuple[FitRun, ...]) -> Fit:
    """The fit after a new look at the starts of runs that it misses: an impact may have led them astray."""
    usual = float(np.median([fit.floors(run.name) for run in runs]))
    missed = tuple(run for run in runs if fit.floors(run.name) > max(2.0, 1.5 * usual))
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
    step = step_of(fit.theory.problem.plant, effects, fit.theory.problem.surrogate)
    return readings_of(effects, sweep(numbers[None], terms_of(effects), times, run.inputs, step)[0])


def pieces(runs: tuple[FitRun, ...], seconds: float) -> tuple[FitRun, ...]:
    """The runs cut into stretches of about `seconds`, each with a start of its own."""
    found = []
    for run in runs:
        duration = float(run.times_s[-1] - run.times_s[0])
        count = max(1, min(round(duration / seconds), len(run.q) // 12))
        bounds = np.linspace(0, len(run.q), count + 1).astype(int)
        found += [
            replace(run.between(int(a), int(b)), name=f"{run.name}#{i}") for i, (a, b) in enumerate(pairwise(bounds))
        ]
    return tuple(found)


def _residuals(reader: Reader, runs: tuple[FitRun, ...], x: Array, p: int, step: float) -> list[Array]:
    numbers, effects = reader.numbers(x[:p])
    terms, parts = terms_of(effects), []
    for i, run in enumerate(runs):
        numbers[kernel.Q0], numbers[kernel.QD0] = x[p + 2 * i], x[p + 2 * i + 1]
        q = sweep(numbers[None], terms, run.times_s, run.inputs, step)[0]
        parts.append((run.q - (readings_of(effects, q) if reader.sensing else q)) / run.sigma)
    return parts


def _cost(parts: list[Array], ranges: tuple[Range, ...], x: Array) -> float:
    known = sum(((x[i] - r.neutral) / r.prior) ** 2 for i, r in enumerate(ranges))
    return float(sum(part @ part for part in parts) + known)


def tangent(fit: Fit, runs: tuple[FitRun, ...]) -> tuple[list[Array], list[Array], list[Array]]:
    """Of every run: residuals (n,), and what a unit of start (2, n) and of each parameter (p, n) does to the readings,
    all in floors. The fit must have starts for the runs.
    """
    reader = Reader(fit.theory)
    p = len(reader.ranges)
    x = np.concatenate([fit.theta, *[np.array(fit.starts[run.name]) for run in runs]])
    step = step_of(fit.theory.problem.plant, reader.effects(fit.theta), fit.theory.problem.surrogate)
    parts = _residuals(reader, runs, x, p, step)
    slopes = _slopes(reader, runs, x, p, step, parts, True)
    return parts, [J[:2] for J in slopes], [J[2:] for J in slopes]


def _slopes(
    reader: Reader, runs: tuple[FitRun, ...], x: Array, p: int, step: float, parts: list[Array], free: bool
) -> list[Array]:
    """Of every run (2 + p, n): what a unit of its start and of every parameter does to its readings, in floors."""
    count = p if free else 0
    problem, ranges = reader.theory.problem, reader.ranges[:count]
    deltas = np.array([_PROBE * max(0.1 * abs(x[i]), r.size) for i, r in enumerate(ranges)])
    deltas = np.array([-d if x[i] + d > r.upper else d for i, (d, r) in enumerate(zip(deltas, ranges, strict=True))])
    numbers, effects = reader.numbers(x[:p])
    made = [(numbers, effects), (numbers, effects)]
    for j in range(count):
        theta = x[:p].copy()
        theta[j] += deltas[j]
        made.append(reader.numbers(theta))
    table, terms, found = np.array([row for row, _ in made]), terms_of(effects), []
    moves = np.append([_PROBE * 0.1 * problem.reference[2], _PROBE * 0.1 * problem.speed], deltas)
    for i, run in enumerate(runs):
        q0, qd0 = x[p + 2 * i], x[p + 2 * i + 1]
        table[:, kernel.Q0], table[:, kernel.QD0] = q0, qd0
        moves[0] = abs(moves[0]) * (-1.0 if q0 + abs(moves[0]) > problem.plant.upper else 1.0)
        table[0, kernel.Q0] += moves[0]
        table[1, kernel.QD0] += moves[1]
        q = sweep(table, terms, run.times_s, run.inputs, step)
        if reader.sensing:
            q = np.stack([readings_of(its, row) for (_, its), row in zip(made, q, strict=True)])
        found.append((q - (run.q - parts[i] * run.sigma)) / run.sigma / moves[:, None])
    return found


def _normal_equations(
    reader: Reader, runs: tuple[FitRun, ...], x: Array, p: int, step: float, parts: list[Array], free: bool
) -> tuple[Array, Array, Array]:
    """Approximate Hessian, gradient (towards less cost) and the parameters' own information, the starts being free."""
    n, moving = len(x), np.arange(p if free else 0)
    A, g = np.zeros((n, n)), np.zeros(n)
    for i, J in enumerate(_slopes(reader, runs, x, p, step, parts, free)):
        index = np.concatenate([[p + 2 * i, p + 2 * i + 1], moving]).astype(int)
        A[np.ix_(index, index)] += J @ J.T
        g[index] += J @ parts[i]
    for j in moving:
        r = reader.ranges[j]
        if np.isfinite(r.prior):
            A[j, j] += 1 / r.prior**2
            g[j] -= (x[j] - r.neutral) / r.prior**2
    inner = A[p:, p:] + 1e-12 * np.diag(np.diag(A[p:, p:]) + 1e-12)
    cross = A[:p, p:]
    return A, g, A[:p, :p] - cross @ np.linalg.lstsq(inner, cross.T, rcond=None)[0]


def joined(theory: Theory, parent: Fit, points: dict[str, dict[str, float]]) -> Array:
    """(p,) start of a theory: what the parent has, and `points` for effects that it has not."""
    values = {(r.owner, r.name): float(x) for r, x in zip(parent.theory.ranges(), parent.theta, strict=True)}
    for owner, point in points.items():
        values.update({(owner, name): value for name, value in point.items()})
    return np.array([values.get((r.owner, r.name), r.neutral) for r in theory.ranges()])


def _step(x: Array, A: Array, g: Array, damping: float, low: Array, high: Array) -> Array:
    """The damped step, with what would leave its bounds held there."""
    scale = np.sqrt(np.diag(A))
    active = scale > 0
    trial = x.copy()
    for _ in range(4):
        index = np.flatnonzero(active)
        if not len(index):
            return trial
        s = scale[index]
        M = A[np.ix_(index, index)] / np.outer(s, s) + damping * np.eye(len(index))
        move = np.linalg.lstsq(M, g[index] / s, rcond=None)[0] / s
        trial = x.copy()
        trial[index] += move
        out = ((trial < low) | (trial > high)) & active
        stuck = out & (((x <= low) & (trial < low)) | ((x >= high) & (trial > high)))
        trial = np.clip(trial, low, high)
        if not stuck.any():
            return trial
        active &= ~stuck
    return trial
