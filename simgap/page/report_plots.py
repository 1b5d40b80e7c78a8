"""SVG drawings of the gap page: a replayed run, a map of missing force, an interval."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from freeart21.joint import JointType
from freeart21.se3 import Array
from freeart21.view.document import MOVING, REFERENCE, escape
from freeart21.view.plots import Axes, Curve, curves_data, display_unit, line_figure, tick_values
from simgap.models.localise import ResidualMap
from simgap.prove.comparison import ReplayGap
from simgap.verdict import Quantity, unit_of

MEASURED, BEFORE, AFTER = "#7d8894", MOVING, REFERENCE
"""Grey for the measurement, orange for the asset as given, blue for the repaired one."""
_MOST_POINTS = 600
_MARGINS = 50, 8, 8, 22


def drawn_samples(n: int, most: int = _MOST_POINTS) -> Array:
    """Indices of at most `most` of `n` samples, evenly spaced."""
    return np.unique(np.linspace(0, n - 1, min(most, n)).astype(int))


def _axes(x: tuple[float, float], values: Array, reach: float, margin: float, height: int, width: int = 560) -> Axes:
    """Axes with room for values, and for `reach` on both sides of zero."""
    values = values[np.isfinite(values)]
    low, high = (float(values.min()), float(values.max())) if len(values) else (0.0, 1.0)
    low, high = (min(low, -reach), max(high, reach)) if reach else (low, high)
    room = margin * (high - low) or 1.0
    return Axes(width, height, _MARGINS, x, (low - room, high + room))


def chart(x: Array, lines: Sequence[Curve], title: str, unit: str, *, band: float = 0.0, height: int = 190) -> str:
    """A figure of lines over seconds `x` (n,); `band` is a grey band about zero."""
    axes = run_axes(x, lines, band, height)
    left, right, _, _ = _MARGINS
    top, bottom = float(axes.down(band)), float(axes.down(-band))
    grey = (
        f'<rect class="unseen" x="{left}" width="{axes.width - left - right}" y="{top:.1f}" '
        f'height="{bottom - top:.1f}"/>'
    )
    return line_figure(axes, x, lines, title, unit, " s", under=[grey] if band else [])


def run_axes(x: Array, lines: Sequence[Curve], band: float, height: int) -> Axes:
    """The axes of `chart`."""
    ends = float(x[0]), float(max(x[-1], x[0] + 1e-9))
    return _axes(ends, np.concatenate([line.values for line in lines]), band, 0.07, height)


def run_drawings(
    run: ReplayGap,
    kind: JointType,
    names: tuple[str, str | None] = ("as the asset was", "after"),
    by: Quantity = "position",
) -> tuple[list[str], dict[str, Any]]:
    """Figures of one replayed run, position (or force) and difference, and the data for the script of kind 'curves'.

    `names` are those of the two simulations; without the second only the first is drawn.
    """
    unit, factor = display_unit(kind) if by == "position" else (unit_of(by, kind).replace("*", " "), 1.0)
    kept = drawn_samples(len(run.times_s))
    x, measured = run.times_s[kept] - run.times_s[0], factor * run.measured[kept]
    position, difference = [Curve("measured", MEASURED, measured, "wide")], []
    for name, colour, values, style in zip(names, (BEFORE, AFTER), run.curves, ("dashed", ""), strict=True):
        if name is not None:
            simulated = factor * values[kept]
            position.append(Curve(f"simulated {name}", colour, simulated, style))
            difference.append(Curve(f"{name}, less measured", colour, simulated - measured, style))
    figures = [
        chart(x, position, by.capitalize(), unit),
        chart(x, difference, "Difference", f"{unit}; grey: noise, ± 2 sigma", band=2 * factor * run.floor, height=150),
    ]
    return figures, curves_data(run_axes(x, position, 0.0, 190), x, (position, difference))


def force_map(m: ResidualMap, kind: JointType) -> str:
    """A map of the missing force."""
    unit, factor = ("s", 1.0) if m.quantity == "time" else display_unit(kind)
    unit += "/s" * (m.quantity == "velocity")
    small = 0 < float(np.nanmax(np.abs(m.mean), initial=0.0)) < 0.1
    force_factor, force_unit = 1e3 if small else 1.0, "m" * small + ("N m" if kind == "revolute" else "N")
    how = "towards larger positions" if m.signed else "along the motion; negative brakes"
    rest = ", besides smooth friction and springs" if m.local_only else ""
    title = _TITLES.get(m.quantity, m.quantity.capitalize())
    return map_drawing(m, title, f"{force_unit} {how}{rest}", factor, unit, force_factor)


def map_drawing(m: ResidualMap, title: str, what: str, factor: float, unit: str, force_factor: float = 1.0) -> str:
    """A map as bars with standard errors, flagged bins coloured. `factor` converts edges to `unit`, `force_factor`
    means."""
    mean, spread = force_factor * m.mean, force_factor * m.spread
    reach = np.nan_to_num(np.minimum(spread, np.nanmax(np.abs(mean), initial=0.0)))
    edges = np.arange(len(mean) + 1.0) if m.labels else factor * m.edges
    edges = np.linspace(edges[0], edges[-1], len(mean) + 1)
    axes = _axes((edges[0], edges[-1]), np.array([0.0, *(mean - reach), *(mean + reach)]), 0.0, 0.08, 150, 330)
    ends, zero, (left, right, top, bottom) = axes.across(edges), float(axes.down(0.0)), _MARGINS
    parts = [
        f'<rect class="flagged" x="{a:.1f}" width="{b - a:.1f}" y="{top}" height="{axes.height - top - bottom}"/>'
        for a, b, flag in zip(ends[:-1], ends[1:], m.flagged, strict=True)
        if flag
    ]
    parts += axes.grid(4)
    parts.append(f'<line class="zero" x1="{left}" x2="{axes.width - right}" y1="{zero:.1f}" y2="{zero:.1f}"/>')
    for i in np.flatnonzero(np.isfinite(mean)):
        a, b, tip = ends[i] + 1.5, ends[i + 1] - 1.5, float(axes.down(mean[i]))
        low, high = axes.down(mean[i] + reach[i] * np.array([-1.0, 1.0]))
        parts.append(
            f'<rect class="{"significant" if m.flagged[i] else "mean"}" x="{a:.1f}" width="{b - a:.1f}" '
            f'y="{min(tip, zero):.1f}" height="{max(abs(tip - zero), 0.8):.1f}"/><line class="error" '
            f'x1="{(a + b) / 2:.1f}" x2="{(a + b) / 2:.1f}" y1="{low:.1f}" y2="{high:.1f}"/>'
        )
    if m.labels:
        middles, every = 0.5 * (ends[1:] + ends[:-1]), -(-len(m.labels) // 4)
        named = [(x, str(label)[:14]) for x, label in zip(middles, m.labels, strict=True)][::every]
    else:
        at = tick_values(edges[0], edges[-1], 5)
        sign = unit if unit == "°" else f" {unit}"
        named = [(float(axes.across(t)), f"{t:g}{sign if t == at[-1] else ''}"[:14]) for t in at]
    parts += [
        f'<text x="{x:.1f}" y="{axes.height - 6}" '
        f'text-anchor="{"end" if x > ends[-1] - 25 and not m.labels else "middle"}">{escape(label)}</text>'
        for x, label in named
    ]
    return (
        f"<figure><figcaption><b>{escape(title)}</b>, p = {p_text(m.p_value)}<br>{escape(what)}</figcaption>"
        f'<svg viewBox="0 0 {axes.width} {axes.height}" role="img" aria-label="{escape(title)}">{"".join(parts)}</svg>'
        "</figure>"
    )


def interval_drawing(value: float, low: float, high: float, width: int = 190) -> str:
    """A value and its interval on a line that includes zero."""
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
    """A p-value as text."""
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
