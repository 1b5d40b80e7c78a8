"""Why a result is good or bad, judged without the truth: what its parts, poses and joint say of each other."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from freeart21 import se3
from freeart21.articulation import PARTS
from freeart21.files.diagnostics import Diagnostics
from freeart21.mesh import bounding_diagonal
from freeart21.reconstruction import Reconstruction
from freeart21.se3 import Array
from freeart21.view.curves import Chart, Curve, curves_section
from freeart21.view.document import MOVING, REFERENCE, Section, escape
from freeart21.view.parts import middle
from freeart21.view.plot import display_unit, runs

COLOURS = (REFERENCE, MOVING)
GAP = "#AA3377"
MOST_REMARKS = 14
SPIKE = 3.0
"""Medians above which a frame is worth a remark."""


@dataclass(frozen=True)
class Motion:
    """What the poses of n frames say; NaN where a part was not seen."""

    gap_angle: Array
    """(n,) rad: turn between where the moving part was measured and where reference part and joint put it."""
    gap_distance: Array
    """(n,) metres: displacement of the moving part's middle between the two."""
    step_angle: Array
    """(n, 2) rad: turn of each part since the frame before; NaN in frame 0."""
    step_distance: Array
    """(n, 2) metres: displacement of each part's middle since the frame before; NaN in frame 0."""


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


def motion_of(result: Reconstruction) -> Motion:
    """Gaps to the joint and steps of both parts, from the poses alone: for a result of any method."""
    articulation, seen = result.articulation, result.seen
    Ts = np.stack([result.Ts_camera_reference, result.Ts_camera_moving], 1)
    centres = [middle(articulation.part(name)) for name in PARTS]
    gap = se3.inverse(Ts[:, 0] @ articulation.joint.transform(result.states)) @ Ts[:, 1]
    moved = se3.transform(gap, centres[1][None, None])[:, 0]
    both = seen.all(1)
    angle = np.full((len(result), 2), np.nan)
    distance = angle.copy()
    for k, centre in enumerate(centres):
        kept = seen[1:, k] & seen[:-1, k]
        turn = se3.rotation_angle(Ts[1:, k, :3, :3] @ np.swapaxes(Ts[:-1, k, :3, :3], 1, 2))
        at = se3.transform(Ts[:, k], centre[None, None])[:, 0]
        angle[1:, k] = np.where(kept, turn, np.nan)
        distance[1:, k] = np.where(kept, np.linalg.norm(np.diff(at, axis=0), axis=-1), np.nan)
    return Motion(
        np.where(both, se3.rotation_angle(gap[:, :3, :3]), np.nan),
        np.where(both, np.linalg.norm(moved - centres[1], axis=-1), np.nan),
        angle,
        distance,
    )


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
        moving_jointed = Curve("moving, by the joint", GAP, mm * d.jointed_residual_m[:, 1], dashed=True)
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
    return curves_section("Frame by frame", tuple(charts), abscissa, timed, unseen, note)


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
    """What to distrust, in plain words: first what is about the whole video, then frame by frame."""
    motion = motion_of(result)
    found = [*_of_all(result, diagnostics), *_unseen(result)]
    unit, factor = display_unit(result.articulation.joint.type)
    size = _size(result)
    for k, part in enumerate(("reference", "moving")):
        if diagnostics is not None:
            d = diagnostics
            finest = max(0.5 * d.footprint_m, d.noise_m)
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
        least = np.radians(1.0) if result.articulation.joint.type == "revolute" else 0.005 * size
        found += _high(result.state_std, least, factor, unit, "the standard deviation of the state is")
    whole, some = [r for r in found if r.frames is None], [r for r in found if r.frames is not None]
    return whole + sorted(some, key=lambda r: r.frames or (0, 0))


# ---------------------------------------------------------------- what is worth a remark


def _of_all(result: Reconstruction, diagnostics: Diagnostics | None) -> list[Remark]:
    found = []
    joint, states, seen = result.articulation.joint, result.states, result.seen
    unit, factor = display_unit(joint.type)
    measured = states[seen[:, 1]] if seen[:, 1].any() else states
    span, few = float(np.ptp(measured)), np.radians(10.0) if joint.type == "revolute" else 0.05 * _size(result)
    if span < few:
        found.append(
            Remark(f"the joint moves by only {factor * span:.1f}{_spaced(unit)}, which says little of its axis")
        )
    pixels = _pixels(result)
    share = float(pixels[:, 1].sum() / max(pixels.sum(), 1))
    if share < 0.05:
        found.append(Remark(f"the moving part has only {100 * share:.1f} % of the object's pixels"))
    for k, part in enumerate(("reference", "moving")):
        if seen[:, k].mean() < 0.5:
            found.append(Remark(f"the {part} part was seen in only {int(seen[:, k].sum())} of {len(seen)} frames"))
    motion = motion_of(result)
    for gap, most, factor, unit in (
        (motion.gap_angle, np.radians(2.0), 180 / np.pi, "°"),
        (motion.gap_distance, 0.01 * _size(result), 1000.0, "mm"),
    ):
        usual = _median(gap)
        if usual > most:
            found.append(
                Remark(
                    f"the moving part's measured poses lie off the joint by {factor * usual:.2g}{_spaced(unit)} in the "
                    "median: joint, labels or poses are wrong"
                )
            )
    if diagnostics is not None:
        found += _of_all_measured(diagnostics)
    return found


def _of_all_measured(d: Diagnostics) -> list[Remark]:
    found, finest = [], max(d.footprint_m, d.noise_m)
    for k, part in enumerate(("reference", "moving")):
        residual, met, sure = (_median(values[:, k]) for values in (d.residual_m, d.inliers, d.confidence))
        if residual > 1.5 * finest:
            found.append(
                Remark(
                    f"the {part} part's residual is {1000 * residual:.2g} mm in the median, a pixel covers "
                    f"{1000 * d.footprint_m:.2g} mm"
                )
            )
        if met < 0.75:
            where = "meet its surface in other frames, in the median"
            found.append(Remark(f"only {100 * met:.0f} % of the {part} part's points {where}"))
        if sure < 0.85:
            found.append(Remark(f"the {part} part's labels are only {100 * sure:.0f} % sure in the median"))
    free, bound = d.residual_m[:, 1], d.jointed_residual_m[:, 1]
    both = np.isfinite(free) & np.isfinite(bound)
    a, b = _median(free[both]), _median(bound[both])
    if b > 1.3 * a and b - a > 0.1 * finest:
        found.append(
            Remark(
                f"under the joint the moving part's residual is {1000 * b:.2f} mm, without it {1000 * a:.2f} mm: "
                "the joint does not explain the motion"
            )
        )
    return found


def _median(values: Array) -> float:
    """The median of what is known; NaN, which compares with nothing, when nothing is."""
    known = values[np.isfinite(values)]
    return float(np.median(known)) if len(known) else np.nan


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
    usual = _median(motion.gap_angle), _median(motion.gap_distance)
    far = (angle > max(SPIKE * usual[0], np.radians(1.0))) | (distance > max(SPIKE * usual[1], 0.005 * size))
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
    """Steps far larger than those two and three frames before and after, and than `floor`.

    A single bad pose makes two large steps, one there and one back: next neighbours do not count.
    """
    found = []
    padded = np.pad(values, 3, constant_values=np.nan)
    for i in map(int, np.flatnonzero(np.nan_to_num(values) > floor)):
        around = padded[[i, i + 1, i + 5, i + 6]]
        around = around[np.isfinite(around)]
        if len(around) >= 2 and values[i] > 4 * around.max():
            text = f"{what} {values[i]:.3g}{_spaced(unit)} in one frame, its neighbours by {around.max():.2g}"
            found.append(Remark(text + _spaced(unit), (i, i)))
    return found


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


def _size(result: Reconstruction) -> float:
    """Metres: diagonal of both parts at the first state, 1 when they are empty."""
    a = result.articulation
    return bounding_diagonal(a.reference, a.moving.moved(a.joint.transform(float(result.states[0])))) or 1.0


def _spaced(unit: str) -> str:
    return unit if unit == "°" else f" {unit}"
