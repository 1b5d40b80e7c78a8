"""How the colours drift: exposure and the tone curve's exponent over the film, the asset's own light left free.

A frame says two numbers of it: how much brighter it is than simulated, and how that goes with the asset's brightness
(both after what lamps that stand still make of the surface). A drift is a curve over the film through these.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from freeart21.se3 import Array
from simgap.film.choose import Tried, smallest
from simgap.film.library import hats, waves
from simgap.film.linear import Block, fitted
from simgap.film.samples import Rows

KNOTS = 7
"""Of a drift's curve over the film: frames of each kind take turns ten times or more, so that each knot has some."""
LEAST_STOPS, LEAST_GAMMA = 0.1, 0.05
"""Least spread (largest less smallest) of a drift that is named, and how much frames must differ at all (root mean
square): two clean films lit by SAPIEN's lamps came to .009 and .065 stops by light alone."""
KEEPS = 0.5
"""Share by which a drift's curve may change once the brightness may also change over the picture and with time. Not
measured."""
LEAST_ROWS = 200
_FLOOR = (0.02, 0.01)
"""Stops of a row and of a frame: 8 bits of a middle grey are a hundredth of a stop."""
_LEAST = np.array([0.01, 0.02])
"""The least noise of a frame's two numbers: stops, and stops a stop."""
_NU = 4.0


@dataclass(frozen=True)
class Colours:
    """What was found."""

    chosen: tuple[str, ...]
    """exposure_drift, gamma_drift, both or neither."""
    exposure: tuple[float, ...]
    """Stops at `KNOTS` moments, the mean taken out."""
    gamma: tuple[float, ...]
    rivals: tuple[tuple[str, ...], ...]
    tried: tuple[Tried, ...]
    null: Tried | None
    gains: Array
    before: float
    """Root mean square of what frames are off by as a whole, stops, on confirming frames."""
    after: float
    floor: float
    refused: str = ""
    """Why the drift is not named, where it gives way to something nameless."""


def colours(rows: Rows, split: tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.int64]], lit: bool) -> Colours:
    """Drift of exposure and tone, by frames that were not fitted.

    Where the asset's colours hold the light of the film (`lit`), as a reconstruction's do, the tone curve is not asked
    for: light that wanders over the surface looks alike.
    """
    fit_on, choose_on, confirm_on = split
    kept = np.flatnonzero(np.isfinite(rows["stops"]) & (np.abs(rows["stops"]) < 6))
    nothing = Colours((), (), (), (), (), None, np.zeros(len(confirm_on)), 0.0, 0.0, LEAST_STOPS / 2)
    if len(kept) < LEAST_ROWS:
        return nothing
    share = np.array([f.share for f in rows.frames])
    spoken = _numbers(rows, kept, fit_on)
    sets: list[tuple[str, ...]] = [(), ("exposure_drift",)]
    if not lit:
        sets += [("gamma_drift",), ("exposure_drift", "gamma_drift")]
    fits = {names: _curve(spoken, share, fit_on, names) for names in sets}
    middle = np.nanmedian(spoken.numbers[:, 0])
    shows = _size(spoken.numbers[confirm_on, 0] - middle) >= LEAST_STOPS
    tried = [
        Tried(names, len(names) * KNOTS, _density(spoken, share, choose_on, fit))
        for names, fit in fits.items()
        if not names or (shows and _matters(fit.curves))
    ]
    null = next(t for t in tried if not t.names)
    first, alike = smallest(tried)
    fit = fits[first.names]
    gains = _density(spoken, share, confirm_on, fit) - _density(spoken, share, confirm_on, fits[()])
    off = spoken.numbers[confirm_on, 0] - _told(spoken, share, fit)[confirm_on, 0]
    before = spoken.numbers[confirm_on, 0] - middle
    return Colours(
        first.names,
        fit.curves.get("exposure_drift", ()),
        fit.curves.get("gamma_drift", ()),
        tuple(t.names for t in alike),
        tuple(sorted(tried, key=lambda t: -t.mean)),
        null,
        gains,
        _size(before),
        _size(off - np.nanmedian(off)),
        LEAST_STOPS / 2,
        _given_way(rows, kept, fit_on, share, first.names, fit),
    )


@dataclass(frozen=True)
class _Spoken:
    """What every frame says."""

    numbers: Array
    """(frames, 2) stops too bright at the frame's middle brightness, and stops a stop of brightness; NaN for none."""
    middle: Array
    """(frames,) log2 of that brightness."""


@dataclass(frozen=True)
class _Drift:
    curves: dict[str, tuple[float, ...]]
    constant: Array
    """(2,) what all frames share."""
    spread: Array
    """(2,) noise of a frame's two numbers."""


def _numbers(rows: Rows, kept: NDArray[np.int64], fit_on: NDArray[np.int64], places: bool = False) -> _Spoken:
    """The two numbers of every frame. With `places` brightness may also change over the picture, turning with time."""
    frame, y, light = rows.of("stops")[kept], rows["stops"][kept], rows["light"][kept]
    base = [_lighting(rows["normal"][kept]), hats(light, 6)]
    if places:
        at = rows["at"][kept] / max(float(np.abs(rows["at"]).max(initial=1.0)), 1.0)
        share = np.array([f.share for f in rows.frames])[frame]
        knots = _hats_over(share)
        base += [waves(at), (at[:, :, None] * knots[:, None, :]).reshape(len(y), -1)]
    columns = np.concatenate(base, 1)
    block = Block(y, columns, np.ones((len(y), 1)), frame, _FLOOR, 12.0)
    fit = fitted([block.of(fit_on)], range(columns.shape[1]), np.full(columns.shape[1], 1e-1))
    left = y - columns @ fit.beta
    n = len(rows.frames)
    numbers, middle = np.full((n, 2), np.nan), np.zeros(n)
    for f in range(n):
        on = frame == f
        if on.sum() < 20:
            continue
        x, r = light[on], left[on]
        middle[f] = np.median(x)
        numbers[f] = _line(x - middle[f], r)
    return _Spoken(numbers, middle)


def _line(x: Array, r: Array) -> Array:
    """(2,) value at zero and slope, by a robust line; no slope where there is hardly any brightness to tell it by."""
    value, slope = float(np.median(r)), 0.0
    if np.std(x) < 0.15:
        return np.array([value, np.nan])
    for _ in range(8):
        e = r - value - slope * x
        s = max(1.4826 * float(np.median(np.abs(e))), 0.01)
        w = 1 / (1 + (e / (2 * s)) ** 2)
        A = np.array([[w.sum(), (w * x).sum()], [(w * x).sum(), (w * x * x).sum()]])
        value, slope = np.linalg.solve(A + 1e-9 * np.eye(2), [(w * r).sum(), (w * x * r).sum()])
    return np.array([value, slope])


def _hats_over(share: Array) -> Array:
    return np.stack([np.interp(share, np.linspace(0, 1, KNOTS), np.eye(KNOTS)[k]) for k in range(KNOTS)], -1)


def _design(spoken: _Spoken, share: Array, names: tuple[str, ...]) -> tuple[Array, Array]:
    """Columns (frames, p) of the first and of the second number: two constants, then curves without their mean."""
    curve = _hats_over(share)[:, 1:] - _hats_over(share)[:, 1:].mean(0)
    n = len(share)
    first, second = [np.ones((n, 1)), np.zeros((n, 1))], [np.zeros((n, 1)), np.ones((n, 1))]
    if "exposure_drift" in names:
        first.append(curve)
        second.append(np.zeros_like(curve))
    if "gamma_drift" in names:
        first.append(curve * spoken.middle[:, None])
        second.append(curve)
    return np.concatenate(first, 1), np.concatenate(second, 1)


def _curve(spoken: _Spoken, share: Array, frames: NDArray[np.int64], names: tuple[str, ...]) -> _Drift:
    """The curves through the numbers of `frames`: least squares with t-weights, each number by its own noise."""
    X = np.stack(_design(spoken, share, names), 1)[frames]
    y = spoken.numbers[frames]
    ok = np.isfinite(y)
    y = np.where(ok, y, 0.0)
    spread = np.maximum([0.3 * float(np.std(y[:, 0])), 0.3 * float(np.std(y[:, 1]))], _LEAST)
    beta = np.zeros(X.shape[2])
    ridge = np.r_[1e-6, 1e-6, np.full(X.shape[2] - 2, 1.0)]
    for _ in range(15):
        e = (y - X @ beta) / spread
        w = ok * (_NU + 1) / (_NU + e**2) / spread**2
        A = np.einsum("fk,fka,fkb->ab", w, X, X) + np.diag(ridge)
        beta = np.linalg.solve(A, np.einsum("fk,fka,fk->a", w, X, y))
        e = y - X @ beta
        free = max(len(frames) - 0.5 * len(beta), 0.25 * len(frames))
        weight = ok * (_NU + 1) / (_NU + (e / spread) ** 2)
        spread = np.maximum(np.sqrt((weight * e**2).sum(0) / free), _LEAST)
    curves: dict[str, tuple[float, ...]] = {}
    at = 2
    for name in names:
        values = np.array([0.0, *beta[at : at + KNOTS - 1]])
        curves[name] = tuple(float(v) for v in values - values.mean())
        at += KNOTS - 1
    return _Drift(curves, beta, spread)


def _told(spoken: _Spoken, share: Array, fit: _Drift) -> Array:
    """(frames, 2) what the model says of the numbers."""
    return np.asarray(np.stack(_design(spoken, share, tuple(fit.curves)), 1) @ fit.constant)


def _density(spoken: _Spoken, share: Array, frames: NDArray[np.int64], fit: _Drift) -> Array:
    """(frames,) log density, Student's t, of the numbers of each."""
    e = (spoken.numbers - _told(spoken, share, fit))[frames] / fit.spread
    logs = np.log(0.375) - np.log(fit.spread) - 0.5 * (_NU + 1) * np.log1p(e**2 / _NU)
    return np.asarray(np.where(np.isfinite(e), logs, 0.0).sum(1))


def _matters(curves: dict[str, tuple[float, ...]]) -> bool:
    least = {"exposure_drift": LEAST_STOPS, "gamma_drift": LEAST_GAMMA}
    return all(np.ptp(curve) >= least[name] for name, curve in curves.items())


def _size(values: Array) -> float:
    values = values[np.isfinite(values)]
    return float(np.sqrt(np.mean(values**2))) if len(values) else 0.0


def _lighting(normal: Array) -> Array:
    """(n, 8) what lamps that stand still make of normals (n, 3), to second order: the constant is the brightness's own.

    Nine such numbers give the light on a matt surface to 1 % (Ramamoorthi and Hanrahan 2001).
    """
    x, y, z = normal.T
    return np.stack([x, y, z, x * y, y * z, x * z, x * x - y * y, 3 * z * z - 1], -1)


def _given_way(
    rows: Rows, kept: NDArray[np.int64], fit_on: NDArray[np.int64], share: Array, names: tuple[str, ...], fit: _Drift
) -> str:
    """Why the drift gives way: with brightness that may change over picture and time, it has another shape."""
    if not names:
        return ""
    beside = _curve(_numbers(rows, kept[::4], fit_on, places=True), share, fit_on, names)
    for name in names:
        change = np.linalg.norm(np.subtract(beside.curves[name], fit.curves[name]))
        if change > KEEPS * max(float(np.linalg.norm(fit.curves[name])), 1e-12):
            return (
                "brightness that changes over the picture and with time explains more than a drift of the whole picture"
            )
    return ""
