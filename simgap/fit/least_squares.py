"""Levenberg-Marquardt for many runs that share parameters and have a start state each.

Start states are eliminated from the normal equations (variable projection: Golub and Pereyra 1973). Each has its own
damping, and a start that makes its run worse moves less or stays. So one run that hits a stop, where linearisation
fails, does not block the others.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from freeart21.se3 import Array

ResidualFunction = Callable[[NDArray[np.int64], Array, Array], list[Array]]
"""(runs (m,), starts (m, 2), parameters (p,)) to the normalised residuals of each of these runs."""
JacobianFunction = Callable[[Array, Array, list[Array], bool], list[Array]]
"""(starts (r, 2), parameters, residuals, whether the parameters move) to a (2 [+ p], n) array per run: the decrease of
its residuals per unit of start state and parameter."""

_TRIALS = 6
_SHORTER = np.array([0.3, 0.1, 0.03])
"""Shares of a start's step that are tried where the full step makes its run worse."""
_ENOUGH = 0.3
"""Share of the convergence threshold: a step whose predicted decrease is below it is not tried."""
_OUTLIER = 3.0
"""Ratio to the median RMS (at least 1) above which a run's loss grows logarithmically."""


@dataclass
class State:
    """State of the optimisation."""

    theta: Array
    """(p,)"""
    starts: Array
    """(r, 2)"""
    parts: list[Array]
    """Normalised residuals of every run."""
    cost: float
    normal: Array
    """(p, p) information matrix of the parameters, start states eliminated."""


@dataclass(frozen=True)
class Prior:
    """Bounds (p,) and Gaussian prior of the parameters."""

    low: Array
    high: Array
    neutral: Array
    weight: Array
    """(p, p) precision."""

    def cost(self, theta: Array) -> float:
        """Negative log prior, doubled."""
        return float((theta - self.neutral) @ self.weight @ (theta - self.neutral))


def solve(
    theta: Array,
    starts: Array,
    evaluate: ResidualFunction,
    differentiate: JacobianFunction,
    prior: Prior,
    lower: float,
    upper: float,
    iterations: int,
    free: bool = True,
) -> State:
    """The local minimum from `theta` (p,) and `starts` (r, 2). `lower` and `upper` bound start positions.

    With `free` False only start states move. Runs with a far larger RMS than the others have an error of unknown size,
    so their loss is robust (`robust_loss`).
    """
    p, runs = len(theta), len(starts)
    every = np.arange(runs)
    parts = evaluate(every, starts, theta)
    costs = np.array([part @ part for part in parts])
    sizes = np.array([len(part) for part in parts])
    damping, start_damping, normal = 1e-3, np.full(runs, 1e-3), np.zeros((p, p))
    for _ in range(iterations):
        weights = robust_weight(costs / sizes)
        total = float(weights @ costs) + prior.cost(theta)
        table = differentiate(starts, theta, parts, free)
        blocks = np.array([J @ J.T for J in table])
        rights = np.array([J @ part for J, part in zip(table, parts, strict=True)])
        normal = _information_matrix(blocks, weights, prior, p) if free else normal
        gain, improved, enough = 0.0, False, 1e-4 * total + 1e-2
        for trials in range(_TRIALS):
            shift, moves = _damped_step(theta, blocks, rights, weights, damping, start_damping, prior, free)
            if (
                not trials
                and _predicted_decrease(shift, moves, theta, blocks, rights, weights, prior, free) < _ENOUGH * enough
            ):
                break
            trial = np.clip(theta + shift, prior.low, prior.high)
            there = starts + moves
            there[:, 0] = np.clip(there[:, 0], lower, upper)
            new_starts, new_parts = there.copy(), evaluate(every, there, trial)
            new_costs = np.array([part @ part for part in new_parts])
            taken = np.full(runs, True)
            worse = np.flatnonzero(new_costs > costs)
            for i, row in zip(worse, evaluate(worse, starts[worse], trial) if len(worse) else (), strict=True):
                if (cost := row @ row) < new_costs[i]:
                    new_starts[i], new_parts[i], new_costs[i], taken[i] = starts[i], row, cost, False
            which = np.repeat(every[~taken], len(_SHORTER))
            if len(which):
                ways = starts[which] + np.tile(_SHORTER, runs - taken.sum())[:, None] * (there - starts)[which]
                for i, way, row in zip(which, ways, evaluate(which, ways, trial), strict=True):
                    if (cost := row @ row) < new_costs[i]:
                        new_starts[i], new_parts[i], new_costs[i] = way, row, cost
            new_total = float(weights @ new_costs) + prior.cost(trial)
            start_damping = np.where(taken, np.maximum(start_damping / 10, 1e-9), np.minimum(start_damping * 10, 1e3))
            if new_total < total:
                gain, improved = total - new_total, True
                theta, starts, parts, costs = trial, new_starts, new_parts, new_costs
                damping = max(damping / 10, 1e-9)
                break
            damping *= 8
        if not improved or gain < enough:
            break
    return State(theta, starts, parts, float(sizes @ robust_loss(costs / sizes)) + prior.cost(theta), normal)


def robust_loss(powers: Array) -> Array:
    """(r,) loss per reading of runs with mean squared residuals `powers` (r,): the power itself up to a multiple of the
    median, beyond that its logarithm (the likelihood of an error of unknown variance)."""
    most = _outlier_power(powers)
    return np.asarray(np.where(powers <= most, powers, most * (1 + np.log(np.maximum(powers, most) / most))))


def robust_weight(powers: Array) -> Array:
    """(r,) derivative of `robust_loss` at a fixed median."""
    return np.asarray(np.minimum(1.0, _outlier_power(powers) / np.maximum(powers, 1e-12)))


def _outlier_power(powers: Array) -> float:
    return _OUTLIER**2 * max(float(np.median(powers)), 1.0)


def _information_matrix(blocks: Array, weights: Array, prior: Prior, p: int) -> Array:
    """(p, p) of the parameters, start states eliminated without damping."""
    return np.asarray(prior.weight + _eliminate_starts(blocks, weights, 1e-9)[0])


def _eliminate_starts(blocks: Array, weights: Array, ridge: Array | float) -> tuple[Array, Array, Array]:
    """Normal matrix (p, p) with the starts eliminated, (r, p, 2) coupling of the starts, and (r, 2, 2) inverses of
    their blocks, whose diagonals are increased by the share `ridge` (r,)."""
    inner = blocks[:, :2, :2].copy()
    inner[:, (0, 1), (0, 1)] = inner[:, (0, 1), (0, 1)] * (1 + np.broadcast_to(ridge, len(blocks))[:, None]) + 1e-12
    inverses = np.linalg.inv(inner)
    cross = blocks[:, 2:, :2] @ inverses
    information = blocks[:, 2:, 2:] - cross @ blocks[:, :2, 2:]
    return np.tensordot(weights, information, 1), cross, np.asarray(inverses)


def _damped_step(
    theta: Array,
    blocks: Array,
    rights: Array,
    weights: Array,
    damping: float,
    start_damping: Array,
    prior: Prior,
    free: bool,
) -> tuple[Array, Array]:
    """Steps of the parameters (p,) and of the starts (r, 2)."""
    information, cross, inverses = _eliminate_starts(blocks, weights, start_damping + 1e-9)
    shift, of_starts = np.zeros(len(theta)), rights[:, :2]
    if free and len(theta):
        beyond = rights[:, 2:] - (cross @ rights[:, :2, None])[..., 0]
        g = weights @ beyond - prior.weight @ (theta - prior.neutral)
        size = np.diag(prior.weight) + weights @ np.diagonal(blocks[:, 2:, 2:], axis1=1, axis2=2)
        shift = _bounded_step(theta, prior.weight + information, g, damping * size, prior)
        of_starts = of_starts - blocks[:, :2, 2:] @ shift
    return shift, (inverses @ of_starts[..., None])[..., 0]


def _predicted_decrease(
    shift: Array,
    moves: Array,
    theta: Array,
    blocks: Array,
    rights: Array,
    weights: Array,
    prior: Prior,
    free: bool,
) -> float:
    """Decrease of the cost by the linear model."""
    steps = np.hstack([moves, np.tile(shift, (len(moves), 1))]) if free else moves
    falls = 2 * (steps * rights).sum(1) - np.einsum("ri,rij,rj->r", steps, blocks, steps)
    return float(weights @ falls) + prior.cost(theta) - prior.cost(theta + shift)


def _bounded_step(theta: Array, A: Array, g: Array, ridge: Array, prior: Prior) -> Array:
    """The damped step; parameters that would leave their bounds are clamped there."""
    active = ridge > 0
    shift = np.zeros(len(theta))
    for _ in range(len(theta) + 1):
        index = np.flatnonzero(active)
        if not len(index):
            break
        scale = np.sqrt(np.maximum(np.diag(A)[index] + ridge[index], 1e-300))
        M = (A[np.ix_(index, index)] + np.diag(ridge[index])) / np.outer(scale, scale)
        move = np.linalg.lstsq(
            M, (g[index] - A[np.ix_(index, np.flatnonzero(~active))] @ shift[~active]) / scale, None
        )[0]
        shift[index] = move / scale
        out = active & ((theta + shift < prior.low) | (theta + shift > prior.high))
        if not out.any():
            break
        shift[out] = np.clip(theta[out] + shift[out], prior.low[out], prior.high[out]) - theta[out]
        active &= ~out
    return shift
