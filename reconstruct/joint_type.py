"""Joint type: both types are fitted to all evidence and compared."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from freeart21 import se3
from freeart21.joint import JointType
from freeart21.se3 import Array
from reconstruct.evidence import Evidence
from reconstruct.joint import JointFit, fit_joint, paper_joint_type
from reconstruct.poses import JointedPoses, Labels, joint_adjustment
from reconstruct.scene import UnsolvableError
from reconstruct.settings import ReconstructSettings

REVOLUTE_COST = 0.9
"""Cost of the revolute joint relative to the prismatic one, below which it is chosen: it has two parameters more."""
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
    fits = {kind: fit_joint(relative, kind, centre, lever, settings.joint) for kind in kinds}

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
    found = {kind: adjust(kind) for kind in kinds}
    return found["revolute" if _revolute_wins(found, centre, evidence.scene.diagonal) else "prismatic"]


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


def _revolute_wins(found: dict[JointType, JointedPoses], centre: Array, diagonal: float) -> bool:
    """Whether the revolute joint is clearly cheaper and its axis near the object.

    A distant hinge describes the same motion as a slide with two parameters more.
    """
    revolute = found["revolute"]
    away = np.cross(centre - revolute.joint.pivot, revolute.joint.axis)
    near = np.linalg.norm(away) < FARTHEST_HINGE * diagonal
    return bool(near and revolute.cost < REVOLUTE_COST * found["prismatic"].cost)
