"""Search over sets of effects by inverse dynamics, which is fast enough to fit all sets of a size."""

from __future__ import annotations

from dataclasses import dataclass, field
from itertools import combinations
from typing import ClassVar

import numpy as np

from freeart21.effects import EFFECTS, Effect
from simgap.fit.fit import Fit, Model, Problem, bic_penalty, fit_model, initial_theta, residual_dispersion
from simgap.fit.force_predictor import require_force_runs
from simgap.fit.guess import first_guesses, neutral_point
from simgap.fit.model import repeats_family
from simgap.fit.search import CONTENDERS, EXPLAINED, MAX_EFFECTS
from simgap.measure.data import FitRun
from simgap.measure.prescribed import ForceRun

_ACTS = ("force", "drive", "inertia", "command")
"""Actions that forces show; sensors and stops show in positions alone."""
CONSTANT_LOAD = 0.1
"""Relative variation of the bearing load below which load-dependent friction is confounded with other friction, whose
own model error is as large."""
_BINS, _RETURNED = 20, 0.5
"""Bins over the range; share of them that must be passed both ways to separate a force over position from friction. Not
measured."""
_POINTS = 2
"""Initial guesses from each subset."""


def list_candidates(problem: Problem, runs: tuple[FitRun, ...], without: tuple[str, ...] = ()) -> tuple[str, ...]:
    """Effects that the force of these runs could show, but those of `without`."""
    force_runs = require_force_runs(runs)
    driven = any(run.on.any() for run in force_runs)
    to_and_fro = _share_both_ways(force_runs) >= _RETURNED
    even = has_constant_load(force_runs)
    turned = any((run.acceleration != 0).any() for run in force_runs)

    def possible(cls: type[Effect]) -> bool:
        if problem.plant.joint_type not in cls.joint_types or cls.acts not in _ACTS or not problem.covers_range(cls):
            return False
        if cls.remember is not Effect.remember or cls.delay is not Effect.delay:
            return False  # memory and delays do not show in steady motion
        of_place = (cls.acts == "force" and not cls.speed_dependent) or cls.gain is not Effect.gain  # like weight
        if of_place and not to_and_fro:
            return False  # confounded with friction over position
        if cls.acts == "command":
            return driven
        if cls.geared:
            return False  # the drive's force is the reading, so its friction cannot be predicted
        if cls.needs_load and cls.confounded_with and (even or not problem.bearing_loaded):
            return False  # confounded with the other friction, which represents both
        return cls.acts != "inertia" or turned

    return tuple(name for name, cls in EFFECTS.items() if possible(cls) and name not in without)


def _share_both_ways(runs: tuple[ForceRun, ...]) -> float:
    """Share of the visited positions that were passed in both directions."""
    q, v = (np.concatenate([getattr(run, k) for run in runs]) for k in ("position", "speed"))
    edges = np.linspace(q.min(), q.max(), _BINS + 1)
    forth, back = (np.histogram(q[way], edges)[0] > 0 for way in (v > 0, v < 0))
    return float((forth & back).sum() / max((forth | back).sum(), 1))


def has_constant_load(runs: tuple[FitRun, ...]) -> bool:
    """Whether the bearing load varies by less than friction's model error."""
    load = np.concatenate([run.load for run in require_force_runs(runs)])
    return float(np.std(load)) < CONSTANT_LOAD * float(np.mean(load))


@dataclass
class ForceSearch:
    """All fits to the force of the training runs."""

    problem: Problem
    train: tuple[FitRun, ...]
    names: tuple[str, ...]
    fits: dict[tuple[str, ...], Fit] = field(default_factory=dict)
    is_overtime: ClassVar[bool] = False
    """It takes next to no time."""

    def base(self) -> Fit:
        """No effect missing, only errors of the asset."""
        if () not in self.fits:
            self.fits[()] = self._fitted((), None)
        return self.fits[()]

    def is_promising(self) -> bool:
        """Whether any effect improves the fit by more than its parameters cost, to first order."""
        base = self.base()
        unit, readings = residual_dispersion(base.residuals), sum(len(run.q) for run in self.train)
        found = first_guesses(base, self.train, self.names)
        return any(0.5 * (base.rss - guess.cost) / unit > bic_penalty(len(guess.point), readings) for guess in found)

    def fit_shapes(self) -> list[Fit]:
        """None: by inverse dynamics free shapes are searched with all other effects."""
        return []

    def explore(self) -> list[Fit]:
        """The best sets of every size, until nothing is left to explain."""
        best: list[Fit] = []
        for size in range(1, MAX_EFFECTS + 1):
            known = {fit.model.names for fit in best if len(fit.model.names) == size - 1}
            sets = [names for names in combinations(sorted(self.names), size) if not repeats_family(names)]
            if size == 3:
                sets = [names for names in sets if any(set(smaller) < set(names) for smaller in known)]
            level = sorted((self.fit_set(names) for names in sets), key=lambda fit: fit.cost)
            best += level[:CONTENDERS]
            best += [fit for fit in level if all(EFFECTS[n].dissipates for n in fit.model.names) and fit not in best]
            if min(fit.rms for fit in self.fits.values()) < EXPLAINED:
                break
        return best

    def fit_set(self, names: tuple[str, ...]) -> Fit:
        """The fit of this set, no worse than any subset's."""
        if not names:
            return self.base()
        if names not in self.fits:
            model, tried = Model(self.problem, names, instant_friction=True), []
            for name in names:
                smaller = self.fit_set(tuple(n for n in names if n != name))
                points = [guess.point for guess in first_guesses(smaller, self.train, (name,))[:_POINTS]]
                for point in (*points, neutral_point(self.problem, name)):
                    tried.append(self._fitted(names, initial_theta(model, smaller, {name: point})))
            self.fits[names] = min(tried, key=lambda fit: fit.cost)
        return self.fits[names]

    def confounded_sets(self, names: tuple[str, ...]) -> list[Fit]:
        """Sets with load-dependent friction in place of other friction, confounded under constant load."""
        if not has_constant_load(self.train):
            return []
        found = []
        for name in (n for n, cls in EFFECTS.items() if cls.needs_load and cls.confounded_with in names):
            model = Model(
                self.problem, tuple(sorted({*names, name} - {EFFECTS[name].confounded_with})), instant_friction=True
            )
            load, values = self.problem.load, self.fits[names].values
            own = [r.name for r in model.ranges() if r.owner == name]
            first = next(x for (owner, _), x in values.items() if owner == EFFECTS[name].confounded_with)
            found.append(
                fit_model(model, self.train, initial_theta(model, self.fits[names], {name: {own[0]: first / load}}))
            )
        return found

    def _fitted(self, names: tuple[str, ...], theta: np.ndarray | None) -> Fit:
        return fit_model(Model(self.problem, names, instant_friction=True), self.train, theta)
