"""Small charts of many quantities over the frames, side by side, with one cursor in all of them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from freeart21.view.document import Section, escape
from freeart21.view.plot import path_data, runs, ticks, unseen_boxes

WIDTH, HEIGHT = 400, 150
LEFT, RIGHT, TOP, BOTTOM = 40, 6, 8, 20
TALLEST = 12.0
"""Medians that a chart is high at most: a single far outlier leaves at the top, and the rest stays readable."""


@dataclass(frozen=True)
class Curve:
    """One line of a chart."""

    name: str
    colour: str
    values: NDArray[np.float64]
    """(n,); the line is broken where NaN."""
    dashed: bool = False


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
    across = LEFT + (x - x[0]) / max(float(x[-1] - x[0]), 1e-9) * (WIDTH - LEFT - RIGHT)
    under = unseen_boxes(across, ~unseen, TOP, HEIGHT - TOP - BOTTOM) if unseen is not None else []
    drawn = "".join(_figure(chart, x, across, timed, under) for chart in charts)
    below = f'<p class="note">{escape(note)}</p>' if note else ""
    return Section(
        title,
        f'<div class="charts">{drawn}</div>{below}',
        "curves",
        {
            "x": np.round(across, 2),
            "width": WIDTH,
            "charts": [[_rounded(curve.values) for curve in chart.curves] for chart in charts],
            "units": [chart.unit for chart in charts],
        },
        "full",
    )


def _figure(chart: Chart, x: NDArray[np.float64], across: NDArray[np.float64], timed: bool, under: list[str]) -> str:
    values = np.concatenate([curve.values for curve in chart.curves])
    high = _high(values[np.isfinite(values)], chart.top)

    def down(value: NDArray[np.float64] | float) -> NDArray[np.float64]:
        return TOP + (1 - np.minimum(np.asarray(value), high) / high) * (HEIGHT - TOP - BOTTOM)

    parts = [f'<svg viewBox="0 0 {WIDTH} {HEIGHT}" role="img" aria-label="{escape(chart.title)} over time">', *under]
    for y in ticks(0.0, high, 3):
        parts.append(
            f'<line class="grid" x1="{LEFT}" x2="{WIDTH - RIGHT}" y1="{down(y):.1f}" y2="{down(y):.1f}"/>'
            f'<text x="{LEFT - 5}" y="{down(y) + 4:.1f}" text-anchor="end">{y:g}</text>'
        )
    begin, end = float(x[0]), float(max(x[-1], x[0] + 1e-9))
    for t in ticks(begin, end, 5):
        at = LEFT + (t - begin) / (end - begin) * (WIDTH - LEFT - RIGHT)
        label = f"{t:g}{' s' if timed and t == ticks(begin, end, 5)[-1] else ''}"
        parts.append(f'<text x="{at:.1f}" y="{HEIGHT - 5}" text-anchor="middle">{label}</text>')
    for curve in chart.curves:
        dashes = ' class="dashed"' if curve.dashed else ""
        for run in runs(np.isfinite(curve.values)):
            line = path_data(across[run], down(curve.values[run]))
            parts.append(f'<path{dashes} stroke="{curve.colour}" d="{line}"/>')
    parts += [f'<line class="cursor" x1="{LEFT}" x2="{LEFT}" y1="{TOP}" y2="{HEIGHT - BOTTOM}"/>', "</svg>"]
    legend = "".join(
        f'<li><i{" class=dashed" if curve.dashed else ""} style="color:{curve.colour}"></i>{escape(curve.name)} '
        f"<output></output></li>"
        for curve in chart.curves
    )
    return (
        f'<figure><figcaption title="{escape(chart.about)}"><b>{escape(chart.title)}</b>, {escape(chart.unit)}'
        f'</figcaption>{"".join(parts)}<ul class="legend">{legend}</ul></figure>'
    )


def _high(values: NDArray[np.float64], top: float | None) -> float:
    if not len(values):
        return top or 1.0
    high = float(min(values.max(), max(TALLEST * np.median(values), np.percentile(values, 95))))
    return 1.05 * high or 1.0 if top is None else max(high, top)


def _rounded(values: NDArray[np.float64]) -> list[float | None]:
    return [float(f"{v:.4g}") if np.isfinite(v) else None for v in np.asarray(values, float).tolist()]
