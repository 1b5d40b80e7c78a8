"""The page of a data folder: a summary, and every sequence with its images and statistics."""

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
from freeart21.statistics import FEW, GONE_FRAMES, HARD_FRAMES, MotionStatistics, motion_statistics
from freeart21.view.document import Markup, data_url, document
from freeart21.view.tables import Cell, table_section
from freeart21.view.video import encode_jpeg, shown_frames

IMAGES, WIDTH, QUALITY = 3, 120, 72
COLUMNS = (
    *("Sequence", "Images", "Motion", "Frames", "Median rotation, °/frame", "Largest rotation, °/frame"),
    *("Only object moves", "Only joint moves", "Both move", "Neither", "Viewpoints covered", "Joint range covered"),
    *(f"Frames below {FEW:.0%}", "Out of sight, frames", "Height filled", "Depth, m", "Inside the image", "Masks"),
)
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
    rows: list[list[Cell]] = []
    hidden: list[str] = []
    for name in benchmark.sequences:
        if not (benchmark.truth(name) / "truth.json").is_file():
            hidden.append(name)
            continue
        recording = read_sequence(benchmark.sequence(name))
        shown.append(motion_statistics(recording, read_truth(benchmark.truth(name))))
        rows.append(_row(shown[-1], _images(recording)))
    if not shown:
        raise FreeArtError(f"{folder} has {len(benchmark.sequences)} sequences, but the truth of none: nothing to show")
    names = ", ".join(hidden[:5]) + " ..." * (len(hidden) > 5)
    notices = [f"{len(hidden)} sequences have no truth here and are left out: {names}"] if hidden else []
    sequences, frames = f"{len(shown)} sequence{'s' * (len(shown) > 1)}", f"{sum(s.frames for s in shown)} frames"
    sections = [
        table_section(f"Summary of {sequences}, {frames}", summary_rows(shown), (), "full", NOTE),
        table_section("Sequences", rows, COLUMNS, "full", css="sortable dense"),
    ]
    return document(
        title, sections, "data", [sequences, frames, f"version {benchmark.version}", benchmark.split], notices
    )


def summary_rows(statistics: Sequence[MotionStatistics]) -> list[tuple[str, str]]:
    """Facts about all sequences together."""
    n = len(statistics)

    def of(count: int) -> str:
        return f"{count} of {n} ({count / n:.0%})"

    def middle(values: Sequence[float]) -> str:
        return f"median {np.median(values):.0%}, least {min(values):.0%}"

    paces = [s.median_degrees for s in statistics]
    gone = sum(s.longest_absence >= GONE_FRAMES for s in statistics)
    return [
        ("Hard: under 5 % in 15 % of the frames", of(sum(s.is_hard for s in statistics))),
        (f"Moving part out of sight for {GONE_FRAMES} frames", of(gone)),
        ("First frame shows both parts (5 % or more)", of(sum(s.share[0] >= FEW for s in statistics))),
        ("Object inside the image in all frames", of(sum(not s.leaves for s in statistics))),
        ("Rotation per frame", f"medians {min(paces):.2f}° to {max(paces):.2f}°"),
        ("Viewpoints covered", middle([s.coverage for s in statistics])),
        ("Joint range covered", middle([s.range_covered for s in statistics])),
        ("Object height, share of the image's", middle([s.fill for s in statistics])),
        ("Frames per sequence", f"{min(s.frames for s in statistics)} to {max(s.frames for s in statistics)}"),
        ("Masks, part masks and pixel counts agree", of(sum(s.masks_valid for s in statistics))),
    ]


def _row(s: MotionStatistics, images: str) -> list[Cell]:
    shares = s.pose_only, s.joint_only, s.both, s.neither, s.coverage, s.range_covered
    source = ", ".join(f"{key} {value}" for key, value in s.source.items())
    return [
        Cell(s.name, s.name, below=f"{source}, {s.joint_type}".removeprefix(", ")),
        Cell(Markup('<img alt="{}" src="{}">').format(f"{IMAGES} images of the video", images)),
        Cell(s.motion_source),
        Cell(s.frames),
        Cell(f"{s.median_degrees:.2f}"),
        Cell(f"{s.max_degrees:.1f}"),
        *(Cell(f"{v:.0%}", v) for v in shares),
        Cell(f"{s.few_pixels_share:.0%}" + " hard" * s.is_hard, s.few_pixels_share),
        Cell(s.longest_absence),
        Cell(f"{s.fill:.0%}", s.fill),
        Cell(f"{s.depth_m[0]:.2f} to {s.depth_m[1]:.2f}", s.depth_m[0]),
        Cell("no" if s.leaves else "yes"),
        Cell("agree" if s.masks_valid else "differ"),
    ]


def _images(recording: Recording) -> str:
    """Images of a video side by side, as the address of a JPEG."""
    images = []
    for i in shown_frames(len(recording), IMAGES):
        rgb = recording.frame(int(i)).rgb
        size = WIDTH, max(1, round(WIDTH * rgb.shape[0] / rgb.shape[1]))
        images.append(cv2.resize(rgb, size, interpolation=cv2.INTER_AREA))
    return data_url("image/jpeg", encode_jpeg(np.hstack(images).astype(np.uint8), QUALITY))
