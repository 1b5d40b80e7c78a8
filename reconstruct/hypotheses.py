"""Revolute or prismatic: both joints fitted to the end, to all the evidence, and compared."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from freeart21 import se3
from freeart21.joint import JointType
from freeart21.se3 import Array
from reconstruct.evidence import Evidence
from reconstruct.joint import JointFit, fit_joint, paper_joint_type
from reconstruct.poses import JointedPoses, Labels, joint_adjustment
from reconstruct.scene import HopelessError
from reconstruct.settings import JointSettings, ReconstructSettings


def better_type(
    evidence: Evidence,
    labels: Labels,
    Ts: Array,
    seen: NDArray[np.bool_],
    body: Array,
    within: NDArray[np.bool_],
    settings: ReconstructSettings,
    rng: np.random.Generator,
    so_far: JointedPoses | None = None,
) -> JointedPoses:
    """Poses under the joint that explains the frames `within` (n,) better, or under that of the paper's type rule.

    `Ts` (2, n, 4, 4) are poses of both parts that know no joint, and `body` (b, 3) points of the second part in its own
    frame. Each type starts from its fit to the relative poses, or from where it stands `so_far`. A type that is
    found `so_far` and fits the poses far better than the other is taken without further ado.
    Raises HopelessError when fewer than 4 frames show both parts.
    """
    frames = frames_with_both(seen, within)
    relative = se3.inverse(Ts[0, frames]) @ Ts[1, frames]
    centre, lever = body.mean(0), float(np.linalg.norm(body - body.mean(0), axis=1).mean())
    kinds: tuple[JointType, ...] = ("revolute", "prismatic")
    fits = {kind: fit_joint(relative, kind, centre, lever, settings.joint) for kind in kinds}

    def adjusted(kind: JointType) -> JointedPoses:
        start = so_far if so_far is not None and so_far.joint.type == kind else _started(fits[kind], Ts[0], frames)
        return joint_adjustment(evidence, labels, start, seen, settings.poses, rng, 8, within)

    if settings.joint.type_rule == "paper":
        return adjusted(paper_joint_type(relative, settings.joint))
    if so_far is not None:
        mine, other = (fits[kind].residual for kind in _self_and_other(so_far.joint.type))
        if mine < settings.joint.beyond_doubt * other:
            return so_far
    found = {kind: adjusted(kind) for kind in kinds}
    return found["revolute" if _hinged(found, centre, evidence.scene.diagonal, settings.joint) else "prismatic"]


def frames_with_both(seen: NDArray[np.bool_], within: NDArray[np.bool_]) -> NDArray[np.int64]:
    """The frames `within` (n,) that have `seen` (n, 2) both parts; raises HopelessError when they are fewer than 4."""
    frames = np.flatnonzero(within & seen.all(1))
    if len(frames) < 4:
        raise HopelessError(f"no second part: {len(frames)} frames show both parts, at least 4 are needed")
    return frames


def _self_and_other(kind: JointType) -> tuple[JointType, JointType]:
    return ("revolute", "prismatic") if kind == "revolute" else ("prismatic", "revolute")


def _started(fit: JointFit, Ts: Array, frames: NDArray[np.int64]) -> JointedPoses:
    """Poses of all frames under a fitted joint, in the frame of the first part."""
    states = np.interp(np.arange(len(Ts)), frames, fit.states)
    return JointedPoses(fit.joint(), states, Ts.copy(), np.full(len(states), np.inf), np.inf)


def _hinged(found: dict[JointType, JointedPoses], centre: Array, diagonal: float, settings: JointSettings) -> bool:
    """Whether the revolute hypothesis wins: clearly cheaper, and with its hinge at the object.

    A hinge far away says no more than a slide, with two unknowns more.
    """
    revolute = found["revolute"]
    away = np.cross(centre - revolute.joint.pivot, revolute.joint.axis)
    near = np.linalg.norm(away) < settings.farthest_hinge * diagonal
    return bool(near and revolute.cost < settings.revolute_cost * found["prismatic"].cost)
