"""Which pixel belongs to which part, given the poses of both parts: dense masks with confidence.

A pixel is asked twice. Frames between which the joint has moved say by depth, silhouette and colour which of the two
motions it follows. Then, since a surface never changes its part, other frames pass on what they know: while growing,
those near in time and in view; afterwards all frames together, by `votes`. And a random walk (Grady 2006) over
neighbours that look alike and lie in one plane carries the answers to where neither knows: the harmonic interpolation
between sure pixels, to the end and not only so far as a few rounds reach.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy.ndimage import distance_transform_edt

from freeart21 import se3
from freeart21.se3 import Array
from reconstruct import kernels
from reconstruct.evidence import Evidence, spread
from reconstruct.rigid import view_angle
from reconstruct.settings import LabelSettings
from reconstruct.votes import SurfaceVotes

Frames = NDArray[np.int64]
Floats = NDArray[np.float32]

SURE = 3.0
"""Log-odds of a pixel that knows."""


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
    """Log-odds (h, w), from -3 to 3, that pixels of `frame` are the second part's; 0 where nobody knows.

    `Ts` (2, n, 4, 4) are both parts' poses and `body` (b, 3) points of the second part in its own frame. Asked are the
    frames `known` (n,): their poses are believed, their joint if it was `measured` (n,), and their `logodds` (n, h, w)
    as far as they go.
    """
    telling = telling_frames(evidence, frame, Ts, body, measured, rng)
    found = motion_evidence(evidence, frame, Ts, telling)
    return walked(evidence, frame, found, *hearsay(evidence, frame, Ts, known, logodds), start=logodds[frame])


def label_frames(
    evidence: Evidence, Ts: Array, body: Array, seen: NDArray[np.bool_], start: Floats, rng: np.random.Generator
) -> Floats:
    """Log-odds (n, h, w) of all frames: what the pixels of each say, and then what all frames say of their surfaces.

    Frames in which the joint is a guess say nothing of their own: they begin with what was believed. Each
    part was `seen` (n, 2) or not by the log-odds `start` (n, h, w) so far; see `label_frame` for the rest.
    """
    n = Ts.shape[1]
    unsure = np.array([is_open(logodds[valid]) for logodds, valid in zip(start, evidence.scene.valid, strict=True)])
    measured = np.asarray(seen.all(1)) | unsure
    nothing = np.zeros(0, np.int64)  # where the joint stands is a guess in a frame that was not measured
    telling = [telling_frames(evidence, i, Ts, body, measured, rng) if measured[i] else nothing for i in range(n)]
    found = kernels.each_in_threads(lambda i: motion_evidence(evidence, i, Ts, telling[i]).astype(np.float16), n)
    logodds = start.copy()
    for i in np.flatnonzero(measured):
        logodds[i] = np.clip(found[i], -SURE, SURE)
    votes = SurfaceVotes(evidence, Ts, seen | unsure[:, None])
    for _ in range(evidence.label_settings.rounds_of_votes):
        beliefs = votes.beliefs(logodds, SURE)

        def vote(i: int, beliefs: Floats = beliefs) -> None:
            heard = votes.in_frame(beliefs, i)
            strength = np.float32(evidence.label_settings.vote) * np.abs(heard)
            seen = found[i].astype(np.float32)
            logodds[i] = walked(evidence, i, seen, np.sign(heard), strength, start=logodds[i])

        kernels.each_in_threads(vote, n)
    return logodds


def is_open(logodds: Floats) -> bool:
    """Whether so many of a frame's pixels (p,) are in doubt that either part may be among them.

    Such a frame moved as one body with its neighbours; with no pixel in doubt, a part that is not seen is hidden, and
    its state a guess.
    """
    return len(logodds) > 0 and bool((np.abs(logodds) <= 1).mean() > 0.25)


def motion_evidence(evidence: Evidence, frame: int, Ts: Array, others: Frames) -> Floats:
    """Log-odds (h, w), within 6, from `others`, between which and `frame` the joint has moved; see `label_frame`."""
    unary = np.zeros(evidence.scene.mask.shape[1:], np.float32)
    measured = evidence.measured(frame)
    if len(others) == 0 or not measured.any():
        return unary
    costs = evidence.costs(frame, others, _motions(Ts, frame, others), np.argwhere(measured))
    unary[measured] = np.clip((costs[:, :, 0] - costs[:, :, 1]).sum(1) / np.sqrt(len(others)), -6, 6)
    return spread(unary, measured)


def hearsay(
    evidence: Evidence, frame: int, Ts: Array, usable: NDArray[np.bool_], logodds: Floats
) -> tuple[Floats, Floats]:
    """Mean belief (h, w), -1 to 1, of frames near in time and in view of the surfaces of `frame`, and its strength."""
    scene, s = evidence.scene, evidence.label_settings
    others = knowing_frames(frame, _turn(Ts, frame), usable, s)
    mean, strength = np.zeros(scene.mask.shape[1:], np.float32), np.zeros(scene.mask.shape[1:], np.float32)
    measured = evidence.measured(frame)
    if len(others) == 0 or not measured.any():
        return mean, strength
    pixels, T = np.argwhere(measured), np.ascontiguousarray(_motions(Ts, frame, others))
    said, size = np.zeros(len(pixels)), np.zeros(len(pixels))
    lens = (scene.fx, scene.fy, scene.cx, scene.cy)
    arguments = (frame, others, T, pixels, scene.points, scene.normals, logodds, *lens, 3 * evidence.unit, said, size)
    kernels.in_threads(lambda begin, end: _hear(begin, end, *arguments), len(pixels), 2000)
    mean[measured] = said / np.maximum(size, 1e-6)
    strength[measured] = s.propagation * np.minimum(np.abs(said), 4) / 4
    return spread(mean, measured), spread(strength, measured)


def _turn(Ts: Array, frame: int) -> Array:
    """(n,) radians from the view in `frame`, of the part whose view changed less."""
    return np.minimum(*(view_angle(T[:, :3, :3], T[frame, :3, :3]) for T in Ts))


def _motions(Ts: Array, frame: int, others: Frames) -> Array:
    """(s, 2, 4, 4) of both parts from `frame` to `others`."""
    return np.stack([Ts[:, j] @ se3.inverse(Ts[:, frame]) for j in others])


def telling_frames(
    evidence: Evidence, frame: int, Ts: Array, body: Array, usable: NDArray[np.bool_], rng: np.random.Generator
) -> Frames:
    """Frames of a similar view in which the joint stands elsewhere: they tell the two motions apart.

    See `label_frame` for the arguments.
    """
    settings, turn = evidence.label_settings, _turn(Ts, frame)
    known = np.flatnonzero(usable & (turn < settings.max_turn) & (np.arange(len(turn)) != frame))
    relative = se3.inverse(Ts[0, known]) @ Ts[1, known]
    here = se3.transform(se3.inverse(Ts[0, frame]) @ Ts[1, frame], body)
    there = se3.transform(relative, np.broadcast_to(body, (len(known), *body.shape)))
    apart = np.linalg.norm(there - here, axis=2).mean(1) / evidence.scene.diagonal
    known, apart = known[apart > settings.least_apart], apart[apart > settings.least_apart]
    value = np.minimum(apart, 0.25) - 0.25 * turn[known]
    pool = known[np.argsort(-value, kind="stable")[: 4 * settings.references]]
    if len(pool) > settings.references:
        pool = rng.choice(pool, settings.references, replace=False)
    return np.sort(pool)


def knowing_frames(frame: int, turn: Array, usable: NDArray[np.bool_], settings: LabelSettings) -> Frames:
    """Frames that show the same surfaces, whatever the joint does: near in time, and near in view."""
    n = len(turn)
    usable = usable & (np.arange(n) != frame)
    chosen = [frame + d for d in settings.neighbours if 0 <= frame + d < n and usable[frame + d]]
    similar = np.flatnonzero(usable & (np.abs(np.arange(n) - frame) > max(settings.neighbours)))
    similar = similar[turn[similar] < settings.max_turn]
    similar = similar[np.argsort(turn[similar], kind="stable")][: 8 * settings.similar : 8]
    return np.union1d(np.array(chosen, int), similar)


def walked(
    evidence: Evidence,
    frame: int,
    seen: Floats,
    heard: Floats | float = 0.0,
    strength: Floats | float = 0.0,
    start: Floats | None = None,
) -> Floats:
    """Log-odds (h, w), from -3 to 3, after the random walk.

    A pixel is held to what it has `seen` (log-odds, h, w) by their size, to what it has `heard` by its `strength`, to
    not knowing by a little, and to its neighbours. So belief fades with the way from those who know. The nearer the
    log-odds `start` (h, w) to the outcome, the sooner it is found.
    """
    valid, s = evidence.scene.valid[frame], evidence.label_settings
    hold = np.abs(seen) + strength + s.doubt
    target = (np.abs(seen) * np.clip(seen, -1, 1) + strength * heard) / hold
    logodds = np.zeros(valid.shape, np.float32)
    starts, ends, weights = _graph(evidence, frame)
    hold, target = hold[valid].astype(float), target[valid].astype(float)
    first = target if start is None else start[valid] / SURE
    x = _random_walk(hold, target, first.astype(float), starts, ends, s.walk * weights, s.residual, 300)
    logodds[valid] = SURE * np.clip(x, -1, 1)
    blind = evidence.scene.mask[frame] & ~valid
    if blind.any() and valid.any():  # a pixel without depth goes with the nearest that has
        rows, columns = distance_transform_edt(~valid, return_distances=False, return_indices=True)
        logodds[blind] = logodds[rows[blind], columns[blind]]
    return logodds


def _graph(evidence: Evidence, frame: int) -> tuple[NDArray, NDArray, NDArray]:
    """See `kernels.neighbours`."""
    scene = evidence.scene
    surface = (scene.valid[frame], scene.points[frame], scene.normals[frame], scene.features[frame])
    return kernels.neighbours(*surface, evidence.label_settings.reach * scene.diagonal, 2 * evidence.unit)


@njit(nogil=True, cache=True)
def _random_walk(strength, target, first, starts, ends, weights, tolerance, rounds):  # pragma: no cover
    """x (p,) that minimises sum strength (x - target)^2 + sum over edges weights (x_p - x_q)^2.

    Conjugate gradients with Jacobi's preconditioner from `first` (p,), until the residual has fallen to `tolerance` of
    the target's.
    """
    n = len(strength)
    diagonal = strength.copy()
    for p in range(n):
        for e in range(starts[p], starts[p + 1]):
            diagonal[p] += weights[e]
    x, d = target.copy(), np.zeros(n)
    r, product = np.empty(n), np.empty(n)
    _residual(x, strength, target, diagonal, starts, ends, weights, r)
    enough = max(tolerance * tolerance * (r * r / diagonal).sum(), 1e-12 * diagonal.sum())
    x[:] = first
    _residual(x, strength, target, diagonal, starts, ends, weights, r)
    gain = (r * r / diagonal).sum()
    before = np.inf
    for _ in range(rounds):
        if not gain > enough:
            break
        d = r / diagonal + gain / before * d
        for p in range(n):
            product[p] = diagonal[p] * d[p]
            for e in range(starts[p], starts[p + 1]):
                product[p] -= weights[e] * d[ends[e]]
        step = gain / (d * product).sum()
        x += step * d
        r -= step * product
        before = gain
        gain = (r * r / diagonal).sum()
    return x


@njit(nogil=True, cache=True)
def _residual(x, strength, target, diagonal, starts, ends, weights, r):  # pragma: no cover
    """Fills r (p,), minus half of the gradient at x (p,); see `_random_walk`."""
    for p in range(len(x)):
        r[p] = strength[p] * target[p] - diagonal[p] * x[p]
        for e in range(starts[p], starts[p + 1]):
            r[p] += weights[e] * x[ends[e]]


@njit(nogil=True, cache=True)
def _hear(
    begin, end, frame, others, T, pixels, points, normals, logodds, fx, fy, cx, cy, gate, said, size
):  # pragma: no cover  # fmt: skip
    """What `others` (s,) believe of the surfaces at pixels begin to end, under both motions T (s, 2, 4, 4).

    Where the first motion leads to what is believed the second part's, that speaks for the second; and the other way
    round. A frame speaks as loudly as it is sure, lest rumours feed on themselves. Fills the sums, over frames, of
    belief times its size, `said` (p,), and of its `size` (p,).
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
            said[p] += belief * abs(belief)
            size[p] += abs(belief)
