"""How likely a frame is under a linear model: errors with heavy tails, and an error of its own that a frame shares.

Pixels of one frame are not independent: a pose that is a little off moves them all. So a frame has random effects (its
mean depth error, the mean shift of its two outlines), and the log predictive density of a frame is that of these plus
that of what every row then lacks (Student's t, mixed with outliers).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise

import numpy as np
from numba import njit
from numpy.typing import NDArray

from freeart21.se3 import Array

NU = 4.0
"""Degrees of freedom of Student's t: tails as robust fits of depth use them (Lange et al. 1989 recommend 4)."""
OUTLIERS = 0.02
"""Share of rows that may be anything at all."""
ROUNDS = 6
"""Of reweighting; a further one moves parameters by under 1 % of their standard error (looked at on ten fits)."""
_T = 0.375
"""Density of Student's t of 4 degrees at 0: 3 / 8."""


@dataclass(frozen=True)
class Block:
    """Rows of one kind."""

    y: Array
    """(n,) measured less simulated."""
    columns: Array
    """(n, K) one column for every parameter of the library."""
    own: Array
    """(n, d) what a frame's random effects do."""
    frame: NDArray[np.int64]
    """(n,) ascending."""
    least: tuple[float, float]
    """Least standard deviation of a row and of a frame's effects: the floor of what the comparison itself can tell."""
    span: float
    """Range over which an outlier may lie."""

    @cached_property
    def starts(self) -> NDArray[np.int64]:
        """(frames,) the first row of each."""
        return np.flatnonzero(np.r_[True, self.frame[1:] != self.frame[:-1]])

    @cached_property
    def index(self) -> NDArray[np.int64]:
        """(n,) number of the row's frame among the block's."""
        return np.cumsum(np.r_[False, self.frame[1:] != self.frame[:-1]])

    def of(self, frames: NDArray[np.int64]) -> Block:
        """The rows of some frames alone."""
        kept = np.isin(self.frame, frames)
        return Block(self.y[kept], self.columns[kept], self.own[kept], self.frame[kept], self.least, self.span)


@dataclass(frozen=True)
class LinearFit:
    """A model with its parameters."""

    chosen: tuple[int, ...]
    """Columns in it."""
    beta: Array
    """(k,)."""
    covariance: Array
    """(k, k), from frame to frame: the sandwich over frames."""
    sigma: tuple[float, ...]
    """A block's standard deviation of a row."""
    tau: tuple[float, ...]
    """A block's standard deviation of a frame's effects."""


def fitted(blocks: Sequence[Block], chosen: Sequence[int], ridge: Array | None = None) -> LinearFit:
    """The columns `chosen`, by maximum likelihood with t-weights; frames' effects are integrated out.

    `ridge` (K,) holds each parameter towards zero, as 1 / standard deviation^2.
    """
    k = list(chosen)
    beta = np.zeros(len(k))
    told = [i for i, b in enumerate(blocks) if len(b.y)]
    X = {i: np.ascontiguousarray(blocks[i].columns[:, k]) for i in told}
    sigma = [max(float(np.median(np.abs(b.y)) / 0.74) if len(b.y) else 0.0, b.least[0]) for b in blocks]
    tau = [max(s, b.least[1]) for s, b in zip(sigma, blocks, strict=True)]
    held = np.zeros(len(k)) if ridge is None else ridge[k]
    A, pulls = np.diag(held).astype(float), dict[int, tuple[Array, Array]]()
    for _ in range(ROUNDS if k else ROUNDS // 2):
        A, g = np.diag(held).astype(float), np.zeros(len(k))
        for i in told:
            b = blocks[i]
            e, w, m, v = _weighed(b, b.y - X[i] @ beta, sigma[i], tau[i])
            inlying = _inlying(e, sigma[i], b.span)
            sigma[i] = max(float(np.sqrt((w * e**2).sum() / max(inlying.sum(), 1))), b.least[0])
            tau[i] = max(float(np.sqrt(np.mean(m**2 + v))), b.least[1])
            if k:
                pulls[i] = _solved(b, X[i], w / sigma[i] ** 2, tau[i])
                A += pulls[i][0].sum(0)
                g += pulls[i][1].sum(0)
        if k:
            beta = np.linalg.solve(A + 1e-12 * np.eye(len(k)) * max(np.trace(A), 1e-300), g)
    for i in told:  # what is left once the last step is taken
        b = blocks[i]
        e, w, m, v = _weighed(b, b.y - X[i] @ beta, sigma[i], tau[i])
        sigma[i] = max(float(np.sqrt((w * e**2).sum() / max(_inlying(e, sigma[i], b.span).sum(), 1))), b.least[0])
        tau[i] = max(float(np.sqrt(np.mean(m**2 + v))), b.least[1])
    return LinearFit(tuple(k), beta, _sandwich(blocks, A, pulls, beta), tuple(sigma), tuple(tau))


def _sandwich(blocks: Sequence[Block], A: Array, pulls: dict[int, tuple[Array, Array]], beta: Array) -> Array:
    """(k, k) covariance of the parameters from frame to frame."""
    if not pulls:
        return np.zeros((len(beta), len(beta)))
    inverse = np.linalg.pinv(A)
    names = np.unique(np.concatenate([blocks[i].frame for i in pulls]))
    scores = np.zeros((len(names), len(beta)))
    for i, (A_f, g_f) in pulls.items():
        scores[np.searchsorted(names, np.unique(blocks[i].frame))] += g_f - A_f @ beta
    n = len(names)
    return np.asarray(inverse @ (scores.T @ scores * n / max(n - len(beta), 1)) @ inverse)


def _weighed(b: Block, r: Array, s: float, t: float) -> tuple[Array, Array, Array, Array]:
    """Of residuals `r`: what rows lack besides their frame's effects, weights, the effects, and their variances."""
    m, v = _effects(b, r, s, t)
    e = r - (b.own * m[b.index]).sum(1)
    return e, _weights(e, s, b.span), m, v


def density(blocks: Sequence[Block], fit: LinearFit, frames: NDArray[np.int64], by_block: bool = False) -> Array:
    """(frames,) log predictive density; (frames, blocks) with `by_block`."""
    out = np.zeros((len(frames), len(blocks)))
    for i, (whole, s, t) in enumerate(zip(blocks, fit.sigma, fit.tau, strict=True)):
        b = whole.of(frames)
        if not len(b.y):
            continue
        r = b.y - b.columns[:, list(fit.chosen)] @ fit.beta
        m, v = _effects(b, r, s, t)
        e = r - (b.own * m[b.index]).sum(1)
        logs = np.log((1 - OUTLIERS) * _T / s * (1 + (e / s) ** 2 / NU) ** (-(NU + 1) / 2) + OUTLIERS / b.span)
        starts = b.starts
        rows = np.add.reduceat(logs, starts)
        rows += (-0.5 * m**2 / (t**2 + v) - 0.5 * np.log(2 * np.pi * (t**2 + v)) + 0.5 * np.log(v)).sum(1)
        out[np.searchsorted(frames, b.frame[starts]), i] = rows
    return out if by_block else np.asarray(out.sum(1))


def left(blocks: Sequence[Block], fit: LinearFit, frames: NDArray[np.int64]) -> list[float]:
    """Of each block, metres or pixels: the root mean square of what rows lack, their frame's effects included, sizes
    beyond the 95th percentile taken as that."""
    out = []
    for whole in blocks:
        b = whole.of(frames)
        r = b.y - b.columns[:, list(fit.chosen)] @ fit.beta
        r = np.abs(r[np.isfinite(r)])
        out.append(float(np.sqrt(np.mean(np.minimum(r, np.quantile(r, 0.95)) ** 2))) if len(r) else 0.0)
    return out


def _inlying(e: Array, s: float, span: float) -> Array:
    p = (1 - OUTLIERS) * _T / s * (1 + (e / s) ** 2 / NU) ** (-(NU + 1) / 2)
    return np.asarray(p / (p + OUTLIERS / span))


def _weights(e: Array, s: float, span: float) -> Array:
    return np.asarray(_inlying(e, s, span) * (NU + 1) / (NU + (e / s) ** 2))


def _effects(b: Block, r: Array, s: float, t: float) -> tuple[Array, Array]:
    """(frames, d) effects of the frames of residuals `r`, and their variances by the rows alone."""
    ends = np.append(b.starts, len(r))
    m, H = _frame_effects(b.own, np.ascontiguousarray(r), ends, max(s, 1e-300), t, b.span, OUTLIERS, NU)
    v = 1 / np.maximum(np.diagonal(H, axis1=1, axis2=2), 1 / (100 * max(t, b.least[1]) ** 2))
    return m, v


@njit(cache=True)
def _frame_effects(own, r, ends, s, t, span, outliers, nu):  # pragma: no cover
    """Effects (frames, d) by three rounds of t-weights, and their normal matrices without the prior 1 / t^2."""
    n, d = len(ends) - 1, own.shape[1]
    m, H = np.zeros((n, d)), np.zeros((n, d, d))
    for f in range(n):
        for _ in range(3):
            A, g = np.zeros((d, d)), np.zeros(d)
            for i in range(ends[f], ends[f + 1]):
                e = r[i]
                for a in range(d):
                    e -= own[i, a] * m[f, a]
                x = (e / s) ** 2
                p = (1 - outliers) * 0.375 / s * (1 + x / nu) ** (-(nu + 1) / 2)
                w = p / (p + outliers / span) * (nu + 1) / (nu + x) / s**2
                for a in range(d):
                    g[a] += w * r[i] * own[i, a]
                    for c in range(d):
                        A[a, c] += w * own[i, a] * own[i, c]
            H[f] = A
            B = A.copy()
            for a in range(d):
                B[a, a] += 1 / t**2
            m[f] = np.linalg.solve(B, g)
    return m, H


def _solved(b: Block, X: Array, w: Array, t: float) -> tuple[Array, Array]:
    """Every frame's normal equations (frames, k, k) and (frames, k), its own effects eliminated."""
    d, k = b.own.shape[1], X.shape[1]
    both = np.concatenate([X, b.own, b.y[:, None]], 1)
    ends = np.append(b.starts, len(w))
    G = np.stack([both[i:j].T @ (w[i:j, None] * both[i:j]) for i, j in pairwise(ends)])
    BB = G[:, k : k + d, k : k + d] + np.eye(d) / t**2
    through = np.linalg.solve(BB, G[:, k : k + d, :k])
    A = G[:, :k, :k] - np.swapaxes(G[:, k : k + d, :k], 1, 2) @ through
    g = G[:, :k, -1] - np.einsum("fdk,fd->fk", through, G[:, k : k + d, -1])
    return A, g
