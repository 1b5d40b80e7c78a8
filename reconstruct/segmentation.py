"""Free-moving part segmentation: grow labels and poses of two parts from a seed, both ways in time.

Growth starts free (two poses a frame); as soon as the relative motion says what the joint is, it goes on with six plus
one degrees of freedom. Labels of a frame come from all its pixels: under both motions, against several earlier frames.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from freeart21 import se3
from freeart21.se3 import Array
from reconstruct.evidence import Evidence
from reconstruct.growth import Grown, Growth, body_points
from reconstruct.hypotheses import frames_with_both
from reconstruct.labels import Frames, label_frames
from reconstruct.pieces import is_doubtful, join, lost_stretches
from reconstruct.poses import joint_adjustment
from reconstruct.recovery import doubted_frames, found_anew, is_lost
from reconstruct.scene import HopelessError
from reconstruct.seeds import Seed, find_seeds
from reconstruct.settings import ReconstructSettings
from reconstruct.tracks import Tracker


def frontier(growth: Growth) -> list[tuple[int, int]]:
    """(frame, neighbour already done) at the ends of what is done."""
    frames, (first, last) = np.flatnonzero(growth.done), growth.span
    ends = [(int(frames[-1]) + 1, int(frames[-1])), (int(frames[0]) - 1, int(frames[0]))]
    return [(i, p) for i, p in ends if first <= i <= last]


def add_frames(growth: Growth, most: int) -> int:
    """Add up to `most` frames, alternating between the two ends; how many were added."""
    added = 0
    while added < most and (ends := frontier(growth)):
        for frame, neighbour in ends:
            if growth.joint is None:
                step_free(growth, frame, neighbour, tuple(growth.predictions(k, frame, neighbour) for k in range(2)))
            else:
                step_jointed(growth, frame, neighbour)
            added += 1
    return added


def step_free(growth: Growth, frame: int, neighbour: int, starts: tuple[list[Array], ...]) -> None:
    """Pose both parts of a frame freely, each from the best of several starts, and label it."""
    growth.labels[frame] = growth.carried(frame, neighbour)
    found: list[Array | None] = []
    for k in range(2):
        best, best_cost = None, np.inf
        for start in starts[k]:
            references = growth.references(k, start, frame)
            if len(references) == 0:
                continue
            T, inliers = growth.registered(k, frame, start, references, growth.settings.growth.gates)
            cost = growth.cost(k, frame, T, references)
            if inliers >= growth.settings.growth.min_part_pixels and cost < best_cost:
                best, best_cost = T, cost
        found.append(best)
    poses = []
    for k in range(2):
        mine, other = found[k], found[1 - k]
        if mine is None:  # a hidden part moves as if fixed to the other
            other = growth.Ts[1 - k, neighbour] if other is None else other
            mine = other @ se3.inverse(growth.Ts[1 - k, neighbour]) @ growth.Ts[k, neighbour]
        poses.append(mine)
    for last in (False, True):
        growth.Ts[:, frame] = poses
        growth.label(frame)
        for k in range(0 if last else 2):
            references = growth.references(k, poses[k], frame)
            if growth.seen[frame, k] and len(references):
                T, inliers = growth.registered(k, frame, poses[k], references, (6.0, 5.0, 4.0))
                poses[k] = T if inliers >= growth.settings.growth.min_part_pixels else poses[k]
    growth.done[frame] = True
    growth.body = None


def _by_cost(found: tuple[Array, float, float]) -> float:
    """The cost of a registration."""
    return found[2]


def step_jointed(growth: Growth, frame: int, neighbour: int) -> None:
    """Pose a frame by the reference pose and the joint state, from the best of several starts, and label it."""
    growth.labels[frame] = growth.carried(frame, neighbour)
    starts, gates = growth.starts(frame, neighbour), growth.settings.growth.gates
    moving = [growth.registered_jointed(frame, T, q, gates) for T, q in starts]
    still = [growth.registered_jointed(frame, T, q, gates, True) for T, q in starts if q == growth.states[neighbour]]
    T, q, cost = min(moving, key=_by_cost)
    at_rest = min(still, key=_by_cost)
    if not at_rest[2] > growth.settings.growth.rest_cost * cost:  # nor is there a motion where nothing is measured
        T, q, cost = at_rest
    rest, parted = q == growth.states[neighbour], False
    if is_lost(growth, neighbour):
        T, q, parted = found_anew(growth, frame, neighbour, T, q)
    if parted:
        cost = growth.jointed_cost(frame, T, q)
        if growth.jumped(q - growth.states[neighbour]):
            growth.found_again.append((frame, neighbour))
    growth.place(frame, T, q)
    growth.label(frame)
    if not parted:
        labels = growth.labels[frame].copy()
        if growth.open[frame]:
            growth.labels[frame][np.abs(growth.logodds[frame]) <= 1] = 0  # either part may be met there
        T, q, cost = growth.registered_jointed(frame, T, q, (6.0, 5.0, 4.0), rest)
        growth.labels[frame] = labels
    if growth.moved(frame, T, q) > growth.settings.growth.same_place * growth.evidence.unit:
        growth.place(frame, T, q)
        growth.label(frame)
    growth.place(frame, T, q)
    growth.costs[frame] = cost
    growth.done[frame] = True


def go_back(growth: Growth, frame: int, neighbour: int) -> bool:
    """Grow again from `frame`, where a part was found anew, over `neighbour` to where it had been lost.

    There old and new poses agree; whether they do. If not, all is as before. What lies between is no reference
    until it is grown again.
    """
    back = 1 if neighbour > frame else -1
    doubted = doubted_frames(growth, neighbour, back)
    Ts, states, logodds = growth.Ts[:, doubted].copy(), growth.states[doubted].copy(), growth.logodds[doubted].copy()
    costs, seen = growth.costs[doubted].copy(), growth.seen[doubted].copy()
    growth.body = growth.body_points() if growth.body is None else growth.body
    growth.done[doubted] = False
    alike = grown = 0
    for i, T, q in zip(doubted, Ts[0], states, strict=True):
        step_jointed(growth, int(i), int(i) - back)
        grown += 1
        near = growth.moved(int(i), T, q) < growth.settings.growth.agreeing * growth.evidence.unit
        alike = alike + 1 if near else 0
        if alike == growth.settings.growth.agreeing_frames:
            break
    agreed = alike == growth.settings.growth.agreeing_frames
    for c, i in enumerate(doubted[:grown]):
        if not agreed:
            growth.Ts[:, i], growth.states[i] = Ts[:, c], states[c]
            growth.put_labels(int(i), logodds[c])
            growth.costs[i], growth.seen[i] = costs[c], seen[c]
    growth.done[doubted] = True
    growth.body = None
    return agreed


def grow(
    evidence: Evidence, tracker: Tracker, seeds: Sequence[Seed], settings: ReconstructSettings, rng: np.random.Generator
) -> Grown:
    """Labels, poses and joint of the whole recording from one of `seeds`, best first, and from others where that was
    lost for long.

    Raises HopelessError when the second part never moves against the first.
    """
    growth = _best_grown(evidence, tracker, seeds, settings, rng)
    given_up: set[int] = set()
    for _ in range(settings.pieces.most):
        stretch = next((run for run in lost_stretches(growth) if int(run[0]) not in given_up), None)
        if stretch is None:
            break
        if not _mended(growth, stretch, rng):
            given_up.add(int(stretch[0]))
    return Grown(growth.jointed(), growth.labels, growth.logodds, growth.seen)


def _best_grown(
    evidence: Evidence, tracker: Tracker, seeds: Sequence[Seed], settings: ReconstructSettings, rng: np.random.Generator
) -> Growth:
    """All frames, grown from one of `seeds`, and from others if much of that is in doubt: the least cost decides."""
    best, failure = None, HopelessError("no second part")
    for _ in range(settings.growth.attempts):
        try:
            growth, seed = _grown_piece(evidence, tracker, seeds, settings, rng)
        except HopelessError as error:
            failure = error
            break
        if best is None or np.nanmean(growth.costs) < np.nanmean(best.costs):
            best = growth
        if not is_doubtful(growth):
            break
        seeds = [other for other in seeds if abs(other.frame - seed.frame) >= settings.growth.beginnings_apart]
    if best is None:
        raise failure
    return best


def _grown_piece(
    evidence: Evidence,
    tracker: Tracker,
    seeds: Sequence[Seed],
    settings: ReconstructSettings,
    rng: np.random.Generator,
    span: tuple[int, int] | None = None,
) -> tuple[Growth, Seed]:
    """All frames, or those from the first to the last of `span`, grown from the returned one of `seeds`."""
    growth, seed = _begun(evidence, tracker, seeds, settings, rng, span)
    while frontier(growth):
        add_frames(growth, settings.growth.adjust_every)
        found, growth.found_again = growth.found_again, []
        for pair in found:
            go_back(growth, *pair)
        growth.found_again.clear()  # what the way back found leads nowhere new
        growth.relabel_doubtful()
        _adjust(growth, rng)
    return growth, seed


def _begun(
    evidence: Evidence,
    tracker: Tracker,
    seeds: Sequence[Seed],
    settings: ReconstructSettings,
    rng: np.random.Generator,
    span: tuple[int, int] | None = None,
) -> tuple[Growth, Seed]:
    """Grown until the joint is known, from the first of some `seeds` far apart that leads to one without doubt.

    If all leave doubt, from that whose joint explains its frames best; of those with motion enough, if there are any.
    """
    s, chosen = settings.growth, list[Seed]()
    for seed in seeds:
        if all(abs(seed.frame - other.frame) >= s.beginnings_apart for other in chosen):
            chosen.append(seed)
    best, least, failure = None, (True, np.inf), HopelessError("no second part")
    for seed in chosen[: s.beginnings]:
        try:
            growth = _with_joint(Growth(evidence, tracker, seed, settings, rng, span), seed)
        except HopelessError as error:
            failure = error
            continue
        still = growth.relative_motion() < s.bootstrap_motion * evidence.scene.diagonal
        frames = np.flatnonzero(growth.done & growth.seen.all(1))
        costs = [growth.jointed_cost(int(i), growth.Ts[0, i], growth.states[i]) for i in frames]
        quality = still, float(np.mean(costs))
        if best is None or quality < least:
            best, least = (growth, seed), quality
        if least < (False, s.sure_cost):
            break
    if best is None:
        raise failure
    return best


def _with_joint(growth: Growth, seed: Seed) -> Growth:
    """`growth` from `seed` on, free at first, until the relative motion says what the joint is."""
    for j, T in zip(seed.others, seed.Ts, strict=True):
        step_free(growth, int(j), int(j) - 1, ([T[0]], [T[1]]))
    s = growth.settings.growth
    add_frames(growth, s.bootstrap_frames - int(growth.done.sum()))
    enough = s.bootstrap_motion * growth.evidence.scene.diagonal
    while growth.relative_motion() < enough and growth.done.sum() < s.bootstrap_most and frontier(growth):
        add_frames(growth, 4)
    frames_with_both(growth.seen, growth.done)
    growth.adopt(growth.try_joint())
    return growth


def _adjust(growth: Growth, rng: np.random.Generator) -> None:
    """All poses so far under one joint, roughly."""
    roughly = replace(growth.settings.poses, samples=growth.settings.growth.adjust_samples)
    asked = growth.evidence, growth.labels, growth.jointed(), growth.seen, roughly, rng
    growth.adopt(joint_adjustment(*asked, 4, growth.done))


def _mended(growth: Growth, stretch: Frames, rng: np.random.Generator) -> bool:
    """Whether a piece from a seed within `stretch` took the place of what growth had found there."""
    settings, last = growth.settings, len(growth.done) - 1
    span = max(0, int(stretch[0]) - settings.pieces.margin), min(last, int(stretch[-1]) + settings.pieces.margin)
    try:
        within = int(stretch[0]), int(stretch[-1])
        seeds = find_seeds(growth.evidence, growth.tracker, settings.seeds, rng, within)
        piece, _ = _grown_piece(growth.evidence, growth.tracker, seeds, settings, rng, span)
    except HopelessError:
        return False
    if not join(growth, piece, stretch):
        return False
    _adjust(growth, rng)
    return True


def relabel(evidence: Evidence, grown: Grown, settings: ReconstructSettings, rng: np.random.Generator) -> Grown:
    """Labels of all frames anew, given all poses."""
    Ts = np.stack([grown.poses.Ts, grown.poses.Ts_moving])
    body = body_points(evidence, grown.labels, Ts[1], grown.seen[:, 1])
    logodds = label_frames(evidence, Ts, body, grown.seen, grown.logodds, rng)
    scene, least = evidence.scene, settings.growth.min_jointed_pixels
    labels = np.where(scene.mask, (logodds > 0) + np.uint8(1), np.uint8(0))
    sure = np.abs(logodds) > 1
    seen = [[evidence.usable(i, (labels[i] == k) & sure[i]).sum() >= least for k in (1, 2)] for i in range(len(labels))]
    return replace(grown, labels=labels, logodds=logodds, seen=np.array(seen))
