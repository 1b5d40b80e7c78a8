"""Joint type: both types are fitted to all evidence and compared by the cost of pixels under their motions."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from freeart21 import se3
from freeart21.joint import Joint, JointType
from freeart21.joint_fit import JointFit, fit_joint_of_type, paper_joint_type
from freeart21.se3 import Array
from reconstruct.evidence import Evidence, sample_evenly, sample_pixels
from reconstruct.labels import discriminative_frames
from reconstruct.poses import JointedPoses, Labels, joint_adjustment
from reconstruct.scene import UnsolvableError
from reconstruct.settings import ReconstructSettings

REVOLUTE_GAIN = 0.02
"""Cost of a pixel by which the revolute joint must be better to be chosen: it has two parameters more. It gained up to
0.006 on five slides (clean, tof, noise2, phone), 0.24 to 1.25 on eight hinges (clean, tof, noise2)."""
RIVAL_COST = 0.05
"""Cost of a pixel up to which a joint of the other type is a rival. On nine of those recordings it cost 0.11 and more;
on a phone's keyboard filmed by the sensor `phone` 0.002 (standard error 0.006)."""
MOST_OTHERS = 12
"""Frames that one is compared with when none differs clearly in state."""
SAMPLES = 200
"""Pixels per frame and part that joints are compared by."""
BEYOND_DOUBT = 0.4
"""Residual of the present joint relative to the other type's, below which the other type is not tried again."""
FARTHEST_HINGE = 2.0
"""Object diagonals from the moving part within which a hinge is plausible."""


def choose_joint_type(
    evidence: Evidence,
    labels: Labels,
    Ts: Array,
    seen: NDArray[np.bool_],
    body: Array,
    within: NDArray[np.bool_],
    settings: ReconstructSettings,
    rng: np.random.Generator,
    current: JointedPoses | None = None,
) -> JointedPoses:
    """Poses under the joint that explains the frames `within` (n,) better, or whose type the paper's rule selects.

    `Ts` (2, n, 4, 4) are poses of both parts without a joint, `body` (b, 3) points of the second part in its own frame.
    Each type starts from its fit to the relative poses, or from the `current` poses. These are returned as they are
    when their type fits the relative poses far better than the other. Raises UnsolvableError when fewer than 4 frames
    show both parts.
    """
    frames = frames_with_both_parts(seen, within)
    relative = se3.inverse(Ts[0, frames]) @ Ts[1, frames]
    centre, lever = body.mean(0), float(np.linalg.norm(body - body.mean(0), axis=1).mean())
    kinds: tuple[JointType, ...] = ("revolute", "prismatic")
    fits = {kind: fit_joint_of_type(relative, kind, centre, lever, settings.joint.noise_resistance) for kind in kinds}

    def adjust(kind: JointType) -> JointedPoses:
        known = current if current is not None and current.joint.type == kind else None
        start = known or _initial_poses(fits[kind], Ts[0], frames)
        return joint_adjustment(evidence, labels, start, seen, settings.poses, rng, 8, within)

    if settings.joint.type_rule == "paper":
        return adjust(paper_joint_type(relative))
    if current is not None:
        other: JointType = "prismatic" if current.joint.type == "revolute" else "revolute"
        if fits[current.joint.type].residual < BEYOND_DOUBT * fits[other].residual:
            return current
    hinge, slide = (adjust(kind) for kind in kinds)
    costs = mean_costs(evidence, labels, (slide, hinge), Ts, seen & within[:, None], body, settings.seed)
    near = is_near(hinge.joint, centre, evidence.scene.diagonal)
    return hinge if near and costs[1] < costs[0] - REVOLUTE_GAIN else slide


def find_rival(
    evidence: Evidence,
    labels: Labels,
    poses: JointedPoses,
    Ts: Array,
    seen: NDArray[np.bool_],
    body: Array,
    settings: ReconstructSettings,
) -> tuple[JointedPoses | None, Array]:
    """Poses under the best joint of the other type when that is a rival of `poses`, and the costs (2,) of a pixel under
    both, NaN where nothing can be compared.

    Arguments as of `choose_joint_type`. Of hinges, those near the part are rivals of a slide: a distant one describes
    the same.
    """
    frames, rng = np.flatnonzero(seen.all(1)), np.random.default_rng(settings.seed)
    if len(frames) < 4:
        return None, np.full(2, np.nan)
    centre, lever = body.mean(0), float(np.linalg.norm(body - body.mean(0), axis=1).mean())
    other: JointType = "prismatic" if poses.joint.type == "revolute" else "revolute"
    relative = se3.inverse(Ts[0, frames]) @ Ts[1, frames]
    fit = fit_joint_of_type(relative, other, centre, lever, settings.joint.noise_resistance)
    if other == "revolute":
        fit = _brought_near(fit, se3.transform(fit.T_zero, centre), 0.75 * FARTHEST_HINGE * evidence.scene.diagonal)
    rival = joint_adjustment(evidence, labels, _initial_poses(fit, Ts[0], frames), seen, settings.poses, rng, 8)
    costs = mean_costs(evidence, labels, (poses, rival), Ts, seen, body, settings.seed)
    plausible = other == "prismatic" or is_near(rival.joint, centre, evidence.scene.diagonal)
    return rival if plausible and costs[1] < costs[0] + RIVAL_COST else None, costs


def mean_costs(
    evidence: Evidence,
    labels: Labels,
    candidates: tuple[JointedPoses, ...],
    Ts: Array,
    seen: NDArray[np.bool_],
    body: Array,
    seed: int,
) -> Array:
    """(k,) mean cost of a pixel under the motions of each of `candidates`, on the same pixels and pairs of frames.

    Both parts count the same. Pixels are compared between frames of a similar view at different states; of the `Ts`
    (2, n, 4, 4) poses without a joint and the points `body` (b, 3) it depends which these are. NaN without any.
    """
    rng, known, found = np.random.default_rng([seed, 22]), np.asarray(seen.all(1)), []
    for i in map(int, np.flatnonzero(known)):
        others = discriminative_frames(evidence, i, Ts, body, known, rng)
        if not len(others):  # the joint hardly moves
            others = sample_evenly(np.setdiff1d(np.flatnonzero(known), [i]), MOST_OTHERS)
        pixels = [sample_pixels(evidence.usable_pixels(i, labels[i] == k), SAMPLES, rng) for k in (1, 2)]
        if len(others) and all(map(len, pixels)):
            motions = ([c.Ts for c in candidates], [c.Ts_moving for c in candidates])
            T = [np.stack([Ts[others] @ se3.inverse(Ts[i]) for Ts in poses], 1) for poses in motions]
            found.append([evidence.costs(i, others, T[k], pixels[k]).mean((0, 1)) for k in range(2)])
    return np.mean(found, (0, 1)) if found else np.full(len(candidates), np.nan)


def frames_with_both_parts(seen: NDArray[np.bool_], within: NDArray[np.bool_]) -> NDArray[np.int64]:
    """The frames `within` (n,) with both parts `seen` (n, 2). Raises UnsolvableError when they are fewer than 4."""
    frames = np.flatnonzero(within & seen.all(1))
    if len(frames) < 4:
        raise UnsolvableError(f"no second part: {len(frames)} frames show both parts, at least 4 are needed")
    return frames


def _initial_poses(fit: JointFit, Ts: Array, frames: NDArray[np.int64]) -> JointedPoses:
    """Poses of all frames under a fitted joint, in the frame of the first part."""
    states = np.interp(np.arange(len(Ts)), frames, fit.states)
    return JointedPoses(fit.joint(), states, Ts.copy(), np.full(len(states), np.inf), np.inf)


def _brought_near(hinge: JointFit, centre: Array, reach: float) -> JointFit:
    """`hinge` with its axis moved to `reach`, metres, from the part's `centre` (3,) where it is farther away."""
    away = centre - hinge.pivot
    away = away - (away @ hinge.axis) * hinge.axis
    distance = float(np.linalg.norm(away))
    if distance <= reach:
        return hinge
    return replace(hinge, pivot=centre - reach / distance * away, states=distance / reach * hinge.states)


def is_near(hinge: Joint, centre: Array, diagonal: float) -> bool:
    """Whether the axis of a `hinge` passes the part's `centre` (3,) near enough.

    A distant hinge describes the same motion as a slide with two parameters more.
    """
    away = np.linalg.norm(np.cross(centre - hinge.pivot, hinge.axis))
    return bool(away < FARTHEST_HINGE * diagonal)
