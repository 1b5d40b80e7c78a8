"""Where the two films part: maps over picture, distance, angle of incidence, edges and time, tested frame by frame.

Pixels beside each other say the same, so the exchangeable unit is the frame: where nothing is missing, a frame's mean
error in a bin is as likely to be positive as negative. The largest deviation of a map's bins is compared with those of
frames whose signs are flipped at random (one p-value a map), and maps are corrected for their number.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from freeart21.se3 import Array
from simgap.film.choose import benjamini_hochberg
from simgap.film.samples import Rows

LEVEL = 0.05
"""False discovery rate over the maps."""
_FLIPS = 1999
_LEAST_FRAMES = 6
_BINS = 10


@dataclass(frozen=True)
class FilmMap:
    """One quantity over bins of another."""

    what: str
    """Such as 'depth error'."""
    unit: str
    over: str
    """Such as 'distance'."""
    over_unit: str
    edges: Array
    """(bins + 1,); of a map over the picture the columns' edges in pixels from the principal point."""
    rows: Array
    """Of a map over the picture the rows' edges; empty else."""
    before: Array
    """(bins,) or (rows, columns) mean over frames, for the asset's film as it is; NaN where nothing is seen."""
    after: Array
    """The same with what was named."""
    p_value: float
    adjusted: float
    flagged: NDArray[np.bool_]
    """Bins whose deviation alone is beyond what flipped signs make anywhere."""


def maps_of(rows: Rows, errors: dict[str, tuple[Array, Array]], seed: int = 0) -> tuple[FilmMap, ...]:
    """The maps of all frames. `errors` are before and after, by name: 'depth error' (metres, rows of "error"), 'holes'
    (share less told, rows of "error"), 'outline of the mask', 'outline of the depth' (pixels, rows of "mask_off")."""
    rng = np.random.default_rng([seed, 23])
    share = np.array([f.share for f in rows.frames])
    inner, edge = rows.of("error"), rows.of("mask_off")
    angle = np.degrees(np.arccos(np.clip(rows["cosine"], 0, 1)))
    outward = np.degrees(np.arctan2(rows["outward"][:, 1], rows["outward"][:, 0]))
    made: list[FilmMap] = []

    def add(what: str, unit: str, over: str, over_unit: str, x: Array, frame: NDArray[np.int64]) -> None:
        before, after = errors[what]
        made.append(_map(what, unit, over, over_unit, x, before, after, frame, rng))

    for what, unit in (("depth error", "mm"), ("holes", "%")):
        if what in errors:
            made.append(_picture(what, unit, rows["at"], *errors[what], inner, rng))
            add(what, unit, "distance", "m", rows["z"], inner)
            add(what, unit, "angle of incidence", "°", angle, inner)
            add(what, unit, "brightness", "", rows["measured_brightness"], inner)
    for what, x, over, over_unit, frame in (
        ("depth error", share[inner], "time", "of the film", inner),
        ("outline of the mask", outward, "direction of the outline", "° from right, clockwise", edge),
        ("outline of the depth", outward, "direction of the outline", "° from right, clockwise", edge),
        ("brightness of the picture", share[inner], "time", "of the film", inner),
    ):
        if what in errors:
            add(
                what,
                {"depth error": "mm", "brightness of the picture": "stops"}.get(what, "px"),
                over,
                over_unit,
                x,
                frame,
            )
    if "pixels at edges" in errors:
        add("pixels at edges", "%", "distance to the edge", "px", rows["band"], rows.of("band"))
    made = [m for m in made if np.isfinite(m.before).any()]
    adjusted = benjamini_hochberg(np.array([m.p_value for m in made]))
    return tuple(_adjusted(m, float(p)) for m, p in zip(made, adjusted, strict=True))


def _map(
    what: str, unit: str, over: str, over_unit: str, x: Array, before: Array, after: Array, frame: NDArray[np.int64],
    rng: np.random.Generator,
) -> FilmMap:  # fmt: skip
    kept = np.isfinite(before) & np.isfinite(x)
    low, high = np.percentile(x[kept], [1, 99]) if kept.any() else (0.0, 1.0)
    edges = np.linspace(low, max(high, low + 1e-9), _BINS + 1)
    bins = np.clip(np.searchsorted(edges, x, side="right") - 1, 0, _BINS - 1)
    mean, p, flagged = _tested(before, bins, frame, kept, _BINS, rng)
    then = _tested(after, bins, frame, kept & np.isfinite(after), _BINS, None)[0]
    return FilmMap(what, unit, over, over_unit, edges, np.zeros(0), mean, then, p, p, flagged)


def _picture(
    what: str, unit: str, at: Array, before: Array, after: Array, frame: NDArray[np.int64], rng: np.random.Generator
) -> FilmMap:
    kept = np.isfinite(before)
    low, high = np.percentile(at, [0.5, 99.5], axis=0) if len(at) else np.array([[-1.0, -1], [1, 1]])
    high = np.maximum(high, low + 1e-9)
    columns, lines = np.linspace(low[0], high[0], 13), np.linspace(low[1], high[1], 10)
    bins = np.clip(np.searchsorted(lines, at[:, 1]) - 1, 0, 8) * 12 + np.clip(
        np.searchsorted(columns, at[:, 0]) - 1, 0, 11
    )
    mean, p, flagged = _tested(before, bins, frame, kept, 108, rng)
    then = _tested(after, bins, frame, kept & np.isfinite(after), 108, None)[0]
    shape = (9, 12)
    return FilmMap(
        what, unit, "place in the picture", "px", columns, lines, mean.reshape(shape), then.reshape(shape), p, p,
        flagged.reshape(shape),
    )  # fmt: skip


def _tested(
    values: Array, bins: NDArray[np.int64], frame: NDArray[np.int64], kept: NDArray[np.bool_], count: int,
    rng: np.random.Generator | None,
) -> tuple[Array, float, NDArray[np.bool_]]:  # fmt: skip
    """Mean over frames of each bin's mean, the p-value of the largest deviation, and bins beyond it."""
    n = int(frame.max(initial=0)) + 1
    cell = frame[kept] * count + bins[kept]
    number = np.bincount(cell, minlength=n * count).reshape(n, count)
    cap = 5 * max(float(np.median(np.abs(values[kept]))) if kept.any() else 0.0, 1e-12)
    capped = np.clip(values[kept], -cap, cap) if cap > 1e-9 else values[kept]
    with np.errstate(invalid="ignore"):
        mean = np.bincount(cell, capped, minlength=n * count).reshape(n, count) / number
    seen = number >= 5
    total = seen.sum(0)
    per_bin = np.where(total > 0, np.where(seen, mean, 0).sum(0) / np.maximum(total, 1), np.nan)
    usable = total >= _LEAST_FRAMES
    flagged = np.zeros(count, bool)
    if rng is None or not usable.any():
        return per_bin, 1.0, flagged
    m = np.where(seen, mean, 0.0)[:, usable]
    size = np.sqrt((m**2).sum(0))
    size = np.maximum(size, 1e-300)
    z = np.abs(m.sum(0)) / size
    signs = rng.choice([-1.0, 1.0], size=(_FLIPS, n))
    largest = np.abs(signs @ (m / size)).max(1)
    p = float((1 + (largest >= z.max() - 1e-12).sum()) / (_FLIPS + 1))
    flagged[usable] = z > np.quantile(largest, 0.95)
    return per_bin, p, flagged


def _adjusted(m: FilmMap, p: float) -> FilmMap:
    values = {**vars(m), "adjusted": p}
    if p > LEVEL:
        values["flagged"] = np.zeros(m.flagged.shape, bool)
    return FilmMap(**values)
