"""Small charts of many quantities over the frames, side by side, with one cursor in all of them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from freeart21.view.document import Section, escape
from freeart21.view.plot import Axes, path_data, runs, unseen_boxes

WIDTH, HEIGHT = 400, 150
MARGINS = 40, 6, 8, 20
TALLEST = 12.0
"""Medians that a chart is high at most: a single far outlier leaves at the top, and the rest stays readable."""


@dataclass(frozen=True)
class Curve:
    """One line of a chart."""

    name: str
    colour: str
    values: NDArray[np.float64]
    """(n,); the line is broken where NaN."""
    style: str = ""
    """Class of the line: '', 'dashed' or 'wide'."""


@dataclass(frozen=True)
class Chart:
    """Curves of one unit over the frames."""

    title: str
    unit: str
    curves: tuple[Curve, ...]
    about: str
    """What it shows, in a sentence."""
    top: float | None = None
    """What the vertical axis reaches at least, such as 100 for shares."""


def curves_section(
    title: str,
    charts: tuple[Chart, ...],
    abscissa: NDArray[np.float64],
    timed: bool,
    unseen: NDArray[np.bool_] | None = None,
    note: str = "",
) -> Section:
    """Charts over `abscissa` (n,), seconds when `timed`, else frame numbers; all start at zero.

    Frames where `unseen` (n,) lie on grey. The scripts add a cursor that follows the video, and the values there.
    """
    x = np.asarray(abscissa, float)
    axes = [Axes(WIDTH, HEIGHT, MARGINS, _ends(x), (0.0, _high(chart))) for chart in charts]
    under = (
        unseen_boxes(axes[0].across(x), ~unseen, MARGINS[2], HEIGHT - sum(MARGINS[2:])) if unseen is not None else []
    )
    drawn = "".join(
        line_figure(on, x, chart.curves, chart.title, chart.unit, " s" * timed, (5, 3), under, chart.about)
        for chart, on in zip(charts, axes, strict=True)
    )
    below = f'<p class="note">{escape(note)}</p>' if note else ""
    data = curves_data(axes[0], x, [chart.curves for chart in charts], [chart.unit for chart in charts])
    return Section(title, f'<div class="charts">{drawn}</div>{below}', "curves", data, "full")


def line_figure(
    axes: Axes,
    x: NDArray[np.float64],
    curves: Sequence[Curve],
    title: str,
    unit: str,
    x_unit: str,
    ticks: tuple[int, int] = (6, 4),
    under: Sequence[str] = (),
    about: str = "",
) -> str:
    """A figure of curves over `x` (n,), with a legend; what is `under` them is SVG.

    It fits the script of kind 'curves' and `curves_data`: a cursor, and a place for the value there after every name.
    """
    lines = "".join(
        f'<path{_class(curve)} stroke="{curve.colour}" '
        f'd="{path_data(axes.across(x[run]), axes.down(curve.values[run]))}"/>'
        for curve in curves
        for run in runs(np.isfinite(curve.values))
    )
    names = "".join(
        f'<li><i{_class(curve) * (curve.style == "dashed")} style="color:{curve.colour}"></i>{escape(curve.name)} '
        "<output></output></li>"
        for curve in curves
    )
    drawn = "".join([*under, *axes.grid(ticks[1]), *axes.marks(ticks[0], x_unit), lines, axes.cursor])
    tip = f' title="{escape(about)}"' if about else ""
    return (
        f"<figure><figcaption{tip}><b>{escape(title)}</b>, {escape(unit)}</figcaption>"
        f'<svg viewBox="0 0 {axes.width} {axes.height}" role="img" aria-label="{escape(title)} over time">{drawn}</svg>'
        f'<ul class="legend">{names}</ul></figure>'
    )


def curves_data(
    axes: Axes, x: NDArray[np.float64], curves: Sequence[Sequence[Curve]], units: Sequence[str]
) -> dict[str, Any]:
    """What the script of kind 'curves' needs of `line_figure`s over the same `x` (n,)."""
    values = [[_rounded(curve.values) for curve in chart] for chart in curves]
    return {"x": np.round(axes.across(x), 2), "width": axes.width, "charts": values, "units": list(units)}


def _class(curve: Curve) -> str:
    return f' class="{curve.style}"' if curve.style else ""


def _ends(x: NDArray[np.float64]) -> tuple[float, float]:
    return float(x[0]), float(max(x[-1], x[0] + 1e-9))


def _high(chart: Chart) -> float:
    """The upper end of a chart's axis."""
    values = np.concatenate([curve.values for curve in chart.curves])
    values = values[np.isfinite(values)]
    if not len(values):
        return chart.top or 1.0
    high = float(min(values.max(), max(TALLEST * np.median(values), np.percentile(values, 95))))
    return 1.05 * high or 1.0 if chart.top is None else max(high, chart.top)


def _rounded(values: NDArray[np.float64]) -> list[float | None]:
    return [float(f"{v:.4g}") if np.isfinite(v) else None for v in np.asarray(values, float).tolist()]
