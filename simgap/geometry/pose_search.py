"""Subsets of kinematic effects, judged on runs that they were not fitted to.

The model is nearly linear about its best fit, so subsets are compared by linear algebra there: each run is predicted
from the others, and losses of half swings are compared in pairs. The frequency of rocking is found without the run it
is judged on, and its phase in every half run is fitted to the other half.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from freeart21.se3 import Array
from simgap.geometry.pose_model import ROCK, STATIC, Linear, Weighting, normal_equations, sine_cosine, solve_bounded

_RIDGE = 1e-9


@dataclass(frozen=True)
class Losses:
    """Held-out losses of many subsets of effects."""

    subsets: tuple[tuple[str, ...], ...]
    units: Array
    """(subsets, units) mean whitened squared residual per frame; about 5 for noise alone."""
    ceiling: Array
    """(units,) the same for a free function of the joint's position."""
    weights: Array
    """(units,) frames."""

    def mean(self, subset: tuple[str, ...]) -> float:
        """Held-out loss per frame."""
        return float(np.average(self.of(subset), weights=self.weights))

    def of(self, subset: tuple[str, ...]) -> Array:
        """(units,)."""
        return self.units[self.subsets.index(subset)]

    def gain(self, small: Array, big: Array) -> tuple[float, float]:
        """Decrease of the loss per frame from `small` to `big` (units,), and a one-sided p-value of no gain.

        Twice the lesser of two paired t-tests: of differences, dominated by large swings, and of ratios, to which all
        swings contribute evenly.
        """
        gain, weights = float(np.average(small - big, weights=self.weights)), self.weights
        differences = (small - big) * weights / weights.mean()
        ratios = np.log(np.maximum(small, 1e-12)) - np.log(np.maximum(big, 1e-12))
        return gain, min(1.0, 2 * min(_p_above_zero(differences), _p_above_zero(ratios)))


def _p_above_zero(terms: Array) -> float:
    """p-value of a mean not above 0."""
    from scipy.stats import t as student

    n = len(terms)
    if n < 2:
        return 1.0
    error = float(terms.std(ddof=1)) / np.sqrt(n)
    if error == 0:
        return 0.0 if terms.mean() > 0 else 1.0
    return float(student.sf(terms.mean() / error, n - 1))


def held_out_losses(
    lin: Linear,
    names: tuple[str, ...],
    weighting: Weighting,
    units: NDArray[np.int64],
    subsets: tuple[tuple[str, ...], ...],
    frequencies: Sequence[float | None],
    folds: NDArray[np.int64],
) -> Losses:
    """Each fold predicted from the others, for every subset.

    Args:
        lin: the model about its fit with all `names`.
        names: static effects, in the order of `lin`'s columns.
        weighting: noise, and priors of coordinates and registration.
        units: (n,) exchangeable units of the losses.
        subsets: of `names` and ROCK.
        frequencies: Hz of rocking for each fold, found without it; None for no candidate.
        folds: (n,) fold of each frame.
    """
    k, prior, limits = lin.columns.shape[-1] - 6, weighting.priors(names), weighting.bounds(names)
    of_column = np.repeat(np.array([*names, ""]), [*(STATIC[name] for name in names), 6])  # "" is the registration
    numbers = np.unique(folds)
    count = np.bincount(units)
    plain = {f: normal_equations(lin.columns[folds == f], lin.data[folds == f]) for f in numbers}
    out = np.zeros((len(subsets), int(units.max()) + 1))
    for f, frequency in zip(numbers, frequencies, strict=True):
        here = folds == f
        rocked = None if frequency is None else _rock_grams(lin, frequency, folds)
        for s, subset in enumerate(subsets):
            use = np.flatnonzero(np.isin(of_column, [*subset, ""]))
            grams = plain if rocked is None or ROCK not in subset else rocked
            A = sum((grams[g][0] for g in numbers if g != f), np.zeros_like(plain[f][0]))
            b = sum((grams[g][1] for g in numbers if g != f), np.zeros_like(plain[f][1]))
            x = solve_bounded(A[np.ix_(use, use)] + np.diag(prior[use]), b[use], *(ends[use] for ends in limits))
            residual = lin.data[here] - lin.columns[here][:, :, use] @ x
            if grams is rocked and frequency is not None:
                residual = _remove_rocking(residual, lin.rocks[here], lin.times_s[here], frequency)
            out[s] += np.bincount(units[here], (residual**2).sum(-1), len(count))
    ceiling = _ceiling_losses(lin, prior[k:], folds, units)
    scored = count > 0
    return Losses(subsets, out[:, scored] / count[scored], ceiling[scored] / count[scored], count[scored].astype(float))


def free_columns(lin: Linear, degree: int = 5) -> Array:
    """(n, 6, 6 m) of a free twist over the joint's position: polynomials, or Fourier terms over many turns."""
    span = float(np.ptp(lin.q)) or 1.0
    if span > 4 * np.pi:
        waves = [f(h * lin.q) for h in range(1, 5) for f in (np.sin, np.cos)]
        basis = np.stack([np.ones_like(lin.q), lin.q / span, *waves], -1)
    else:
        x = 2 * (lin.q - lin.q.min()) / span - 1
        basis = np.polynomial.legendre.legvander(x, degree)
    n, m = basis.shape
    return (lin.parent_to_whitened[..., None] * basis[:, None, None, :]).reshape(n, 6, 6 * m)


def free_residual(lin: Linear, prior: Array, rocking: Array | float = 0.0) -> Array:
    """(n, 6) residual of `rocking` (n, 6) and a free function of position; `prior` (6,) is of the registration."""
    columns, data = np.concatenate([free_columns(lin), lin.columns[..., -6:]], -1), lin.data - rocking
    A, b = normal_equations(columns, data)
    return data - columns @ _ridge(A, b, np.concatenate([np.zeros(len(b) - 6), prior]))


def find_rocking_frequency(
    lin: Linear, residual: Array, folds: NDArray[np.int64], rate_hz: float
) -> list[float | None]:
    """Per fold the frequency, Hz, at which the other folds' residuals (n, 6) rock most above their noise.

    Between 1.5 periods in the shortest fold and 0.45 of the sampling rate; None where runs are too short for any.
    """
    from scipy.ndimage import median_filter

    numbers = np.unique(folds)
    spans = [float(np.ptp(lin.times_s[folds == f])) for f in numbers]
    low, high = 1.5 / max(min(spans), 1e-9), min(0.45 * rate_hz, 100.0)
    if not low < high:
        return [None] * len(numbers)
    grid = np.arange(low, high, 1 / (4 * max(spans)))[:20000]
    powers = []
    for f in numbers:
        here = folds == f
        R = lin.rocks[here]
        turns = np.einsum("nij,ni->nj", R, residual[here])
        size = np.einsum("nij,nik->jk", R, R) / here.sum()
        t = lin.times_s[here]
        chunks = [
            np.exp(-2j * np.pi * part[:, None] * t) @ turns for part in np.array_split(grid, len(grid) // 256 + 1)
        ]
        waves = np.concatenate(chunks)
        powers.append(np.einsum("fi,ij,fj->f", waves.conj(), np.linalg.inv(size), waves).real / here.sum())
    found: list[float | None] = []
    for k in range(len(numbers)):
        others = sum((p for i, p in enumerate(powers) if i != k), np.zeros(len(grid)))
        level = median_filter(others, size=min(101, len(grid) // 2 * 2 + 1), mode="nearest")
        found.append(float(grid[int(np.argmax(others / np.maximum(level, 1e-12)))]))
    return found


def fit_rocking(lin: Linear, residual: Array, frequency: float) -> Array:
    """(runs, 2, 2) rad of rocking fitted to residuals (n, 6), run by run: rows are the directions."""
    out = []
    for r in range(int(lin.run.max()) + 1):
        here = lin.run == r
        columns = _rock_columns(lin.rocks[here], lin.times_s[here], frequency)
        out.append(_ridge(*normal_equations(columns, residual[here])).reshape(2, 2))
    return np.stack(out)


def _ridge(A: Array, b: Array, prior: Array | float = 0.0) -> Array:
    ridge = np.broadcast_to(prior, len(b)) + _RIDGE * (np.trace(A) / len(b) + 1e-300)
    return np.asarray(np.linalg.solve(A + np.diag(ridge), b), float)


def _rock_columns(rocks: Array, times_s: Array, frequency: float) -> Array:
    """(n, 6, 4) of rocking: directions by sine and cosine."""
    waves = sine_cosine(frequency, times_s)
    return (rocks[..., None] * waves[:, None, None, :]).reshape(len(rocks), 6, 4)


def _rock_grams(lin: Linear, frequency: float, folds: NDArray[np.int64]) -> dict[int, tuple[Array, Array]]:
    """Normal equations of every fold with its own rocking eliminated (Schur complement)."""
    out = {}
    for f in np.unique(folds):
        here = folds == f
        both = np.concatenate([lin.columns[here], _rock_columns(lin.rocks[here], lin.times_s[here], frequency)], -1)
        A, b = normal_equations(both, lin.data[here])
        k = len(b) - 4
        D = A[k:, k:] + _RIDGE * np.trace(A[k:, k:]) * np.eye(4)
        solved = np.linalg.solve(D, np.concatenate([A[k:, :k], b[k:, None]], -1))
        out[int(f)] = (A[:k, :k] - A[:k, k:] @ solved[:, :k], b[:k] - A[:k, k:] @ solved[:, k])
    return out


def _remove_rocking(residual: Array, rocks: Array, times_s: Array, frequency: float) -> Array:
    """Residuals less the rocking fitted to the other half of the run, at this frequency."""
    columns = _rock_columns(rocks, times_s, frequency)
    late = times_s > np.median(times_s)
    out = np.array(residual)
    for part in (late, ~late):
        if part.any() and (~part).any():
            out[part] -= columns[part] @ _ridge(*normal_equations(columns[~part], residual[~part]))
    return out


def _ceiling_losses(lin: Linear, prior: Array, folds: NDArray[np.int64], units: NDArray[np.int64]) -> Array:
    columns = np.concatenate([free_columns(lin), lin.columns[..., -6:]], -1)
    precisions = np.concatenate([np.zeros(columns.shape[-1] - 6), prior])
    grams = {f: normal_equations(columns[folds == f], lin.data[folds == f]) for f in np.unique(folds)}
    total_A, total_b = (sum((g[i] for g in grams.values()), 0.0 * grams[folds[0]][i]) for i in (0, 1))
    out = np.zeros(int(units.max()) + 1)
    whole = _ridge(total_A, total_b, precisions)
    for f, (A, b) in grams.items():
        here, others = folds == f, lin.q[folds != f]
        beyond = (lin.q[here] < others.min()) | (lin.q[here] > others.max())  # no extrapolation of polynomials
        x = np.where(beyond[:, None], whole, _ridge(total_A - A, total_b - b, precisions))
        residual = lin.data[here] - (columns[here] @ x[..., None])[..., 0]
        out += np.bincount(units[here], (residual**2).sum(-1), len(out))
    return out
