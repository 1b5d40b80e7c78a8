"""Quality of a result without the truth: charts over the frames, and warnings.

The overall verdict is the result's own, or that of `freeart21.trust`.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from freeart21.articulation import PARTS
from freeart21.files.diagnostics import Diagnostics
from freeart21.reconstruction import Reconstruction
from freeart21.se3 import Array
from freeart21.trust import JUMP, Motion, find_jumps, judge, measure_motion, median, object_size
from freeart21.view.document import MOVING, REFERENCE, Section, render
from freeart21.view.plots import Chart, Curve, curves_section, true_runs

COLOURS = (REFERENCE, MOVING)
JOINT_RESIDUAL = "#AA3377"
MAX_WARNINGS = 14
OUTLIER = 3.0
"""Medians above which a frame gets a warning."""
MIN_LENGTH = 0.005
"""Lengths below this share of the object's size get no warning. A near-perfect stapler of 19 cm has frames with three
medians of residual, .3 mm."""
BRIDGE = 3
"""Warnings closer than this many frames are one."""


@dataclass(frozen=True)
class Finding:
    """One sign of a bad result."""

    text: str
    frames: tuple[int, int] | None = None
    """First and last frame, or None for the whole video."""

    @property
    def where(self) -> str:
        """'frames 3-8', 'frame 3' or ''."""
        if self.frames is None:
            return ""
        first, last = self.frames
        return f"frame {first}" if first == last else f"frames {first}-{last}"


def diagnosis_section(
    result: Reconstruction, diagnostics: Diagnostics | None, abscissa: NDArray[np.float64], timed: bool
) -> Section:
    """Charts of residuals, labels and motion over `abscissa` (n,), seconds when `timed`, else frame numbers.

    Those that need the method's own `diagnostics` are left out without them.
    """
    motion = measure_motion(result)
    note = "Grey: a part was not seen. No ground truth is used."
    if diagnostics is None:
        note += " The method wrote no diagnostics: residuals and confidence are unknown."

    pixels = np.stack([(result.part_masks == k).sum((1, 2)) for k in (1, 2)], 1) / 1000
    far = "of the moving part's measured pose from its pose by the reference part and the joint."
    angle, distance = (
        (Curve("moving part", JOINT_RESIDUAL, values),)
        for values in (np.degrees(motion.gap_angle), 1000 * motion.gap_distance)
    )
    charts = [
        *(_own_charts(diagnostics) if diagnostics is not None else ()),
        Chart("Joint residual: rotation", "°", angle, f"Angle {far}"),
        Chart("Joint residual: translation", "mm", distance, f"Distance {far}"),
        Chart("Rotation per frame", "°", _both(np.degrees(motion.step_angle)), "Since the previous frame."),
        Chart("Translation per frame", "mm", _both(1000 * motion.step_distance), "Of the part's centre."),
        Chart("Visible pixels", "thousands", _both(pixels), "Pixels of each part."),
    ]
    unseen = np.asarray(~result.seen.all(1))
    return curves_section("Quality, frame by frame", charts, abscissa, timed, unseen, note)


def _own_charts(d: Diagnostics) -> list[Chart]:
    """Charts of the method's own diagnostics."""
    by_joint = Curve("moving, pose by the joint", JOINT_RESIDUAL, 1000 * d.jointed_residual_m[:, 1], "dashed")
    about = (
        "RMS distance of each part's points from its surface in other frames. Where the dashed line is higher than "
        "the moving part's own, the joint does not explain the measurement."
    )
    near = f"Share of each part's points within {1000 * d.gate_m:.1f} mm of its surface in other frames."
    colour = "Median colour difference of rendered surface and image, CIELAB, lightness damped."
    own = (
        ("Inliers", "%", d.inliers, near, 100.0),
        ("Outside the mask", "%", d.outside, "Share of each part's points outside the mask of other frames.", 5.0),
        ("Label confidence", "%", d.confidence, "Mean probability of the part labels.", 100.0),
        ("Pixels without surface", "%", d.uncovered, "Share of each part's pixels on neither rendered surface.", 5.0),
        ("Surface outside the mask", "%", d.spilled, "Share of each part's rendered surface outside the mask.", 5.0),
        ("Depth off the surface", "%", d.off_surface, "Share of each part's pixels with a depth off its surface.", 5.0),
        ("Colour residual", "CIELAB", d.colour_residual, colour, None),
    )
    return [
        Chart("Residual", "mm", (*_both(1000 * d.residual_m), by_joint), about),
        *(
            Chart(title, unit, _both((100 if unit == "%" else 1) * values), text, top)
            for title, unit, values, text, top in own
            if values is not None
        ),
    ]


def warnings_section(result: Reconstruction, diagnostics: Diagnostics | None) -> Section:
    """The warnings as a list; a click on the frames shows them."""
    found = warnings(result, diagnostics)
    more = len(found) - MAX_WARNINGS
    return Section("Warnings", render("warnings.html.j2", warnings=found[:MAX_WARNINGS], more=more), place="right")


def warnings(result: Reconstruction, diagnostics: Diagnostics | None = None) -> list[Finding]:
    """Reasons to doubt the result: of the whole (its own `trust`, else judged here), then frame by frame."""
    motion, trust = measure_motion(result), result.trust or judge(result, diagnostics)
    size = object_size(result)
    found = _off_the_joint(motion, size)
    for seen, what in (
        (result.seen[:, 1], "the moving part was not seen; its states are not measured"),
        (result.seen[:, 0], "the reference part was not seen; its poses are guessed"),
    ):
        found += [Finding(what, _ends(run)) for run in true_runs(~seen)]
    for k, part in enumerate(PARTS):
        if diagnostics is not None:
            residual = diagnostics.residual_m[:, k]
            least = max(0.5 * diagnostics.footprint_m, diagnostics.noise_m, MIN_LENGTH * size)
            for run in true_runs(np.nan_to_num(residual) > max(OUTLIER * median(residual), least), BRIDGE):
                text = f"the residual of the {part} part is {1000 * np.nanmax(residual[run]):.3g} mm"
                found.append(Finding(f"{text}, its median {1000 * median(residual):.3g} mm", _ends(run)))
        found += _jumps(np.degrees(motion.step_angle[:, k]), 3.0, "°", f"the {part} part turns by")
        found += _jumps(1000 * motion.step_distance[:, k], 20 * size, " mm", f"the {part} part moves by")
    return [*map(Finding, trust.reasons), *sorted(found, key=lambda one: one.frames or (0, 0))]


def _off_the_joint(motion: Motion, size: float) -> list[Finding]:
    """A warning for every run of frames with a measured pose far from the joint's, by angle or distance."""
    angle, distance = np.nan_to_num(motion.gap_angle), np.nan_to_num(motion.gap_distance)
    medians = median(motion.gap_angle), median(motion.gap_distance)
    far = angle > max(OUTLIER * medians[0], np.radians(1.0))
    far |= distance > max(OUTLIER * medians[1], MIN_LENGTH * size)
    return [
        Finding(
            f"the moving part's measured pose deviates from the joint by {'up to ' * (len(run) > 1)}"
            f"{np.degrees(angle[run].max()):.3g}° and {1000 * distance[run].max():.3g} mm; the medians are "
            f"{np.degrees(medians[0]):.2g}° and {1000 * medians[1]:.2g} mm",
            _ends(run),
        )
        for run in true_runs(far, BRIDGE)
    ]


def _jumps(values: Array, least: float, unit: str, what: str) -> list[Finding]:
    """A warning for every frame with a step far larger than its neighbours' and than `least`."""
    return [
        Finding(f"{what} {values[i]:.3g}{unit} in one frame, far more than in its neighbours", (i, i))
        for i in map(int, find_jumps(values, least, JUMP))
    ]


def _ends(run: NDArray[np.int64]) -> tuple[int, int]:
    return int(run[0]), int(run[-1])


def _both(values: Array) -> tuple[Curve, ...]:
    return tuple(Curve(name, COLOURS[k], values[:, k]) for k, name in enumerate(PARTS))
