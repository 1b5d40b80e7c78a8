"""Line plots and bars as SVG: axes, curves with a legend, and the joint state over a video."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from freeart21.view.document import Markup, Section, render
from freeart21.view.source import Source

Array = NDArray[np.float64]
Box = tuple[str, float, float, float, float]
"""A rectangle by its CSS class, values of x at its left and right, values of y at its bottom and top."""

MARGINS = 46, 14, 8, 24
"""Pixels left, right, above and below."""
MAX_MEDIANS = 12.0
"""Upper end of a chart that starts at zero, in medians: a single far outlier is cut off, the rest stays readable."""


@dataclass(frozen=True)
class Curve:
    """One line of a plot."""

    name: str
    colour: str
    values: Array
    """(n,); the line is broken where NaN."""
    style: str = ""
    """CSS class of the line: '', 'dashed' or 'wide'."""
    half_width: Array | None = None
    """(n,) half the width of a band around it; NaN where unknown."""


@dataclass(frozen=True)
class Chart:
    """Curves of one unit over a common abscissa."""

    title: str
    unit: str
    curves: Sequence[Curve]
    about: str = ""
    """What it shows, in a sentence."""
    top: float | None = None
    """Smallest upper end of the vertical axis, such as 100 for percentages."""
    y: tuple[float, float] | None = None
    """Ends of the vertical axis; from zero to the largest value when not given."""
    boxes: Sequence[Box] = ()
    width: int = 560
    height: int = 190


def curves_section(
    title: str,
    charts: Sequence[Chart],
    abscissa: Array,
    timed: bool = True,
    unseen: NDArray[np.bool_] | None = None,
    note: str = "",
    place: Any = "full",
    frames: NDArray[np.int64] | None = None,
) -> Section:
    """Charts over `abscissa` (n,), seconds when `timed`, else frame numbers.

    Frames with `unseen` (n,) have a grey background. A cursor follows the video, legends show the values there, and
    hide curves. `frames` (n,) are the frames of the video at these places; 0 to n - 1 when not given.
    """
    x = np.asarray(abscissa, float)
    edges = np.concatenate([x[:1], (x[1:] + x[:-1]) / 2, x[-1:]])  # half a frame to either side
    runs = true_runs(np.zeros(len(x), bool) if unseen is None else unseen)
    grey: list[Box] = [("unseen", edges[run[0]], edges[run[-1] + 1], -np.inf, np.inf) for run in runs]
    drawn = [figure(replace(chart, boxes=[*grey, *chart.boxes]), x, " s" * timed) for chart in charts]
    values = [[[float(f"{v:.4g}") for v in curve.values] for curve in chart.curves] for chart in charts]
    data = {"charts": values, "x": _across(x, x, charts[0].width), "width": charts[0].width}
    if frames is not None:
        data["frames"] = frames
    html = Markup('<div class="charts">{}</div>').format(Markup("").join(drawn))
    return Section(title, html, "curves", data, place, note)


def figure(
    chart: Chart, x: Array, x_unit: str = "", legend: bool = True, x_labels: Mapping[float, str] | None = None
) -> Markup:
    """An SVG of a chart over `x` (n,), with a legend that the script of kind 'curves' fills.

    `x_unit` follows the last tick label; `x_labels` replace them. What is beyond an end of y is drawn at that end.
    """
    left, right, top, bottom = MARGINS
    y_ends = chart.y or (0.0, _upper_end(chart))

    def down(values: ArrayLike) -> Array:
        return _scale(values, y_ends, (chart.height - bottom, top))

    curves = []
    for curve in chart.curves:
        bands, there = [], _across(x, x, chart.width)
        width = np.full(len(x), np.nan) if curve.half_width is None else curve.half_width
        for run in true_runs(np.isfinite(width)):
            low, high = (down(curve.values[run] + sign * width[run]) for sign in (-1, 1))
            if len(run) > 1:
                bands.append(f"{_path(np.r_[there[run], there[run[::-1]]], np.r_[low, high[::-1]])}Z")
        lines = [_path(there[run], down(curve.values[run])) for run in true_runs(np.isfinite(curve.values))]
        curves.append((curve, bands, lines))
    boxes = []
    for css, a, b, *ends in chart.boxes:
        (x0, x1), (y1, y0) = _across([a, b], x, chart.width), down(ends)
        boxes.append((css, x0, y0, round(x1 - x0, 1), round(max(y1 - y0, 0.8), 1)))
    across = tick_values(*_ends(x), 6)
    texts = x_labels or {float(v): f"{v:g}{x_unit if v == across[-1] else ''}" for v in across}
    return render(
        "figure.html.j2",
        chart=chart,
        legend=legend,
        boxes=boxes,
        curves=curves,
        y_ticks=[(down(v), f"{v:g}") for v in tick_values(*y_ends, 4)],
        x_ticks=[(_across(value, x, chart.width), text) for value, text in texts.items()],
        left=left,
        right=chart.width - right,
        top=top,
        bottom=chart.height - bottom,
    )


def state_section(
    sources: Sequence[Source],
    abscissa: Array,
    timed: bool,
    seen: NDArray[np.bool_] | None = None,
    frames: NDArray[np.int64] | None = None,
    note: str = "",
) -> Section:
    """The joint states over the video of all sources with the first one's joint type, with its sign and zero.

    The first one decides the range; those far beyond it run along the edge. Frames without `seen` (n,) are grey.
    `frames` (n,) are those at the places `abscissa`; all when None.
    """
    unit, factor = display_unit(sources[0].joint.type)
    at = slice(None) if frames is None else frames
    curves = []
    for one in sources:
        if one.articulation is not None and one.offset is not None and one.zero is None:
            known = one.state_std is not None and bool(np.isfinite(one.state_std).any())
            band = None if one.state_std is None or not known else 2 * factor * one.state_std[at]
            style, states = "wide" if one.is_truth else "", factor * one.states_of_first[at]
            curves.append(Curve(one.name + ", ± 2 std" * known, one.colours[1], states, style, band))
    curves.sort(key=lambda curve: curve.style != "wide")  # the truth first, below the others
    ends = padded_range([c.values for c in curves[:1]], 0.75)
    bands = [np.zeros(1) if c.half_width is None else np.nan_to_num(c.half_width) for c in curves]
    every = padded_range([c.values + sign * w for c, w in zip(curves, bands, strict=True) for sign in (-1, 1)])
    chart = Chart("", unit, curves, y=(max(ends[0], every[0]), min(ends[1], every[1])), height=210)
    name = f"Joint state, {'degrees' if unit == '°' else unit}"
    grey = "" if seen is None or seen.all() else "Grey: the moving part was not measured. "
    unseen = None if seen is None else ~np.asarray(seen, bool)
    return curves_section(name, [chart], abscissa, timed, unseen, (grey + note).strip(), "left", frames)


def display_unit(joint_type: str) -> tuple[str, float]:
    """The unit in which people read joint states, and its size in rad or m inverted: degrees, or centimetres."""
    return ("°", 180 / np.pi) if joint_type == "revolute" else ("cm", 100.0)


def padded_range(values: Sequence[Array], margin: float = 0.06) -> tuple[float, float]:
    """Smallest and largest finite value of arrays, with a margin on both sides as a share of their distance."""
    every = np.concatenate([np.ravel(v) for v in values]) if len(values) else np.zeros(1)
    every = every[np.isfinite(every)]
    low, high = (float(every.min()), float(every.max())) if len(every) else (0.0, 1.0)
    room = margin * (high - low) or 1.0
    return low - room, high + room


def tick_values(low: float, high: float, about: int) -> Array:
    """Round numbers between two ends: steps of 1, 2 or 5 times a power of ten."""
    raw = (high - low) / about
    power = 10.0 ** np.floor(np.log10(raw))
    step = power * min((m for m in (1, 2, 5, 10) if m * power >= raw), default=10)
    return np.asarray(np.round(np.arange(np.ceil(low / step), np.floor(high / step) + 1) * step, 10) + 0.0)


def true_runs(flags: NDArray[np.bool_], bridge: int = 1) -> list[NDArray[np.int64]]:
    """Indices of every run of True; runs with fewer than `bridge` False between them are joined."""
    index = np.flatnonzero(flags)
    pieces = np.split(index, np.flatnonzero(np.diff(index) > bridge) + 1) if len(index) else []
    return [np.arange(piece[0], piece[-1] + 1) for piece in pieces]


def _ends(x: Array) -> tuple[float, float]:
    return float(x[0]), float(max(x[-1], x[0] + 1e-9))


def _across(values: ArrayLike, x: Array, width: int) -> Array:
    """Pixels from the left of a figure over `x` (n,)."""
    return _scale(values, _ends(x), (MARGINS[0], width - MARGINS[1]))


def _scale(values: ArrayLike, ends: tuple[float, float], pixels: tuple[float, float]) -> Array:
    return np.asarray(np.round(np.interp(np.asarray(values, float), ends, pixels), 1))


def _path(x: Array, y: Array) -> str:
    """An SVG path through points; a single one becomes a dot."""
    points = "L".join(f"{a:g} {b:g}" for a, b in zip(x, y, strict=True))
    return f"M{points}{'h0' if len(x) == 1 else ''}"


def _upper_end(chart: Chart) -> float:
    values = np.concatenate([curve.values for curve in chart.curves])
    values = values[np.isfinite(values)]
    if not len(values):
        return chart.top or 1.0
    high = float(min(values.max(), max(MAX_MEDIANS * np.median(values), np.percentile(values, 95))))
    return 1.05 * high or 1.0 if chart.top is None else max(high, chart.top)
