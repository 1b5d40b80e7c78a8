"""Initial guesses of effects at a place, from the force that the equation of motion lacks there.

A catch holds the joint where a simulation without it moves on, so linearising that simulation shows nothing. The
measured accelerations do. They are noisy and biased, so these are starting points only.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import product

import numpy as np

from freeart21.base_motion import base_motion_force
from freeart21.effects import EFFECTS, Effect
from freeart21.se3 import Array
from simgap.fit.model import Model, Problem
from simgap.measure.data import FitRun
from simgap.measure.inputs import DEFAULT_HOLDING
from simgap.models.surrogate import Plant

_READINGS = 7
"""Readings of a window whose parabola gives speed and acceleration."""
_PLACES, _WIDTHS = 41, (0.012, 0.02, 0.03, 0.045, 0.065, 0.1, 0.15)
"""Grid of places over the range, and of widths as shares of it."""
_RATIOS = (0.25, 0.5, 0.8)
_SURE = 1e9
"""Precision of parameters without uncertainty."""
_LIMIT_MARGIN = 0.02
"""Share of the range next to a limit where the contact force is unknown."""


@dataclass(frozen=True)
class MissingForceSamples:
    """Samples of all runs in a row, (n,) each unless stated."""

    q: Array
    qd: Array
    force: Array
    """N*m or N that the motion needs beyond the asset's equation."""
    weight: Array
    """1 / noise of the force; 0 next to a limit."""
    smooth: Array
    """(n, k) regressors of asset errors and of friction."""
    first: Array
    """Whether a run begins here."""
    precision: Array
    """(k,) 1 / prior standard deviation of the coefficients of `smooth`."""


def sample_missing_force(
    problem: Problem, runs: tuple[FitRun, ...], effects: tuple[Effect, ...] = ()
) -> MissingForceSamples:
    """The force that the asset's equation lacks in the runs with `effects` added."""
    plant = replace(problem.plant, effects=(*problem.plant.effects, *effects))
    parts = [_sample_run(problem, plant, run) for run in runs if len(run.q) >= _READINGS]
    doubts = {r.name: 1 / r.prior for r in Model(problem, ()).ranges()}
    precision = np.array([doubts.get(name, _SURE) for name in ("inertia", "weight", "lean", "lean_across")] + 4 * [0.0])
    q, qd, force, weight, smooth, first = (np.concatenate(column) for column in zip(*parts, strict=True))
    return MissingForceSamples(q, qd, force, weight, smooth, first, precision)


def _sample_run(problem: Problem, plant: Plant, run: FitRun) -> tuple[Array, ...]:
    t, x, sigma = (np.lib.stride_tricks.sliding_window_view(s, _READINGS) for s in (run.times_s, run.q, run.sigma))
    middle = t[:, _READINGS // 2]
    t = t - middle[:, None]
    powers = t[:, :, None] ** np.arange(3)
    inverse = np.linalg.pinv(powers / (reach := np.abs(t).max(1))[:, None, None] ** np.arange(3))
    terms = (inverse @ x[:, :, None])[..., 0]
    q, qd, qdd = terms[:, 0], terms[:, 1] / reach, 2 * terms[:, 2] / reach**2
    noise = 2 * np.linalg.norm(inverse[:, 2], axis=1) / reach**2 * sigma.mean(1)
    ways = plant.gravity_terms @ np.stack([np.cos(q), np.sin(q), np.ones(len(q))])
    drive, others = _input_forces(plant, run, middle, q, qd)
    acting = drive + _known_forces(plant, q, qd, qdd, drive, others + ways[0])
    slack = _LIMIT_MARGIN * (problem.q_high - problem.q_low)
    near = (x.min(1) < plant.lower + slack) | (x.max(1) > plant.upper - slack)
    inertia = plant.mechanics.inertia
    smooth = np.stack([inertia * qdd, *ways, np.ones(len(q)), np.sign(qd), qd, qd * np.abs(qd)], -1)
    first = np.arange(len(q)) == 0
    return q, qd, inertia * qdd - acting, np.where(near, 0.0, 1 / (inertia * noise)), smooth, first


def _input_forces(plant: Plant, run: FitRun, times: Array, q: Array, qd: Array) -> tuple[Array, Array]:
    """(n,) force of the actuator, and (n,) forces of pushes and base motion."""
    inputs = run.inputs
    if not len(inputs.times_s):
        return np.zeros(len(times)), np.zeros(len(times))
    at = np.clip(np.searchsorted(inputs.times_s, times, side="right") - 1, 0, len(inputs.times_s) - 1)
    series = np.stack([inputs.command, inputs.effort, inputs.push])
    command, effort, push = (
        series if inputs.hold_difference is None else series + DEFAULT_HOLDING * inputs.hold_difference
    )[:, at]
    gain = float(np.prod([e.gain() for e in plant.effects]))
    bias = float(np.sum([e.bias_force() for e in plant.effects]))
    given = gain * plant.drive.forces(q, qd, command, effort) + bias
    on = True if inputs.on is None else inputs.on[at]
    base_force = 0.0 if inputs.base_motion is None else base_motion_force(inputs.base_motion[:, at], q)
    return np.where(on, given, 0.0), np.asarray(push + base_force)


def _known_forces(plant: Plant, q: Array, qd: Array, qdd: Array, drive: Array, others: Array) -> Array:
    """(n,) `others`, forces but the drive's, plus those of the asset's own effects."""
    load, total, level = plant.mechanics.load(q, qd, qdd), others.copy(), np.zeros(len(q))
    for effect in plant.effects:
        memory: float | Array = 0.0
        if type(effect).remember is not Effect.remember:
            memory, now = np.zeros(len(q)), 0.0
            for i, at in enumerate(q):
                now = memory[i] = float(effect.remember(at, now, *effect.values()))
        total += effect.force(q, qd, 0.0, memory)
    carried = np.abs(drive - total)
    for effect in plant.effects:
        level += effect.drive_limit(q, qd, carried if effect.geared else load)
    return np.asarray(total - np.sign(qd) * level)


def guess_places(problem: Problem, samples: MissingForceSamples, name: str, most: int) -> list[dict[str, float]]:
    """At most `most` points of an effect with place and width, best first; none of any other effect."""
    cls, kind = EFFECTS[name], problem.plant.joint_type
    specs = cls.parameters(kind)
    size, *others = specs
    if not cls.is_local():
        return []
    span = problem.q_high - problem.q_low
    grids = []
    for other in others:
        spec = specs[other]
        if spec.unit(kind) == "1":
            grids.append(list(_RATIOS))
        elif spec.lower >= 0:
            grids.append([part * span for part in _WIDTHS])
        else:
            grids.append(list(np.linspace(problem.q_low, problem.q_high, _PLACES)))
    grid = np.array(list(product(*grids)))
    values = np.insert(grid, 0, 1.0, 1).T[:, :, None]  # (p, g, 1)
    columns = cls.law(samples.q, samples.qd, 0.0, _run_memory(cls, samples, values), *values) * samples.weight
    costs, sizes = _fit_columns(samples, np.asarray(columns))
    spec = specs[size]
    costs = np.where((sizes > spec.lower) & (sizes < spec.upper), costs, np.inf)
    found: list[dict[str, float]] = []
    for i in np.argsort(costs):
        point = {size: float(sizes[i]), **{n: float(v) for n, v in zip(others, grid[i], strict=True)}}
        if len(found) == most or not np.isfinite(costs[i]):
            break
        if not any(_is_neighbour(point, other, specs.keys() - {size}, 0.06 * span) for other in found):
            found.append(point)
    return found


def _run_memory(cls: type[Effect], samples: MissingForceSamples, values: Array) -> Array:
    """(g, n) memory of an effect at every sample, for all points (p, g, 1) of the grid."""
    if cls.remember is Effect.remember:
        return np.zeros((1, 1))
    now, out = np.zeros(values.shape[1]), np.empty((values.shape[1], len(samples.q)))
    for i, (q, first) in enumerate(zip(samples.q, samples.first, strict=True)):
        now = cls.remember(q, 0.0 * now if first else now, *values[..., 0])
        out[:, i] = now
    return out


def _fit_columns(samples: MissingForceSamples, columns: Array) -> tuple[Array, Array]:
    """(g,) sums of squares with each of the columns (g, n) and all smooth regressors fitted, and the columns' sizes."""
    k = len(samples.precision)
    smooth = np.concatenate(
        [samples.smooth * samples.weight[:, None], np.diag(samples.precision)]
    )  # the prior as extra rows
    scale = np.linalg.norm(smooth, axis=0)
    basis = np.linalg.svd(smooth[:, scale > 1e-9] / scale[scale > 1e-9], full_matrices=False)[0]
    force = np.append(samples.force * samples.weight, np.zeros(k))
    force = force - basis @ (basis.T @ force)
    columns = np.concatenate([columns, np.zeros((len(columns), k))], 1)
    columns = columns - (columns @ basis) @ basis.T
    power = np.maximum((columns**2).sum(1), 1e-12)
    along = columns @ force
    return float(force @ force) - along**2 / power, along / power


def _is_neighbour(first: dict[str, float], second: dict[str, float], names: set[str], reach: float) -> bool:
    """Whether two points are neighbours: places within `reach`, all else within a factor of 2."""
    return all(
        abs(first[n] - second[n]) < reach or (min(first[n], second[n]) > 0 and 0.5 < first[n] / second[n] < 2)
        for n in names
    )
