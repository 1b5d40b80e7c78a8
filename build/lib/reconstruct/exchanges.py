"""Stretches of the video in which the parts were taken for each other are found and turned back.

When a part was hidden or the joint rested, the growth may take one part for the other as it goes on: a lid that opens
looks like a box that closes past its lid. What follows is consistent in itself and wrong against what came before.
With T_second = T_first J(q), and r the state in which the parts were confused, the exchange is T_first' = T_second
J(-r), T_second' = T_first J(r), so q' = 2 r - q: where q = r nothing moves. Views of both sides that look alike tell.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from freeart21 import se3
from freeart21.se3 import Array
from reconstruct.evidence import Evidence, Samples, draw
from reconstruct.growth import Grown
from reconstruct.poses import JointedPoses
from reconstruct.rigid import view_angle
from reconstruct.settings import ExchangeSettings

Frames = NDArray[np.int64]


@dataclass(frozen=True)
class _Exchange:
    """All frames from `cut` on, or all before it, with their parts exchanged at the state `turning`."""

    cut: int
    turning: float
    gain: float
    """Share by which the cost between the two sides of the cut falls."""


def undo_exchanges(evidence: Evidence, grown: Grown, settings: ExchangeSettings, rng: np.random.Generator) -> Grown:
    """`grown` with the parts exchanged on the shorter side of every cut across which they then fit better.

    The cut that gains most comes first. A stretch between two cuts is exchanged, and what lies beyond it restored.
    """
    frames, n = np.flatnonzero(grown.seen.all(1))[:: settings.every], len(grown.labels)
    for _ in range(settings.most):
        pixels = [_part_pixels(evidence, grown, frames, k, settings.samples, rng) for k in (1, 2)]
        asked = evidence, grown.poses, frames, pixels, settings
        rough = _best(frames[1:], *asked)
        if rough is None or not rough.gain > settings.suspicion:
            break
        found = _best(np.arange(frames[0] + 1, frames[-1] + 1), *asked)
        if found is None or found.gain < settings.least_gain:
            break
        after = np.arange(n) >= found.cut
        grown = exchanged(grown, after if 2 * after.sum() <= n else ~after, found.turning)
    return grown


def exchanged(grown: Grown, frames: NDArray[np.bool_], turning: float) -> Grown:
    """`grown` with each part called the other in `frames` (n,): their poses agree where the state is `turning`."""
    poses = grown.poses
    Ts = np.where(frames[:, None, None], poses.Ts_moving @ poses.joint.transform(-turning), poses.Ts)
    states = np.where(frames, 2 * turning - poses.states, poses.states)
    labels, logodds = grown.labels.copy(), grown.logodds.copy()
    for i in map(int, np.flatnonzero(frames)):  # all at once would be half a gigabyte of copies
        labels[i] = np.where(labels[i] > 0, 3 - labels[i], 0)
        logodds[i] = -logodds[i]
    seen = np.where(frames[:, None], grown.seen[:, ::-1], grown.seen)
    std = poses.joint_std
    std = None if std is None else std[::-1] if frames.all() else std
    joint = poses.joint.spanning(states)
    return Grown(replace(poses, joint=joint, states=states, Ts=Ts, joint_std=std), labels, logodds, seen)


def _best(
    cuts: Frames,
    evidence: Evidence,
    poses: JointedPoses,
    frames: Frames,
    pixels: list[Samples],
    settings: ExchangeSettings,
) -> _Exchange | None:
    """The exchange at one of `cuts` that gains most, if any can be judged."""
    found = [_exchange(evidence, poses, frames, pixels, int(cut), settings) for cut in cuts]
    return max((e for e in found if e is not None), key=lambda e: e.gain, default=None)


def _part_pixels(
    evidence: Evidence, grown: Grown, frames: Frames, part: int, most: int, rng: np.random.Generator
) -> Samples:
    """Pixels that are surely of `part`, frame by frame."""
    sure = (grown.labels == part) & (np.abs(grown.logodds) > 1)
    return {i: draw(evidence.usable(i, sure[i]), most, rng) for i in map(int, frames)}


def _exchange(
    evidence: Evidence,
    poses: JointedPoses,
    frames: Frames,
    pixels: list[Samples],
    cut: int,
    settings: ExchangeSettings,
) -> _Exchange | None:
    """What an exchange at `cut` gains; None when too few views on its two sides are alike to tell."""
    turning = float(poses.states[cut])
    both = np.stack([poses.Ts, poses.Ts_moving])
    other = np.stack([both[1] @ poses.joint.transform(-turning), both[0] @ poses.joint.transform(turning)])
    before, after = frames[frames < cut], frames[frames >= cut]
    costs = []
    for sides in ((before, after), (after, before)):
        for i in map(int, sides[0]):
            others = _alike(both, other, i, sides[1], settings)
            if len(others) == 0:
                continue
            for k in range(2):  # seen from either side, the other one is exchanged
                Ts = np.stack([both[k, others], other[k, others]], 1) @ se3.inverse(both[k, i])
                costs.append(evidence.costs(i, others, Ts, pixels[k][i]).mean(1))
    if len(costs) < 2 * settings.least_views or not sum(map(len, costs)):
        return None
    as_is, exchanged = np.concatenate(costs).mean(0)
    return _Exchange(cut, turning, 1 - float(exchanged) / max(float(as_is), 1e-9))


def _alike(both: Array, other: Array, frame: int, candidates: Frames, settings: ExchangeSettings) -> Frames:
    """Those of `candidates` whose view is most like that of `frame`, as they stand or exchanged."""
    turns = [view_angle(Ts[k, candidates, :3, :3], both[k, frame, :3, :3]) for Ts in (both, other) for k in range(2)]
    turn, chosen = np.min(turns, axis=0), list[int]()
    for j in map(int, candidates[np.argsort(turn, kind="stable")][: (turn < settings.max_turn).sum()]):
        if len(chosen) < settings.references and all(abs(j - c) > settings.every for c in chosen):
            chosen.append(j)
    return np.array(sorted(chosen), int)
