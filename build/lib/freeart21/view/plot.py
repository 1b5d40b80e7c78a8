"""The joint state over time as a drawing: prediction with its band, truth, and where the moving part was not seen."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from freeart21.joint import JointType
from freeart21.view.document import MOVING, TRUTH, Section

WIDTH, HEIGHT = 720, 260
LEFT, RIGHT, TOP, BOTTOM = 52, 10, 12, 40


@dataclass(frozen=True)
class StateSeries:
    """What is plotted, (n,) each, rad or m."""

    type: JointType
    frames_or_times: NDArray[np.float64]
    """Abscissa: seconds when `timed`, else frame numbers."""
    timed: bool
    found: NDArray[np.float64] | None = None
    std: NDArray[np.float64] | None = None
    """Standard deviations of `found`; NaN where unknown."""
    seen: NDArray[np.bool_] | None = None
    """False where the moving part was not measured."""
    truth: NDArray[np.float64] | None = None
    """As the prediction counts it, or as it is when there is no prediction."""


def display_unit(joint_type: str) -> tuple[str, float]:
    """What a state is told in, and by how much rad or m are multiplied for it: degrees, or centimetres."""
    return ("°", 180 / np.pi) if joint_type == "revolute" else ("cm", 100.0)


def plot_section(series: StateSeries) -> Section:
    """The state plot. The scripts add a cursor that follows the video, and a click that moves it."""
    unit, factor = display_unit(series.type)
    x = np.asarray(series.frames_or_times, float)
    curves = [factor * values for values in (series.found, series.truth) if values is not None]
    band = _band(series, factor)
    low, high = _range([*curves, *(band or ())])
    x_low, x_high = float(x[0]), float(max(x[-1], x[0] + 1e-9))

    def across(value: NDArray[np.float64] | float) -> NDArray[np.float64]:
        return LEFT + (np.asarray(value) - x_low) / (x_high - x_low) * (WIDTH - LEFT - RIGHT)

    def down(value: NDArray | float) -> NDArray[np.float64]:
        return TOP + (high - np.asarray(value)) / (high - low) * (HEIGHT - TOP - BOTTOM)

    parts = [f'<svg viewBox="0 0 {WIDTH} {HEIGHT}" role="img" aria-label="joint state over time">']
    if series.seen is not None:
        parts += unseen_boxes(across(x), series.seen, TOP, HEIGHT - TOP - BOTTOM)
    for y in ticks(low, high, 5):
        parts.append(
            f'<line class="grid" x1="{LEFT}" x2="{WIDTH - RIGHT}" y1="{down(y):.1f}" y2="{down(y):.1f}"/>'
            f'<text x="{LEFT - 7}" y="{down(y) + 4:.1f}" text-anchor="end">{y:g}</text>'
        )
    for t in ticks(x_low, x_high, 8):
        parts.append(f'<text x="{across(t):.1f}" y="{HEIGHT - BOTTOM + 18}" text-anchor="middle">{t:g}</text>')
    if band is not None:
        parts += [
            f'<path class="band" d="{_area(across(x[run]), down(band[0][run]), down(band[1][run]))}"/>'
            for run in runs(np.isfinite(band[0]))
            if len(run) > 1
        ]
    if series.truth is not None:
        points = _points(across(x), down(factor * series.truth))
        parts.append(
            f'<polyline class="{"truth" if series.found is not None else "found"}" stroke="{TRUTH}" points="{points}"/>'
        )
    if series.found is not None:
        points = _points(across(x), down(factor * series.found))
        parts.append(f'<polyline class="found" stroke="{MOVING}" points="{points}"/>')
    name = "time, s" if series.timed else "frame"
    parts += [
        f'<text x="{WIDTH - RIGHT}" y="{HEIGHT - 3}" text-anchor="end">{name}</text>',
        f'<line class="cursor" x1="{LEFT}" x2="{LEFT}" y1="{TOP}" y2="{HEIGHT - BOTTOM}"/>',
        "</svg>",
    ]
    return Section(
        f"Joint state, {'degrees' if unit == '°' else unit}",
        f'<div class="plot">{"".join(parts)}{_legend(series, band)}</div>',
        "plot",
        {
            "x": np.round(across(x), 2),
            "width": WIDTH,
            "found": _rounded(series.found),
            "truth": _rounded(series.truth),
            "type": series.type,
        },
        "left",
    )


def _band(series: StateSeries, factor: float) -> tuple[NDArray[np.float64], NDArray[np.float64]] | None:
    if series.found is None or series.std is None or not np.isfinite(series.std).any():
        return None
    return factor * (series.found - 2 * series.std), factor * (series.found + 2 * series.std)


def _range(curves: list[NDArray[np.float64]]) -> tuple[float, float]:
    values = np.concatenate(curves) if curves else np.zeros(1)
    values = values[np.isfinite(values)]
    low, high = (float(values.min()), float(values.max())) if len(values) else (0.0, 1.0)
    margin = 0.06 * (high - low) or 1.0
    return low - margin, high + margin


def ticks(low: float, high: float, about: int) -> NDArray[np.float64]:
    """Round numbers between two ends: steps of 1, 2 or 5 times a power of ten."""
    raw = (high - low) / about
    power = 10.0 ** np.floor(np.log10(raw))
    step = power * min((m for m in (1, 2, 5, 10) if m * power >= raw), default=10)
    return np.round(np.arange(np.ceil(low / step), np.floor(high / step) + 1) * step, 10) + 0.0


def runs(flags: NDArray[np.bool_]) -> list[NDArray[np.int64]]:
    """Indices of every unbroken run of True."""
    index = np.flatnonzero(flags)
    return np.split(index, np.flatnonzero(np.diff(index) > 1) + 1) if len(index) else []


def unseen_boxes(across: NDArray[np.float64], seen: NDArray[np.bool_], top: float, height: float) -> list[str]:
    """Grey boxes over the frames that were not measured, half a frame to either side; `across` (n,) in the drawing."""
    edges = np.concatenate([across[:1], (across[1:] + across[:-1]) / 2, across[-1:]])
    boxes = [(float(edges[run[0]]), float(edges[run[-1] + 1])) for run in runs(~np.asarray(seen, bool))]
    return [
        f'<rect class="unseen" x="{left:.1f}" width="{right - left:.1f}" y="{top}" height="{height}"/>'
        for left, right in boxes
    ]


def path_data(x: NDArray[np.float64], y: NDArray[np.float64]) -> str:
    """An SVG path through points; a single one becomes a dot."""
    points = "L".join(f"{a:.1f} {b:.1f}" for a, b in zip(x, y, strict=True))
    return f"M{points}{'h0' if len(x) == 1 else ''}"


def _points(x: NDArray[np.float64], y: NDArray[np.float64]) -> str:
    return " ".join(f"{a:.1f},{b:.1f}" for a, b in zip(x, y, strict=True) if np.isfinite(b))


def _area(x: NDArray[np.float64], low: NDArray[np.float64], high: NDArray[np.float64]) -> str:
    there = "L".join(f"{a:.1f} {b:.1f}" for a, b in zip(x, low, strict=True))
    back = "L".join(f"{a:.1f} {b:.1f}" for a, b in zip(x[::-1], high[::-1], strict=True))
    return f"M{there}L{back}Z"


def _legend(series: StateSeries, band: object) -> str:
    entries = []
    if series.found is not None:
        entries.append(f'<li><i style="background:{MOVING}"></i>found</li>')
    if band is not None:
        entries.append('<li><i class="band"></i>± 2 standard deviations</li>')
    if series.truth is not None:
        entries.append(f'<li><i style="background:{TRUTH}"></i>truth</li>')
    if series.seen is not None and not np.asarray(series.seen).all():
        entries.append('<li><i class="unseen"></i>moving part not measured</li>')
    return f'<ul class="legend">{"".join(entries)}</ul>'


def _rounded(values: NDArray[np.float64] | None) -> NDArray[np.float64] | None:
    return None if values is None else np.round(values, 6)
