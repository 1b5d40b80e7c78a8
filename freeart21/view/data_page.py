"""The page of a data folder: every sequence with its images and statistics."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np

from freeart21 import sphere
from freeart21.errors import FreeArtError
from freeart21.files.benchmark import read_benchmark
from freeart21.files.sequence import read_sequence
from freeart21.files.truth import read_truth
from freeart21.statistics import FEW, GONE_FRAMES, HARD_FRAMES, MotionStatistics, motion_statistics
from freeart21.view.document import Markup, document
from freeart21.view.tables import Cell, table_section
from freeart21.view.video import jpeg_url, shown_frames

IMAGES, WIDTH, QUALITY = 3, 120, 72
NOTE = (
    f"Hard: the moving part has less than {FEW:.0%} of the object's pixels in {HARD_FRAMES:.0%} of the frames or more. "
    f"Out of sight: no pixel of it is visible in {GONE_FRAMES} or more successive frames. Viewpoints covered: share of "
    f"{sphere.CELLS} equal cells of the sphere within {sphere.REACH_DEGREES:.0f}° of a view."
)


def data_page(folder: Path, title: str) -> str:
    """The page of a data folder.

    Sequences without their truth are named and left out. Raises FreeArtError when none has its truth.
    """
    benchmark = read_benchmark(folder)
    shown: list[MotionStatistics] = []
    rows: list[dict[str, Cell]] = []
    hidden: list[str] = []
    for name in benchmark.sequences:
        if not (benchmark.truth(name) / "truth.json").is_file():
            hidden.append(name)
            continue
        recording = read_sequence(benchmark.sequence(name))
        shown.append(motion_statistics(recording, read_truth(benchmark.truth(name))))
        images = []
        for i in shown_frames(len(recording), IMAGES):
            rgb = recording.frame(int(i)).rgb
            size = WIDTH, max(1, round(WIDTH * rgb.shape[0] / rgb.shape[1]))
            images.append(cv2.resize(rgb, size, interpolation=cv2.INTER_AREA))
        rows.append(_row(shown[-1], jpeg_url(np.hstack(images).astype(np.uint8), QUALITY)))
    if not shown:
        raise FreeArtError(f"{folder} has {len(benchmark.sequences)} sequences, but the truth of none: nothing to show")
    names = ", ".join(hidden[:5]) + " ..." * (len(hidden) > 5)
    notices = [f"{len(hidden)} sequences have no truth here and are left out: {names}"] if hidden else []
    frames, hard = sum(len(s.share) for s in shown), sum(s.is_hard for s in shown)
    section = table_section("Sequences", rows, (), "full", NOTE, "sortable dense")
    chips = [f"{len(shown)} sequence{'s' * (len(shown) > 1)}", f"{frames} frames", f"{hard} of {len(shown)} hard"]
    return document(title, [section], "data", [*chips, f"version {benchmark.version}", benchmark.split], notices)


def _row(s: MotionStatistics, images: str) -> dict[str, Cell]:
    """The cells of a sequence by their headings."""
    source = ", ".join(f"{key} {value}" for key, value in s.source.items())
    return {
        "Sequence": Cell(s.name, s.name, below=f"{source}, {s.joint_type}".removeprefix(", ")),
        "Images": Cell(Markup('<img alt="{}" src="{}">').format(f"{IMAGES} images of the video", images)),
        "Motion": Cell(s.motion_source),
        "Frames": Cell(len(s.share)),
        "Median rotation, °/frame": Cell(f"{np.median(s.degrees):.2f}" if len(s.degrees) else "0.00"),
        "Largest rotation, °/frame": Cell(f"{s.degrees.max(initial=0):.1f}"),
        "Both move": Cell(f"{s.both:.0%}", s.both),
        "Viewpoints covered": Cell(f"{s.coverage:.0%}", s.coverage),
        "Joint range covered": Cell(f"{s.range_covered:.0%}", s.range_covered),
        f"Frames below {FEW:.0%}": Cell(f"{s.few_pixels_share:.0%}" + " hard" * s.is_hard, s.few_pixels_share),
        "Out of sight, frames": Cell(s.longest_absence),
        "Depth, m": Cell(f"{s.depth_m[0]:.2f} to {s.depth_m[1]:.2f}", s.depth_m[0]),
    }
