"""Why a result is good or bad, judged without the truth: what its parts, poses and joint say of each other.

Whether to trust it at all is what it says itself, or what `freeart21.trust` makes of it; here are the frames.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from freeart21.articulation import PARTS
from freeart21.files.diagnostics import Diagnostics
from freeart21.reconstruction import Reconstruction
from freeart21.se3 import Array
from freeart21.trust import JUMP, Motion, judge, median, motion_of, outstanding, size_of
from freeart21.view.curves import Chart, Curve, curves_section
from freeart21.view.document import MOVING, REFERENCE, Section, escape
from freeart21.view.plot import display_unit, runs

COLOURS = (REFERENCE, MOVING)
GAP = "#AA3377"
MOST_REMARKS = 14
SPIKE = 3.0
"""Medians above which a frame is worth a remark."""
MATTERS = 0.005
"""Sizes of the object below which no length is worth a remark. A near-perfect stapler of 19 cm has frames with three
medians of residual, .3 mm."""


@dataclass(frozen=True)
class Remark:
    """One thing to distrust."""

    text: str
    frames: tuple[int, int] | None = None
    """First and last frame, or None when it is about the whole video."""

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
    """Charts of residuals, labels, gaps and steps; those that need a method's own diagnostics only when given."""
    motion = motion_of(result)
    percent, mm = 100.0, 1000.0
    unseen = np.asarray(~result.seen.all(1))
    charts: list[Chart] = []
    if diagnostics is not None:
        d = diagnostics
        moving_jointed = Curve("moving, by the joint", GAP, mm * d.jointed_residual_m[:, 1], "dashed")
        residual = Chart(
            "Residual",
            "mm",
            (*_both(mm * d.residual_m), moving_jointed),
            "Root mean square distance of each part's points to its surface in other frames. When the dashed line lies "
            "above the moving part's own, the joint does not explain what was measured.",
        )
        charts += [
            residual,
            Chart(
                "Met surface",
                "%",
                _both(percent * d.inliers),
                f"Share of each part's points that meet its surface in other frames within {mm * d.gate_m:.1f} mm.",
                100.0,
            ),
            Chart(
                "Off the mask",
                "%",
                _both(percent * d.outside),
                "Share of each part's points that fall off the foreground in other frames.",
                5.0,
            ),
            Chart("Label confidence", "%", _both(percent * d.confidence), "Mean probability of the labels.", 100.0),
            *_surface_charts(d),
        ]
    charts += [
        Chart(
            "Off the joint: turn",
            "°",
            (Curve("moving part", GAP, np.degrees(motion.gap_angle)),),
            "Angle between the moving part's measured pose and where the reference part and the joint put it.",
        ),
        Chart(
            "Off the joint: shift",
            "mm",
            (Curve("moving part", GAP, mm * motion.gap_distance),),
            "Distance between the moving part's measured middle and where the reference part and the joint put it.",
        ),
        Chart("Turn a frame", "°", _both(np.degrees(motion.step_angle)), "Rotation of each part since the last frame."),
        Chart("Shift a frame", "mm", _both(mm * motion.step_distance), "Way of each part's middle since then."),
        Chart("Pixels", "thousands", _both(_pixels(result) / 1000), "Pixels of each part in the picture."),
    ]
    note = "Grey: frames in which a part was not seen. Nothing here knows the truth."
    if diagnostics is None:
        note += " The method wrote no diagnostics: residuals and confidence are not known."
    elif diagnostics.extent_ratio is not None and diagnostics.seen_share is not None:
        extents, shares = diagnostics.extent_ratio, percent * diagnostics.seen_share
        note += (
            f" Surfaces of reference and moving part extend over {extents[0]:.2g} and {extents[1]:.2g} times what "
            f"their pixels span; {shares[0]:.0f} and {shares[1]:.0f} % of them were seen where they are."
        )
    return curves_section("Frame by frame", tuple(charts), abscissa, timed, unseen, note)


def _surface_charts(d: Diagnostics) -> list[Chart]:
    """What the surfaces, posed by joint and states, look like beside the video, as far as that was measured."""
    shares = (
        ("On no surface", d.uncovered, "Share of each part's pixels on which neither surface lies.", 5.0),
        ("Surface off the mask", d.spilled, "Share of each part's drawn surface off the object's mask.", 5.0),
        ("Off the surface", d.off_surface, "Share of each part's pixels whose depth lies off its surface.", 5.0),
    )
    charts = [Chart(title, "%", _both(100 * v), text, top) for title, v, text, top in shares if v is not None]
    if d.colour_residual is not None:
        about = "Median distance of the surface's colours to the picture's, CIELAB, lightness damped."
        charts.append(Chart("Colours", "CIELAB", _both(d.colour_residual), about))
    return charts


def remarks_section(result: Reconstruction, diagnostics: Diagnostics | None) -> Section:
    """The remarks as a list; a click on the frames shows them."""
    found = remarks(result, diagnostics)
    lines = []
    for remark in found[:MOST_REMARKS]:
        go = "" if remark.frames is None else f'<button type="button" data-frame="{_middle_of(remark)}">'
        where = f"{go}{remark.where.capitalize()}</button>: " if go else ""
        text = remark.text if go else remark.text[:1].upper() + remark.text[1:]
        lines.append(f"<li>{where}{escape(text)}.</li>")
    if len(found) > MOST_REMARKS:
        lines.append(f"<li>And {len(found) - MOST_REMARKS} more of the same kinds.</li>")
    if not found:
        lines = ["<li class=fine>Nothing stands out.</li>"]
    return Section(
        "What to distrust", f'<ul class="remarks">{"".join(lines)}</ul>', "remarks", {"n": len(found)}, "right"
    )


def remarks(result: Reconstruction, diagnostics: Diagnostics | None = None) -> list[Remark]:
    """What to distrust, in plain words: the reasons to doubt the whole answer, then frame by frame.

    Those of the answer itself (`trust`) when it gives any. Of frames only what matters at the object's size.
    """
    motion = motion_of(result)
    trust = result.trust or judge(result, diagnostics)
    found = [*map(Remark, trust.reasons), *_unseen(result)]
    unit, factor = display_unit(result.articulation.joint.type)
    size = size_of(result)
    for k, part in enumerate(("reference", "moving")):
        if diagnostics is not None:
            d = diagnostics
            finest = max(0.5 * d.footprint_m, d.noise_m, MATTERS * size)
            found += _high(d.residual_m[:, k], finest, 1000, "mm", f"the residual of the {part} part is")
            found += _low_shares(
                d.inliers[:, k], 0.6, f"only {{:.0f}} % of the {part} part's points meet its surface in other frames"
            )
            found += _low_shares(
                d.confidence[:, k], 0.75, f"the {part} part's labels are only {{:.0f}} % sure on average"
            )
            found += _high(
                d.outside[:, k], 0.05, 100, "%", f"the {part} part's points off the mask in other frames are"
            )
        found += _jumps(np.degrees(motion.step_angle[:, k]), 3.0, "°", f"the {part} part turns by")
        found += _jumps(1000 * motion.step_distance[:, k], 20 * size, "mm", f"the {part} part shifts by")
    found += _off_the_joint(motion, size)
    if result.state_std is not None:
        least = np.radians(1.0) if result.articulation.joint.type == "revolute" else MATTERS * size
        found += _high(result.state_std, least, factor, unit, "the standard deviation of the state is")
    whole, some = [r for r in found if r.frames is None], [r for r in found if r.frames is not None]
    return whole + sorted(some, key=lambda r: r.frames or (0, 0))


# ---------------------------------------------------------------- what is worth a remark


def _unseen(result: Reconstruction) -> list[Remark]:
    found, last = [], len(result) - 1
    for run in runs(~result.seen[:, 1]):
        inside = run[0] > 0 and run[-1] < last
        then = "states there are interpolated" if inside else "states there are not measured"
        found.append(Remark(f"the moving part was not seen; {then}", _ends(run)))
    for run in runs(~result.seen[:, 0]):
        found.append(Remark("the reference part was not seen; its poses there are guessed", _ends(run)))
    return found


def _high(values: Array, floor: float, factor: float, unit: str, what: str) -> list[Remark]:
    """A remark a run of frames with values beyond SPIKE medians and `floor`."""
    known = values[np.isfinite(values)]
    if not len(known):
        return []
    median = float(np.median(known))
    found = []
    for run in _near_runs(np.nan_to_num(values) > max(SPIKE * median, floor)):
        most = float(np.nanmax(values[run]))
        times = f", {most / median:.0f} times the median" if median > 0 and most < 1000 * median else ""
        upto = "up to " if len(run) > 1 else ""
        found.append(Remark(f"{what} {upto}{factor * most:.3g}{_spaced(unit)}{times}", _ends(run)))
    return found


def _off_the_joint(motion: Motion, size: float) -> list[Remark]:
    """A remark a run of frames whose angle or distance off the joint is far beyond the median and one half percent."""
    angle, distance = np.nan_to_num(motion.gap_angle), np.nan_to_num(motion.gap_distance)
    usual = median(motion.gap_angle), median(motion.gap_distance)
    far = (angle > max(SPIKE * usual[0], np.radians(1.0))) | (distance > max(SPIKE * usual[1], MATTERS * size))
    return [
        Remark(
            f"the moving part's measured pose lies off the joint by {'up to ' * (len(run) > 1)}"
            f"{np.degrees(angle[run].max()):.3g}° and {1000 * distance[run].max():.3g} mm; the medians are "
            f"{np.degrees(usual[0]):.2g}° and {1000 * usual[1]:.2g} mm",
            _ends(run),
        )
        for run in _near_runs(far)
    ]


def _low_shares(values: Array, least: float, what: str) -> list[Remark]:
    """A remark a run of frames with shares below `least`; `what` has a place for the lowest, percent."""
    found = []
    for run in _near_runs(np.nan_to_num(values, nan=1.0) < least):
        low = float(np.nanmin(values[run]))
        found.append(Remark(what.format(100 * low), _ends(run)))
    return found


def _jumps(values: Array, floor: float, unit: str, what: str) -> list[Remark]:
    """A remark a frame whose step, far larger than those around it and than `floor`, is `outstanding`."""
    return [
        Remark(f"{what} {values[i]:.3g}{_spaced(unit)} in one frame, far more than before and after", (i, i))
        for i in map(int, outstanding(values, floor, JUMP))
    ]


def _near_runs(flags: NDArray[np.bool_], bridge: int = 3) -> list[NDArray[np.int64]]:
    """Runs of True, joined over up to `bridge` - 1 frames of False."""
    index = np.flatnonzero(flags)
    pieces = np.split(index, np.flatnonzero(np.diff(index) > bridge) + 1) if len(index) else []
    return [np.arange(piece[0], piece[-1] + 1) for piece in pieces]


def _ends(run: NDArray[np.int64]) -> tuple[int, int]:
    return int(run[0]), int(run[-1])


def _middle_of(remark: Remark) -> int:
    assert remark.frames is not None
    return sum(remark.frames) // 2


def _both(values: Array) -> tuple[Curve, ...]:
    return tuple(Curve(name, COLOURS[k], values[:, k]) for k, name in enumerate(PARTS))


def _pixels(result: Reconstruction) -> Array:
    """(n, 2) pixels of each part."""
    return np.stack([(result.part_masks == k).sum((1, 2)) for k in (1, 2)], 1).astype(float)


def _spaced(unit: str) -> str:
    return unit if unit == "°" else f" {unit}"
