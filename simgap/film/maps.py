"""Localisation between films: maps over picture, distance, angle of incidence, edges and time, tested frame by frame.

Neighbouring pixels are dependent, so the exchangeable unit is the frame, like half swings in `simgap.models.localise`.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from freeart21.camera_faults import CameraFaults
from freeart21.se3 import Array
from simgap.film import colour, geometry, pixel_faults
from simgap.film.samples import Rows
from simgap.models.localise import LEVEL, ResidualMap, bin_map, correct_maps
from simgap.verdict import Region

_BINS = 10
_PICTURE = (9, 12)
"""Rows and columns of a map over the picture."""


@dataclass(frozen=True)
class FilmMap:
    """One error over bins of another quantity."""

    gap: str
    """The mapped gap (`proof`)."""
    what: str
    unit: str
    over: str
    over_unit: str
    bins: ResidualMap
    """Edges in `over_unit`, means in `unit`; for a map over the picture row by row, with the columns' edges."""
    rows: Array
    """For a map over the picture the rows' edges, pixels from the principal point; else empty."""


def film_maps(rows: Rows, coloured: bool) -> tuple[FilmMap, ...]:
    """The maps of all frames for the simulated film with an ideal camera."""
    rng = np.random.default_rng(23)
    share = np.array([f.share for f in rows.frames])
    inner, edge, band = rows.of("error"), rows.of("mask_off"), rows.of("band")
    angle = np.degrees(np.arccos(np.clip(rows["cosine"], 0, 1)))
    outward = np.degrees(np.arctan2(rows["outward"][:, 1], rows["outward"][:, 0]))
    lost = np.isnan(rows["error"]).astype(float)
    lost -= (np.bincount(inner, lost) / np.maximum(np.bincount(inner), 1))[inner]  # relative to the frame's mean
    error = (geometry.GAPS[0], "depth error", "mm", 1e3 * rows["error"], inner)
    holes = (pixel_faults.LOST, "holes", "%", 100 * lost, inner)
    masks, depths = (
        (gap, gap, "px", rows[field], edge)
        for gap, field in zip(geometry.GAPS[1:], ("mask_off", "depth_off"), strict=True)
    )
    bright = (colour.GAP, "brightness", "stops", rows["stops"] - np.nanmedian(rows["stops"]), inner)
    surface = [("distance", "m", rows["z"]), ("angle of incidence", "°", angle)]
    surface += [("brightness", "", rows["measured_brightness"])]
    wanted = [(what, *over) for what in (error, holes) for over in surface]
    wanted += [(what, "direction of the outline", "° from right, clockwise", outward) for what in (masks, depths)]
    wanted += [(what, "time", "of the film", share[inner]) for what in (error, *[bright] * coloured)]
    flying = pixel_faults.find_flying(rows, CameraFaults()).astype(float)
    flying_map = (pixel_faults.FLYING, pixel_faults.FLYING, "%", 100 * (flying - flying.mean()), band)
    wanted += [(flying_map, "distance to the edge", "px", rows["band"])]
    made = [_over_picture(what, rows["at"], rng) for what in (error, holes)]
    for (gap, what, unit, values, frame), over, over_unit, x in wanted:
        usable = np.isfinite(values) & np.isfinite(x)
        if usable.any():
            low, high = np.percentile(x[usable], [1, 99])
            edges = np.linspace(low, max(high, low + 1e-9), _BINS + 1)
            bins = np.clip(np.searchsorted(edges, x[usable], side="right") - 1, 0, _BINS - 1)
            found = bin_map(f"{what} by {over}", edges, bins, _capped(values[usable]), frame[usable], rng)
            made.append(FilmMap(gap, what, unit, over, over_unit, found, np.zeros(0)))
    corrected = correct_maps([m.bins for m in made])
    return tuple(replace(m, bins=bins) for m, bins in zip(made, corrected, strict=True))


def _over_picture(what: tuple[str, str, str, Array, NDArray[np.int64]], at: Array, rng: np.random.Generator) -> FilmMap:
    gap, name, unit, values, frame = what
    usable = np.isfinite(values)
    ends = np.percentile(at, [0.5, 99.5], axis=0) if len(at) else np.array([[-1.0, -1.0], [1.0, 1.0]])
    columns, lines = (np.linspace(ends[0, k], ends[1, k], n + 1) for k, n in ((0, _PICTURE[1]), (1, _PICTURE[0])))
    column, line = (
        np.clip(np.searchsorted(edges, at[usable, k]) - 1, 0, len(edges) - 2) for k, edges in ((0, columns), (1, lines))
    )
    cells = np.arange(_PICTURE[0] * _PICTURE[1] + 1.0)
    bins = line * _PICTURE[1] + column
    found = bin_map(f"{name} by place in the picture", cells, bins, _capped(values[usable]), frame[usable], rng)
    return FilmMap(gap, name, unit, "place in the picture", "px", replace(found, edges=columns), lines)


def flagged_places(maps: tuple[FilmMap, ...]) -> list[tuple[str, Region]]:
    """The gap and the largest deviation of every significant map."""
    found = []
    for m in maps:
        b = m.bins
        if b.adjusted > LEVEL or not b.flagged.any():
            continue
        k = int(np.nanargmax(np.where(b.flagged, np.abs(b.mean), -1)))
        size = f"{b.mean[k]:+.2g} {m.unit}"
        if len(m.rows):
            line, column = divmod(k, _PICTURE[1])
            u, v = (float(e[i] + e[i + 1]) / 2 for e, i in ((b.edges, column), (m.rows, line)))
            text, ends = f"{m.what}: {size} at {u:.0f}, {v:.0f} px from the principal point", (u, v)
        else:
            ends = float(b.edges[k]), float(b.edges[k + 1])
            text = f"{m.what}: {size} at {m.over} {ends[0]:.3g} to {ends[1]:.3g} {m.over_unit}".strip()
        found.append((m.gap, Region(b.quantity, *ends, b.adjusted, text)))
    return found


def _capped(values: Array) -> Array:
    """Values limited to five times their median size, so that one edge does not decide."""
    cap = 5 * float(np.median(np.abs(values))) if len(values) else 0.0
    return np.clip(values, -cap, cap) if cap > 1e-9 else values
