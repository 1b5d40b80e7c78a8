"""The joint state over time as a drawing: prediction with its band, truth, and where the moving part was not seen."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from freeart21.joint import JointType
from freeart21.view.document import MOVING, TRUTH, Section, escape


@dataclass(frozen=True)
class Axes:
    """Where values lie in a drawing, pixels from its upper left corner, and the lines and numbers of its axes."""

    width: int
    height: int
    margins: tuple[int, int, int, int]
    """Left, right, top and bottom."""
    x: tuple[float, float]
    """Values at the left and the right end."""
    y: tuple[float, float]
    """Values at the bottom and the top."""

    def across(self, value: NDArray[np.float64] | float) -> NDArray[np.float64]:
        """From the left."""
        left, right, _, _ = self.margins
        share = (np.asarray(value, float) - self.x[0]) / max(self.x[1] - self.x[0], 1e-9)
        return np.asarray(left + share * (self.width - left - right))

    def down(self, value: NDArray[np.float64] | float) -> NDArray[np.float64]:
        """From the top; what lies above the axes is drawn at their top."""
        _, _, top, bottom = self.margins
        share = (self.y[1] - np.minimum(np.asarray(value, float), self.y[1])) / (self.y[1] - self.y[0])
        return np.asarray(top + share * (self.height - top - bottom))

    def grid(self, about: int) -> list[str]:
        """Some `about` lines with their values at the left."""
        left, right, _, _ = self.margins
        return [
            f'<line class="grid" x1="{left}" x2="{self.width - right}" y1="{y:.1f}" y2="{y:.1f}"/>'
            f'<text x="{left - 6}" y="{y + 4:.1f}" text-anchor="end">{value:g}</text>'
            for value in ticks(*self.y, about)
            for y in [float(self.down(value))]
        ]

    def marks(self, about: int, unit: str = "") -> list[str]:
        """Some `about` values below, the last one with the unit behind it."""
        at, y = ticks(*self.x, about), self.height - self.margins[3] + 16
        return [
            f'<text x="{self.across(t):.1f}" y="{y}" text-anchor="middle">'
            f"{t:g}{escape(unit) if t == at[-1] else ''}</text>"
            for t in at
        ]

    @property
    def cursor(self) -> str:
        """The line that the scripts move."""
        left, _, top, bottom = self.margins
        return f'<line class="cursor" x1="{left}" x2="{left}" y1="{top}" y2="{self.height - bottom}"/>'


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
    axes = Axes(720, 260, (52, 10, 12, 40), (float(x[0]), float(max(x[-1], x[0] + 1e-9))), (low, high))
    across, down = axes.across, axes.down
    parts = [f'<svg viewBox="0 0 {axes.width} {axes.height}" role="img" aria-label="joint state over time">']
    if series.seen is not None:
        parts += unseen_boxes(across(x), series.seen, 12, 208)
    parts += [*axes.grid(5), *axes.marks(8)]
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
        f'<text x="{axes.width - 10}" y="{axes.height - 3}" text-anchor="end">{name}</text>',
        axes.cursor,
        "</svg>",
    ]
    return Section(
        f"Joint state, {'degrees' if unit == '°' else unit}",
        f'<div class="plot">{"".join(parts)}{_legend(series, band)}</div>',
        "plot",
        {
            "x": np.round(across(x), 2),
            "width": axes.width,
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
