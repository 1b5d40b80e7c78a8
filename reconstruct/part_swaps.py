"""Detection and undoing of part swaps: stretches of the video in which the two parts were confused.

When a part was hidden or the joint rested, propagation may continue with the parts swapped: a lid that opens looks like
a box that closes past its lid. The rest is consistent in itself, but not with what came before. With T_second = T_first
J(q), and r the state of the confusion, the swap is T_first' = T_second J(-r), T_second' = T_first J(r), so q' = 2 r -
q. Similar views on both sides of the cut reveal it.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from freeart21 import se3
from freeart21.se3 import Array
from reconstruct.evidence import Evidence, Samples, sample_pixels
from reconstruct.poses import JointedPoses
from reconstruct.propagation import PartEstimate
from reconstruct.rigid import view_angle
from reconstruct.settings import PartSwapSettings

Frames = NDArray[np.int64]

EVERY = 4
"""Frames between those that are compared, and between the cuts that are tried first."""
SUSPICION = 0.05
"""All cuts are tried if one of these lowers the cost by this share."""
SAMPLES = 120
"""Pixels of a part per frame."""
REFERENCES = 3
"""Frames on the other side of a cut that a frame is compared with."""
MAX_TURN = 0.7
"""Radians between two views that are compared."""
MIN_VIEWS = 6
"""Frames that must have such views on the other side of a cut for it to be judged."""
MIN_GAIN = 0.1
"""Share by which the cost must fall for the parts to be swapped."""


@dataclass(frozen=True)
class _Swap:
    """All frames from `cut` on, or all before it, with their parts swapped at the state `turning`."""

    cut: int
    turning: float
    gain: float
    """Share by which the cost between both sides of the cut falls."""


def undo_part_swaps(
    evidence: Evidence, estimate: PartEstimate, settings: PartSwapSettings, rng: np.random.Generator
) -> PartEstimate:
    """`estimate` with the parts swapped on the shorter side of every cut where that lowers the cost, best cut first.

    A stretch between two cuts is swapped by two such swaps.
    """
    frames, n = np.flatnonzero(estimate.seen.all(1))[::EVERY], len(estimate.labels)
    for _ in range(settings.most):
        pixels = [_certain_pixels(evidence, estimate, frames, k, rng) for k in (1, 2)]
        known = evidence, estimate.poses, frames, pixels
        rough = _best_swap(frames[1:], *known)
        if rough is None or not rough.gain > SUSPICION:
            break
        found = _best_swap(np.arange(frames[0] + 1, frames[-1] + 1), *known)
        if found is None or found.gain < MIN_GAIN:
            break
        after = np.arange(n) >= found.cut
        estimate = swap_parts(estimate, after if 2 * after.sum() <= n else ~after, found.turning)
    return estimate


def swap_parts(estimate: PartEstimate, frames: NDArray[np.bool_], turning: float) -> PartEstimate:
    """`estimate` with the parts swapped in `frames` (n,); poses agree at the state `turning`."""
    poses = estimate.poses
    Ts = np.where(frames[:, None, None], poses.Ts_moving @ poses.joint.transform(-turning), poses.Ts)
    states = np.where(frames, 2 * turning - poses.states, poses.states)
    labels, logodds = estimate.labels.copy(), estimate.logodds.copy()
    for i in map(int, np.flatnonzero(frames)):  # one by one, to save memory
        labels[i] = np.where(labels[i] > 0, 3 - labels[i], 0)
        logodds[i] = -logodds[i]
    seen = np.where(frames[:, None], estimate.seen[:, ::-1], estimate.seen)
    std = poses.joint_std
    std = None if std is None else std[::-1] if frames.all() else std
    joint = poses.joint.spanning(states)
    return PartEstimate(replace(poses, joint=joint, states=states, Ts=Ts, joint_std=std), labels, logodds, seen)


def _best_swap(
    cuts: Frames,
    evidence: Evidence,
    poses: JointedPoses,
    frames: Frames,
    pixels: list[Samples],
) -> _Swap | None:
    """The swap at one of `cuts` that gains most; None when none can be judged."""
    found = [_evaluate_swap(evidence, poses, frames, pixels, int(cut)) for cut in cuts]
    return max((e for e in found if e is not None), key=lambda e: e.gain, default=None)


def _certain_pixels(
    evidence: Evidence, estimate: PartEstimate, frames: Frames, part: int, rng: np.random.Generator
) -> Samples:
    """Pixels that are certainly of `part`, frame by frame."""
    sure = (estimate.labels == part) & (np.abs(estimate.logodds) > 1)
    return {i: sample_pixels(evidence.usable_pixels(i, sure[i]), SAMPLES, rng) for i in map(int, frames)}


def _evaluate_swap(
    evidence: Evidence,
    poses: JointedPoses,
    frames: Frames,
    pixels: list[Samples],
    cut: int,
) -> _Swap | None:
    """What a swap at `cut` gains; None when too few views on its two sides are similar."""
    turning = float(poses.states[cut])
    both = np.stack([poses.Ts, poses.Ts_moving])
    other = np.stack([both[1] @ poses.joint.transform(-turning), both[0] @ poses.joint.transform(turning)])
    before, after = frames[frames < cut], frames[frames >= cut]
    costs = []
    for sides in ((before, after), (after, before)):
        for i in map(int, sides[0]):
            others = _similar_views(both, other, i, sides[1])
            if len(others) == 0:
                continue
            for k in range(2):
                Ts = np.stack([both[k, others], other[k, others]], 1) @ se3.inverse(both[k, i])
                costs.append(evidence.costs(i, others, Ts, pixels[k][i]).mean(1))
    if len(costs) < 2 * MIN_VIEWS or not sum(map(len, costs)):
        return None
    as_is, swapped = np.concatenate(costs).mean(0)
    return _Swap(cut, turning, 1 - float(swapped) / max(float(as_is), 1e-9))


def _similar_views(both: Array, other: Array, frame: int, candidates: Frames) -> Frames:
    """Those of `candidates` with the most similar view to `frame`, with or without the swap."""
    turns = [view_angle(Ts[k, candidates, :3, :3], both[k, frame, :3, :3]) for Ts in (both, other) for k in range(2)]
    turn, chosen = np.min(turns, axis=0), list[int]()
    for j in map(int, candidates[np.argsort(turn, kind="stable")][: (turn < MAX_TURN).sum()]):
        if len(chosen) < REFERENCES and all(abs(j - c) > EVERY for c in chosen):
            chosen.append(j)
    return np.array(sorted(chosen), int)
