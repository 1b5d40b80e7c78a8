"""How the colours drift: exposure and the tone curve's exponent over the film, the asset's own light left free."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from freeart21.se3 import Array
from simgap.film.choose import Tried, smallest
from simgap.film.library import hats, waves
from simgap.film.linear import Block, LinearFit, density, fitted
from simgap.film.samples import Rows

KNOTS = 7
"""Of a drift's curve over the film: frames of each kind take turns ten times or more, so that each knot has some."""
LEAST_STOPS, LEAST_GAMMA = 0.1, 0.05
"""Least spread (largest less smallest) of a drift that is named: a tenth of a stop is hardly seen (film standards give
exposure in thirds). Not measured."""
LEAST_ROWS = 200
_FLOOR = (0.02, 0.01)
"""Stops of a row and of a frame: 8 bits of a middle grey are a hundredth of a stop."""


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
    spreads: dict[str, float]


def colours(rows: Rows, split: tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.int64]]) -> Colours:
    """Drift of exposure and tone, by frames that were not fitted. Where the asset has no colours nothing is said."""
    fit_on, choose_on, confirm_on = split
    kept = np.flatnonzero(np.isfinite(rows["stops"]) & (np.abs(rows["stops"]) < 6))
    nothing = Colours((), (), (), (), (), None, np.zeros(len(confirm_on)), 0.0, 0.0, LEAST_STOPS, {})
    if len(kept) < LEAST_ROWS:
        return nothing
    frame, y = rows.of("stops")[kept], rows["stops"][kept]
    share = np.array([f.share for f in rows.frames])[frame]
    light = rows["light"][kept]
    knots = np.stack([np.interp(share, np.linspace(0, 1, KNOTS), np.eye(KNOTS)[k]) for k in range(KNOTS)], -1)
    at = rows["at"][kept] / max(float(np.abs(rows["at"]).max(initial=1.0)), 1.0)
    base = np.column_stack([np.ones(len(y)), rows["normal"][kept], light])
    places = waves(at)
    turning = np.stack([np.cos(2 * np.pi * share), np.sin(2 * np.pi * share)], -1)
    rolling = (at[:, :, None] * np.concatenate([turning, knots], -1)[:, None, :]).reshape(len(y), -1)
    pieces = {
        "base": base,
        "exposure_drift": knots[:, 1:],
        "gamma_drift": knots[:, 1:] * light[:, None],
        "place in the picture": places,
        "place and time": rolling,
        "brightness": hats(rows["light"][kept], 6),
    }
    columns: dict[str, list[int]] = {}
    count = 0
    for name, made in pieces.items():
        columns[name] = list(range(count, count + made.shape[1]))
        count += made.shape[1]
    block = Block(y, np.concatenate(list(pieces.values()), 1), np.ones((len(y), 1)), frame, _FLOOR, 12.0)
    ridge = np.full(count, 1e-2)
    ridge[columns["exposure_drift"]], ridge[columns["gamma_drift"]] = 1.0, 4.0  # a stop, half an exponent
    fitting, choosing = [block.of(fit_on)], [block.of(choose_on)]
    tried: list[Tried] = []
    fits: dict[tuple[str, ...], LinearFit] = {}

    def attempt(names: tuple[str, ...], nameless: bool = False) -> None:
        chosen = [c for name in ("base", *names) for c in columns[name]]
        fits[names] = fit = fitted(fitting, chosen, ridge)
        if not nameless and not _matters(_curves(fit, columns, names)):
            return
        tried.append(Tried(names, len(chosen), density(choosing, fit, choose_on), nameless))

    for names in ((), ("exposure_drift",), ("gamma_drift",), ("exposure_drift", "gamma_drift")):
        attempt(names)
    first, alike = smallest(tried)
    for name in ("place in the picture", "place and time", "brightness"):
        attempt((name,), nameless=True)
        if first.names:
            attempt((*first.names, name), nameless=True)
    null = next(t for t in tried if not t.names)
    fit = fits[first.names]
    curves = _curves(fit, columns, first.names)
    confirming = [block.of(confirm_on)]
    gains = density(confirming, fit, confirm_on) - density(confirming, fits[()], confirm_on)
    sizes = [_of_frames(block.of(confirm_on), fits[names]) for names in ((), first.names)]
    spreads = {
        name: float(np.sqrt(np.mean(np.diag(fit.covariance)[[fit.chosen.index(c) for c in columns[name]]])))
        for name in first.names
    }
    return Colours(
        first.names,
        curves.get("exposure_drift", ()),
        curves.get("gamma_drift", ()),
        tuple(t.names for t in alike),
        tuple(sorted(tried, key=lambda t: -t.mean)),
        null,
        gains,
        *sizes,
        LEAST_STOPS / 4,
        spreads,
    )


def _curves(fit: LinearFit, columns: dict[str, list[int]], names: tuple[str, ...]) -> dict[str, tuple[float, ...]]:
    """A drift's values at the knots, the mean taken out: what is the same all along is the asset's light."""
    at = {c: float(v) for c, v in zip(fit.chosen, fit.beta, strict=True)}
    out = {}
    for name in names:
        if name in ("exposure_drift", "gamma_drift"):
            values = np.array([0.0, *(at[c] for c in columns[name])])
            out[name] = tuple(float(v) for v in values - values.mean())
    return out


def _matters(curves: dict[str, tuple[float, ...]]) -> bool:
    least = {"exposure_drift": LEAST_STOPS, "gamma_drift": LEAST_GAMMA}
    return all(np.ptp(curve) >= least[name] for name, curve in curves.items())


def _of_frames(block: Block, fit: LinearFit) -> float:
    """Root mean square over frames of the median that their rows lack, stops."""
    r = block.y - block.columns[:, list(fit.chosen)] @ fit.beta
    medians = [np.median(r[block.frame == f]) for f in np.unique(block.frame)]
    return float(np.sqrt(np.mean(np.square(medians)))) if medians else 0.0
