"""Likelihood of a frame under a linear model, with heavy-tailed errors and random effects of the frame.

Pixels of one frame are dependent: a small pose error moves them all. So a frame has random effects (mean depth error,
mean shift of its two outlines). Its log predictive density is that of these plus that of the rows' residuals (Student's
t with outliers).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from freeart21.se3 import Array

NU = 4.0
"""Degrees of freedom of Student's t (Lange et al. 1989 recommend 4)."""
OUTLIERS = 0.02
"""Share of outlier rows."""
ROUNDS = 6
"""Of reweighting; one more moves parameters by under 1 % of their standard error (ten fits)."""


@dataclass(frozen=True)
class Block:
    """Rows of one kind."""

    y: Array
    """(n,) measured less simulated."""
    columns: Array
    """(n, K) one column per parameter."""
    own: Array
    """(n, d) design of a frame's random effects."""
    frame: NDArray[np.int64]
    """(n,) ascending."""
    least: tuple[float, float]
    """Least standard deviation of a row and of a frame's effects: the resolution of the comparison."""
    span: float
    """Range over which an outlier may lie."""

    @cached_property
    def starts(self) -> NDArray[np.int64]:
        """(frames,) first row of each frame."""
        return np.flatnonzero(np.diff(self.frame, prepend=-1))

    @cached_property
    def index(self) -> NDArray[np.int64]:
        """(n,) number of the row's frame in the block."""
        return np.cumsum(np.diff(self.frame, prepend=self.frame[:1]) != 0)

    def of(self, frames: NDArray[np.int64]) -> Block:
        """The rows of some frames."""
        return self.cut(np.isin(self.frame, frames))

    def cut(self, rows: NDArray[np.bool_] | slice) -> Block:
        """Some rows."""
        return replace(self, y=self.y[rows], columns=self.columns[rows], own=self.own[rows], frame=self.frame[rows])

    def thinned(self, most: int) -> Block:
        """At most about `most` rows, evenly spaced."""
        return self.cut(slice(None, None, max(1, len(self.y) // most)))


@dataclass(frozen=True)
class LinearFit:
    """A fitted model."""

    chosen: tuple[int, ...]
    """Its columns."""
    beta: Array
    """(k,)."""
    sigma: tuple[float, ...]
    """Standard deviation of a row, per block."""
    tau: tuple[float, ...]
    """Standard deviation of a frame's effects, per block."""

    def residual(self, b: Block) -> Array:
        """(n,) residuals of a block's rows."""
        return b.y - b.columns[:, list(self.chosen)] @ self.beta


def fit_blocks(blocks: Sequence[Block], chosen: Sequence[int], ridge: Array | None = None) -> LinearFit:
    """The columns `chosen`, by maximum likelihood with t-weights; frames' effects are integrated out.

    `ridge` (K,) is the prior precision of each parameter about zero.
    """
    k = list(chosen)
    sigma = [max(float(np.median(np.abs(b.y)) / 0.74) if len(b.y) else 0.0, b.least[0]) for b in blocks]
    tau = [max(s, b.least[1]) for s, b in zip(sigma, blocks, strict=True)]
    fit = LinearFit(tuple(k), np.zeros(len(k)), tuple(sigma), tuple(tau))
    prior = np.diag(np.zeros(len(k)) if ridge is None else ridge[k]).astype(float)
    for last in [False] * (ROUNDS if k else 2) + [True]:  # the last round updates scales only
        A, g = prior.copy(), np.zeros(len(k))
        for i, b in enumerate(blocks):
            if not len(b.y):
                continue
            m, v, e = _frame_effects(b, fit.residual(b), sigma[i], tau[i])
            inlying = _inlier_share(e, sigma[i], b.span)
            w = inlying * (NU + 1) / (NU + (e / sigma[i]) ** 2)
            sigma[i] = max(float(np.sqrt((w * e**2).sum() / max(inlying.sum(), 1))), b.least[0])
            tau[i] = max(float(np.sqrt(np.mean(m**2 + v))), b.least[1])
            if k and not last:
                more, pull = _normal_equations(b, b.columns[:, k], w / sigma[i] ** 2, tau[i])
                A, g = A + more, g + pull
        if k and not last:
            beta = np.linalg.solve(A + 1e-12 * np.eye(len(k)) * max(np.trace(A), 1e-300), g)
            fit = replace(fit, beta=beta)
    return replace(fit, sigma=tuple(sigma), tau=tuple(tau))


def density(blocks: Sequence[Block], fit: LinearFit, frames: NDArray[np.int64]) -> Array:
    """(frames,) log predictive density of each of `frames`, ascending."""
    out = np.zeros(len(frames))
    for b, s, t in zip([b.of(frames) for b in blocks], fit.sigma, fit.tau, strict=True):
        if not len(b.y):
            continue
        m, v, e = _frame_effects(b, fit.residual(b), s, t)
        rows = np.add.reduceat(np.log(_inlier_density(e, s) + OUTLIERS / b.span), b.starts)
        rows += (-0.5 * m**2 / (t**2 + v) - 0.5 * np.log(2 * np.pi * (t**2 + v)) + 0.5 * np.log(v)).sum(1)
        out[np.searchsorted(frames, b.frame[b.starts])] += rows
    return out


def _inlier_density(e: Array, s: float) -> Array:
    """Density of inliers: Student's t with 4 degrees of freedom, 3 / 8 at 0."""
    return np.asarray((1 - OUTLIERS) * 0.375 / s * (1 + (e / s) ** 2 / NU) ** (-(NU + 1) / 2))


def _inlier_share(e: Array, s: float, span: float) -> Array:
    p = _inlier_density(e, s)
    return np.asarray(p / (p + OUTLIERS / span))


def _frame_effects(b: Block, r: Array, s: float, t: float) -> tuple[Array, Array, Array]:
    """(frames, d) effects of the frames of residuals `r` (n,), their variances from the rows alone, and remaining
    residuals (n,)."""
    d = b.own.shape[1]
    squares = b.own[:, :, None] * b.own[:, None, :]
    m: Array = np.zeros((len(b.starts), d))
    e: Array = r
    for _ in range(3):
        w = _inlier_share(e, s, b.span) * (NU + 1) / (NU + (e / s) ** 2) / s**2
        H = np.add.reduceat(w[:, None, None] * squares, b.starts)
        g = np.add.reduceat((w * r)[:, None] * b.own, b.starts)
        m = np.asarray(np.linalg.solve(H + np.eye(d) / t**2, g[..., None])[..., 0], float)
        e = r - np.asarray((b.own * m[b.index]).sum(1))
    return m, 1 / np.maximum(np.diagonal(H, axis1=1, axis2=2), 1 / (100 * max(t, b.least[1]) ** 2)), e


def _normal_equations(b: Block, X: Array, w: Array, t: float) -> tuple[Array, Array]:
    """(k, k) and (k,) with the frames' effects eliminated."""
    d, k = b.own.shape[1], X.shape[1]
    both = np.concatenate([X, b.own, b.y[:, None]], 1)
    ends = np.append(b.starts, len(w))
    G = np.stack([both[i:j].T @ (w[i:j, None] * both[i:j]) for i, j in pairwise(ends)])
    through = np.linalg.solve(G[:, k : k + d, k : k + d] + np.eye(d) / t**2, G[:, k : k + d, :k])
    A = G[:, :k, :k] - np.swapaxes(G[:, k : k + d, :k], 1, 2) @ through
    return A.sum(0), (G[:, :k, -1] - np.einsum("fdk,fd->fk", through, G[:, k : k + d, -1])).sum(0)
