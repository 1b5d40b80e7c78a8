"""Drawings of the gap page, as SVG text: a replayed run, a map of missing force, an interval."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from freeart21.joint import JointType
from freeart21.se3 import Array
from freeart21.view.document import MOVING, REFERENCE, escape
from freeart21.view.plot import display_unit, path_data, runs, ticks
from simgap.models.localise import ResidualMap
from simgap.prove.show import ReplayGap
from simgap.verdict import By, unit_of

MEASURED, BEFORE, AFTER = "#7d8894", MOVING, REFERENCE
"""Grey for what was measured, orange for the asset as it was, blue for the repaired one."""
_MOST_POINTS = 600
_LEFT, _RIGHT, _TOP, _BOTTOM = 50, 8, 8, 22


@dataclass(frozen=True)
class Line:
    """One line of a drawing."""

    name: str
    colour: str
    values: Array
    """(n,); broken where NaN."""
    style: str = ""
    """Class of the line: '', 'dashed' or 'wide'."""


def chart(
    x: Array,
    lines: Sequence[Line],
    title: str,
    unit: str,
    *,
    x_unit: str = "s",
    band: float | None = None,
    height: int = 190,
    width: int = 560,
) -> str:
    """A figure of lines over `x` (n,), with room above and below; `band` is a grey stretch about zero.

    It fits the script of kind 'curves': a cursor, and a place for the value there after every name of the legend.
    """
    values = np.concatenate([line.values for line in lines])
    values = values[np.isfinite(values)]
    low, high = (float(values.min()), float(values.max())) if len(values) else (0.0, 1.0)
    if band:
        low, high = min(low, -band), max(high, band)
    margin = 0.07 * (high - low) or 1.0
    low, high = low - margin, high + margin
    first, last = float(x[0]), float(max(x[-1], x[0] + 1e-9))

    def across(value: Array | float) -> Array:
        return _LEFT + (np.asarray(value, float) - first) / (last - first) * (width - _LEFT - _RIGHT)

    down = _scale(low, high, height)
    parts = [f'<svg viewBox="0 0 {width} {height}" role="img" aria-label="{escape(title)}">']
    if band:
        top, bottom = float(down(band)), float(down(-band))
        parts.append(
            f'<rect class="unseen" x="{_LEFT}" width="{width - _LEFT - _RIGHT}" y="{top:.1f}" '
            f'height="{bottom - top:.1f}"/>'
        )
    parts += _grid(low, high, down, width)
    at = ticks(first, last, 6)
    for t in at:
        label = f"{t:g}{' ' + x_unit if t == at[-1] else ''}"
        parts.append(f'<text x="{across(t):.1f}" y="{height - 6}" text-anchor="middle">{escape(label)}</text>')
    for line in lines:
        style = f' class="{line.style}"' if line.style else ""
        for stretch in runs(np.isfinite(line.values)):
            path = path_data(across(x[stretch]), down(line.values[stretch]))
            parts.append(f'<path{style} stroke="{line.colour}" d="{path}"/>')
    parts.append(f'<line class="cursor" x1="{_LEFT}" x2="{_LEFT}" y1="{_TOP}" y2="{height - _BOTTOM}"/></svg>')
    legend = "".join(
        f'<li><i{" class=dashed" if line.style == "dashed" else ""} style="color:{line.colour}"></i>'
        f"{escape(line.name)} <output></output></li>"
        for line in lines
    )
    return (
        f"<figure><figcaption><b>{escape(title)}</b>, {escape(unit)}</figcaption>{''.join(parts)}"
        f'<ul class="legend">{legend}</ul></figure>'
    )


def run_drawings(
    run: ReplayGap, kind: JointType, names: tuple[str, str | None] = ("as the asset was", "after"), by: By = "position"
) -> tuple[list[str], dict[str, object]]:
    """Figures of one replayed run, position (or force) and difference, and what the script of kind 'curves' needs.

    `names` say what the two simulations are; without a second one only the first is drawn.
    """
    unit, factor = display_unit(kind) if by == "position" else (unit_of(by, kind).replace("*", " "), 1.0)
    kept = np.unique(np.linspace(0, len(run.times_s) - 1, min(_MOST_POINTS, len(run.times_s))).astype(int))
    x = run.times_s[kept] - run.times_s[0]
    measured, before, after = (factor * series[kept] for series in (run.measured, run.before, run.after))
    position = [Line("measured", MEASURED, measured, "wide"), Line(f"simulated {names[0]}", BEFORE, before, "dashed")]
    difference = [Line(f"{names[0]}, less measured", BEFORE, before - measured, "dashed")]
    if names[1] is not None:
        position.append(Line(f"simulated {names[1]}", AFTER, after))
        difference.append(Line(f"{names[1]}, less measured", AFTER, after - measured))
    figures = [
        chart(x, position, by.capitalize(), unit),
        chart(x, difference, "Difference", f"{unit}; grey: noise, ± 2 floors", band=2 * factor * run.floor, height=150),
    ]
    across = _LEFT + x / max(float(x[-1]), 1e-9) * (560 - _LEFT - _RIGHT)
    data: dict[str, object] = {
        "x": np.round(across, 2),
        "width": 560,
        "charts": [[_short(line.values) for line in lines] for lines in (position, difference)],
        "units": [unit, unit],
    }
    return figures, data


def force_map(m: ResidualMap, kind: JointType) -> str:
    """A map of the missing force."""
    factor, unit = _axis(m, kind)
    force_factor, force_unit = _force_unit(m, kind)
    how = "towards larger positions" if m.signed else "along the motion; negative brakes"
    rest = ", besides smooth friction and springs" if m.within else ""
    title = _TITLES.get(m.quantity, m.quantity.capitalize())
    return map_drawing(m, title, f"{force_unit} {how}{rest}", factor, unit, force_factor)


def map_drawing(m: ResidualMap, title: str, what: str, factor: float, unit: str, force_factor: float = 1.0) -> str:
    """A map as bars with their standard errors, flagged ones on colour; `factor` makes `unit` of its edges, and
    `force_factor` what is written of its means."""
    height, width = 150, 330
    mean, spread = force_factor * m.mean, force_factor * m.spread
    known = np.isfinite(mean)
    reach = np.nan_to_num(np.minimum(spread, np.nanmax(np.abs(mean), initial=0.0)))
    low = float(np.nanmin(mean - reach, initial=0.0))
    high = float(np.nanmax(mean + reach, initial=0.0))
    margin = 0.08 * (high - low) or 1.0
    low, high = low - margin, high + margin
    count = len(mean)
    ends = np.linspace(_LEFT, width - _RIGHT, count + 1)

    down = _scale(low, high, height)
    parts = [f'<svg viewBox="0 0 {width} {height}" role="img" aria-label="{escape(title)}">']
    for a, b, flag in zip(ends[:-1], ends[1:], m.flagged, strict=True):
        if flag:
            parts.append(
                f'<rect class="flagged" x="{a:.1f}" width="{b - a:.1f}" y="{_TOP}" height="{height - _TOP - _BOTTOM}"/>'
            )
    parts += _grid(low, high, down, width)
    parts.append(
        f'<line class="zero" x1="{_LEFT}" x2="{width - _RIGHT}" y1="{float(down(0)):.1f}" y2="{float(down(0)):.1f}"/>'
    )
    for i in np.flatnonzero(known):
        a, b = ends[i] + 1.5, ends[i + 1] - 1.5
        top, bottom = sorted((float(down(mean[i])), float(down(0.0))))
        middle = 0.5 * (a + b)
        parts.append(
            f'<rect class="{"told" if m.flagged[i] else "mean"}" x="{a:.1f}" width="{b - a:.1f}" y="{top:.1f}" '
            f'height="{max(bottom - top, 0.8):.1f}"/>'
            f'<line class="error" x1="{middle:.1f}" x2="{middle:.1f}" y1="{float(down(mean[i] - reach[i])):.1f}" '
            f'y2="{float(down(mean[i] + reach[i])):.1f}"/>'
        )
    parts += _map_ticks(m, factor, unit, ends, height)
    return (
        f"<figure><figcaption><b>{escape(title)}</b>, p = {p_text(m.p_value)}<br>{escape(what)}</figcaption>"
        f"{''.join(parts)}</svg></figure>"
    )


def interval_drawing(value: float, low: float, high: float, width: int = 190) -> str:
    """A value and its interval on a line that begins at zero or reaches to both sides of it."""
    finite = [v for v in (value, low, high, 0.0) if np.isfinite(v)]
    a, b = min(finite), max(finite)
    span = (b - a) or 1.0

    def at(v: float) -> float:
        return 6 + (float(np.clip(v, a, b)) - a) / span * (width - 12)

    return (
        f'<svg class="interval" viewBox="0 0 {width} 16" role="img" aria-label="interval">'
        f'<line class="grid" x1="6" x2="{width - 6}" y1="8" y2="8"/>'
        f'<line class="zero" x1="{at(0.0):.1f}" x2="{at(0.0):.1f}" y1="2" y2="14"/>'
        f'<line class="reach" x1="{at(low):.1f}" x2="{at(high):.1f}" y1="8" y2="8"/>'
        f'<circle cx="{at(value):.1f}" cy="8" r="4"/></svg>'
    )


def p_text(p: float) -> str:
    """A p-value as people write it."""
    return f"{p:.1g}" if p >= 1e-4 else "below 0.0001"


_TITLES = {
    "position": "Over the position",
    "position, by itself": "Over the position, what is local",
    "velocity": "Over the speed",
    "direction": "By direction",
    "time": "Over time",
    "distance since reversal": "Since it turned back",
    "distance to limit": "To the nearer stop",
    "command": "Over the command's lead",
    "run": "By run",
}


def _axis(m: ResidualMap, kind: JointType) -> tuple[float, str]:
    if m.quantity == "time":
        return 1.0, "s"
    unit, factor = display_unit(kind)
    return factor, unit + ("/s" if m.quantity == "velocity" else "")


def _force_unit(m: ResidualMap, kind: JointType) -> tuple[float, str]:
    unit = "N m" if kind == "revolute" else "N"
    largest = float(np.nanmax(np.abs(m.mean), initial=0.0))
    return (1e3, f"m{unit}") if 0 < largest < 0.1 else (1.0, unit)


def _map_ticks(m: ResidualMap, factor: float, unit: str, ends: Array, height: int) -> list[str]:
    if m.labels:
        middles = 0.5 * (ends[1:] + ends[:-1])
        every = -(-len(m.labels) // 4)
        named = [(x, label) for x, label in zip(middles, m.labels, strict=True)][::every]
    else:
        low, high = factor * m.edges[0], factor * m.edges[-1]
        at = ticks(low, high, 5)
        named = [
            (
                float(ends[0] + (t - low) / (high - low) * (ends[-1] - ends[0])),
                f"{t:g}" + (f" {unit}" if t == at[-1] and unit != "°" else unit if t == at[-1] else ""),
            )
            for t in at
        ]
    return [
        f'<text x="{x:.1f}" y="{height - 6}" text-anchor="{"end" if x > ends[-1] - 25 and not m.labels else "middle"}">'
        f"{escape(str(label)[:14])}</text>"
        for x, label in named
    ]


def _scale(low: float, high: float, height: int) -> Callable[[Array | float], Array]:
    """Values from `low` to `high` to pixels from the top."""
    return lambda value: _TOP + (high - np.asarray(value, float)) / (high - low) * (height - _TOP - _BOTTOM)


def _grid(low: float, high: float, down: Callable[[float], Array], width: int) -> list[str]:
    return [
        f'<line class="grid" x1="{_LEFT}" x2="{width - _RIGHT}" y1="{float(down(y)):.1f}" y2="{float(down(y)):.1f}"/>'
        f'<text x="{_LEFT - 6}" y="{float(down(y)) + 4:.1f}" text-anchor="end">{y:g}</text>'
        for y in ticks(low, high, 4)
    ]


def _short(values: NDArray[np.float64]) -> list[float | None]:
    return [float(f"{v:.4g}") if np.isfinite(v) else None for v in values.tolist()]
