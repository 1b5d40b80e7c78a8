"""How the sequences of a data folder move, by where their motion is from: small multiples with the same axes."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from freeart21 import sphere
from freeart21.se3 import Array
from freeart21.statistics import MotionStatistics
from freeart21.submovements import TURN_DEGREES, Movement
from freeart21.view.document import MOVING, REFERENCE, TRUTH, Section, escape

_WIDTH, _HEIGHT = 220, 112
_LEFT, _RIGHT, _TOP, _BOTTOM = 36, 18, 10, 20
_TURNS = (0.01, 40.0)
"""Degrees a frame, from the noise of motion capture to a burst."""
_RESTS = (0.1, 10.0)
_STROKE_S = 3.0
_BINS, _FEWER_BINS = 22, 8

NOTE = (
    f"Same axes in every row. A turn below {TURN_DEGREES:g}° a frame is rest (dashed). Grasped anew: the object "
    "comes to rest between two sweeps, for a second at most. Recorded motion stands under what it was taken with."
)


def motion_section(statistics: Sequence[MotionStatistics]) -> Section:
    """Every source of motion, scripted ones first, with its turns, strokes of the joint, rests and views."""
    groups: dict[tuple[bool, str], list[MotionStatistics]] = {}
    for s in statistics:
        groups.setdefault((s.recorded, s.motion_source), []).append(s)
    rows = "".join(_group(name, recorded, groups[recorded, name]) for recorded, name in sorted(groups))
    return Section("Motion, by its source", f'<div class="motions">{rows}</div><p class="note">{escape(NOTE)}</p>',
                   place="full")  # fmt: skip


def _group(name: str, recorded: bool, group: list[MotionStatistics]) -> str:
    moves = [s.movement for s in group]
    turns, frames = np.concatenate([m.degrees for m in moves]), sum(s.frames for s in group)
    minutes = max(sum(len(m.degrees) / m.fps for m in moves) / 60, 1e-9)
    kind = "recorded" if recorded else "scripted"
    many = f"{len(group)} sequence{'s' * (len(group) > 1)}, {frames} frames"
    facts = [
        ("turn a frame", f"{_percentile(turns, 50):.2f}°, most {turns.max(initial=0.0):.1f}°"),
        ("object at rest", _share([~m.pose_moves for m in moves])),
        ("joint at rest", _share([~m.joint_moves for m in moves])),
        ("grasped anew", f"{np.mean([m.regrasps_a_minute for m in moves]):.0f} a minute"),
        ("joint strokes", f"{sum(len(m.joint_submovements) for m in moves) / minutes:.0f} a minute"),
    ]
    told = "".join(f"<div><dt>{escape(label)}</dt><dd>{escape(value)}</dd></div>" for label, value in facts)
    panels = _turns(turns) + _strokes(moves) + _rests(moves, minutes) + _views(group)
    return (
        f"<article><h3>{escape(name)} <small>{kind}, {many}</small></h3><dl>{told}</dl>"
        f'<div class="panels">{panels}</div></article>'
    )


# --- panels -----------------------------------------------------------------------------------------------------------


def _turns(turns: Array) -> str:
    """Shares of the frames over how far the object turns in them, on a logarithmic axis."""
    top = 0.4
    bars = _bars(turns, _TURNS, top, len(turns), REFERENCE)
    at = _log_across(np.array([TURN_DEGREES]), _TURNS)[0]
    bars += f'<line class="rest" x1="{at:.1f}" x2="{at:.1f}" y1="{_TOP}" y2="{_HEIGHT - _BOTTOM}"/>'
    axis = _log_axis(_TURNS, {0.01: ".01", 0.1: ".1", 1: "1", 10: "10°"}) + _scale(
        ((0.0, "0"), (top, f"{top:.0%}")), top
    )
    return _panel("turn a frame, share of frames", axis + bars)


def _strokes(moves: list[Movement]) -> str:
    """A dot a stroke of the joint: how long it lasts and how much of the range it passes."""
    seconds = np.concatenate([np.diff(m.joint_submovements, axis=1)[:, 0] / m.fps for m in moves])
    ways = np.abs(np.concatenate([m.joint_ways for m in moves]))
    x = _LEFT + np.minimum(seconds / _STROKE_S, 1) * (_WIDTH - _LEFT - _RIGHT)
    y = _down(ways, 1.0)
    dots = "".join(f'<circle class="stroke" cx="{a:.1f}" cy="{b:.1f}" r="2.6"/>' for a, b in zip(x, y, strict=True))
    marks = "".join(
        f'<text x="{_LEFT + k / _STROKE_S * (_WIDTH - _LEFT - _RIGHT):.1f}" y="{_HEIGHT - 5}" text-anchor="middle">'
        f"{k}{' s' if k == _STROKE_S else ''}</text>"
        for k in range(int(_STROKE_S) + 1)
    )
    axis = _scale(((0.0, "0"), (1.0, "100%")), 1.0) + marks
    return _panel("a joint's stroke: its time, its share of the range", axis + f'<g fill="{MOVING}">{dots}</g>')


def _rests(moves: list[Movement], minutes: float) -> str:
    """Rests a minute of the object (filled) and of the joint (outlined), over how long they last."""
    top = 16.0
    axis = _log_axis(_RESTS, {0.1: ".1", 1: "1", 10: "10 s"}) + _scale(((0.0, "0"), (top, f"{top:g}")), top)
    held, still = (np.concatenate([getattr(m, name) for m in moves]) for name in ("holds_s", "joint_holds_s"))
    both = _bars(held, _RESTS, top, minutes, TRUTH, _FEWER_BINS) + _bars(
        still, _RESTS, top, minutes, MOVING, _FEWER_BINS, outline=True
    )
    return _panel("rests a minute: object filled, joint outlined", axis + both)


def _views(group: list[MotionStatistics]) -> str:
    """The cells of the sphere of views, the darker the more of the sequences saw the object from there."""
    seen = np.mean([sphere.covered_cells(s.views).any(0) for s in group], axis=0)
    cells, radius, parts = sphere.fibonacci_sphere(sphere.CELLS), 44.0, []
    for k, sign in enumerate((1.0, -1.0)):
        x0, y0 = 56 + 108 * k, 56
        parts.append(f'<circle class="half" cx="{x0}" cy="{y0}" r="{radius + 6}"/>')
        for (x, y, z), share in zip(cells, seen, strict=True):
            if sign * z >= 0:  # equal areas (Lambert), as in the cards below
                scale = radius / np.sqrt(1 + abs(z))
                at = f'cx="{x0 + sign * scale * x:.1f}" cy="{y0 - scale * y:.1f}"'
                parts.append(f'<circle class="cell" {at} r="6"/>')
                parts.append(f'<circle class="seen" {at} r="6" fill-opacity="{share:.2f}"/>')
    covered = np.mean([s.coverage for s in group])
    return _panel(f"seen from above, from below: {covered:.0%} of all views a sequence", "".join(parts))


# --- what they share --------------------------------------------------------------------------------------------------


def _panel(label: str, drawn: str) -> str:
    return (
        f'<figure><svg viewBox="0 0 {_WIDTH} {_HEIGHT}" role="img" aria-label="{escape(label)}">{drawn}</svg>'
        f"<figcaption>{escape(label)}</figcaption></figure>"
    )


def _bars(
    values: Array,
    ends: tuple[float, float],
    top: float,
    unit: float,
    colour: str,
    bins: int = _BINS,
    outline: bool = False,
) -> str:
    """A histogram on a logarithmic axis, counts divided by `unit`; what lies beyond an end counts at that end."""
    edges = np.geomspace(*ends, bins + 1)
    counts = np.histogram(np.clip(values, *ends), edges)[0] / max(unit, 1e-9)
    x, y = _log_across(edges, ends), _down(np.minimum(counts, top), top)
    bottom = _HEIGHT - _BOTTOM
    path = f"M{x[0]:.1f},{bottom}" + "".join(
        f"V{y[k]:.1f}H{x[k + 1]:.1f}" for k in range(bins)
    ) + f"V{bottom}" + ("" if outline else "Z")  # fmt: skip
    look = f'fill="none" stroke="{colour}" stroke-width="1.6"' if outline else f'fill="{colour}"'
    return f'<path {look} d="{path}"/>'


def _log_across(values: Array, ends: tuple[float, float]) -> Array:
    share = np.log(values / ends[0]) / np.log(ends[1] / ends[0])
    return np.asarray(_LEFT + share * (_WIDTH - _LEFT - _RIGHT))


def _log_axis(ends: tuple[float, float], marks: dict[float, str]) -> str:
    at = _log_across(np.array(list(marks)), ends)
    return "".join(
        f'<text x="{x:.1f}" y="{_HEIGHT - 5}" text-anchor="middle">{escape(text)}</text>'
        for x, text in zip(at, marks.values(), strict=True)
    )


def _scale(marks: tuple[tuple[float, str], ...], top: float) -> str:
    return "".join(
        f'<line class="grid" x1="{_LEFT}" x2="{_WIDTH - _RIGHT}" y1="{y:.1f}" y2="{y:.1f}"/>'
        f'<text x="{_LEFT - 4}" y="{y + 4:.1f}" text-anchor="end">{text}</text>'
        for y, text in ((float(_down(np.array(v), top)), text) for v, text in marks)
    )


def _down(values: Array, top: float) -> Array:
    return np.asarray(_TOP + (1 - np.asarray(values) / top) * (_HEIGHT - _TOP - _BOTTOM))


def _percentile(values: Array, percent: float) -> float:
    return float(np.percentile(values, percent)) if len(values) else 0.0


def _share(flags: list[NDArray[np.bool_]]) -> str:
    every = np.concatenate(flags)
    return f"{every.mean():.0%}" if len(every) else "-"
