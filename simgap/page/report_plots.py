"""Drawings of the gap page: replayed runs, and maps of missing force."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from freeart21.joint import JointType
from freeart21.se3 import Array
from freeart21.view.document import MOVING, REFERENCE, Markup, Section
from freeart21.view.plots import Chart, Curve, curves_section, display_unit, figure, padded_range
from simgap.models.localise import ResidualMap
from simgap.prove.comparison import ReplayGap
from simgap.verdict import Quantity, unit_of

MEASURED, BEFORE, AFTER = "#7d8894", MOVING, REFERENCE
"""Grey for the measurement, orange for the asset as given, blue for the repaired one."""
_MOST_POINTS = 600


def drawn_samples(n: int, most: int = _MOST_POINTS) -> Array:
    """Indices of at most `most` of `n` samples, evenly spaced."""
    return np.unique(np.linspace(0, n - 1, min(most, n)).astype(int))


def chart(lines: Sequence[Curve], title: str, unit: str, height: int = 190) -> Chart:
    """A chart with room for all lines."""
    return Chart(title, unit, lines, y=padded_range([line.values for line in lines]), height=height)


def run_section(
    title: str, run: ReplayGap, kind: JointType, names: tuple[str, str | None], by: Quantity = "position"
) -> Section:
    """Position (or force) of one replayed run over time, and the difference.

    `names` are those of the two simulations; without the second only the first is drawn.
    """
    unit, factor = display_unit(kind) if by == "position" else (unit_of(by, kind).replace("*", " "), 1.0)
    drawn = drawn_samples(len(run.times_s))
    x, measured = run.times_s[drawn] - run.times_s[0], factor * run.measured[drawn]
    position, difference = [Curve("measured", MEASURED, measured, "wide")], []
    for name, colour, values, style in zip(names, (BEFORE, AFTER), run.curves, ("dashed", ""), strict=True):
        if name is not None:
            simulated = factor * values[drawn]
            position.append(Curve(f"simulated {name}", colour, simulated, style))
            difference.append(Curve(f"{name}, less measured", colour, simulated - measured, style))
    noise = 2 * factor * run.floor
    ends = padded_range([np.array([-noise, noise]), *(line.values for line in difference)])
    boxes = [("unseen", x[0], x[-1], -noise, noise)]
    off = Chart("Difference", f"{unit}; grey: noise, ± 2 sigma", difference, y=ends, boxes=boxes, height=150)
    return curves_section(title, [chart(position, by.capitalize(), unit), off], x)


def force_map(m: ResidualMap, kind: JointType) -> Markup:
    """A map of the missing force."""
    unit, factor = ("s", 1.0) if m.quantity == "time" else display_unit(kind)
    unit += "/s" * (m.quantity == "velocity")
    small = 0 < float(np.nanmax(np.abs(m.mean), initial=0.0)) < 0.1
    force_factor, force_unit = 1e3 if small else 1.0, "m" * small + ("N m" if kind == "revolute" else "N")
    how = "towards larger positions" if m.signed else "along the motion; negative brakes"
    rest = ", besides smooth friction and springs" if m.local_only else ""
    return map_drawing(m, f"Over {m.quantity}", f"{force_unit} {how}{rest}", factor, unit, force_factor)


def map_drawing(m: ResidualMap, title: str, what: str, factor: float, unit: str, force_factor: float = 1.0) -> Markup:
    """A map as bars with standard errors, flagged bins coloured.

    `factor` converts edges to `unit`, `force_factor` means.
    """
    mean, spread = force_factor * m.mean, force_factor * m.spread
    reach = np.nan_to_num(np.minimum(spread, np.nanmax(np.abs(mean), initial=0.0)))
    edges = np.arange(len(mean) + 1.0) if m.labels else factor * m.edges
    edges = np.linspace(edges[0], edges[-1], len(mean) + 1)
    ends = padded_range([np.zeros(1), mean - reach, mean + reach], 0.08)
    step = edges[1] - edges[0]
    thin = 0.003 * (edges[-1] - edges[0])
    boxes = [("flagged", a, a + step, -np.inf, np.inf) for a, flag in zip(edges[:-1], m.flagged, strict=True) if flag]
    boxes.append(("error", edges[0], edges[-1], 0.0, 0.0))
    for i in np.flatnonzero(np.isfinite(mean)):
        a, middle = edges[i] + 0.06 * step, edges[i] + 0.5 * step
        look, (low, high) = "significant" if m.flagged[i] else "mean", sorted((0.0, mean[i]))
        boxes.append((look, a, a + 0.88 * step, low, high))
        boxes.append(("error", middle - thin, middle + thin, mean[i] - reach[i], mean[i] + reach[i]))
    labels = None
    if m.labels:
        every = -(-len(m.labels) // 4)
        labels = {float(edges[k] + 0.5 * step): str(m.labels[k])[:14] for k in range(0, len(m.labels), every)}
    sign = unit if unit == "°" else f" {unit}"
    drawn = Chart(f"{title}, p = {p_text(m.p_value)}", what, (), y=ends, boxes=boxes, width=330, height=150)
    return figure(drawn, edges, sign, legend=False, x_labels=labels)


def p_text(p: float) -> str:
    """A p-value as text."""
    return f"{p:.1g}" if p >= 1e-4 else "below 0.0001"
