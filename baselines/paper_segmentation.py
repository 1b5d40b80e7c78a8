"""The paper's free-moving part segmentation: clusters, transforms, windowed objective, propagation.

Functions are in the order of the paper (Sec. 3.2; supplement: Transformation Initialization, Part Segmentation) and use
its names. T^0 and T^1 are `Ts` (2, 4, 4); a weight w near 1 means part 1, which moves by T^1. Lengths are in half
object diagonals: the paper's objects, and with them its learning rates, are of about 2 m. Numbers are the paper's where
it states them. The tracker filters the tracks.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.cluster.vq import kmeans2
from scipy.spatial import cKDTree
from scipy.spatial.distance import cdist

from baselines.paper_features import describe, similarity
from freeart21 import se3
from freeart21.se3 import Array, Bools, Ints
from reconstruct import rigid
from reconstruct.evidence import Evidence
from reconstruct.scene import Scene, UnsolvableError
from reconstruct.tracks import Tracker, Tracks

MAIN, SMOOTHNESS, ENTROPY, INIT = 200.0, 10.0, 0.01, 5.0
"""Weights of the terms: lambda_m, lambda_s, lambda_e, lambda_init. The released code has -0.01 for the entropy, of a
term of the other sign, and 20 for L_init."""
ITERATIONS = 100
"""Adam steps per frame pair."""
WINDOW = 8
"""Frames of a window; pairs are (0, i) with i up to WINDOW - 1."""
RATE_TRANSFORM, RATE_WEIGHT = 1e-4, 1e-2
"""Adam's learning rates of the transforms' twists and of the part weights."""
HUBER = 1.0
"""Where rho turns from square to linear, relative to the displacement. The paper does not state it."""
EPSILON = 1e-3
"""The constant in L_main's denominator. The paper does not state it."""
EM_ROUNDS = 5
"""EM iterations of the initial transforms."""
TUKEY = 5.0
"""Cut-off of Tukey's weight, in units of `Evidence.unit`. The paper does not state it."""
RADIUS, NEIGHBOURS = 1.0, 12
"""Radius of the neighbour graph in feature space, which the paper does not state, and nearest neighbours used."""
FILL_NEIGHBOURS = 16
"""Tracks, nearest in features, whose weights fill a pixel."""
MAX_TRACKS = 1500
"""Tracks of a window, to bound time."""
MIN_TRACKS = 60
"""A pair with fewer tracks is not solved: it keeps weights and motions of the pair before."""
MIN_WEIGHT = 1e-3
"""Weights stay away from 0 and 1, where BCE and entropy have infinite slope."""


# --- initial weights and transforms -----------------------------------------------------------------------------------


def feature_clusters(descriptors: Array, rng: np.random.Generator) -> Ints:
    """(p,) one of two clusters for each descriptor by k-means: "semantically similar points are assigned the same part
    label"."""
    return kmeans2(descriptors, 2, iter=30, minit="++", rng=rng)[1].astype(np.int64)


def initial_transforms(
    X: Array, Y: Array, second: Bools, cutoff: float, rng: np.random.Generator
) -> tuple[Array, Bools] | None:
    """T^0, T^1 (2, 4, 4) from X to Y (p, 3), metres, and which tracks follow T^1: RANSAC, Tukey, EM.

    Supplement, Transformation Initialization: Eq. (1) and both steps of EM, from the partition `second` (p,). None when
    there are too few tracks.
    """
    fits = (rigid.ransac_fit(X[mine], Y[mine], cutoff / 2, rng) for mine in (~second, second))
    Ts = [T for T in fits if T is not None]
    if not Ts:
        return None
    pair = _separate_motions(np.stack([Ts[0], Ts[-1]]), X, Y, second, cutoff, rng)
    z = second
    for _ in range(EM_ROUNDS):
        errors = rigid.distances(pair, X[None], Y[None])
        z = np.where(errors[0] == errors[1], z, errors[1] < errors[0])  # E-step
        for k, mine in enumerate((~z, z)):  # M-step
            if mine.sum() >= 6:
                pair[k] = rigid.tukey_fit(pair[k], X[mine], Y[mine], cutoff / 2, 3)
    return pair, z


def _separate_motions(pair: Array, X: Array, Y: Array, second: Bools, cutoff: float, rng: np.random.Generator) -> Array:
    """`pair`, or, where both are the same motion, that one and the motion of the tracks it does not explain.

    Not in the paper, whose learned features separate the parts better.
    """
    if np.median(np.linalg.norm(se3.transform(pair[0], X) - se3.transform(pair[1], X), axis=1)) > cutoff / 2:
        return pair
    errors = rigid.distances(pair, X[None], Y[None])
    first = int(np.minimum(errors, cutoff).mean(1).argmin())
    rest = errors[first] > cutoff / 2
    other = rigid.ransac_fit(X[rest], Y[rest], cutoff / 2, rng) if rest.sum() >= 12 else None
    if other is None:
        return pair
    follows = rigid.distances(other, X, Y) < errors[first]
    swapped = (follows == second).mean() < 0.5  # most tracks keep their label
    return np.stack([other, pair[first]] if swapped else [pair[first], other])


# --- the objective ----------------------------------------------------------------------------------------------------


def neighbour_graph(descriptors: Array) -> tuple[Ints, Array]:
    """N(p) and alpha_pq of L_smooth: (e, 2) p and q, at most NEIGHBOURS of each p within RADIUS, and (e,) their weights
    by similarity, which add up to 1."""
    k = min(NEIGHBOURS + 1, len(descriptors))
    distance, other = cKDTree(descriptors).query(descriptors, k=k, distance_upper_bound=RADIUS)
    p = np.repeat(np.arange(len(descriptors)), k)
    distance, other = distance.ravel(), other.ravel()
    near = np.isfinite(distance) & (other != p)
    p, q = p[near], other[near]
    alpha = similarity(distance[near] ** 2)
    total = np.bincount(p, alpha, len(descriptors))
    return np.stack([p, q], 1), alpha / np.maximum(total[p], 1e-12)


@dataclass(frozen=True)
class Pair:
    """The data of the objective of one frame pair (0, t)."""

    X: Array
    """(p, 3) X_{0,p}, in half diagonals from the object's middle."""
    Y: Array
    """(p, 3) X_{t,p}, likewise."""
    w_init: Array
    """(p,) initial weights w_{0,p}."""
    graph: tuple[Ints, Array]
    """See `neighbour_graph`."""


def objective(pair: Pair, Ts: Array, w: Array) -> tuple[float, Array, Array]:
    """L, and its gradients: (2, 6) by left twists (v, w) of `Ts` (2, 4, 4), and (p,) by w.

    L = lambda_m L_main + lambda_s L_smooth + lambda_e L_ent + lambda_init L_init (Sec. 3.2).
    """
    displacement = pair.X @ np.swapaxes(Ts[:, :3, :3], 1, 2) + Ts[:, None, :3, 3]
    off = displacement - pair.Y
    length = np.sqrt((off**2).sum(2))
    scale = np.linalg.norm(pair.X - pair.Y, axis=1) + EPSILON
    ratio = length / scale
    rho = np.where(ratio < HUBER, 0.5 * ratio**2, HUBER * (ratio - 0.5 * HUBER))
    share = np.stack([1 - w, w])
    pull = (MAIN * share * np.minimum(ratio, HUBER) / scale / np.maximum(length, 1e-12))[..., None] * off
    dT = np.concatenate([pull.sum(1), np.cross(displacement, pull).sum(1)], 1)
    (p, q), alpha = pair.graph[0].T, pair.graph[1]
    difference, w0 = w[p] - w[q], pair.w_init
    value = MAIN * (share * rho).sum() + SMOOTHNESS * (alpha * np.abs(difference)).sum()
    value -= ENTROPY * (w * np.log(w) + (1 - w) * np.log(1 - w)).sum()
    value -= INIT * (w0 * np.log(w) + (1 - w0) * np.log(1 - w)).sum()
    signed = SMOOTHNESS * alpha * np.sign(difference)
    dw = MAIN * (rho[1] - rho[0]) + (np.bincount(p, signed, len(w)) - np.bincount(q, signed, len(w)))
    dw -= ENTROPY * np.log(w / (1 - w))
    dw += INIT * (w - w0) / (w * (1 - w))
    return float(value), dT, dw


def solve_pair(pair: Pair, Ts: Array) -> tuple[Array, Array]:
    """T^0, T^1 and w of one frame pair: Adam on the objective from the initial transforms and weights (Sec. 4.1).

    Weights are updated directly and cut to (0, 1); transforms by left twists.
    """
    w = np.clip(pair.w_init, MIN_WEIGHT, 1 - MIN_WEIGHT)
    step_T, step_w = _Adam((2, 6), RATE_TRANSFORM), _Adam(w.shape, RATE_WEIGHT)
    for _ in range(ITERATIONS):
        _, dT, dw = objective(pair, Ts, w)
        Ts = se3.exp_se3(-step_T(dT)) @ Ts
        w = np.clip(w - step_w(dw), MIN_WEIGHT, 1 - MIN_WEIGHT)
    return se3.orthonormalised(Ts), w


class _Adam:
    """Steps of Adam (Kingma and Ba 2015)."""

    def __init__(self, shape: tuple[int, ...], rate: float) -> None:
        self.rate, self.m, self.v, self.t = rate, np.zeros(shape), np.zeros(shape), 0

    def __call__(self, gradient: Array) -> Array:
        self.t += 1
        self.m = 0.9 * self.m + 0.1 * gradient
        self.v = 0.999 * self.v + 0.001 * gradient**2
        return self.rate * (self.m / (1 - 0.9**self.t)) / (np.sqrt(self.v / (1 - 0.999**self.t)) + 1e-8)


# --- windows ----------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Window:
    """A solved window."""

    Ts: Array
    """(s + 1, 2, 4, 4) motions T_{0->i}, metres, camera frame; the identity for i = 0."""
    pixels: list[Ints]
    """The tracks' pixels (m, 2), row and column, for each frame."""
    weights: list[Array]
    """The tracks' weights (m,) for each frame; those of frame 0 are means over the pairs."""


def solve_window(evidence: Evidence, tracks: Tracks, carried: Array | None, rng: np.random.Generator) -> Window | None:
    """One window of the Part Solver. `carried` (h, w) are the dense weights of its first frame, if known.

    None when there are too few tracks.
    """
    scene = evidence.scene
    used = np.flatnonzero(tracks.visible[:, 1])
    used = used[np.sort(rng.permutation(len(used))[:MAX_TRACKS])]
    if len(used) < MIN_TRACKS:
        return None
    visible, points = tracks.visible[used], tracks.points[used]
    pixels = np.rint(tracks.pixels[used][..., ::-1]).astype(np.int64)
    descriptors = describe(scene, int(tracks.frames[0]), pixels[:, 0])
    w_init = feature_clusters(descriptors, rng).astype(float) if carried is None else carried[tuple(pixels[:, 0].T)]
    middle, half = np.median(points[:, 0], axis=0), scene.diagonal / 2
    Ts = np.tile(np.eye(4), (len(tracks.frames), 2, 1, 1))
    sums, counts = np.zeros(len(used)), np.zeros(len(used))
    found_pixels, found_weights = [pixels[:, 0]], [w_init]
    for i in range(1, len(Ts)):
        mine = visible[:, i]
        X, Y, w = points[mine, 0], points[mine, i], w_init[mine]
        first = initial_transforms(X, Y, w > 0.5, TUKEY * evidence.unit, rng) if mine.sum() >= MIN_TRACKS else None
        if first is not None:
            pair = Pair((X - middle) / half, (Y - middle) / half, w, neighbour_graph(descriptors[mine]))
            solved, w = solve_pair(pair, _scaled(first[0], middle, half))
            Ts[i] = _scaled(solved, -middle / half, 1 / half)
            sums[mine] += w
            counts[mine] += 1
        elif i > 1:
            Ts[i] = Ts[i - 1] @ se3.inverse(Ts[i - 2]) @ Ts[i - 1]
        found_pixels.append(pixels[mine, i])
        found_weights.append(w)
    found_weights[0] = np.where(counts > 0, sums / np.maximum(counts, 1), w_init)
    return Window(Ts, found_pixels, found_weights)


def _scaled(Ts: Array, middle: Array, unit: float) -> Array:
    """Transforms (..., 4, 4) in the coordinates (X - middle) / unit."""
    R, t = Ts[..., :3, :3], Ts[..., :3, 3]
    return se3.pose(R, (R @ middle + t - middle) / unit)


def dense_weights(scene: Scene, frame: int, pixels: Ints, weights: Array) -> Array:
    """The dense map w~_t (h, w) of one frame: `weights` (m,) at the tracks' `pixels` (m, 2), elsewhere the
    similarity-weighted mean of the nearest ones (supplement). The background has 0.5."""
    foreground = scene.valid[frame]
    dense = np.full(foreground.shape, 0.5)
    if len(pixels) == 0:
        return dense
    wanted = np.argwhere(foreground)
    known, unknown = describe(scene, frame, pixels), describe(scene, frame, wanted)
    if len(known) > FILL_NEIGHBOURS:
        distance, near = cKDTree(known).query(unknown, k=FILL_NEIGHBOURS)
        squared, values = distance**2, weights[near]
    else:
        squared = cdist(unknown, known, "sqeuclidean")
        values = np.broadcast_to(weights, squared.shape)
    s = similarity(squared - squared.min(1, keepdims=True)) + 1e-12  # normalised by each row's largest
    dense[tuple(wanted.T)] = (s * values).sum(1) / s.sum(1)
    covered = foreground[tuple(pixels.T)]
    dense[tuple(pixels[covered].T)] = weights[covered]
    return dense


def segment(evidence: Evidence, tracker: Tracker, rng: np.random.Generator) -> tuple[NDArray[np.float32], Array]:
    """Part weights w~ (n, h, w) of every frame, above 0.5 part 1, and the motions (n, 2, 4, 4) of both parts from each
    frame to the next, metres, the identity for the last: window after window, each from the dense map at the end of the
    one before.

    Windows share one frame. Where a window has too few tracks, the weights of the frame before are carried on by
    features alone. Raises UnsolvableError when no window can be solved.
    """
    scene, n = evidence.scene, len(evidence.scene)
    weights = np.full(scene.mask.shape, 0.5, np.float32)
    motions = np.tile(np.eye(4), (n, 2, 1, 1))
    carried: Array | None = None
    t = most = 0
    while t < n - 1:
        tracks = tracker.follow(t, min(WINDOW - 1, n - 1 - t))
        most = max(most, int(tracks.visible[:, 1].sum()))
        window = solve_window(evidence, tracks, carried, rng) if len(tracks.pixels) else None
        if window is None:
            if carried is not None:
                at = np.argwhere(scene.valid[t])
                at = at[np.sort(rng.permutation(len(at))[:MAX_TRACKS])]
                there = at + np.rint(tracker.step(t, 1)[tuple(at.T)][:, ::-1]).astype(int)
                there = np.clip(there, 0, np.array(scene.mask.shape[1:]) - 1)
                weights[t + 1] = carried = dense_weights(scene, t + 1, there, carried[tuple(at.T)])
            t += 1
            continue
        for i, frame in enumerate(map(int, tracks.frames)):
            if i > 0 or carried is None:
                weights[frame] = dense_weights(scene, frame, window.pixels[i], window.weights[i])
        motions[t : t + len(window.Ts) - 1] = window.Ts[1:] @ se3.inverse(window.Ts[:-1])
        t = int(tracks.frames[-1])
        carried = weights[t].astype(float)
    if carried is None:
        raise UnsolvableError(
            f"from no frame to the next can {MIN_TRACKS} points of the object be followed: {most} at most"
        )
    return weights, motions
