"""Whether to trust a result, judged from the result itself, without ground truth.

For a correct result every frame is explained to the noise by two motions and no third; both parts are visible; each
part follows its own motion and not the other's; the other joint type, and any other state, explains the video much
worse; states change smoothly; and the surfaces, posed by joint and states, match the video in every frame. Each check
below tests one of these. Lengths are judged relative to the object's size and a pixel's footprint. The measurements at
the constants are of right and wrong answers of benchmarks/trust.py (320 x 180 pixels, 48 frames).
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from freeart21 import se3
from freeart21.articulation import PARTS
from freeart21.files.diagnostics import Diagnostics
from freeart21.joint import Joint
from freeart21.mesh import Mesh, bounding_diagonal, box_centre
from freeart21.reconstruction import Reconstruction, Trust
from freeart21.se3 import Array

MIN_SEEN = 0.5
"""Share of frames that must show each part. Right answers: 0.70 and more; the other states are interpolated."""
MAX_EXTRAPOLATED = 0.25
"""Share of frames before the first, or after the last, that shows both parts: their states are extrapolated. Right
answers: up to 0.23; wrong ones: 0.33."""
MAX_OFF_JOINT = 0.02
"""Displacement between the moving part's measured poses and the joint, in object sizes: rms over its vertices, median
over the frames. Right answers: up to 1.4 %, in a hand; wrong ones: 4.7 %. Angles would not do for a thin part."""
SIGMAS_OFF_JOINT = 2.0
"""Standard deviations of the measured poses that such a displacement is not judged by: 95 % of normal errors."""
MAX_RESIDUAL, MAX_RESIDUAL_SHARE = 1.5, 0.005
"""Median residual, in footprints or standard deviations of depth, whichever is more, and in object sizes. Right
answers: up to 0.6 and 0.002; two doors: 1.5 and 0.01."""
MIN_INLIERS = 0.75
"""Median share of a part's points that meet its surface in other frames. Right: 0.93 and more; two doors: 0.64."""
MIN_LABEL_PROBABILITY = 0.8
"""Median probability of the labels. Right answers: 0.83 and more; wrong ones: 0.66."""
MAX_JOINT_RATIO, MAX_JOINT_SHARE = 1.3, 0.001
"""Moving part's residual under the joint: its ratio to that without it, and the difference in object sizes."""
MAX_THIRD_MOTION = 0.008
"""Share of the pixels that follow neither motion, in a tenth of the frames. Right ones: up to 0.003; wrong: 0.017."""
MIN_OTHER_COST = 0.5
"""Median cost of a part's pixels under the other part's motion; 0.5 is a misfit of one standard deviation. Right
answers: 0.76 and more; a faucet whose round base turns unseen: 0.25."""
MAX_RIVALS, REACH_OF_RIVAL = 0.25, 1 / 3
"""Share of frames that another state explains as well; and the largest change of the state per frame, relative to the
distance of that state: above a half, extrapolation leads to the wrong one. Only a fan has such states."""
MAX_AXIS_STD, MAX_PIVOT_STD = np.radians(5.0), 0.05
"""Standard deviations of the axis, and of the pivot in object sizes: the benchmark's limits of a wrong answer."""
MIN_ANGLE, MIN_SLIDE = np.radians(10.0), 0.05
"""Range of motion, in object sizes for a slide, below which the axis is uncertain when the method does not estimate
it."""
JUMP, JUMP_ANGLE, JUMP_SHARE = 4.0, np.radians(20.0), 0.1
"""A jump of the state exceeds this times the steps two and three frames before and after, and this angle, or distance
in object sizes. Right answers have steps of 26 degrees among similar ones."""
MAX_TURN_PER_FRAME = np.radians(15.0)
"""Median turn of a part per frame. People who handle objects: 0.1 to 4 degrees, 15 at the 95th percentile."""

MAX_UNCOVERED = 0.01
"""Share of a part's pixels on neither surface, in a tenth of the frames. Right answers, 24 recordings: 0 in 22, 0.007,
and 0.024 with poses off in a sixth of the frames. A tenth of a surface missing: 0.08 and more in six of eight; poses 2
to 4 degrees off: 0.25 and more."""
MAX_SPILLED = 0.04
"""Median share of a rendered surface off the mask. Right answers: 0; parts larger by 15 %: 0.06 to 0.21."""
MAX_OFF_SURFACE = 0.015
"""Median share of a part's pixels whose depth lies off its surface. Right answers: up to 0.010; an axis 1.4 degrees
off: 0.021."""
MAX_OFF_COLOUR = 8.0
"""Median colour difference. Right answers: up to 1.6, unlit; inverted colours: 17 and more; wrong labels: 9.5."""
EXTENT_RATIOS = 0.6, 2.0
"""Limits of a part's extent relative to the span of its pixels. Right ones: 0.75 to 1.6; half a surface: 0.5 to 1."""
MIN_SURFACE_SEEN = 0.75
"""Share of a part's surface on which some frame measured depth, without detached components that were seen at one state
only. Right answers: 0.81 and more; wrong ones: 0.74 and less."""


def judge(result: Reconstruction, diagnostics: Diagnostics | None = None) -> Trust:
    """Sound, or doubtful with all reasons. With the method's own diagnostics, more is checked."""
    reasons = [*_doubts_of_poses(result)]
    if diagnostics is not None:
        reasons += _doubts_of_agreement(diagnostics, result)
        reasons += [text for k in range(len(PARTS)) for text in _surface_off_video(diagnostics, k)]
    return Trust("doubtful" if reasons else "sound", tuple(reasons))


# ---------------------------------------------------------------- motion from the poses


@dataclass(frozen=True)
class Motion:
    """Motion of both parts over n frames, from the poses; NaN where a part was not seen."""

    gap_angle: Array
    """(n,) rad: rotation between the moving part's measured pose and the one from reference part and joint."""
    gap_distance: Array
    """(n,) metres: displacement of the moving part's middle between the two."""
    gap_surface: Array
    """(n,) metres: rms displacement of the moving part's vertices between the two."""
    step_angle: Array
    """(n, 2) rad: rotation of each part since the frame before; NaN in frame 0."""
    step_distance: Array
    """(n, 2) metres: displacement of each part's middle since the frame before; NaN in frame 0."""


def measure_motion(result: Reconstruction) -> Motion:
    """Gaps to the joint and steps of both parts, for a result of any method."""
    articulation, seen = result.articulation, result.seen
    Ts = np.stack([result.Ts_camera_reference, result.Ts_camera_moving], 1)
    centres = [box_centre(articulation.part(name)) for name in PARTS]
    gap = se3.inverse(Ts[:, 0] @ articulation.joint.transform(result.states)) @ Ts[:, 1]
    moved = se3.transform(gap, centres[1][None, None])[:, 0]
    both = seen.all(1)
    angle = np.full((len(result), 2), np.nan)
    distance = angle.copy()
    for k, centre in enumerate(centres):
        in_both = seen[1:, k] & seen[:-1, k]
        turn = se3.rotation_angle(Ts[1:, k, :3, :3] @ np.swapaxes(Ts[:-1, k, :3, :3], 1, 2))
        at = se3.transform(Ts[:, k], centre[None, None])[:, 0]
        angle[1:, k] = np.where(in_both, turn, np.nan)
        distance[1:, k] = np.where(in_both, np.linalg.norm(np.diff(at, axis=0), axis=-1), np.nan)
    return Motion(
        np.where(both, se3.rotation_angle(gap[:, :3, :3]), np.nan),
        np.where(both, np.linalg.norm(moved - centres[1], axis=-1), np.nan),
        np.where(both, _rms_displacement(gap, articulation.moving), np.nan),
        angle,
        distance,
    )


def _rms_displacement(Ts: Array, mesh: Mesh) -> Array:
    """(n,) metres: rms displacement of the vertices of `mesh` by rigid motions (n, 4, 4); 0 when it is empty.

    The mean of |R x + t - x|^2 over points of mean m and covariance C is |R m + t - m|^2 + tr((R - I) C (R - I)^T).
    """
    if mesh.empty:
        return np.zeros(len(Ts))
    used = mesh.vertices[np.unique(mesh.faces)]
    mean, spread = used.mean(0), np.cov(used.T, bias=True)
    turn = Ts[:, :3, :3] - np.eye(3)
    shift = turn @ mean + Ts[:, :3, 3]
    return np.sqrt((shift**2).sum(1) + np.einsum("nij,jk,nik->n", turn, spread, turn))


def object_size(result: Reconstruction) -> float:
    """Metres: diagonal of both parts at the first state; 1 when they are empty."""
    a = result.articulation
    return bounding_diagonal(a.reference, a.moving.moved(a.joint.transform(float(result.states[0])))) or 1.0


def state_steps(result: Reconstruction) -> Array:
    """(n,) change of the state, rad or m, since the last frame in which both parts were seen; NaN in other frames.

    Over frames that hide a part, it is the total change.
    """
    found = np.full(len(result), np.nan)
    frames = np.flatnonzero(result.seen.all(1))
    found[frames[1:]] = np.abs(np.diff(result.states[frames]))
    return found


def find_jumps(values: Array, floor: float, times: float) -> NDArray[np.int64]:
    """Where `values` (n,) exceed `floor`, and `times` those two and three frames before and after.

    The next neighbours do not count: a single bad frame makes two large steps, there and back.
    """
    padded = np.pad(values, 3, constant_values=np.nan)
    found = []
    for i in map(int, np.flatnonzero(np.nan_to_num(values) > floor)):
        around = padded[[i, i + 1, i + 5, i + 6]]
        around = around[np.isfinite(around)]
        if len(around) >= 2 and values[i] > times * around.max():
            found.append(i)
    return np.array(found, np.int64)


# ---------------------------------------------------------------- checks


def _doubts_of_poses(result: Reconstruction) -> Iterator[str]:
    """Reasons to doubt the poses, the states and the joint, from these alone."""
    joint, seen, n = result.articulation.joint, result.seen, len(result)
    motion, size = measure_motion(result), object_size(result)
    in_both = np.asarray(seen.all(1))
    both = np.flatnonzero(in_both)
    ends = [] if not len(both) else [("before", both[0], both[0]), ("after", both[-1], n - 1 - both[-1])]
    for where, at, count in ends:
        if count > MAX_EXTRAPOLATED * n:
            yield f"no frame {where} frame {at} shows both parts: {count} of {n} states are extrapolated"
    for k, part in enumerate(PARTS):
        if seen[:, k].mean() < MIN_SEEN:
            yield f"the {part} part was seen in only {int(seen[:, k].sum())} of {n} frames"
    turn = np.nanmax(np.nan_to_num(motion.step_angle[1:]), axis=1)
    median_turn = float(np.median(turn)) if len(turn) else 0.0
    if median_turn > MAX_TURN_PER_FRAME:
        degrees = np.degrees(median_turn)
        yield f"a part turns by {degrees:.0f}° from frame to frame in the median: film slower, or more frames"

    steps = np.where(np.r_[False, in_both[:-1]], state_steps(result), np.nan)  # over a gap it is no step of a frame
    jumps = find_jumps(steps, JUMP_ANGLE if joint.type == "revolute" else JUMP_SHARE * size, JUMP)
    if len(jumps):
        frames = ", ".join(map(str, jumps[:5])) + (" and others" if len(jumps) > 5 else "")
        yield f"the state jumps by up to {_format_state(float(steps[jumps].max()), joint)} in one frame ({frames})"

    uncertain = SIGMAS_OFF_JOINT * _pose_uncertainty(result)
    off = median(np.sqrt(np.maximum(motion.gap_surface**2 - uncertain**2, 0)))
    if off > MAX_OFF_JOINT * size:
        yield (
            f"the moving part's measured poses lie off the joint by {1000 * off:.2g} mm, {100 * off / size:.2g} % of "
            "the object, in the median: joint, labels or poses are wrong"
        )

    if result.axis_std is None:
        span = float(np.ptp(result.states[seen[:, 1]])) if seen[:, 1].any() else 0.0
        if span < (MIN_ANGLE if joint.type == "revolute" else MIN_SLIDE * size):
            yield f"the joint moves by only {_format_state(span, joint)}, which says little of its axis"
    elif result.axis_std > MAX_AXIS_STD:
        yield f"the axis is known to {np.degrees(result.axis_std):.2g}° only (one standard deviation)"
    if result.pivot_std is not None and result.pivot_std > MAX_PIVOT_STD * size:
        yield f"the axis line is known to {1000 * result.pivot_std:.2g} mm only (one standard deviation)"
    for other in result.alternatives:
        costs = f"only {other.cost_difference:.2g}" if other.cost_difference > 0 else "no"
        yield f"revolute or prismatic is undecided: under a {other.joint.type} joint a pixel costs {costs} more"


def _pose_uncertainty(result: Reconstruction) -> Array:
    """(n,) metres: rms displacement of the moving part's vertices by errors of both parts' measured poses, one standard
    deviation; 0 where the result gives none.

    A near-symmetric part's own pose is undetermined about its axis.
    """
    mesh = result.articulation.moving
    if result.covariances is None or mesh.empty:
        return np.zeros(len(result))
    used, Ts = mesh.vertices[np.unique(mesh.faces)], result.Ts_camera_moving
    mean = se3.transform(Ts, used.mean(0)[None, None])[:, 0]
    moments = Ts[:, :3, :3] @ np.cov(used.T, bias=True) @ np.swapaxes(Ts[:, :3, :3], 1, 2)
    moments = moments + mean[:, :, None] * mean[:, None]
    C = np.nan_to_num(result.covariances).sum(1)
    turned = np.trace(moments, axis1=1, axis2=2)[:, None, None] * np.eye(3) - moments
    of_v, of_both, of_w = C[:, :3, :3], C[:, :3, 3:] * se3.hat(mean), C[:, 3:, 3:] * turned
    variance = np.trace(of_v, axis1=1, axis2=2) + (of_w - 2 * of_both).sum((1, 2))  # of v + w x X
    return np.sqrt(np.maximum(variance, 0))


def _doubts_of_agreement(d: Diagnostics, result: Reconstruction) -> Iterator[str]:
    """Reasons to doubt that two motions and the joint explain the video, from the method's diagnostics."""
    worst = max(MAX_RESIDUAL * max(d.footprint_m, d.noise_m), MAX_RESIDUAL_SHARE * d.diagonal_m)
    for k, part in enumerate(PARTS):
        residual, met, sure = (median(values[:, k]) for values in (d.residual_m, d.inliers, d.confidence))
        if residual > worst:
            yield (
                f"the {part} part's residual is {1000 * residual:.2g} mm in the median, a pixel covers "
                f"{1000 * d.footprint_m:.2g} mm"
            )
        if met < MIN_INLIERS:
            yield f"only {100 * met:.0f} % of the {part} part's points meet its surface in other frames"
        if sure < MIN_LABEL_PROBABILITY:
            yield f"the {part} part's labels are only {100 * sure:.0f} % sure in the median"

    free, bound = d.residual_m[:, 1], d.jointed_residual_m[:, 1]
    both = np.isfinite(free) & np.isfinite(bound)
    a, b = median(free[both]), median(bound[both])
    least = max(0.1 * max(d.footprint_m, d.noise_m), MAX_JOINT_SHARE * d.diagonal_m)
    if b > MAX_JOINT_RATIO * a and b - a > least:
        yield (
            f"under the joint the moving part's residual is {1000 * b:.2f} mm, without it {1000 * a:.2f} mm: the joint "
            "does not explain the motion"
        )

    third = _ninth_decile(d.unexplained)
    if third > MAX_THIRD_MOTION:
        yield (
            f"{100 * third:.1f} % of the object's pixels follow neither part's motion in a tenth of the frames: a "
            "third part moves, or labels or poses are wrong"
        )
    for k, part in enumerate(PARTS):
        if d.other_motion_cost is not None and median(d.other_motion_cost[:, k]) < MIN_OTHER_COST:
            yield (
                f"the {part} part's pixels follow the other part's motion within the noise: what it does itself is not "
                "seen"
            )

    tested = np.zeros(0) if d.rival_distance is None else d.rival_distance[np.isfinite(d.rival_distance)]
    rivals = tested[tested > 0]
    if len(rivals) and len(rivals) >= MAX_RIVALS * len(tested):
        away, step = median(rivals), float(np.nanmax(np.nan_to_num(state_steps(result))))
        if step >= REACH_OF_RIVAL * away:
            far, joint = _format_state(away, result.articulation.joint), result.articulation.joint
            yield (
                f"a state {far} away explains {100 * len(rivals) / len(tested):.0f} % of the frames as well, and the "
                f"state moves by up to {_format_state(step, joint)} between frames: it may be off by as much"
            )


def _ninth_decile(values: Array | None) -> float:
    """What a tenth of the finite values exceed; 0 when there are none."""
    known = np.zeros(0) if values is None else values[np.isfinite(values)]
    return float(np.percentile(known, 90)) if len(known) else 0.0


def _surface_off_video(d: Diagnostics, k: int) -> Iterator[str]:
    """How the surface of part `k`, posed by joint and states, contradicts the video."""
    part = PARTS[k]
    uncovered, spilled, off, colour = (
        np.zeros(0) if values is None else values[:, k]
        for values in (d.uncovered, d.spilled, d.off_surface, d.colour_residual)
    )
    ratio, seen = (np.nan if values is None else float(values[k]) for values in (d.extent_ratio, d.seen_share))
    if not EXTENT_RATIOS[0] <= ratio <= EXTENT_RATIOS[1] and np.isfinite(ratio):
        yield f"the {part} part's surface extends over {ratio:.3g} times what its pixels span"
    if (share := _ninth_decile(uncovered)) > MAX_UNCOVERED:
        yield (
            f"{100 * share:.3g} % of the {part} part's pixels lie on neither surface in a tenth of the frames, most in "
            f"frame {int(np.nanargmax(uncovered))}: a piece is missing, or poses, joint, states or surface are wrong"
        )
    if median(spilled) > MAX_SPILLED:
        yield f"{100 * median(spilled):.0f} % of the {part} part's surface lies off the mask in the median"
    if median(off) > MAX_OFF_SURFACE:
        yield (
            f"{100 * median(off):.3g} % of the {part} part's pixels lie off its surface in the median: joint, states "
            "or surface are wrong"
        )
    if median(colour) > MAX_OFF_COLOUR:
        yield f"the {part} part's colours are not those of the video: {median(colour):.0f} CIELAB units away"
    if seen < MIN_SURFACE_SEEN:
        yield (
            f"only {100 * seen:.0f} % of the {part} part's surface was seen where it is, in pieces that are known to "
            "move with it"
        )


def median(values: Array) -> float:
    """The median of the finite values; NaN when there are none."""
    known = values[np.isfinite(values)]
    return float(np.median(known)) if len(known) else np.nan


def _format_state(state: float, joint: Joint) -> str:
    return f"{np.degrees(state):.0f}°" if joint.type == "revolute" else f"{1000 * state:.2g} mm"
