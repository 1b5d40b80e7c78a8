"""Inverse dynamics: the force that a model requires for the measured motion."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import fields, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from freeart21.effects import Effect
from freeart21.se3 import Array
from simgap.fit.model import Model, ParameterMap
from simgap.measure.data import FitRun
from simgap.measure.prescribed import ForceRun
from simgap.models import kernel, laws
from simgap.models.surrogate import effect_terms

_PROBE = 1e-4
"""Finite-difference step, as a share of a parameter's size."""
_LEAST_GAIN = 1e-3
"""Smallest gain of a drive by which the commanded force is divided."""


class ForcePredictor:
    """A model and runs as the solver takes them; start states have no effect."""

    def __init__(self, model: Model, runs: Sequence[FitRun]):
        self.mapping = ParameterMap(model)
        self.runs = require_force_runs(runs)
        self.all = concatenate_runs(self.runs)
        self.ends = np.cumsum([len(run.q) for run in self.runs])[:-1]

    def evaluate(self, which: NDArray[np.int64], starts: Array, theta: Array) -> list[Array]:
        """Normalised force residuals of the runs `which` (m,); `starts` are ignored."""
        numbers, effects = self.mapping.vector(theta)
        if len(which) < len(self.runs):
            return [force_residuals(self.runs[i], numbers, effects) for i in which]
        return np.split(force_residuals(self.all, numbers, effects), self.ends)

    def differentiate(self, starts: Array, theta: Array, parts: list[Array], free: bool) -> list[Array]:
        """Per run (2 + p, n): response to the start state, zero, and to every parameter, normalised."""
        every, ranges = np.arange(len(self.runs)), self.mapping.ranges[: len(theta) if free else 0]
        found = [[np.zeros(len(part))] * 2 for part in parts]
        for j, (x, r) in enumerate(zip(theta, ranges, strict=False)):
            delta = _PROBE * max(0.1 * abs(x), r.size)
            moved = theta.copy()
            moved[j] += -delta if x + delta > r.upper else delta
            there = self.evaluate(every, starts, moved)
            for rows, part, new in zip(found, parts, there, strict=True):
                rows.append((part - new) / (moved[j] - x))
        return [np.stack(rows) for rows in found]


def require_force_runs(runs: Sequence[FitRun]) -> tuple[ForceRun, ...]:
    """The runs, if they all have a measured force; else TypeError."""
    force_runs = tuple(run for run in runs if isinstance(run, ForceRun))
    if len(force_runs) != len(runs):
        raise TypeError("runs of position among runs of force")
    return force_runs


def concatenate_runs(runs: Sequence[ForceRun]) -> ForceRun:
    """All readings in a row."""
    joined: dict[str, Any] = {
        f.name: np.concatenate([getattr(run, f.name) for run in runs], -1)
        for f in fields(ForceRun)
        if isinstance(getattr(runs[0], f.name), np.ndarray)
    }
    return replace(runs[0], **joined)


def force_residuals(run: ForceRun, numbers: Array, effects: tuple[Effect, ...]) -> Array:
    """(n,) normalised: commanded force less required force; a drive's gain divides the required one."""
    q, v = run.position, run.speed
    cosine, sine, constant = numbers[kernel.GRAVITY_COS : kernel.GRAVITY_CONST + 1]
    taken = numbers[kernel.INERTIA] * run.acceleration - cosine * run.cos_sin[0] - sine * run.cos_sin[1] - constant
    places = {laws.NAMES[which]: at for which, _, at, *_ in effect_terms(effects)}
    for effect in effects:
        if effect.acts == "force":
            taken = taken - kernel.error_factors(numbers, places[effect.name], q, v) * effect.force(q, v)
    carried = np.abs(run.commanded * run.on - (numbers[kernel.INERTIA] * run.acceleration - taken))
    for effect in effects:
        if effect.acts == "drive":
            level = effect.drive_limit(q, v, carried if effect.geared else run.load)
            taken = taken + np.sign(v) * kernel.error_factors(numbers, places[effect.name], q, v) * level
    gain = np.where(run.on > 0, max(float(numbers[kernel.GAIN]), _LEAST_GAIN), 1.0)
    external = run.q - run.commanded
    return np.asarray((run.commanded + (numbers[kernel.OFFSET] * run.on + external - taken) / gain) / run.sigma)
