"""Levenberg and Marquardt's method for many runs that share parameters and have a start state each.

A start state touches its own run only. It is taken out of the normal equations (variable projection: Golub and Pereyra
1973), damped by itself, and moves less, or stays, where its move makes its run worse: so one run that meets a stop
otherwise than its linear picture says holds up nothing but itself.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from freeart21.se3 import Array

Look = Callable[[int, Array, Array], Array]
"""(run, starts (m, 2), parameters (p,)) to residuals (m, n), in floors."""
Slopes = Callable[[Array, Array, list[Array], bool], list[Array]]
"""(starts (r, 2), parameters, residuals, whether the parameters move) to (2 [+ p], n) of every run: what a unit of its
start and of every parameter takes from its residuals."""

_TRIALS = 6
_SHORTER = np.array([0.3, 0.1, 0.03])
"""Parts of a start's move that are tried where all of it makes its run worse."""
_OUTLIER = 3.0
"""Times the usual error, or floors where that is less than the floor, beyond which a run counts for less."""


@dataclass
class State:
    """Where the search is."""

    theta: Array
    """(p,)"""
    starts: Array
    """(r, 2)"""
    parts: list[Array]
    """Residuals of every run."""
    cost: float
    normal: Array
    """(p, p) information of the parameters, the starts being free."""


@dataclass(frozen=True)
class Prior:
    """Bounds of the parameters, (p,) each, and what is known of them beforehand."""

    low: Array
    high: Array
    neutral: Array
    weight: Array
    """(p, p) inverse of the covariance."""

    def cost(self, theta: Array) -> float:
        """Of parameters away from what is known."""
        return float((theta - self.neutral) @ self.weight @ (theta - self.neutral))


def solve(
    theta: Array,
    starts: Array,
    look: Look,
    slopes: Slopes,
    prior: Prior,
    lower: float,
    upper: float,
    iterations: int,
    free: bool = True,
) -> State:
    """The least sum of squares from `theta` (p,) and `starts` (r, 2); `lower`, `upper` bound start positions.

    Without `free` only the starts move. A run that is missed by far more than the others has an error of its own, which
    no formula is near enough to meet and of which only its size is known: its part of the cost is `charge`.
    """
    p, runs = len(theta), len(starts)
    parts = [look(i, starts[i : i + 1], theta)[0] for i in range(runs)]
    costs = np.array([part @ part for part in parts])
    sizes = np.array([len(part) for part in parts])
    damping, own, normal = 1e-3, np.full(runs, 1e-3), np.zeros((p, p))
    for _ in range(iterations):
        weights = weight(costs / sizes)
        total = float(weights @ costs) + prior.cost(theta)
        table = slopes(starts, theta, parts, free)
        blocks = [J @ J.T for J in table]
        rights = [J @ part for J, part in zip(table, parts, strict=True)]
        normal = _information(blocks, weights, prior, p) if free else normal
        gain, moved = 0.0, False
        for _ in range(_TRIALS):
            shift, moves = _step(theta, blocks, rights, weights, damping, own, prior, free)
            trial = np.clip(theta + shift, prior.low, prior.high)
            new_starts, new_parts, taken = starts.copy(), [], np.zeros(runs, bool)
            for i in range(runs):
                there = starts[i] + moves[i]
                there[0] = min(max(there[0], lower), upper)
                ways = np.stack([there, starts[i]])
                rows = look(i, ways, trial)
                at_costs = (rows * rows).sum(1)
                taken[i] = at_costs[0] <= at_costs[1]
                if not taken[i]:
                    ways = np.concatenate([ways[1:], starts[i] + _SHORTER[:, None] * (there - starts[i])])
                    rows = np.concatenate([rows[1:], look(i, ways[1:], trial)])
                    at_costs = (rows * rows).sum(1)
                best = 0 if taken[i] else int(np.argmin(at_costs))
                new_starts[i] = ways[best]
                new_parts.append(rows[best])
            new_costs = np.array([part @ part for part in new_parts])
            new_total = float(weights @ new_costs) + prior.cost(trial)
            own = np.where(taken, np.maximum(own / 10, 1e-9), np.minimum(own * 10, 1e3))
            if new_total < total:
                gain, moved = total - new_total, True
                theta, starts, parts, costs = trial, new_starts, new_parts, new_costs
                damping = max(damping / 10, 1e-9)
                break
            damping *= 8
        if not moved or gain < 1e-4 * total + 1e-2:
            break
    return State(theta, starts, parts, float(sizes @ charge(costs / sizes)) + prior.cost(theta), normal)


def charge(powers: Array) -> Array:
    """(r,) what each reading of runs costs that are missed by mean squares `powers` (r,), floors squared: those, up to
    some times the usual one, and beyond as their logarithm, the likelihood of an error whose size is unknown."""
    most = _most(powers)
    return np.asarray(np.where(powers <= most, powers, most * (1 + np.log(np.maximum(powers, most) / most))))


def weight(powers: Array) -> Array:
    """(r,) slope of `charge`, the usual error held."""
    return np.asarray(np.minimum(1.0, _most(powers) / np.maximum(powers, 1e-12)))


def _most(powers: Array) -> float:
    return _OUTLIER**2 * max(float(np.median(powers)), 1.0)


def _information(blocks: list[Array], weights: Array, prior: Prior, p: int) -> Array:
    """(p, p) of the parameters, all starts free and undamped."""
    total = prior.weight
    for w, block in zip(weights, blocks, strict=True):
        inner = block[:2, :2] + np.diag(1e-9 * np.diag(block[:2, :2]) + 1e-12)
        total = total + w * (block[2:, 2:] - block[2:, :2] @ np.linalg.solve(inner, block[:2, 2:]))
    return total


def _step(
    theta: Array,
    blocks: list[Array],
    rights: list[Array],
    weights: Array,
    damping: float,
    own: Array,
    prior: Prior,
    free: bool,
) -> tuple[Array, Array]:
    """Moves of the parameters (p,) and of the starts (r, 2)."""
    inner = np.array([block[:2, :2] for block in blocks])
    inner[:, (0, 1), (0, 1)] = inner[:, (0, 1), (0, 1)] * (1 + own[:, None] + 1e-9) + 1e-12
    inverses = np.linalg.inv(inner)
    shift = np.zeros(len(theta))
    if free and len(theta):
        A, g = prior.weight.copy(), -prior.weight @ (theta - prior.neutral)
        size = np.diag(A).copy()
        for w, block, right, inverse in zip(weights, blocks, rights, inverses, strict=True):
            cross = block[2:, :2] @ inverse
            A += w * (block[2:, 2:] - cross @ block[:2, 2:])
            g += w * (right[2:] - cross @ right[:2])
            size += w * np.diag(block[2:, 2:])
        shift = _bounded(theta, A, g, damping * size, prior)
    moves = [
        inverse @ (right[:2] - (block[:2, 2:] @ shift if free else 0.0))
        for block, right, inverse in zip(blocks, rights, inverses, strict=True)
    ]
    return shift, np.array(moves)


def _bounded(theta: Array, A: Array, g: Array, ridge: Array, prior: Prior) -> Array:
    """The damped step, with what would leave its bounds held there."""
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
