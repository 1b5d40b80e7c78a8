"""Part labels of pixels, given the poses of both parts: dense masks with confidence.

A pixel gets evidence of two kinds. Frames between which the joint has moved compare both motions by depth, silhouette
and colour. Other frames pass on their beliefs, since a surface never changes its part: during propagation the frames
near in time and view, afterwards all frames together (`votes`). A random walk (Grady 2006) over neighbours of similar
colour in a common plane then interpolates harmonically between certain pixels.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy.ndimage import distance_transform_edt

from freeart21 import se3
from freeart21.se3 import Array, Bools, Floats, Ints
from reconstruct import kernels
from reconstruct.evidence import Evidence, fill_between
from reconstruct.rigid import view_angle
from reconstruct.votes import SurfaceVotes

Frames = NDArray[np.int64]

SURE = 3.0
"""Log-odds of a pixel whose part is certain."""
AMBIGUOUS_SHARE = 0.25
"""Share of uncertain pixels (log-odds within 1) above which a frame is ambiguous."""
REFERENCES = 10
"""Frames that each frame is compared with."""
MAX_TURN = 1.2
"""Radians between two views that are compared."""
MIN_DISPLACEMENT = 0.02
"""Object diagonals that the second part must have moved between two frames for them to tell the motions apart."""
NEIGHBOUR_OFFSETS = (-12, -6, -3, -1, 1, 3, 6, 12)
"""Frame offsets over which beliefs are passed on."""
SIMILAR_FRAMES = 5
"""More distant frames, of the most similar view, that pass their beliefs on."""
EDGE_WEIGHT = 8.0
"""Random walk: weight of a similar neighbour. A pixel that has seen the joint move weighs its own log-odds."""
VOTE_WEIGHT = 20.0
"""Random walk: weight of the belief of all frames about a surface."""
PRIOR_WEIGHT = 0.03
"""Random walk: pull to log-odds 0, which makes beliefs fade with the distance to pixels that know."""
RESIDUAL = 3e-3
"""Residual, relative to that of the unsmoothed log-odds, at which the random walk is solved."""


def label_frame(
    evidence: Evidence,
    frame: int,
    Ts: Array,
    body: Array,
    known: NDArray[np.bool_],
    measured: NDArray[np.bool_],
    logodds: Floats,
    rng: np.random.Generator,
) -> Floats:
    """Log-odds (h, w), from -3 to 3, that pixels of `frame` are the second part's; 0 where unknown.

    `Ts` (2, n, 4, 4) are both parts' poses and `body` (b, 3) points of the second part in its own frame. Evidence comes
    from the frames `known` (n,) by their `logodds` (n, h, w), and, where the joint state was `measured` (n,), by their
    motion.
    """
    references = discriminative_frames(evidence, frame, Ts, body, measured, rng)
    own = motion_logodds(evidence, frame, Ts, references)
    beliefs = neighbour_beliefs(evidence, frame, Ts, known, logodds)
    return random_walk_logodds(evidence, frame, own, *beliefs, start=logodds[frame])


def label_frames(
    evidence: Evidence, Ts: Array, body: Array, seen: NDArray[np.bool_], start: Floats, rng: np.random.Generator
) -> Floats:
    """Log-odds (n, h, w) of all frames: from each frame's own motion evidence, then from the beliefs of all frames.

    Frames whose joint state is a guess have no motion evidence and keep their log-odds `start` (n, h, w). `seen` (n, 2)
    says which parts were visible. See `label_frame` for the other arguments.
    """
    n = Ts.shape[1]
    valid = evidence.scene.valid
    ambiguous = np.array([is_ambiguous(values[here]) for values, here in zip(start, valid, strict=True)])
    measured = np.asarray(seen.all(1)) | ambiguous
    references = [
        discriminative_frames(evidence, i, Ts, body, measured, rng) if measured[i] else np.zeros(0, np.int64)
        for i in range(n)
    ]
    own = kernels.map_in_threads(lambda i: motion_logodds(evidence, i, Ts, references[i]).astype(np.float16), n)
    logodds = start.copy()
    for i in np.flatnonzero(measured):
        logodds[i] = np.clip(own[i], -SURE, SURE)
    votes = SurfaceVotes(evidence, Ts, seen | ambiguous[:, None])
    for _ in range(evidence.label_settings.rounds_of_votes):
        beliefs = votes.surface_beliefs(logodds, SURE)

        def relabel(i: int, beliefs: Floats = beliefs) -> None:
            belief = votes.frame_beliefs(beliefs, i)
            weight = np.float32(VOTE_WEIGHT) * np.abs(belief)
            own_logodds = own[i].astype(np.float32)
            logodds[i] = random_walk_logodds(evidence, i, own_logodds, np.sign(belief), weight, start=logodds[i])

        kernels.map_in_threads(relabel, n)
    return logodds


def is_ambiguous(logodds: Floats) -> bool:
    """Whether so many of a frame's valid pixels (p,) are uncertain that either part may be among them.

    Such a frame moved rigidly with its neighbours. If instead no pixel is uncertain, an unseen part is hidden, and its
    state is a guess.
    """
    return len(logodds) > 0 and bool((np.abs(logodds) <= 1).mean() > AMBIGUOUS_SHARE)


def motion_logodds(evidence: Evidence, frame: int, Ts: Array, others: Frames) -> Floats:
    """Log-odds (h, w), within 6, from the motion between `frame` and the frames `others`; see `label_frame`."""
    unary = np.zeros(evidence.scene.mask.shape[1:], np.float32)
    measured = evidence.measured_pixels(frame)
    if len(others) == 0 or not measured.any():
        return unary
    costs = evidence.costs(frame, others, part_motions(Ts, frame, others), np.argwhere(measured))
    unary[measured] = np.clip((costs[:, :, 0] - costs[:, :, 1]).sum(1) / np.sqrt(len(others)), -6, 6)
    return fill_between(unary, measured)


def neighbour_beliefs(
    evidence: Evidence, frame: int, Ts: Array, usable: NDArray[np.bool_], logodds: Floats
) -> tuple[Floats, Floats]:
    """Mean belief, -1 to 1, of frames near in time and view about the surfaces of `frame`, and its weight; (h, w)."""
    scene = evidence.scene
    others = neighbour_frames(frame, _view_changes(Ts, frame), usable)
    mean, strength = np.zeros(scene.mask.shape[1:], np.float32), np.zeros(scene.mask.shape[1:], np.float32)
    measured = evidence.measured_pixels(frame)
    if len(others) == 0 or not measured.any():
        return mean, strength
    pixels, T = np.argwhere(measured), np.ascontiguousarray(part_motions(Ts, frame, others))
    belief_sums, weight_sums = np.zeros(len(pixels)), np.zeros(len(pixels))
    surfaces = (scene.points, scene.normals, logodds, *scene.lens)
    arguments = (frame, others, T, pixels, *surfaces, 3 * evidence.unit, belief_sums, weight_sums)
    kernels.run_in_threads(lambda begin, end: _sum_neighbour_beliefs(begin, end, *arguments), len(pixels), 2000)
    mean[measured] = belief_sums / np.maximum(weight_sums, 1e-6)
    strength[measured] = evidence.label_settings.propagation * np.minimum(np.abs(belief_sums), 4) / 4
    return fill_between(mean, measured), fill_between(strength, measured)


def _view_changes(Ts: Array, frame: int) -> Array:
    """(n,) radians of view change against `frame`, of the part whose view changed less."""
    return np.minimum(*(view_angle(T[:, :3, :3], T[frame, :3, :3]) for T in Ts))


def part_motions(Ts: Array, frame: int, others: Frames) -> Array:
    """(s, 2, 4, 4) motions of both parts from `frame` to `others`."""
    return np.stack([Ts[:, j] @ se3.inverse(Ts[:, frame]) for j in others])


def discriminative_frames(
    evidence: Evidence, frame: int, Ts: Array, body: Array, usable: NDArray[np.bool_], rng: np.random.Generator
) -> Frames:
    """Frames of a similar view in which the joint stands elsewhere, so that the two motions differ; see
    `label_frame`."""
    turn = _view_changes(Ts, frame)
    known = np.flatnonzero(usable & (turn < MAX_TURN) & (np.arange(len(turn)) != frame))
    relative = se3.inverse(Ts[0, known]) @ Ts[1, known]
    here = se3.transform(se3.inverse(Ts[0, frame]) @ Ts[1, frame], body)
    there = se3.transform(relative, np.broadcast_to(body, (len(known), *body.shape)))
    displacement = np.linalg.norm(there - here, axis=2).mean(1) / evidence.scene.diagonal
    moved = displacement > MIN_DISPLACEMENT
    known, displacement = known[moved], displacement[moved]
    value = np.minimum(displacement, 0.25) - 0.25 * turn[known]
    best = known[np.argsort(-value, kind="stable")[: 4 * REFERENCES]]
    if len(best) > REFERENCES:
        best = rng.choice(best, REFERENCES, replace=False)
    return np.sort(best)


def neighbour_frames(frame: int, turn: Array, usable: NDArray[np.bool_]) -> Frames:
    """Frames that show the same surfaces, near in time or in view, whatever the joint does."""
    n = len(turn)
    usable = usable & (np.arange(n) != frame)
    chosen = [frame + d for d in NEIGHBOUR_OFFSETS if 0 <= frame + d < n and usable[frame + d]]
    similar = np.flatnonzero(usable & (np.abs(np.arange(n) - frame) > max(NEIGHBOUR_OFFSETS)))
    similar = similar[turn[similar] < MAX_TURN]
    similar = similar[np.argsort(turn[similar], kind="stable")][: 8 * SIMILAR_FRAMES : 8]
    return np.union1d(np.array(chosen, int), similar)


def random_walk_logodds(
    evidence: Evidence,
    frame: int,
    own: Floats,
    belief: Floats | float = 0.0,
    weight: Floats | float = 0.0,
    start: Floats | None = None,
) -> Floats:
    """Log-odds (h, w), from -3 to 3, after the random walk.

    Each pixel is tied to its `own` log-odds (h, w) by their magnitude, to the `belief` (h, w) of other frames by its
    `weight`, to 0 by `PRIOR_WEIGHT`, and to its neighbours. `start` (h, w) only speeds up convergence.
    """
    valid = evidence.scene.valid[frame]
    total = np.abs(own) + weight + PRIOR_WEIGHT
    target = (np.abs(own) * np.clip(own, -1, 1) + weight * belief) / total
    logodds = np.zeros(valid.shape, np.float32)
    first = target if start is None else start / SURE
    box, weights = evidence.neighbour_weights(frame)
    strength, wanted, begin = (values[box].astype(float) for values in (total, target, first))
    x = _random_walk(strength, wanted, begin, valid[box], EDGE_WEIGHT * weights, RESIDUAL, 300)
    logodds[box] = np.where(valid[box], SURE * np.clip(x, -1, 1), 0)
    blind = evidence.scene.mask[frame] & ~valid
    if blind.any() and valid.any():  # pixels without depth take the nearest label
        rows, columns = distance_transform_edt(~valid, return_distances=False, return_indices=True)
        logodds[blind] = logodds[rows[blind], columns[blind]]
    return logodds


@njit(nogil=True, cache=True)
def _random_walk(
    strength: Array, target: Array, first: Array, valid: Bools, weights: Floats, tolerance: float, rounds: int,
) -> Array:  # pragma: no cover  # fmt: skip
    """x (h, w) that minimises sum strength (x - target)^2 + sum over edges weights (x_p - x_q)^2 over `valid` pixels.

    Conjugate gradients with Jacobi preconditioning from `first` (h, w), until the residual is `tolerance` of the
    target's. `weights` (6, h, w) are those of `kernels.neighbours`.
    """
    (h, w), border = valid.shape, kernels.BORDER
    inside = np.flatnonzero(kernels.padded(valid.astype(np.float64)))
    edges, wanted = kernels.padded_weights(weights), kernels.padded(np.where(valid, strength * target, 0.0))
    diagonal = kernels.padded(np.where(valid, strength, 0.0))
    kernels.add_neighbours(diagonal, np.ones(len(diagonal)), edges, w, 1.0)
    diagonal = np.where(diagonal > 0, diagonal, 1.0)  # where there is no pixel, nothing is divided by 0
    x, d, product = kernels.padded(np.where(valid, target, 0.0)), np.zeros(len(wanted)), np.zeros(len(wanted))
    r = wanted - diagonal * x
    kernels.add_neighbours(r, x, edges, w, 1.0)
    enough = max(tolerance * tolerance * _squares(r, diagonal, inside), 1e-12 * diagonal[inside].sum())
    x = kernels.padded(np.where(valid, first, 0.0))
    r = wanted - diagonal * x
    kernels.add_neighbours(r, x, edges, w, 1.0)
    gain, before = _squares(r, diagonal, inside), np.inf
    for _ in range(rounds):
        if not gain > enough:
            break
        ratio = gain / before
        for i in range(len(d)):
            d[i] = r[i] / diagonal[i] + ratio * d[i]
            product[i] = diagonal[i] * d[i]
        kernels.add_neighbours(product, d, edges, w, -1.0)
        along = 0.0
        for p in inside:
            along += d[p] * product[p]
        step = gain / along
        for i in range(len(d)):
            x[i] += step * d[i]
            r[i] -= step * product[i]
        before, gain = gain, _squares(r, diagonal, inside)
    return x.reshape(h + 2 * border, w + 2 * border)[border : border + h, border : border + w]


@njit(nogil=True, cache=True)
def _squares(r: Array, diagonal: Array, inside: Ints) -> float:  # pragma: no cover
    """Sum of r^2 / diagonal over the pixels `inside`."""
    total = 0.0
    for p in inside:
        total += r[p] * r[p] / diagonal[p]
    return total


@njit(nogil=True, cache=True)
def _sum_neighbour_beliefs(
    begin: int, end: int, frame: int, others: Frames, T: Array, pixels: Ints, points: Floats, normals: Floats,
    logodds: Floats, fx: float, fy: float, cx: Array, cy: Array, gate: float, belief_sums: Array, weight_sums: Array,
) -> None:  # pragma: no cover  # fmt: skip
    """Sum the beliefs of the frames `others` (s,) about the pixels begin to end, under both motions T (s, 2, 4, 4).

    A pixel that the first motion takes onto the second part counts for the second part, and vice versa. A frame's
    belief is weighted by its own magnitude, so that uncertain beliefs do not reinforce each other. Fills, per pixel,
    the sums over frames of weighted beliefs, `belief_sums` (p,), and of weights, `weight_sums` (p,).
    """
    h, w = points.shape[1], points.shape[2]
    for p in range(begin, end):
        y, x = pixels[p, 0], pixels[p, 1]
        for s in range(len(others)):
            j = others[s]
            belief = 0.0
            for k in range(2):
                R = T[s, k]
                Y0 = R[0, 3]
                Y1 = R[1, 3]
                Y2 = R[2, 3]
                for c in range(3):
                    Y0 += R[0, c] * points[frame, y, x, c]
                    Y1 += R[1, c] * points[frame, y, x, c]
                    Y2 += R[2, c] * points[frame, y, x, c]
                if Y2 < kernels.NEAR:
                    continue
                xi = math.floor(fx * Y0 / Y2 + cx[j] + 0.5)
                yi = math.floor(fy * Y1 / Y2 + cy[j] + 0.5)
                if xi < 0 or yi < 0 or xi >= w or yi >= h or points[j, yi, xi, 2] <= 0:
                    continue
                d = (Y0 - points[j, yi, xi, 0], Y1 - points[j, yi, xi, 1], Y2 - points[j, yi, xi, 2])
                off, same = 0.0, 0.0
                for c in range(3):
                    off += normals[j, yi, xi, c] * d[c]
                    turned = 0.0
                    for e in range(3):
                        turned += R[c, e] * normals[frame, y, x, e]
                    same += normals[j, yi, xi, c] * turned
                if abs(off) > gate or same < 0.7:
                    continue
                belief += (max(logodds[j, yi, xi], 0.0) if k == 0 else min(logodds[j, yi, xi], 0.0)) / SURE
            belief_sums[p] += belief * abs(belief)
            weight_sums[p] += abs(belief)
