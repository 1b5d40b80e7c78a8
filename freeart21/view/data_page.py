"""The page of a data folder: statistics of its motions, by their source and sequence by sequence."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np

from freeart21 import sphere
from freeart21.errors import FreeArtError
from freeart21.files.benchmark import read_benchmark
from freeart21.files.sequence import read_sequence
from freeart21.files.truth import read_truth
from freeart21.recording import Recording
from freeart21.se3 import Array
from freeart21.statistics import FEW, GONE_FRAMES, HARD_FRAMES, TURN_DEGREES, MotionStatistics, motion_statistics
from freeart21.view.document import MOVING, REFERENCE, TRUTH, Section, data_url, document, escape
from freeart21.view.plots import Axes
from freeart21.view.tables import column_head, row_head, table, table_section, value_cell
from freeart21.view.video import encode_jpeg, shown_frames

THUMBNAILS, THUMBNAIL_WIDTH, THUMBNAIL_QUALITY = 8, 132, 72
CURVE_SIZE, CURVE_MARGINS = (300, 74), (34, 4, 4, 14)
PANEL_SIZE, PANEL_MARGINS = (220, 112), (36, 18, 10, 20)
TURNS, TURN_BINS = (0.01, 40.0), 22
"""Degrees per frame, from the noise of motion capture to a burst."""
COLUMNS = (
    *("Sequence", "Motion", "Frames", "Median rotation, °/frame", "Largest rotation, °/frame", "Only object moves"),
    *("Only joint moves", "Both move", "Neither", "Viewpoints covered", "Joint range covered"),
    *(f"Frames below {FEW:.0%}", "Out of sight, frames", "Height filled", "Depth, m", "Inside the image", "Masks"),
)
SUMMARY_NOTE = (
    f"Hard: the moving part has less than {FEW:.0%} of the object's pixels in {HARD_FRAMES:.0%} of the frames or more. "
    f"Out of sight: no pixel of it is visible in {GONE_FRAMES} or more successive frames. Viewpoints covered: share of "
    f"{sphere.CELLS} equal cells of the sphere within {sphere.REACH_DEGREES:.0f}° of a view."
)
MOTION_NOTE = (
    f"All rows have the same axes. A rotation below {TURN_DEGREES:g}° per frame counts as rest (dashed line). "
    "Recorded motion is listed by its device."
)


def data_page(folder: Path, title: str) -> str:
    """The page of a data folder: a summary, a sortable table, and a card for every sequence.

    Sequences without their truth are named and left out. Raises FreeArtError when none has its truth.
    """
    benchmark = read_benchmark(folder)
    shown: list[tuple[MotionStatistics, str]] = []
    hidden: list[str] = []
    for name in benchmark.sequences:
        if not (benchmark.truth(name) / "truth.json").is_file():
            hidden.append(name)
            continue
        recording = read_sequence(benchmark.sequence(name))
        shown.append((motion_statistics(recording, read_truth(benchmark.truth(name))), _thumbnails(recording)))
    if not shown:
        raise FreeArtError(f"{folder} has {len(benchmark.sequences)} sequences, but the truth of none: nothing to show")
    statistics = [s for s, _ in shown]
    names = ", ".join(hidden[:5]) + " ..." * (len(hidden) > 5)
    notices = [f"{len(hidden)} sequences have no truth here and are left out: {names}"] if hidden else []
    frames = sum(s.frames for s in statistics)
    sequences = f"{len(statistics)} sequence{'s' * (len(statistics) > 1)}"
    chips = [sequences, f"{frames} frames", f"version {benchmark.version}", benchmark.split]
    sections = [
        table_section(
            f"Summary of {sequences}, {frames} frames",
            summary_rows(statistics),
            (),
            "full",
            SUMMARY_NOTE,
        ),
        motion_section(statistics),
        _sequence_table(statistics),
        *(_card(s, thumbnails) for s, thumbnails in shown),
    ]
    return document(title, sections, "data", chips, notices)


def summary_rows(statistics: Sequence[MotionStatistics]) -> list[tuple[str, str]]:
    """Facts about all sequences together."""
    n = len(statistics)

    def of(count: int) -> str:
        return f"{count} of {n} ({count / n:.0%})"

    def middle(values: Sequence[float]) -> str:
        return f"median {np.median(values):.0%}, least {min(values):.0%}"

    paces = [s.median_degrees for s in statistics]
    return [
        ("Hard: under 5 % in 15 % of the frames", of(sum(s.is_hard for s in statistics))),
        (
            f"Moving part out of sight for {GONE_FRAMES} frames",
            of(sum(s.longest_absence >= GONE_FRAMES for s in statistics)),
        ),
        ("First frame shows both parts (5 % or more)", of(sum(s.share[0] >= FEW for s in statistics))),
        ("Object inside the image in all frames", of(sum(not s.leaves for s in statistics))),
        ("Median rotation of 2° to 3° per frame", of(sum(2 <= pace <= 3 for pace in paces))),
        ("Rotation per frame", f"medians {min(paces):.2f}° to {max(paces):.2f}°"),
        ("Viewpoints covered", middle([s.coverage for s in statistics])),
        ("Joint range covered", middle([s.range_covered for s in statistics])),
        ("Object height, share of the image's", middle([s.fill for s in statistics])),
        ("Frames per sequence", f"{min(s.frames for s in statistics)} to {max(s.frames for s in statistics)}"),
        ("Masks, part masks and pixel counts agree", of(sum(s.masks_valid for s in statistics))),
    ]


def motion_section(statistics: Sequence[MotionStatistics]) -> Section:
    """Rotation and viewpoints by source of motion, scripted ones first."""
    groups: dict[tuple[bool, str], list[MotionStatistics]] = {}
    for s in statistics:
        groups.setdefault((s.recorded, s.motion_source), []).append(s)
    rows = "".join(_source_row(name, recorded, groups[recorded, name]) for recorded, name in sorted(groups))
    return Section("Motion by source", f'<div class="motions">{rows}</div>', place="full", note=MOTION_NOTE)


def _source_row(name: str, recorded: bool, group: list[MotionStatistics]) -> str:
    turns, frames = np.concatenate([s.degrees for s in group]), sum(s.frames for s in group)
    kind = "recorded" if recorded else "scripted"
    count = f"{len(group)} sequence{'s' * (len(group) > 1)}, {frames} frames"
    middle = np.median(turns) if len(turns) else 0.0
    facts = [
        ("rotation per frame", f"median {middle:.2f}°, largest {turns.max(initial=0.0):.1f}°"),
        ("object at rest", f"{np.mean([s.joint_only + s.neither for s in group]):.0%}"),
        ("joint at rest", f"{np.mean([s.pose_only + s.neither for s in group]):.0%}"),
    ]
    values = "".join(f"<div><dt>{escape(label)}</dt><dd>{escape(value)}</dd></div>" for label, value in facts)
    panels = _turn_panel(turns) + _view_panel(group)
    return (
        f'<article><h3>{escape(name)} <small>{kind}, {count}</small></h3><dl class="facts">{values}</dl>'
        f'<div class="panels">{panels}</div></article>'
    )


def _turn_panel(turns: Array) -> str:
    axes = Axes(*PANEL_SIZE, PANEL_MARGINS, TURNS, (0.0, 0.4), log_x=True)
    at = float(axes.across(TURN_DEGREES))
    rest = f'<line class="limit" x1="{at:.1f}" x2="{at:.1f}" y1="{axes.down(0.4):.1f}" y2="{axes.down(0.0):.1f}"/>'
    ticks = [*axes.marks({0.01: ".01", 0.1: ".1", 1: "1", 10: "10°"}), *axes.grid({0: "0", 0.4: "40%"})]
    return _figure(
        "rotation per frame, share of frames", ticks, _histogram(axes, turns, TURN_BINS, len(turns), REFERENCE), rest
    )


def _view_panel(group: list[MotionStatistics]) -> str:
    """The cells of the sphere of viewpoints, darker the more sequences cover them."""
    share = np.mean([sphere.covered_cells(s.views).any(0) for s in group], axis=0)
    cells = sphere.fibonacci_sphere(sphere.CELLS)
    places = _hemispheres(cells, 44.0, (56, 164), 56)
    dots = "".join(
        f'<circle class="cell" {at} r="6"/><circle class="seen" {at} r="6" fill-opacity="{share[k]:.2f}"/>'
        for k, at in places
    )
    covered = np.mean([s.coverage for s in group])
    rims = "".join(f'<circle class="rim" cx="{x}" cy="56" r="50"/>' for x in (56, 164))
    return _figure(f"viewpoints from above, from below: {covered:.0%} covered per sequence", rims + dots)


def _sequence_table(statistics: Sequence[MotionStatistics]) -> Section:
    rows: list[list[str]] = []
    for s in statistics:
        shares = (s.pose_only, s.joint_only, s.both, s.neither, s.coverage, s.range_covered)
        rows.append(
            [
                row_head(f'<a href="#{escape(_anchor(s))}">{escape(s.name)}</a>', s.name),
                value_cell(s.source.get("motion", "-"), s.source.get("motion", "")),
                value_cell(str(s.frames), s.frames),
                value_cell(f"{s.median_degrees:.2f}", s.median_degrees),
                value_cell(f"{s.max_degrees:.1f}", s.max_degrees),
                *(value_cell(f"{v:.0%}", v) for v in shares),
                value_cell(f"{s.few_pixels_share:.0%}" + " hard" * s.is_hard, s.few_pixels_share),
                value_cell(str(s.longest_absence), s.longest_absence),
                value_cell(f"{s.fill:.0%}", s.fill),
                value_cell(f"{s.depth_m[0]:.2f} to {s.depth_m[1]:.2f}", s.depth_m[0]),
                value_cell("no" if s.leaves else "yes", float(s.leaves)),
                value_cell("agree" if s.masks_valid else "differ", float(s.masks_valid)),
            ]
        )
    head = [column_head(escape(label), sortable=True) for label in COLUMNS]
    return Section("Sequences", table(rows, head, "sortable dense", "sequences"), place="full")


def _card(s: MotionStatistics, thumbnails: str) -> Section:
    """One sequence: images, three curves over time, and its viewpoints."""
    facts = ", ".join([*(f"{key} {value}" for key, value in s.source.items()), f"{s.joint_type} joint"])
    top = max(0.5, float(s.share.max()))
    curves = _curve_figure(f"moving part's share of the object's pixels; dashed: {FEW:.0%}", s.share, MOVING, top, FEW)
    curves += _curve_figure("joint state, share of its range", s.opening, TRUTH, 1.0)
    curves += _curve_figure("rotation, degrees per frame", s.degrees, REFERENCE, max(8.0, s.max_degrees))
    dots = "".join(
        f'<circle class="{css}" {at} r="{radius}"/>'
        for css, directions, radius in (("cell", sphere.fibonacci_sphere(sphere.CELLS), 1.1), ("seen", s.views, 1.7))
        for _, at in _hemispheres(directions, 33.0, (38, 114), 37)
    )
    rims = "".join(f'<circle class="rim" cx="{x}" cy="37" r="33"/>' for x in (38, 114))
    views = _figure("viewpoints from above, from below", rims + dots, size=(152, CURVE_SIZE[1]))
    html = (
        f'<p class="note">{escape(facts)}, {s.frames} frames</p>'
        f'<img class="strip" alt="{THUMBNAILS} images of the video" src="{thumbnails}">'
        f'<div class="panels sequence">{curves}{views}</div>'
    )
    return Section(s.name + ", hard" * s.is_hard, html, place="full", id=_anchor(s))


# --- drawings ---------------------------------------------------------------------------------------------------------


def _figure(label: str, *drawings: str | list[str], size: tuple[int, int] = PANEL_SIZE) -> str:
    svg = "".join(d if isinstance(d, str) else "".join(d) for d in drawings)
    return (
        f'<figure><svg viewBox="0 0 {size[0]} {size[1]}" role="img" aria-label="{escape(label)}">{svg}</svg>'
        f"<figcaption>{escape(label)}</figcaption></figure>"
    )


def _curve_figure(label: str, values: Array, colour: str, top: float, limit: float | None = None) -> str:
    """A small plot of values (n,) over the frames from 0 to `top`, with a dashed line at `limit`."""
    axes = Axes(*CURVE_SIZE, CURVE_MARGINS, (0.0, float(max(len(values) - 1, 1))), (0.0, top))
    y = axes.down(np.clip(values, 0.0, top))
    points = " ".join(
        f"{a:.1f},{b:.1f}" for a, b in zip(axes.across(np.arange(len(values), dtype=float)), y, strict=True)
    )
    line = f'<polyline fill="none" stroke="{colour}" stroke-width="1.6" points="{points}"/>'
    if limit is not None:
        left, right, _, _ = axes.margins
        at = float(axes.down(limit))
        line += f'<line class="limit" x1="{left}" x2="{axes.width - right}" y1="{at:.1f}" y2="{at:.1f}"/>'
    return _figure(label, axes.grid({0: "0", top: f"{round(top, 2):g}"}), line, size=CURVE_SIZE)


def _histogram(axes: Axes, values: Array, bins: int, unit: float, colour: str) -> str:
    """Counts in geometric bins over the axes, divided by `unit`; values beyond an end count at that end."""
    edges = np.geomspace(*axes.x, bins + 1)
    counts = np.histogram(np.clip(values, *axes.x), edges)[0] / max(unit, 1e-9)
    x, y, bottom = axes.across(edges), axes.down(counts), float(axes.down(0.0))
    steps = "".join(f"V{y[k]:.1f}H{x[k + 1]:.1f}" for k in range(bins))
    path = f"M{x[0]:.1f},{bottom:.1f}{steps}V{bottom:.1f}Z"
    return f'<path fill="{colour}" d="{path}"/>'


def _hemispheres(directions: Array, radius: float, x0: tuple[int, int], y0: int) -> list[tuple[int, str]]:
    """Index and SVG position of unit vectors (n, 3) on the upper and the lower half of the sphere.

    The projection keeps areas (Lambert).
    """
    found = []
    for centre, sign in zip(x0, (1.0, -1.0), strict=True):
        for k, (x, y, z) in enumerate(directions):
            if sign * z >= 0:
                scale = radius / np.sqrt(1 + abs(z))
                found.append((k, f'cx="{centre + sign * scale * x:.1f}" cy="{y0 - scale * y:.1f}"'))
    return found


def _thumbnails(recording: Recording) -> str:
    """Images of a video side by side, as the address of a JPEG."""
    images = []
    for i in shown_frames(len(recording), THUMBNAILS):
        rgb = recording.frame(int(i)).rgb
        size = THUMBNAIL_WIDTH, max(1, round(THUMBNAIL_WIDTH * rgb.shape[0] / rgb.shape[1]))
        images.append(cv2.resize(rgb, size, interpolation=cv2.INTER_AREA))
    return data_url("image/jpeg", encode_jpeg(np.hstack(images).astype(np.uint8), THUMBNAIL_QUALITY))


def _anchor(s: MotionStatistics) -> str:
    return "sequence-" + "".join(c if c.isalnum() else "-" for c in s.name)
