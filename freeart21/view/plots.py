"""Line plots as SVG: axes, curves with legends, small charts over the frames of a video, and the joint state."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from freeart21.joint import JointType
from freeart21.view.document import MOVING, TRUTH, Section, escape

Array = NDArray[np.float64]

CHART_SIZE, CHART_MARGINS = (400, 150), (40, 6, 8, 20)
STATE_SIZE, STATE_MARGINS = (560, 210), (46, 14, 8, 24)
MAX_MEDIANS = 12.0
"""Upper end of a chart, in medians: a single far outlier is cut off, the rest stays readable."""


@dataclass(frozen=True)
class Axes:
    """Maps values to a drawing, pixels from its upper left corner, and draws grid lines and tick labels."""

    width: int
    height: int
    margins: tuple[int, int, int, int]
    """Left, right, top and bottom."""
    x: tuple[float, float]
    """Values at the left and the right end."""
    y: tuple[float, float]
    """Values at the bottom and the top."""
    log_x: bool = False
    """Whether x is logarithmic."""

    def across(self, values: Array | float) -> Array:
        """Pixels from the left."""
        left, right, _, _ = self.margins
        value, low, high = np.asarray(values, float), *self.x
        if self.log_x:
            value, low, high = np.log(value), np.log(low), np.log(high)
        return np.asarray(left + (value - low) / max(high - low, 1e-9) * (self.width - left - right))

    def down(self, values: Array | float) -> Array:
        """Pixels from the top; values above the axes are drawn at their top."""
        _, _, top, bottom = self.margins
        share = (self.y[1] - np.minimum(np.asarray(values, float), self.y[1])) / (self.y[1] - self.y[0])
        return np.asarray(top + share * (self.height - top - bottom))

    def grid(self, at: int | Mapping[float, str]) -> list[str]:
        """Horizontal lines with their values at the left: about so many, or at values with their texts."""
        left, right, _, _ = self.margins
        texts = {float(v): f"{v:g}" for v in tick_values(*self.y, at)} if isinstance(at, int) else at
        return [
            f'<line class="grid" x1="{left}" x2="{self.width - right}" y1="{y:.1f}" y2="{y:.1f}"/>'
            f'<text x="{left - 6}" y="{y + 4:.1f}" text-anchor="end">{escape(text)}</text>'
            for value, text in texts.items()
            for y in [float(self.down(value))]
        ]

    def marks(self, at: int | Mapping[float, str], unit: str = "") -> list[str]:
        """Tick labels of x: about so many, the last one followed by the unit, or at values with their texts."""
        y = self.height - self.margins[3] + 16
        if isinstance(at, int):
            values = tick_values(*self.x, at)
            at = {float(v): f"{v:g}{unit if v == values[-1] else ''}" for v in values}
        return [
            f'<text x="{self.across(value):.1f}" y="{y}" text-anchor="middle">{escape(text)}</text>'
            for value, text in at.items()
        ]

    @property
    def cursor(self) -> str:
        """The vertical line that the scripts move."""
        left, _, top, bottom = self.margins
        return f'<line class="cursor" x1="{left}" x2="{left}" y1="{top}" y2="{self.height - bottom}"/>'


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
    dash: str = ""
    """SVG stroke-dasharray."""


@dataclass(frozen=True)
class Chart:
    """Curves of one unit over the frames."""

    title: str
    unit: str
    curves: tuple[Curve, ...]
    about: str
    """What it shows, in a sentence."""
    top: float | None = None
    """Smallest upper end of the vertical axis, such as 100 for percentages."""


def curves_section(
    title: str,
    charts: tuple[Chart, ...],
    abscissa: Array,
    timed: bool,
    unseen: NDArray[np.bool_] | None = None,
    note: str = "",
) -> Section:
    """Charts over `abscissa` (n,), seconds when `timed`, else frame numbers; all start at zero.

    Frames with `unseen` (n,) have a grey background. A cursor follows the video, legends show the values there.
    """
    x = np.asarray(abscissa, float)
    axes = [Axes(*CHART_SIZE, CHART_MARGINS, x_range(x), (0.0, _upper_end(chart))) for chart in charts]
    under = unseen_boxes(axes[0], x, ~unseen) if unseen is not None else []
    figures = "".join(
        line_figure(on, x, chart.curves, chart.title, chart.unit, " s" * timed, (5, 3), under, chart.about)
        for chart, on in zip(charts, axes, strict=True)
    )
    data = curves_data(axes[0], x, [chart.curves for chart in charts])
    return Section(title, f'<div class="charts">{figures}</div>', "curves", data, "full", note)


def state_section(
    joint_type: JointType,
    abscissa: Array,
    timed: bool,
    estimate: Array | None = None,
    std: Array | None = None,
    seen: NDArray[np.bool_] | None = None,
    truth: Array | None = None,
) -> Section:
    """The joint state over the video.

    Args:
        joint_type: 'revolute' or 'prismatic'.
        abscissa: (n,) seconds when `timed`, else frame numbers.
        timed: Whether `abscissa` is a time.
        estimate: (n,) rad or m.
        std: (n,) its standard deviations; NaN where unknown.
        seen: (n,) False in frames in which the moving part was not measured: these are grey.
        truth: (n,) rad or m, with the sign and the zero of `estimate` when there is one.
    """
    unit, factor = display_unit(joint_type)
    x, curves = np.asarray(abscissa, float), []
    if truth is not None:
        curves.append(Curve("ground truth", TRUTH, factor * truth, "wide" if estimate is not None else ""))
    if estimate is not None:
        band = None if std is None or not np.isfinite(std).any() else 2 * factor * std
        curves.append(Curve("estimate" + ", ± 2 std" * (band is not None), MOVING, factor * estimate, "", band))
    extent = [c.values + side * (0 if c.half_width is None else c.half_width) for c in curves for side in (-1, 1)]
    axes = Axes(*STATE_SIZE, STATE_MARGINS, x_range(x), _padded_range(extent))
    name = f"Joint state, {'degrees' if unit == '°' else unit}"
    under = unseen_boxes(axes, x, seen) if seen is not None else []
    html = line_figure(axes, x, curves, "", name, " s" if timed else "", (6, 5), under)
    note = "Grey: the moving part was not measured." if under else ""
    return Section(
        name, f'<div class="charts wide">{html}</div>', "curves", curves_data(axes, x, [curves]), "left", note
    )


def line_figure(
    axes: Axes,
    x: Array,
    curves: Sequence[Curve],
    title: str,
    unit: str,
    x_unit: str,
    ticks: tuple[int, int] = (6, 4),
    under: Sequence[str] = (),
    about: str = "",
    entry: str = "<li>{}</li>",
) -> str:
    """A figure of curves over `x` (n,) with a legend, for sections of kind 'curves' with `curves_data`.

    Args:
        axes: Where values lie.
        x: Abscissa of all curves.
        curves: Drawn in this order.
        title: Caption; none when empty.
        unit: Unit of the curves.
        x_unit: Follows the last tick label.
        ticks: About how many tick labels x and y have.
        under: SVG below the curves.
        about: Tooltip of the caption.
        entry: HTML of a legend entry, with a place for its content.
    """
    drawn = "".join(map("<g>{}</g>".format, (_curve_svg(axes, x, curve) for curve in curves)))
    names = "".join(
        entry.format(f'{_legend_line(curve)}<span class="who">{escape(curve.name)}</span> <output></output>')
        for curve in curves
    )
    tip = f' title="{escape(about)}"' if about else ""
    caption = f"<figcaption{tip}><b>{escape(title)}</b>, {escape(unit)}</figcaption>" if title else ""
    inside = "".join([*under, *axes.grid(ticks[1]), *axes.marks(ticks[0], x_unit), drawn, axes.cursor])
    return (
        f'<figure>{caption}<svg viewBox="0 0 {axes.width} {axes.height}" role="img" tabindex="0" '
        f'aria-label="{escape(title or unit)} over time; left and right arrows step">{inside}</svg>'
        f'<ul class="legend">{names}</ul></figure>'
    )


def curves_data(
    axes: Axes, x: Array, curves: Sequence[Sequence[Curve]], frames: NDArray[np.int64] | None = None
) -> dict[str, Any]:
    """Input of the script of kind 'curves' for figures over the same `x` (n,).

    `frames` (n,) are the frames of the video at these places; 0 to n - 1 when not given.
    """
    values = [[_rounded(curve.values) for curve in chart] for chart in curves]
    data = {"x": np.round(axes.across(x), 2), "width": axes.width, "charts": values}
    return data if frames is None else {**data, "frames": frames}


def display_unit(joint_type: str) -> tuple[str, float]:
    """The unit in which people read joint states, and its size in rad or m inverted: degrees, or centimetres."""
    return ("°", 180 / np.pi) if joint_type == "revolute" else ("cm", 100.0)


def x_range(x: Array) -> tuple[float, float]:
    """Ends of an axis over `x` (n,)."""
    return float(x[0]), float(max(x[-1], x[0] + 1e-9))


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


def unseen_boxes(axes: Axes, x: Array, seen: NDArray[np.bool_]) -> list[str]:
    """Grey boxes over the places of `x` (n,) that were not measured, half a frame to either side."""
    across, (_, _, top, bottom) = axes.across(x), axes.margins
    height = axes.height - top - bottom
    edges = np.concatenate([across[:1], (across[1:] + across[:-1]) / 2, across[-1:]])
    boxes = [(float(edges[run[0]]), float(edges[run[-1] + 1])) for run in true_runs(~np.asarray(seen, bool))]
    return [
        f'<rect class="unseen" x="{left:.1f}" width="{right - left:.1f}" y="{top}" height="{height}"/>'
        for left, right in boxes
    ]


def path_data(x: Array, y: Array) -> str:
    """An SVG path through points; a single one becomes a dot."""
    points = "L".join(f"{a:.1f} {b:.1f}" for a, b in zip(x, y, strict=True))
    return f"M{points}{'h0' if len(x) == 1 else ''}"


def _curve_svg(axes: Axes, x: Array, curve: Curve) -> str:
    parts = []
    if curve.half_width is not None:
        low, high = axes.down(curve.values - curve.half_width), axes.down(curve.values + curve.half_width)
        for run in true_runs(np.isfinite(low)):
            if len(run) > 1:
                there, back = path_data(axes.across(x[run]), low[run]), path_data(axes.across(x[run]), high[run])
                turned = "L".join(back[1:].split("L")[::-1])
                parts.append(f'<path class="band" fill="{curve.colour}" d="{there}L{turned}Z"/>')
    for run in true_runs(np.isfinite(curve.values)):
        points = path_data(axes.across(x[run]), axes.down(curve.values[run]))
        parts.append(f'<path{_look(curve)} stroke="{curve.colour}" d="{points}"/>')
    return "".join(parts)


def _legend_line(curve: Curve) -> str:
    line = f'<path{_look(curve)} stroke="{curve.colour}" d="M1 4h20"/>'
    return f'<svg class="dash" viewBox="0 0 22 8" aria-hidden="true">{line}</svg>'


def _look(curve: Curve) -> str:
    return f' class="{curve.style}"' * bool(curve.style) + f' stroke-dasharray="{curve.dash}"' * bool(curve.dash)


def _padded_range(curves: list[Array]) -> tuple[float, float]:
    values = np.concatenate(curves) if curves else np.zeros(1)
    values = values[np.isfinite(values)]
    low, high = (float(values.min()), float(values.max())) if len(values) else (0.0, 1.0)
    margin = 0.06 * (high - low) or 1.0
    return low - margin, high + margin


def _upper_end(chart: Chart) -> float:
    values = np.concatenate([curve.values for curve in chart.curves])
    values = values[np.isfinite(values)]
    if not len(values):
        return chart.top or 1.0
    high = float(min(values.max(), max(MAX_MEDIANS * np.median(values), np.percentile(values, 95))))
    return 1.05 * high or 1.0 if chart.top is None else max(high, chart.top)


def _rounded(values: Array) -> list[float | None]:
    return [float(f"{v:.4g}") if np.isfinite(v) else None for v in np.asarray(values, float).tolist()]
