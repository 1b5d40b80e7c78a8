"""Whether to trust an answer, from what it says itself: no truth is asked.

If an answer is right, then every frame is explained to the noise, by two motions and no third; both parts were seen;
each part follows its own motion and not the other's as well; the other joint type, and any other state, explains the
video worse by far; states go on evenly, within the reach of what follows pictures; and the surfaces, posed by joint and
states, lie where the video shows the object, in every frame, and nowhere else. Each sign below is the failure
of one of these, by more than matters: lengths are judged against the object's size and what a pixel covers. What was
measured of right and wrong answers stands beside each constant (benchmarks/trust.py, 320 x 180 pixels, 48 frames).
"""

from __future__ import annotations

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

LEAST_SEEN = 0.5
"""Share of frames that must show each part. Right answers: .70 and more, the rest lies between frames that show it."""
EXTRAPOLATED = 0.25
"""Share of frames before the first or after the last that shows both parts: what lies between two of them is bound by
both, what lies beyond is a guess. Right answers: up to .23; a lighter whose states in the last third are wrong: .33."""
OFF_JOINT_SHARE = 0.02
"""Displacement in sizes, rms over the moving part's vertices and median over the frames, of its measured poses against
the joint. Right answers: up to 1.4 %, in a hand; two doors taken for one joint: 4.7 %. Angles say nothing of a part as
thin as a lighter's lever, which a right answer turns by 5 degrees and so shifts by .5 %."""
RESIDUAL, RESIDUAL_SHARE = 1.5, 0.005
"""Median residual in pixels' widths or standard deviations of depth, whichever is more, and in sizes. Right answers: up
to .6 and .002; two doors: 1.5 and .01."""
LEAST_MET = 0.75
"""Median share of a part's points that meet its surface in other frames. Right: .93 and more; two doors: .64."""
LEAST_SURE = 0.8
"""Median probability of the labels. Right answers: .93 and more, .83 of a hinge that moves by 3 degrees; a slide that
moves by 4 % of its range: .66."""
JOINT_WORSE, JOINT_WORSE_SHARE = 1.3, 0.001
"""The moving part's residual under the joint against that without it, times, and by how many sizes."""
THIRD_MOTION = 0.008
"""Share of the pixels that follow neither motion, in a tenth of the frames. Right answers: up to .003; a door beside a
drawer that moves, too: .017; two doors: .06."""
OWN_MOTION = 0.5
"""Median cost of a part's pixels under the other part's motion, where 0.5 is a misfit of one standard deviation. Right
answers: .76 and more (most above 1.3); a faucet whose round base turns unseen: .25."""
RIVALS, REACH_OF_RIVAL = 0.25, 1 / 3
"""Share of frames that another state explains as well, and the share of its distance that the state may change by in
one frame: beyond half of it, even motion leads to the wrong one. Only a fan has such states: a wing is 45 degrees from
the next, and it turns by up to 26 in a frame."""
TYPE_WORSE = 1.5
"""The other joint type must leave so many times the residual."""
AXIS_STD, PIVOT_STD_SHARE = np.radians(5.0), 0.05
"""Standard deviations of axis and, in sizes, pivot that an answer may have: what the benchmark calls wrong. Right
answers: up to 1.7 degrees, but 5.6 of a monitor that tilts by 31 and 6.4 of a hinge that moves by 3; two doors taken
for one joint: 62."""
LITTLE_ANGLE, LITTLE_SHARE = np.radians(10.0), 0.05
"""Motion of the joint, in sizes if it slides, that says little of its axis when the method does not say how much."""
JUMP, JUMP_ANGLE, JUMP_SHARE = 4.0, np.radians(20.0), 0.1
"""A step of the state that is so many times those two and three frames before and after, and more than this angle, or
distance in sizes. Right answers have steps of 26 degrees among their like."""
FASTEST = np.radians(15.0)
"""Median turn of a part in one frame. People who handle objects: .1 to 4 degrees, 15 at the 95th percentile; the
recorder's scripts: 2 to 4."""

MOST_UNCOVERED = 0.01
"""Share of a part's pixels on neither surface, in a tenth of the frames. Right answers, 24 recordings, clean and tof: 0
of 22, .007, and .024 of a stapler whose poses are off in a sixth of the frames (its Chamfer distance: .8 %). A tenth of
a surface missing: .08 to .78 of six, less than .01 of 2 of 12 others; half: .41 to 1; frames in which poses are 2 to 4
degrees off: .25 and .31; a phone whose slide was not recognised in a fifth of the frames (2.4 %): .06; a kettle whose
lid got a piece of the body (4.9 %): .013; depth of 65535 units taken as metres: .95."""
MOST_SPILLED = 0.04
"""Median share of a drawn surface off the mask. Right answers: 0; parts larger by 15 %: .06 to .21; inflated by 3 % of
the object: .11 to .23."""
MOST_OFF = 0.015
"""Median share of a part's pixels whose depth lies off its surface. Right answers: up to .010. Axes off by 10.7, 4.1,
3.2 and 1.4 degrees: .064, .17, .029 and .021; inflated by 3 % of the object: .85 and more."""
MOST_OFF_COLOUR = 8.0
"""Median distance of colours. Right answers: up to 1.6, unlit; colours inverted: 17 and more; wrong labels: 9.5."""
EXTENT_RATIOS = 0.6, 2.0
"""Extent of a part's surface over the span of its pixels. Right answers: .75 to 1.6; depth of 65535 units taken as
metres: 570 and 860; half a surface: .5 to 1."""
LEAST_SURFACE_SEEN = 0.75
"""Share of a part's surface on which some frame measured depth, without detached pieces that were seen at one state
alone. Right answers: .81 and more; axes off by 10.7 and 4.1 degrees: .74 and .58; lids of kettles with pieces of the
body, seen while the lid was up (Chamfer distances 6.9 and 4.9 %): .62 and .68; surfaces shifted by 5 % of the object,
or inflated by 3 %: .02 to .23."""


def judge(result: Reconstruction, diagnostics: Diagnostics | None = None) -> Trust:
    """Sound, or doubtful with all reasons; the more the method's own diagnostics tell, the more is asked of them."""
    motion, size = motion_of(result), size_of(result)
    reasons = [
        *_hardly_seen(result),
        *_too_fast(motion),
        *_jumps(result, size),
        *_off_the_joint(motion, size),
        *_joint_unsure(result, size),
    ]
    if diagnostics is not None:
        d = diagnostics
        reasons += [*_badly_met(d), *_joint_explains_less(d), *_third_motion(d), *_follows_the_other(d)]
        reasons += [*_either_type(d, result.articulation.joint), *_other_states(d, result)]
        reasons += [text for k in range(len(PARTS)) for text in _surface_elsewhere(d, k)]
    return Trust("doubtful" if reasons else "sound", tuple(reasons))


# ---------------------------------------------------------------- what the poses say


@dataclass(frozen=True)
class Motion:
    """What the poses of n frames say; NaN where a part was not seen."""

    gap_angle: Array
    """(n,) rad: turn between where the moving part was measured and where reference part and joint put it."""
    gap_distance: Array
    """(n,) metres: displacement of the moving part's middle between the two."""
    gap_surface: Array
    """(n,) metres: rms displacement of the moving part's vertices between the two."""
    step_angle: Array
    """(n, 2) rad: turn of each part since the frame before; NaN in frame 0."""
    step_distance: Array
    """(n, 2) metres: displacement of each part's middle since the frame before; NaN in frame 0."""


def motion_of(result: Reconstruction) -> Motion:
    """Gaps to the joint and steps of both parts, from the poses alone: for a result of any method."""
    articulation, seen = result.articulation, result.seen
    Ts = np.stack([result.Ts_camera_reference, result.Ts_camera_moving], 1)
    centres = [box_centre(articulation.part(name)) for name in PARTS]
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
        np.where(both, _rms_displacement(gap, articulation.moving), np.nan),
        angle,
        distance,
    )


def _rms_displacement(Ts: Array, mesh: Mesh) -> Array:
    """(n,) metres by which rigid motions (n, 4, 4) displace the vertices of `mesh`, rms over them; 0 when it is empty.

    The mean of |R x + t - x|^2 over points of mean m and covariance C is |R m + t - m|^2 + tr((R - I) C (R - I)^T).
    """
    if mesh.empty:
        return np.zeros(len(Ts))
    used = mesh.vertices[np.unique(mesh.faces)]
    mean, spread = used.mean(0), np.cov(used.T, bias=True)
    turn = Ts[:, :3, :3] - np.eye(3)
    shift = turn @ mean + Ts[:, :3, 3]
    return np.sqrt((shift**2).sum(1) + np.einsum("nij,jk,nik->n", turn, spread, turn))


def size_of(result: Reconstruction) -> float:
    """Metres: diagonal of both parts at the first state, 1 when they are empty."""
    a = result.articulation
    return bounding_diagonal(a.reference, a.moving.moved(a.joint.transform(float(result.states[0])))) or 1.0


def steps_of(result: Reconstruction) -> Array:
    """(n,) size of the state's change, rad or m, since the last frame in which both parts were seen; NaN in others.

    Over frames that hide a part it is the change over all of them.
    """
    found = np.full(len(result), np.nan)
    frames = np.flatnonzero(result.seen.all(1))
    found[frames[1:]] = np.abs(np.diff(result.states[frames]))
    return found


def outstanding(values: Array, floor: float, times: float) -> NDArray[np.int64]:
    """Where `values` (n,) exceed `floor`, and `times` those two and three frames before and after.

    A single bad frame makes two large steps, one there and one back: next neighbours do not count.
    """
    padded = np.pad(values, 3, constant_values=np.nan)
    found = []
    for i in map(int, np.flatnonzero(np.nan_to_num(values) > floor)):
        around = padded[[i, i + 1, i + 5, i + 6]]
        around = around[np.isfinite(around)]
        if len(around) >= 2 and values[i] > times * around.max():
            found.append(i)
    return np.array(found, np.int64)


# ---------------------------------------------------------------- signs


def _hardly_seen(result: Reconstruction) -> list[str]:
    seen, n = result.seen, len(result)
    both = np.flatnonzero(seen.all(1))
    ends = [] if not len(both) else [("before", both[0], both[0]), ("after", both[-1], n - 1 - both[-1])]
    return [
        f"no frame {where} frame {at} shows both parts: {count} of {n} states are extrapolated"
        for where, at, count in ends
        if count > EXTRAPOLATED * n
    ] + [
        f"the {part} part was seen in only {int(seen[:, k].sum())} of {len(seen)} frames"
        for k, part in enumerate(PARTS)
        if seen[:, k].mean() < LEAST_SEEN
    ]


def _too_fast(motion: Motion) -> list[str]:
    turn = np.nanmax(np.nan_to_num(motion.step_angle[1:]), axis=1)
    usual = float(np.median(turn)) if len(turn) else 0.0
    if usual <= FASTEST:
        return []
    return [f"a part turns by {np.degrees(usual):.0f}° from frame to frame in the median: film slower, or more frames"]


def _jumps(result: Reconstruction, size: float) -> list[str]:
    joint, both = result.articulation.joint, np.asarray(result.seen.all(1))
    steps = np.where(np.r_[False, both[:-1]], steps_of(result), np.nan)  # over a gap it is no step of one frame
    found = outstanding(steps, JUMP_ANGLE if joint.type == "revolute" else JUMP_SHARE * size, JUMP)
    if not len(found):
        return []
    frames = ", ".join(map(str, found[:5])) + (" and others" if len(found) > 5 else "")
    return [f"the state jumps by up to {_told(float(steps[found].max()), joint)} in one frame ({frames})"]


def _off_the_joint(motion: Motion, size: float) -> list[str]:
    off = median(motion.gap_surface)
    if not off > OFF_JOINT_SHARE * size:
        return []
    return [
        f"the moving part's measured poses lie off the joint by {1000 * off:.2g} mm, {100 * off / size:.2g} % of the "
        "object, in the median: joint, labels or poses are wrong"
    ]


def _joint_unsure(result: Reconstruction, size: float) -> list[str]:
    found, joint = [], result.articulation.joint
    if result.axis_std is None:
        span = float(np.ptp(result.states[result.seen[:, 1]])) if result.seen[:, 1].any() else 0.0
        if span < (LITTLE_ANGLE if joint.type == "revolute" else LITTLE_SHARE * size):
            found.append(f"the joint moves by only {_told(span, joint)}, which says little of its axis")
    elif result.axis_std > AXIS_STD:
        found.append(f"the axis is known to {np.degrees(result.axis_std):.2g}° only (one standard deviation)")
    if result.pivot_std is not None and result.pivot_std > PIVOT_STD_SHARE * size:
        found.append(f"the axis line is known to {1000 * result.pivot_std:.2g} mm only (one standard deviation)")
    return found


def _badly_met(d: Diagnostics) -> list[str]:
    found = []
    worst = max(RESIDUAL * max(d.footprint_m, d.noise_m), RESIDUAL_SHARE * d.diagonal_m)
    for k, part in enumerate(PARTS):
        residual, met, sure = (median(values[:, k]) for values in (d.residual_m, d.inliers, d.confidence))
        if residual > worst:
            found.append(
                f"the {part} part's residual is {1000 * residual:.2g} mm in the median, a pixel covers "
                f"{1000 * d.footprint_m:.2g} mm"
            )
        if met < LEAST_MET:
            found.append(f"only {100 * met:.0f} % of the {part} part's points meet its surface in other frames")
        if sure < LEAST_SURE:
            found.append(f"the {part} part's labels are only {100 * sure:.0f} % sure in the median")
    return found


def _joint_explains_less(d: Diagnostics) -> list[str]:
    free, bound = d.residual_m[:, 1], d.jointed_residual_m[:, 1]
    both = np.isfinite(free) & np.isfinite(bound)
    a, b = median(free[both]), median(bound[both])
    least = max(0.1 * max(d.footprint_m, d.noise_m), JOINT_WORSE_SHARE * d.diagonal_m)
    if not (b > JOINT_WORSE * a and b - a > least):
        return []
    return [
        f"under the joint the moving part's residual is {1000 * b:.2f} mm, without it {1000 * a:.2f} mm: the joint "
        "does not explain the motion"
    ]


def _third_motion(d: Diagnostics) -> list[str]:
    known = np.zeros(0) if d.unexplained is None else d.unexplained[np.isfinite(d.unexplained)]
    share = float(np.percentile(known, 90)) if len(known) else 0.0
    if share <= THIRD_MOTION:
        return []
    return [
        f"{100 * share:.1f} % of the object's pixels follow neither part's motion in a tenth of the frames: a third "
        "part moves, or labels or poses are wrong"
    ]


def _follows_the_other(d: Diagnostics) -> list[str]:
    if d.other_motion_cost is None:
        return []
    return [
        f"the {part} part's pixels follow the other part's motion within the noise: what it does itself is not seen"
        for k, part in enumerate(PARTS)
        if median(d.other_motion_cost[:, k]) < OWN_MOTION
    ]


def _either_type(d: Diagnostics, joint: Joint) -> list[str]:
    if d.type_residuals_m is None:
        return []
    own, other = map(float, d.type_residuals_m)
    if not other < TYPE_WORSE * own:
        return []
    kind = "prismatic" if joint.type == "revolute" else "revolute"
    return [
        f"revolute or prismatic cannot be told: a {kind} joint leaves {1000 * other:.2g} mm where the {joint.type} one "
        f"leaves {1000 * own:.2g} mm"
    ]


def _other_states(d: Diagnostics, result: Reconstruction) -> list[str]:
    if d.rival_distance is None:
        return []
    asked = d.rival_distance[np.isfinite(d.rival_distance)]
    rivals = asked[asked > 0]
    if len(rivals) == 0 or len(rivals) < RIVALS * len(asked):
        return []
    away, step = median(rivals), float(np.nanmax(np.nan_to_num(steps_of(result))))
    if step < REACH_OF_RIVAL * away:
        return []
    joint = result.articulation.joint
    return [
        f"a state {_told(away, joint)} away explains {100 * len(rivals) / len(asked):.0f} % of the frames as well, and "
        f"the state moves by up to {_told(step, joint)} between frames: it may be off by as much"
    ]


def _surface_elsewhere(d: Diagnostics, k: int) -> list[str]:
    """What the surface of part `k`, posed by joint and states, has against the video."""
    part, found = PARTS[k], []
    uncovered, spilled, off, colour = (
        np.zeros(0) if values is None else values[:, k]
        for values in (d.uncovered, d.spilled, d.off_surface, d.colour_residual)
    )
    ratio, seen = (np.nan if values is None else float(values[k]) for values in (d.extent_ratio, d.seen_share))
    if not EXTENT_RATIOS[0] <= ratio <= EXTENT_RATIOS[1] and np.isfinite(ratio):
        found.append(f"the {part} part's surface extends over {ratio:.3g} times what its pixels span")
    known = uncovered[np.isfinite(uncovered)]
    share = float(np.percentile(known, 90)) if len(known) else 0.0
    if share > MOST_UNCOVERED:
        found.append(
            f"{100 * share:.3g} % of the {part} part's pixels lie on neither surface in a tenth of the frames, most in "
            f"frame {int(np.nanargmax(uncovered))}: a piece is missing, or poses, joint, states or surface are wrong"
        )
    if median(spilled) > MOST_SPILLED:
        found.append(f"{100 * median(spilled):.0f} % of the {part} part's surface lies off the mask in the median")
    if median(off) > MOST_OFF:
        found.append(
            f"{100 * median(off):.3g} % of the {part} part's pixels lie off its surface in the median: joint, states "
            "or surface are wrong"
        )
    if median(colour) > MOST_OFF_COLOUR:
        found.append(f"the {part} part's colours are not those of the video: {median(colour):.0f} CIELAB units away")
    if seen < LEAST_SURFACE_SEEN:
        found.append(
            f"only {100 * seen:.0f} % of the {part} part's surface was seen where it is, in pieces that are known to "
            "move with it"
        )
    return found


def median(values: Array) -> float:
    """The median of what is known; NaN, which compares with nothing, when nothing is."""
    known = values[np.isfinite(values)]
    return float(np.median(known)) if len(known) else np.nan


def _told(state: float, joint: Joint) -> str:
    return f"{np.degrees(state):.0f}°" if joint.type == "revolute" else f"{1000 * state:.2g} mm"
