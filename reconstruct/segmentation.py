"""Free-moving part segmentation: labels and poses of both parts, propagated from a seed in both time directions.

Propagation starts with two free poses per frame. Once the relative motion determines the joint, it goes on with six
plus one degrees of freedom. The labels of a frame come from all its pixels, under both motions, against earlier frames.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from operator import itemgetter

import numpy as np

from freeart21 import se3
from freeart21.se3 import Array
from reconstruct.evidence import Evidence
from reconstruct.joint_type import frames_with_both_parts
from reconstruct.kernels import HIDDEN
from reconstruct.labels import label_frames
from reconstruct.poses import joint_adjustment
from reconstruct.propagation import (
    AGREEING_FRAMES,
    AGREEMENT,
    FINE_GATES,
    GATES,
    MIN_JOINTED_PIXELS,
    MIN_PART_PIXELS,
    REST_COST,
    PartEstimate,
    Propagation,
    body_points,
)
from reconstruct.recovery import is_lost, recover_frame, unreliable_frames
from reconstruct.scene import UnsolvableError
from reconstruct.seeds import Seed
from reconstruct.settings import ReconstructSettings
from reconstruct.tracks import Tracker

BOOTSTRAP_FRAMES, BOOTSTRAP_MAX_FRAMES = 18, 48
"""Frames with free poses before a joint is fitted: at least, and at most."""
BOOTSTRAP_MOTION = 0.12
"""Relative displacement of the moving part, in object diagonals, from which a joint is fitted."""
SEED_DISTANCE = 20
"""Smallest distance, frames, between alternative seeds."""
SURE_COST = 0.15
"""Mean cost of a start's frames under its joint below which no other seed is tried."""
ADJUST_EVERY, ADJUST_SAMPLES = 16, 250
"""Frames between joint adjustments during propagation, and their pixels per frame and part."""
SAME_PLACE = 0.2
"""A frame whose pose changes by less than this many units after labelling keeps its labels."""
LOST_COST = 2.5
"""A frame that costs more than this times what the best quarter costs is lost."""
UNRELIABLE_SHARE = 0.15
"""Share of lost frames from which a whole propagation is unreliable."""


def next_frames(propagation: Propagation) -> list[tuple[int, int]]:
    """(frame, neighbour already done) at both ends of the frames done."""
    frames = np.flatnonzero(propagation.done)
    ends = [(int(frames[-1]) + 1, int(frames[-1])), (int(frames[0]) - 1, int(frames[0]))]
    return [(i, p) for i, p in ends if 0 <= i < len(propagation.done)]


def add_frames(propagation: Propagation, most: int) -> int:
    """Add up to `most` frames, alternating between the two ends; returns how many were added."""
    added = 0
    while added < most and (ends := next_frames(propagation)):
        for frame, neighbour in ends:
            if propagation.joint is None:
                guesses = tuple(propagation.predict_part_poses(k, frame, neighbour) for k in range(2))
                add_frame_without_joint(propagation, frame, neighbour, guesses)
            else:
                add_frame_with_joint(propagation, frame, neighbour)
            added += 1
    return added


def add_frame_without_joint(
    propagation: Propagation, frame: int, neighbour: int, guesses: tuple[list[Array], ...]
) -> None:
    """Pose both parts of a frame independently, each from the best of its initial `guesses`, and label the frame."""
    propagation.labels[frame] = propagation.carry_labels(frame, neighbour)
    found = [_register_best(propagation, k, frame, guesses[k]) for k in range(2)]
    poses = []
    for k in range(2):
        own, other = found[k], found[1 - k]
        if own is None:  # a hidden part moves as if fixed to the other
            other = propagation.Ts[1 - k, neighbour] if other is None else other
            own = other @ se3.inverse(propagation.Ts[1 - k, neighbour]) @ propagation.Ts[k, neighbour]
        poses.append(own)
    for last in (False, True):
        propagation.Ts[:, frame] = poses
        propagation.label_frame(frame)
        for k in range(0 if last else 2):
            references = propagation.references(k, poses[k], frame)
            if propagation.seen[frame, k] and len(references):
                T, inliers = propagation.register_part(k, frame, poses[k], references, FINE_GATES)
                poses[k] = T if inliers >= MIN_PART_PIXELS else poses[k]
    propagation.done[frame] = True
    propagation.body = None


def _register_best(propagation: Propagation, k: int, frame: int, guesses: list[Array]) -> Array | None:
    """Part k's pose of least cost, registered from several initial guesses; None when it does not show enough."""
    best, best_cost = None, np.inf
    for guess in guesses:
        references = propagation.references(k, guess, frame)
        if len(references) == 0:
            continue
        T, inliers = propagation.register_part(k, frame, guess, references, GATES)
        cost = propagation.cost(k, frame, T, references)
        if inliers >= MIN_PART_PIXELS and cost < best_cost:
            best, best_cost = T, cost
    return best


def add_frame_with_joint(propagation: Propagation, frame: int, neighbour: int) -> None:
    """Pose a frame by reference pose and joint state, from the best of several initial guesses, and label it."""
    propagation.labels[frame] = propagation.carry_labels(frame, neighbour)
    guesses, last_state = propagation.initial_guesses(frame, neighbour), propagation.states[neighbour]
    moving = [propagation.register_with_joint(frame, T, q, GATES) for T, q in guesses]
    resting = [propagation.register_with_joint(frame, T, q, GATES, True) for T, q in guesses if q == last_state]
    T, q, cost = min(moving, key=itemgetter(2))
    at_rest = min(resting, key=itemgetter(2))
    if not at_rest[2] > REST_COST * cost:  # also true where nothing is measured and costs are infinite
        T, q, cost = at_rest
    rests, recovered = q == last_state, False
    if is_lost(propagation, neighbour):
        T, q, recovered = recover_frame(propagation, frame, neighbour, T, q)
    if recovered:
        cost = propagation.cost_with_joint(frame, T, q)
        if propagation.is_state_jump(q - last_state):
            propagation.recovered_frames.append((frame, neighbour))
    propagation.set_pose(frame, T, q)
    propagation.label_frame(frame)
    if not recovered:
        labels = propagation.labels[frame].copy()
        if propagation.ambiguous[frame]:
            propagation.labels[frame][np.abs(propagation.logodds[frame]) <= 1] = 0  # matches either part
        T, q, cost = propagation.register_with_joint(frame, T, q, FINE_GATES, rests)
        propagation.labels[frame] = labels
    if propagation.displacement(frame, T, q) > SAME_PLACE * propagation.evidence.unit:
        propagation.set_pose(frame, T, q)
        propagation.label_frame(frame)
    propagation.set_pose(frame, T, q)
    propagation.costs[frame] = cost
    propagation.done[frame] = True


def redo_lost_frames(propagation: Propagation, frame: int, neighbour: int) -> bool:
    """Propagate again from `frame`, where a part was recovered, over `neighbour` back to where it had been lost.

    Ends where new and old poses agree, and returns whether they do; if not, everything is restored. The frames between
    are no references until they are done again.
    """
    direction = 1 if neighbour > frame else -1
    doubted = unreliable_frames(propagation, neighbour, direction)
    Ts, states = propagation.Ts[:, doubted].copy(), propagation.states[doubted].copy()
    logodds, costs = propagation.logodds[doubted].copy(), propagation.costs[doubted].copy()
    seen = propagation.seen[doubted].copy()
    propagation.body = propagation.body_points() if propagation.body is None else propagation.body
    propagation.done[doubted] = False
    agreeing = redone = 0
    for i, T, q in zip(doubted, Ts[0], states, strict=True):
        add_frame_with_joint(propagation, int(i), int(i) - direction)
        redone += 1
        near = propagation.displacement(int(i), T, q) < AGREEMENT * propagation.evidence.unit
        agreeing = agreeing + 1 if near else 0
        if agreeing == AGREEING_FRAMES:
            break
    agreed = agreeing == AGREEING_FRAMES
    for c, i in enumerate(doubted[:redone]):
        if not agreed:
            propagation.Ts[:, i], propagation.states[i] = Ts[:, c], states[c]
            propagation.set_labels(int(i), logodds[c])
            propagation.costs[i], propagation.seen[i] = costs[c], seen[c]
    propagation.done[doubted] = True
    propagation.body = None
    return agreed


def propagate_from_seeds(
    evidence: Evidence, tracker: Tracker, seeds: Sequence[Seed], settings: ReconstructSettings, rng: np.random.Generator
) -> PartEstimate:
    """Labels, poses and joint of the whole recording, by the cheapest propagation from one of `seeds` (best first);
    other seeds are tried only while much of it is unreliable.

    Raises UnsolvableError when the second part never moves against the first.
    """
    best, failure = None, UnsolvableError("no second part")
    for _ in range(settings.growth.attempts):
        try:
            propagation, seed = _propagate(evidence, tracker, seeds, settings, rng)
        except UnsolvableError as error:
            failure = error
            break
        if best is None or np.nanmean(propagation.costs) < np.nanmean(best.costs):
            best = propagation
        if not _is_unreliable(propagation):
            break
        seeds = [other for other in seeds if abs(other.frame - seed.frame) >= SEED_DISTANCE]
    if best is None:
        raise failure
    return PartEstimate(best.current_poses(), best.labels, best.logodds, best.seen)


def _is_unreliable(propagation: Propagation) -> bool:
    """Whether many frames cost far more than the best quarter, and more than half of what a hidden frame costs."""
    costs = propagation.costs[np.isfinite(propagation.costs)]
    if len(costs) == 0:
        return False
    return bool((costs > max(0.5 * HIDDEN, LOST_COST * np.percentile(costs, 25))).mean() > UNRELIABLE_SHARE)


def _propagate(
    evidence: Evidence, tracker: Tracker, seeds: Sequence[Seed], settings: ReconstructSettings, rng: np.random.Generator
) -> tuple[Propagation, Seed]:
    """A propagation over all frames, and the seed that it started from."""
    propagation, seed = _initial_propagation(evidence, tracker, seeds, settings, rng)
    while next_frames(propagation):
        add_frames(propagation, ADJUST_EVERY)
        found, propagation.recovered_frames = propagation.recovered_frames, []
        for pair in found:
            redo_lost_frames(propagation, *pair)
        propagation.recovered_frames.clear()  # those found on the way back need no second pass
        propagation.relabel_uncertain_frames()
        _adjust_poses(propagation, rng)
    return propagation, seed


def _initial_propagation(
    evidence: Evidence, tracker: Tracker, seeds: Sequence[Seed], settings: ReconstructSettings, rng: np.random.Generator
) -> tuple[Propagation, Seed]:
    """A propagation up to the joint, from the first of some distant `seeds` whose joint is beyond doubt, and that seed.

    Otherwise the one whose joint explains its frames best, preferring those with enough motion.
    """
    chosen = list[Seed]()
    for seed in seeds:
        if all(abs(seed.frame - other.frame) >= SEED_DISTANCE for other in chosen):
            chosen.append(seed)
    best, least, failure = None, (True, np.inf), UnsolvableError("no second part")
    for seed in chosen[: settings.growth.beginnings]:
        try:
            propagation = _propagate_until_joint(Propagation(evidence, tracker, seed, settings, rng), seed)
        except UnsolvableError as error:
            failure = error
            continue
        moves_little = propagation.relative_motion() < BOOTSTRAP_MOTION * evidence.scene.diagonal
        frames = np.flatnonzero(propagation.done & propagation.seen.all(1))
        costs = [propagation.cost_with_joint(int(i), propagation.Ts[0, i], propagation.states[i]) for i in frames]
        quality = moves_little, float(np.mean(costs))
        if best is None or quality < least:
            best, least = (propagation, seed), quality
        if least < (False, SURE_COST):
            break
    if best is None:
        raise failure
    return best


def _propagate_until_joint(propagation: Propagation, seed: Seed) -> Propagation:
    """Propagate from `seed` with free poses until there is enough relative motion, then fit the joint."""
    for j, T in zip(seed.others, seed.Ts, strict=True):
        add_frame_without_joint(propagation, int(j), int(j) - 1, ([T[0]], [T[1]]))
    add_frames(propagation, BOOTSTRAP_FRAMES - int(propagation.done.sum()))
    enough = BOOTSTRAP_MOTION * propagation.evidence.scene.diagonal
    while (
        propagation.relative_motion() < enough
        and propagation.done.sum() < BOOTSTRAP_MAX_FRAMES
        and next_frames(propagation)
    ):
        add_frames(propagation, 4)
    frames_with_both_parts(propagation.seen, propagation.done)
    propagation.set_joint(propagation.choose_joint())
    return propagation


def _adjust_poses(propagation: Propagation, rng: np.random.Generator) -> None:
    """A short joint adjustment of all poses so far."""
    known = propagation.evidence, propagation.labels, propagation.current_poses(), propagation.seen
    settings, within = propagation.settings.poses, propagation.done
    propagation.set_joint(joint_adjustment(*known, settings, rng, 4, within, samples=ADJUST_SAMPLES))


def relabel_frames(evidence: Evidence, estimate: PartEstimate, rng: np.random.Generator) -> PartEstimate:
    """`estimate` with new labels in all frames, given all poses."""
    Ts = np.stack([estimate.poses.Ts, estimate.poses.Ts_moving])
    body = body_points(evidence, estimate.labels, Ts[1], estimate.seen[:, 1])
    logodds = label_frames(evidence, Ts, body, estimate.seen, estimate.logodds, rng)
    labels = np.where(evidence.scene.mask, (logodds > 0) + np.uint8(1), np.uint8(0))
    sure = np.abs(logodds) > 1
    counts = [[evidence.usable_pixels(i, (labels[i] == k) & sure[i]).sum() for k in (1, 2)] for i in range(len(labels))]
    return replace(estimate, labels=labels, logodds=logodds, seen=np.array(counts) >= MIN_JOINTED_PIXELS)
