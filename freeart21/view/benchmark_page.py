"""The page of a data folder: how its motions are, sequence by sequence, and whether they are as hard as they should."""

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
from freeart21.statistics import FEW, GONE_FRAMES, HARD_FRAMES, MotionStatistics, motion_statistics
from freeart21.view.document import MOVING, REFERENCE, TRUTH, Section, data_url, document, escape
from freeart21.view.motion_panels import motion_section
from freeart21.view.tables import table_section

_THUMBS, _THUMB_WIDTH, _QUALITY = 8, 132, 72
_WIDTH, _HEIGHT = 300, 74

COLUMNS = (
    ("sequence", "Sequence"),
    ("motion", "Motion"),
    ("frames", "Frames"),
    ("median", "Median °/frame"),
    ("max", "Largest °/frame"),
    ("pose", "Pose only"),
    ("joint", "Joint only"),
    ("both", "Both"),
    ("neither", "Neither"),
    ("views", "Views covered"),
    ("range", "Joint range"),
    ("few", "Frames under 5 %"),
    ("gone", "Frames gone"),
    ("fill", "Fill"),
    ("depth", "Depth, m"),
    ("in", "In frame"),
    ("masks", "Masks"),
)


def benchmark_page(folder: Path, title: str) -> str:
    """The page of the data folder `folder`: a summary, a table that can be sorted, and a card for every sequence.

    Sequences whose truth is kept back are named and left out. Raises FreeArtError when none has its truth.
    """
    benchmark = read_benchmark(folder)
    shown: list[tuple[MotionStatistics, str]] = []
    hidden: list[str] = []
    for name in benchmark.sequences:
        if not (benchmark.truth(name) / "truth.json").is_file():
            hidden.append(name)
            continue
        recording = read_sequence(benchmark.sequence(name))
        shown.append((motion_statistics(recording, read_truth(benchmark.truth(name))), _strip(recording)))
    if not shown:
        raise FreeArtError(f"{folder} has {len(benchmark.sequences)} sequences, but the truth of none: nothing to tell")
    statistics = [s for s, _ in shown]
    some = ", ".join(hidden[:5]) + " ..." * (len(hidden) > 5)
    notices = [f"{len(hidden)} sequences have no truth here and are left out: {some}"] if hidden else []
    frames = sum(s.frames for s in statistics)
    chips = [f"{len(statistics)} sequences", f"{frames} frames", f"version {benchmark.version}", benchmark.split]
    sections = [
        table_section(
            f"Summary of {len(statistics)} sequences, {frames} frames",
            summary_rows(statistics),
            place="full",
            note=_NOTE,
        ),
        motion_section(statistics),
        _table(statistics),
        *(_card(s, strip) for s, strip in shown),
    ]
    return document(title, sections, "data", chips, notices)


_NOTE = (
    f"Hard: the moving part has under {FEW:.0%} of the object's pixels in at least {HARD_FRAMES:.0%} of the frames. "
    f"Gone: not one pixel of it in at least {GONE_FRAMES} frames on end. "
    f"Views covered: cells, of {sphere.CELLS} equal ones, within {sphere.REACH_DEGREES:.0f}° of a view."
)


def summary_rows(statistics: Sequence[MotionStatistics]) -> list[tuple[str, str]]:
    """What is to be known of all sequences together, and how many of them are as wished."""
    n = len(statistics)

    def of(count: int) -> str:
        return f"{count} of {n} ({count / n:.0%})"

    def middle(values: Sequence[float]) -> str:
        return f"median {np.median(values):.0%}, least {min(values):.0%}"

    paces = [s.median_degrees for s in statistics]
    return [
        ("Hard: under 5 % in 15 % of the frames", of(sum(s.is_hard for s in statistics))),
        (
            f"The moving part gone for {GONE_FRAMES} frames or more",
            of(sum(s.longest_absence >= GONE_FRAMES for s in statistics)),
        ),
        ("First frame shows both parts (5 % or more)", of(sum(s.share[0] >= FEW for s in statistics))),
        ("Object in frame throughout", of(sum(not s.leaves for s in statistics))),
        ("Median turn of 2 to 3 degrees a frame", of(sum(2 <= pace <= 3 for pace in paces))),
        ("Turn a frame, degrees", f"medians {min(paces):.2f} to {max(paces):.2f}"),
        ("Views covered", middle([s.coverage for s in statistics])),
        ("Joint range covered", middle([s.range_covered for s in statistics])),
        ("Fill of the picture's height", middle([s.fill for s in statistics])),
        ("Frames a sequence", f"{min(s.frames for s in statistics)} to {max(s.frames for s in statistics)}"),
        ("Masks, part masks and counts agree", of(sum(s.masks_valid for s in statistics))),
    ]


def _table(statistics: Sequence[MotionStatistics]) -> Section:
    """All figures; a click on a heading sorts by it."""
    head = "".join(
        f'<th scope=col><button type="button" data-column="{k}">{escape(label)}</button></th>'
        for k, (_, label) in enumerate(COLUMNS)
    )
    rows = []
    for s in statistics:
        cells = [
            (s.source.get("motion", "-"), s.source.get("motion", "")),
            (str(s.frames), s.frames),
            (f"{s.median_degrees:.2f}", s.median_degrees),
            (f"{s.max_degrees:.1f}", s.max_degrees),
            *((f"{v:.0%}", v) for v in (s.pose_only, s.joint_only, s.both, s.neither, s.coverage, s.range_covered)),
            (f"{s.few_pixels_share:.0%}" + " hard" * s.is_hard, s.few_pixels_share),
            (str(s.longest_absence), s.longest_absence),
            (f"{s.fill:.0%}", s.fill),
            (f"{s.depth_m[0]:.2f} to {s.depth_m[1]:.2f}", s.depth_m[0]),
            ("no" if s.leaves else "yes", float(s.leaves)),
            ("agree" if s.masks_valid else "differ", float(s.masks_valid)),
        ]
        body = "".join(f'<td data-value="{escape(value)}">{escape(text)}</td>' for text, value in cells)
        name = f'<a href="#{escape(_anchor(s))}">{escape(s.name)}</a>'
        rows.append(f'<tr><th scope=row data-value="{escape(s.name)}">{name}</th>{body}</tr>')
    html = (
        f'<div class="table sortable"><table><thead><tr>{head}</tr></thead><tbody>{"".join(rows)}</tbody></table></div>'
    )
    return Section("Sequences", html, "table", {"columns": len(COLUMNS)}, "full")


def _card(s: MotionStatistics, strip: str) -> Section:
    """One sequence: pictures, three courses over time, and where it was seen from."""
    facts = ", ".join([*(f"{key} {value}" for key, value in s.source.items()), f"{s.joint_type} joint"])
    plots = (
        _course(
            f"moving part's share of the object's pixels; dashed: {FEW:.0%}",
            s.share,
            MOVING,
            0.0,
            max(0.5, float(s.share.max())),
            FEW,
        )
        + _course("joint, share of its range", s.opening, TRUTH, 0.0, 1.0, None)
        + _course("turn, degrees a frame", s.degrees, REFERENCE, 0.0, max(8.0, s.max_degrees), None)
    )
    html = (
        f'<p class="note" id="{escape(_anchor(s))}">{escape(facts)}, {s.frames} frames</p>'
        f'<img class="strip" alt="{_THUMBS} pictures of the video" src="{strip}">'
        f'<div class="courses">{plots}{_globe(s.views)}</div>'
    )
    return Section(s.name + ", hard" * s.is_hard, html, place="full")


def _course(label: str, values: Array, colour: str, low: float, high: float, line: float | None) -> str:
    """A small plot of values (n,) over the frames, with the ends of its scale, and a line where one matters."""
    n = max(len(values) - 1, 1)
    left, bottom = 34, _HEIGHT - 14

    def down(value: Array | float) -> Array:
        return 4 + (high - np.asarray(value, float)) / (high - low) * (bottom - 4)

    points = " ".join(
        f"{left + (_WIDTH - left - 4) * k / n:.1f},{y:.1f}" for k, y in enumerate(down(np.clip(values, low, high)))
    )
    lines = "".join(
        f'<line class="grid" x1="{left}" x2="{_WIDTH - 4}" y1="{down(v):.1f}" y2="{down(v):.1f}"/>'
        f'<text x="{left - 5}" y="{down(v) + 4:.1f}" text-anchor="end">{round(v, 2):g}</text>'
        for v in (low, high)
    )
    if line is not None:
        lines += f'<line class="few" x1="{left}" x2="{_WIDTH - 4}" y1="{down(line):.1f}" y2="{down(line):.1f}"/>'
    return (
        f'<figure><svg viewBox="0 0 {_WIDTH} {_HEIGHT}" role="img" aria-label="{escape(label)}">{lines}'
        f'<polyline fill="none" stroke="{colour}" stroke-width="1.6" points="{points}"/></svg>'
        f"<figcaption>{escape(label)}</figcaption></figure>"
    )


def _globe(views: Array) -> str:
    """Views as dots on both halves of the sphere, from above and from below, in equal-area projection (Lambert)."""
    radius, parts = 33.0, []
    for k, sign in enumerate((1.0, -1.0)):
        x0 = 38 + 76 * k
        parts.append(f'<circle class="half" cx="{x0}" cy="37" r="{radius}"/>')
        for group, dots, size in (("cell", sphere.fibonacci_sphere(sphere.CELLS), 1.1), ("view", views, 1.7)):
            here = dots[sign * dots[:, 2] >= 0]
            scale = radius / np.sqrt(1 + np.abs(here[:, 2]))
            x, y = x0 + sign * scale * here[:, 0], 37 - scale * here[:, 1]
            parts += [
                f'<circle class="{group}" cx="{a:.1f}" cy="{b:.1f}" r="{size}"/>' for a, b in zip(x, y, strict=True)
            ]
    return (
        f'<figure><svg viewBox="0 0 152 {_HEIGHT}" role="img" aria-label="directions of view">{"".join(parts)}</svg>'
        "<figcaption>seen from above, from below</figcaption></figure>"
    )


def _strip(recording: Recording) -> str:
    """Some pictures of a video side by side, as the address of a JPEG."""
    thumbs = []
    for i in np.unique(np.rint(np.linspace(0, len(recording) - 1, _THUMBS)).astype(int)):
        rgb = recording.frame(int(i)).rgb
        size = _THUMB_WIDTH, max(1, round(_THUMB_WIDTH * rgb.shape[0] / rgb.shape[1]))
        thumbs.append(cv2.resize(rgb, size, interpolation=cv2.INTER_AREA))
    strip = cv2.cvtColor(np.hstack(thumbs), cv2.COLOR_RGB2BGR)
    ok, data = cv2.imencode(".jpg", strip, [cv2.IMWRITE_JPEG_QUALITY, _QUALITY])
    if not ok:
        raise FreeArtError(f"cannot encode the pictures of {recording.name}")
    return data_url("image/jpeg", data.tobytes())


def _anchor(s: MotionStatistics) -> str:
    return "sequence-" + "".join(c if c.isalnum() else "-" for c in s.name)
