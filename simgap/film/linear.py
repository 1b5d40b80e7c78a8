"""How likely a frame is under a linear model: errors with heavy tails, and an error of its own that a frame shares.

Pixels of one frame are not independent: a pose that is a little off moves them all. So a frame has random effects (its
mean depth error, the mean shift of its two outlines), and the log predictive density of a frame is that of these plus
that of what every row then lacks (Student's t, mixed with outliers).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
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
    sigma = [max(float(np.median(np.abs(b.y)) / 0.74) if len(b.y) else 0.0, b.least[0]) for b in blocks]
    tau = [max(s, b.least[1]) for s, b in zip(sigma, blocks, strict=True)]
    held = np.zeros(len(k)) if ridge is None else ridge[k]
    pulls: list[tuple[Array, Array]] = []
    for _ in range(ROUNDS):
        A, g = np.diag(held).astype(float), np.zeros(len(k))
        pulls = []
        sums = []
        for b, s, t in zip(blocks, sigma, tau, strict=True):
            if not len(b.y):
                sums.append(None)
                continue
            X = b.columns[:, k]
            r = b.y - X @ beta
            m, _ = _effects(b, r, s, t)
            e = r - (b.own * m[_index(b)]).sum(1)
            w = _weights(e, s, b.span) / s**2
            A_f, g_f, m, rest = _solved(b, X, w, t)
            A += A_f.sum(0)
            g += g_f.sum(0)
            pulls.append((A_f, g_f))
            sums.append(rest)
        if len(k):
            beta = np.linalg.solve(A + 1e-12 * np.eye(len(k)) * max(np.trace(A), 1e-300), g)
        for i, (b, s) in enumerate(zip(blocks, sigma, strict=True)):
            if not len(b.y):
                continue
            r = b.y - b.columns[:, k] @ beta
            m, v = _effects(b, r, s, tau[i])
            e = r - (b.own * m[_index(b)]).sum(1)
            w = _weights(e, s, b.span)
            inlying = _inlying(e, s, b.span)
            sigma[i] = max(float(np.sqrt((w * e**2).sum() / max(inlying.sum(), 1))), b.least[0])
            tau[i] = max(float(np.sqrt(np.mean(m**2 + v))), b.least[1])
    covariance = np.zeros((len(k), len(k)))
    if len(k):
        inverse = np.linalg.pinv(A)
        names = np.unique(np.concatenate([b.frame for b in blocks if len(b.y)]))
        scores = np.zeros((len(names), len(k)))
        for b, (A_f, g_f) in zip([b for b in blocks if len(b.y)], pulls, strict=True):
            at = np.searchsorted(names, np.unique(b.frame))
            scores[at] += g_f - A_f @ beta
        n = len(names)
        covariance = inverse @ (scores.T @ scores * n / max(n - len(k), 1)) @ inverse
    return LinearFit(tuple(k), beta, covariance, tuple(sigma), tuple(tau))


def density(blocks: Sequence[Block], fit: LinearFit, frames: NDArray[np.int64], by_block: bool = False) -> Array:
    """(frames,) log predictive density; (frames, blocks) with `by_block`."""
    out = np.zeros((len(frames), len(blocks)))
    for i, (whole, s, t) in enumerate(zip(blocks, fit.sigma, fit.tau, strict=True)):
        b = whole.of(frames)
        if not len(b.y):
            continue
        r = b.y - b.columns[:, list(fit.chosen)] @ fit.beta
        m, v = _effects(b, r, s, t)
        e = r - (b.own * m[_index(b)]).sum(1)
        logs = np.log((1 - OUTLIERS) * _T / s * (1 + (e / s) ** 2 / NU) ** (-(NU + 1) / 2) + OUTLIERS / b.span)
        starts = _starts(b)
        rows = np.add.reduceat(logs, starts)
        rows += (-0.5 * m**2 / (t**2 + v) - 0.5 * np.log(2 * np.pi * (t**2 + v)) + 0.5 * np.log(v)).sum(1)
        out[np.searchsorted(frames, b.frame[starts]), i] = rows
    return out if by_block else np.asarray(out.sum(1))


def left(blocks: Sequence[Block], fit: LinearFit, frames: NDArray[np.int64]) -> list[tuple[float, float]]:
    """Of each block, in SI units or pixels: the robust size of what rows lack, their frame's effects included, and how
    much of it is the frames'."""
    out = []
    for whole in blocks:
        b = whole.of(frames)
        r = b.y - b.columns[:, list(fit.chosen)] @ fit.beta
        r = np.abs(r[np.isfinite(r)])
        out.append((float(np.sqrt(np.mean(np.minimum(r, np.quantile(r, 0.95)) ** 2))) if len(r) else 0.0, 0.0))
    return out


def _starts(b: Block) -> NDArray[np.int64]:
    return np.flatnonzero(np.r_[True, b.frame[1:] != b.frame[:-1]])


def _index(b: Block) -> NDArray[np.int64]:
    """(n,) number of the row's frame among the block's."""
    return np.cumsum(np.r_[False, b.frame[1:] != b.frame[:-1]])


def _inlying(e: Array, s: float, span: float) -> Array:
    p = (1 - OUTLIERS) * _T / s * (1 + (e / s) ** 2 / NU) ** (-(NU + 1) / 2)
    return np.asarray(p / (p + OUTLIERS / span))


def _weights(e: Array, s: float, span: float) -> Array:
    return np.asarray(_inlying(e, s, span) * (NU + 1) / (NU + (e / s) ** 2))


def _effects(b: Block, r: Array, s: float, t: float) -> tuple[Array, Array]:
    """(frames, d) effects of the frames of residuals `r`, and their variances by the rows alone."""
    starts, index = _starts(b), _index(b)
    m = np.zeros((len(starts), b.own.shape[1]))
    H = None
    for _ in range(3):
        e = r - (b.own * m[index]).sum(1)
        w = _weights(e, max(s, 1e-300), b.span) / s**2
        H = np.add.reduceat(w[:, None, None] * b.own[:, :, None] * b.own[:, None, :], starts)
        g = np.add.reduceat((w * r)[:, None] * b.own, starts)
        m = np.linalg.solve(H + np.eye(b.own.shape[1]) / t**2, g[..., None])[..., 0]
    assert H is not None
    v = 1 / np.maximum(np.diagonal(H, axis1=1, axis2=2), 1 / (100 * max(t, b.least[1]) ** 2))
    return m, v


def _solved(b: Block, X: Array, w: Array, t: float) -> tuple[Array, Array, Array, None]:
    """Every frame's normal equations (frames, k, k) and (frames, k), its own effects eliminated."""
    starts = _starts(b)
    d = b.own.shape[1]
    wX = w[:, None] * X
    XX = np.add.reduceat(wX[:, :, None] * X[:, None, :], starts)
    Xy = np.add.reduceat(wX * b.y[:, None], starts)
    XB = np.add.reduceat(wX[:, :, None] * b.own[:, None, :], starts)
    BB = np.add.reduceat(w[:, None, None] * b.own[:, :, None] * b.own[:, None, :], starts) + np.eye(d) / t**2
    By = np.add.reduceat((w * b.y)[:, None] * b.own, starts)
    through = np.linalg.solve(BB, np.swapaxes(XB, 1, 2))
    A = XX - XB @ through
    g = Xy - np.einsum("fdk,fd->fk", through, By)
    return A, g, np.zeros(0), None
