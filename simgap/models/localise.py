"""Localisation: maps of the missing force, tested by sign flips of half swings.

Neighbouring samples are dependent, so the exchangeable unit is the half swing: where nothing is missing, the sum of its
residuals is positive or negative with equal probability. The largest deviation over all bins of a map is compared with
those of sign-flipped data, which gives one p-value per map; these are corrected for the number of maps (Benjamini and
Hochberg 1995).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from freeart21.joint import JointType
from freeart21.se3 import Array
from simgap.models.equation_error import MissingForce
from simgap.select.words import amount, span_text
from simgap.verdict import Region

LEVEL = 0.05
"""False discovery rate over the maps."""
_BINS = 16
_FLIPS = 1999
_LEAST_UNITS = 6  # half swings; fewer give no rare sign pattern


@dataclass(frozen=True)
class ResidualMap:
    """Mean missing force over one quantity."""

    quantity: str
    edges: Array
    """(bins + 1,) in SI units."""
    mean: Array
    """(bins,) N*m or N; NaN without samples."""
    spread: Array
    """(bins,) standard error of the mean, between half swings."""
    p_value: float
    """Of no missing force anywhere on this map, over all its bins."""
    adjusted: float
    """The same, corrected for the number of maps."""
    flagged: NDArray[np.bool_]
    """(bins,) whether the deviation exceeds that of sign flips anywhere."""
    signed: bool
    """True: positive is towards larger positions. False: positive is along the motion, negative a brake."""
    labels: tuple[str, ...] = ()
    """Names of the bins where they are no range, such as runs."""
    local_only: bool = False
    """True: with smooth friction, springs and gravity removed, so only local forces show."""


def make_residual_maps(found: MissingForce, seed: int = 0) -> tuple[ResidualMap, ...]:
    """Maps over position, speed, direction, distance since reversal, distance to limit, command, time and run."""
    if len(found.force) < 4 * _BINS or not found.qd.any():  # a stuck encoder
        return ()
    rng = np.random.default_rng([seed, 11])
    local = _remove_smooth(found)
    along, moving = np.sign(found.qd), np.abs(found.qd) > 0.05 * np.abs(found.qd).max()
    every = np.ones(len(along), bool)
    maps = [
        _binned_map("position", found.q, found.force, found, every, rng),
        _binned_map("velocity", found.qd, found.force, found, every, rng),
        _named_map("direction", (along > 0).astype(int), found.force, found, moving, rng, ("backwards", "forwards")),
        _binned_map("position, by itself", found.q, local, found, every, rng, local_only=True),
        _binned_map("time", found.time_s, along * local, found, moving, rng, signed=False, local_only=True),
    ]
    known = moving & np.isfinite(found.since_reversal)
    if known.sum() > 4 * _BINS:
        maps.append(
            _binned_map("distance since reversal", found.since_reversal, along * local, found, known, rng, False, True)
        )
    if found.to_limit.min() < 0.15 * np.ptp(found.q):  # a far stop is irrelevant
        maps.append(_binned_map("distance to limit", found.to_limit, local, found, every, rng, local_only=True))
    given = np.isfinite(found.command)
    if given.sum() > 4 * _BINS:
        maps.append(_binned_map("command", found.command, found.force, found, given, rng))
    if len(found.run_names) > 1:
        maps.append(
            _named_map(
                "run", found.run, along * local, found, moving, rng, found.run_names, signed=False, local_only=True
            )
        )
    return correct_maps(maps)


def correct_maps(maps: Sequence[ResidualMap]) -> tuple[ResidualMap, ...]:
    """The maps with p-values corrected for their number, and no flags on those above `LEVEL`."""
    adjusted = benjamini_hochberg(np.array([m.p_value for m in maps])).tolist()
    return tuple(replace(m, adjusted=p, flagged=m.flagged & (p <= LEVEL)) for m, p in zip(maps, adjusted, strict=True))


def benjamini_hochberg(p: Array) -> Array:
    """(n,) p-values corrected for their number (false discovery rate)."""
    order = np.argsort(p)
    n = len(p)
    stepped = np.minimum.accumulate((p[order] * n / np.arange(1, n + 1))[::-1])[::-1]
    out = np.empty(n)
    out[order] = np.minimum(stepped, 1.0)
    return out


def flagged_regions(maps: tuple[ResidualMap, ...], found: MissingForce, joint_type: JointType) -> tuple[Region, ...]:
    """The flagged regions of the maps, in words, the most significant first; and rebounds at stops."""
    out: list[Region] = []
    for m in maps:
        if m.adjusted > LEVEL:
            continue
        for first, last in _flagged_stretches(m):
            mean = float(np.nanmean(m.mean[first : last + 1]))
            low, high = float(m.edges[first]), float(m.edges[last + 1])
            if any(_is_same_place(w, m.quantity, low, high) for w in out):
                continue
            text = _region_text(m, first, low, high, mean, joint_type)
            out.append(Region(m.quantity, low, high, m.p_value, text))
    bounce = _find_bounces(found)
    if bounce is not None:
        out.append(bounce)
    return tuple(sorted(out, key=lambda w: w.p_value))


def sign_flip_test(
    units: NDArray[np.int64], bins: NDArray[np.int64], values: Array, count: int, rng: np.random.Generator
) -> tuple[Array, float, float]:
    """Deviation (bins,) in standard errors, p-value of the largest one, and its 5 % threshold.

    Sums of `values` (n,) by unit and bin are multiplied by random signs, one per unit.
    """
    names, unit = np.unique(units, return_inverse=True)
    sums = np.zeros((len(names), count))
    np.add.at(sums, (unit, bins), values)
    size = np.sqrt((sums**2).sum(0))
    counted = (sums != 0).sum(0) >= _LEAST_UNITS
    usable = counted & (size > 0)
    z = np.where(usable, sums.sum(0) / np.maximum(size, 1e-300), 0.0)
    if not usable.any():
        return z, 1.0, np.inf
    signs = rng.choice([-1.0, 1.0], size=(_FLIPS, len(names)))
    largest = np.abs(signs @ sums[:, usable] / size[usable]).max(1)
    p = (1 + int((largest >= np.abs(z).max() - 1e-12).sum())) / (_FLIPS + 1)
    return z, p, float(np.quantile(largest, 0.95))


def _binned_map(
    quantity: str,
    x: Array,
    values: Array,
    found: MissingForce,
    mask: NDArray[np.bool_],
    rng: np.random.Generator,
    signed: bool = True,
    local_only: bool = False,
) -> ResidualMap:
    """Bins of equal width between the outer percentiles."""
    low, high = np.percentile(x[mask], [0.5, 99.5])
    edges = np.linspace(low, max(high, low + 1e-9), _BINS + 1)
    inside = mask & (x >= low) & (x <= high)
    bins = np.clip(np.searchsorted(edges, x[inside], side="right") - 1, 0, _BINS - 1)
    return bin_map(quantity, edges, bins, values[inside], found.unit[inside], rng, signed, (), local_only)


def _named_map(
    quantity: str,
    bins: NDArray[np.int64],
    values: Array,
    found: MissingForce,
    mask: NDArray[np.bool_],
    rng: np.random.Generator,
    labels: tuple[str, ...],
    signed: bool = True,
    local_only: bool = False,
) -> ResidualMap:
    edges = np.arange(len(labels) + 1.0)
    return bin_map(quantity, edges, bins[mask], values[mask], found.unit[mask], rng, signed, labels, local_only)


def bin_map(
    quantity: str,
    edges: Array,
    bins: NDArray[np.int64],
    values: Array,
    units: NDArray[np.int64],
    rng: np.random.Generator,
    signed: bool = True,
    labels: tuple[str, ...] = (),
    local_only: bool = False,
) -> ResidualMap:
    """The map of `values` (n,) in `bins` (n,), with exchangeable `units` (n,)."""
    count = len(edges) - 1
    z, p, most = sign_flip_test(units, bins, values, count, rng)
    n = np.bincount(bins, minlength=count)
    with np.errstate(invalid="ignore", divide="ignore"):
        mean = np.bincount(bins, values, count) / np.where(n > 0, n, np.nan)
        spread = np.abs(mean) / np.maximum(np.abs(z), 1e-12)
    return ResidualMap(quantity, edges, mean, spread, p, p, np.abs(z) > most, signed, labels, local_only)


def _remove_smooth(found: MissingForce) -> Array:
    """The missing force less friction, drag, spring and gravity, by least squares."""
    q, qd = found.q, found.qd
    columns = np.stack([np.ones_like(q), q, np.sin(q), np.cos(q), qd, np.sign(qd), qd * np.abs(qd)], -1)
    size = np.maximum(np.abs(columns).max(0), 1e-12)
    fitted = np.linalg.lstsq(columns / size, found.force, rcond=1e-8)[0]
    return np.asarray(found.force - columns / size @ fitted)


def _flagged_stretches(m: ResidualMap) -> list[tuple[int, int]]:
    """First and last bin of every run of flagged bins of one sign."""
    out: list[tuple[int, int]] = []
    for i in np.flatnonzero(m.flagged):
        joined = not m.labels and out and out[-1][1] == i - 1 and m.mean[i] * m.mean[i - 1] > 0
        out = [*out[:-1], (out[-1][0], int(i))] if joined else [*out, (int(i), int(i))]
    return out


def _is_same_place(known_region: Region, quantity: str, low: float, high: float) -> bool:
    """Whether a region of the position map is already reported by the local one, or the reverse."""
    both = {known_region.quantity, quantity} == {"position", "position, by itself"}
    return both and low <= known_region.high and high >= known_region.low


def _find_bounces(found: MissingForce) -> Region | None:
    """Impacts after which the part rebounds, which the simulated stop does not do."""
    from scipy.stats import binomtest

    speeds = found.impacts
    if not len(speeds):
        return None
    noise = 0.1 * float(np.abs(found.qd).max(initial=0.0))
    hard = speeds[speeds[:, 1] > 2 * noise]
    back = hard[:, 2] > np.maximum(0.1 * hard[:, 1], 0.5 * noise) if len(hard) else np.zeros(0, bool)
    if not back.any():
        return None
    p = float(binomtest(int(back.sum()), len(hard), 0.1, alternative="greater").pvalue)
    if p > LEVEL:
        return None
    ratio = float(np.median(hard[back, 2] / hard[back, 1]))
    text = (
        f"At the stop the part comes back with about {ratio:.0%} of its speed ({int(back.sum())} of {len(hard)} "
        "times); the simulated stop swallows all of it."
    )
    return Region("distance to limit", 0.0, 0.0, p, text)


def _region_text(m: ResidualMap, first: int, low: float, high: float, mean: float, kind: JointType) -> str:
    size = amount(abs(mean), "N*m" if kind == "revolute" else "N")
    more = "more than smooth friction and springs explain" if m.local_only else "that the simulation lacks"
    if m.signed:
        how = f"it is pushed {'forwards' if mean > 0 else 'backwards'} by {size} {more}"
    else:
        how = f"it is {'pushed on' if mean > 0 else 'braked'} by {size} {more}"
    if m.quantity == "direction":
        return f"When it moves {m.labels[first]}, {how}."
    if m.quantity == "run":
        return f"In run {m.labels[first]}, {how}."
    return f"{_PLACES[m.quantity](span_text(m.quantity, low, high, kind))}, {how}."


_PLACES: dict[str, Callable[[str], str]] = {
    "position": lambda span: f"At {span}",
    "position, by itself": lambda span: f"At {span}",
    "velocity": lambda span: f"At speeds of {span}",
    "time": lambda span: f"From {span} after the start",
    "distance since reversal": lambda span: f"{span} after it turned back",
    "distance to limit": lambda span: f"{span} from the stop",
    "command": lambda span: f"With the command ahead by {span}",
}
