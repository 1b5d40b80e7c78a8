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

from freeart21 import se3
from freeart21.se3 import Array
from reconstruct import rigid
from reconstruct.evidence import Evidence
from reconstruct.features import Descriptors, Features
from reconstruct.joint_type import frames_with_both_parts
from reconstruct.propagation import PartEstimate, Propagation
from reconstruct.scene import UnsolvableError
from reconstruct.seeds import Seed
from reconstruct.segmentation import add_frames
from reconstruct.settings import PaperSegmentationSettings, ReconstructSettings
from reconstruct.tracks import Tracker, Tracks

LAMBDAS = {"main": 200.0, "smoothness": 10.0, "entropy": 0.01, "init": 5.0}
"""Weights of the terms: lambda_m, lambda_s, lambda_e, lambda_init. The released code has -0.01 for the entropy, of a
term of the other sign, and 20 for L_init."""
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
_MIN_WEIGHT = 1e-3
"""Weights stay away from 0 and 1, where BCE and entropy have infinite slope."""


# --- initial weights and transforms -----------------------------------------------------------------------------------


def feature_clusters(descriptors: Descriptors, rng: np.random.Generator) -> NDArray[np.int64]:
    """(p,) one of two clusters for each descriptor by k-means: "semantically similar points are assigned the same part
    label"."""
    if len(descriptors) <= 2:
        return np.arange(len(descriptors)) % 2
    return kmeans2(descriptors, 2, iter=30, minit="++", rng=rng)[1].astype(np.int64)


def initial_transforms(
    X: Array,
    Y: Array,
    second: NDArray[np.bool_],
    cutoff: float,
    rng: np.random.Generator,
) -> tuple[Array, NDArray[np.bool_]] | None:
    """T^0, T^1 (2, 4, 4) from X to Y (p, 3), metres, and which tracks follow T^1: RANSAC, Tukey, EM.

    Supplement, Transformation Initialization: Eq. (1) and both steps of EM, from the partition `second` (p,). None when
    there are too few tracks.
    """
    Ts: list[Array] = []
    for mine in (~second, second):
        T = rigid.ransac_fit(X[mine], Y[mine], cutoff / 2, rng)
        if T is not None:
            Ts.append(T)
    if len(Ts) == 1:
        Ts = [Ts[0], Ts[0]]
    if len(Ts) < 2:
        return None
    pair = _separate_motions(np.stack(Ts), X, Y, second, cutoff, rng)
    z = second
    for _ in range(EM_ROUNDS):
        errors = rigid.distances(pair, X[None], Y[None])
        z = np.where(errors[0] == errors[1], z, errors[1] < errors[0])  # E-step
        for k, mine in enumerate((~z, z)):  # M-step
            if mine.sum() >= 6:
                pair[k] = rigid.tukey_fit(pair[k], X[mine], Y[mine], cutoff / 2, 3)
    return pair, z


def _separate_motions(
    pair: Array, X: Array, Y: Array, second: NDArray[np.bool_], cutoff: float, rng: np.random.Generator
) -> Array:
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


@dataclass(frozen=True)
class Graph:
    """Neighbours in feature space."""

    edges: NDArray[np.int64]
    """(e, 2) p and q."""
    alpha: Array
    """(e,) weights alpha_pq; those of one p add up to 1."""


def neighbour_graph(
    descriptors: Descriptors, features: Features, radius: float = RADIUS, most: int = NEIGHBOURS
) -> Graph:
    """N(p) and alpha_pq of L_smooth: at most `most` neighbours within `radius`, weighted by their similarity."""
    if len(descriptors) < 2:
        return Graph(np.zeros((0, 2), np.int64), np.zeros(0))
    k = min(most + 1, len(descriptors))
    distance, other = cKDTree(descriptors).query(descriptors, k=k, distance_upper_bound=radius)
    p = np.repeat(np.arange(len(descriptors)), k)
    distance, other = distance.ravel(), other.ravel()
    kept = np.isfinite(distance) & (other != p)
    p, q = p[kept], other[kept]
    alpha = features.similarity(distance[kept] ** 2)
    total = np.bincount(p, alpha, len(descriptors))
    return Graph(np.stack([p, q], 1), alpha / np.maximum(total[p], 1e-12))


@dataclass(frozen=True)
class Pair:
    """The data of the objective of one frame pair (0, t)."""

    X: Array
    """(p, 3) X_{0,p}, in half diagonals from the object's middle."""
    Y: Array
    """(p, 3) X_{t,p}, likewise."""
    w_init: Array
    """(p,) initial weights w_{0,p}."""
    graph: Graph


def term_weights(settings: PaperSegmentationSettings) -> dict[str, float]:
    """The weight of each term; 0 for one that is switched off."""
    return {name: value if getattr(settings, f"use_{name}") else 0.0 for name, value in LAMBDAS.items()}


def objective(
    pair: Pair, Ts: Array, w: Array, settings: PaperSegmentationSettings
) -> tuple[dict[str, float], Array, Array]:
    """Weighted terms of L by name, and the gradients of L: (2, 6) by left twists (v, w) of `Ts` (2, 4, 4), and (p,) by
    w.

    L = lambda_m L_main + lambda_s L_smooth + lambda_e L_ent + lambda_init L_init (Sec. 3.2).
    """
    weight = term_weights(settings)
    value = dict.fromkeys(LAMBDAS, 0.0)
    dT, dw = np.zeros((2, 6)), np.zeros(len(w))
    if weight["main"]:
        displacement = pair.X @ np.swapaxes(Ts[:, :3, :3], 1, 2) + Ts[:, None, :3, 3]
        off = displacement - pair.Y
        length = np.sqrt((off**2).sum(2))
        scale = np.linalg.norm(pair.X - pair.Y, axis=1) + EPSILON
        ratio = length / scale
        rho = np.where(ratio < HUBER, 0.5 * ratio**2, HUBER * (ratio - 0.5 * HUBER))
        share = np.stack([1 - w, w])
        value["main"] = weight["main"] * float((share * rho).sum())
        dw += weight["main"] * (rho[1] - rho[0])
        slope = weight["main"] * share * np.minimum(ratio, HUBER) / scale / np.maximum(length, 1e-12)
        pull = slope[..., None] * off
        dT[:, :3] = pull.sum(1)
        dT[:, 3:] = np.cross(displacement, pull).sum(1)
    if weight["smoothness"]:
        p, q = pair.graph.edges.T
        difference = w[p] - w[q]
        value["smoothness"] = weight["smoothness"] * float((pair.graph.alpha * np.abs(difference)).sum())
        signed = weight["smoothness"] * pair.graph.alpha * np.sign(difference)
        dw += np.bincount(p, signed, len(w)) - np.bincount(q, signed, len(w))
    if weight["entropy"]:
        value["entropy"] = -weight["entropy"] * float((w * np.log(w) + (1 - w) * np.log(1 - w)).sum())
        dw -= weight["entropy"] * np.log(w / (1 - w))
    if weight["init"]:
        w0 = pair.w_init
        value["init"] = -weight["init"] * float((w0 * np.log(w) + (1 - w0) * np.log(1 - w)).sum())
        dw += weight["init"] * (w - w0) / (w * (1 - w))
    return value, dT, dw


def solve_pair(pair: Pair, Ts: Array, settings: PaperSegmentationSettings) -> tuple[Array, Array]:
    """T^0, T^1 and w of one frame pair: Adam on the objective from the initial transforms and weights (Sec. 4.1).

    Weights are updated directly and cut to (0, 1); transforms by left twists.
    """
    w = np.clip(pair.w_init, _MIN_WEIGHT, 1 - _MIN_WEIGHT)
    step_T, step_w = _Adam((2, 6), RATE_TRANSFORM), _Adam(w.shape, RATE_WEIGHT)
    for _ in range(settings.iterations):
        _, dT, dw = objective(pair, Ts, w, settings)
        Ts = se3.exp_se3(-step_T(dT)) @ Ts
        w = np.clip(w - step_w(dw), _MIN_WEIGHT, 1 - _MIN_WEIGHT)
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

    frames: NDArray[np.int64]
    """(s + 1,) frames; pairs are (0, i)."""
    Ts: Array
    """(s + 1, 2, 4, 4) motions T_{0->i}, metres, camera frame; the identity for i = 0."""
    pixels: list[NDArray[np.int64]]
    """The tracks' pixels (m, 2), row and column, for each frame."""
    weights: list[Array]
    """The tracks' weights (m,) for each frame; those of frame 0 are means over the pairs."""


def solve_window(
    evidence: Evidence,
    features: Features,
    tracks: Tracks,
    carried: Array | None,
    settings: PaperSegmentationSettings,
    rng: np.random.Generator,
) -> Window | None:
    """One window of the Part Solver. `carried` (h, w) are the dense weights of its first frame, if known.

    None when no pair has enough tracks.
    """
    scene = evidence.scene
    kept = np.flatnonzero(tracks.visible[:, 1])
    kept = kept[np.sort(rng.permutation(len(kept))[:MAX_TRACKS])]
    if len(kept) < MIN_TRACKS:
        return None
    visible, points = tracks.visible[kept], tracks.points[kept]
    pixels = np.rint(tracks.pixels[kept][..., ::-1]).astype(np.int64)
    descriptors = features.describe(int(tracks.frames[0]), pixels[:, 0])
    cutoff = TUKEY * evidence.unit
    if carried is None:
        w_init = feature_clusters(descriptors, rng).astype(float)
    else:
        w_init = carried[tuple(pixels[:, 0].T)]
    middle, half = np.median(points[:, 0], axis=0), scene.diagonal / 2
    steps = len(tracks.frames)
    Ts = np.tile(np.eye(4), (steps, 2, 1, 1))
    sums, counts = np.zeros(len(kept)), np.zeros(len(kept))
    found_pixels, found_weights = [pixels[:, 0]], [w_init]
    for i in range(1, steps):
        mine = visible[:, i]
        X, Y, w0 = points[mine, 0], points[mine, i], w_init[mine]
        first = initial_transforms(X, Y, w0 > 0.5, cutoff, rng) if mine.sum() >= MIN_TRACKS else None
        if first is None:
            Ts[i] = Ts[i - 1] @ se3.inverse(Ts[i - 2]) @ Ts[i - 1] if i > 1 else Ts[i]
            found_pixels.append(pixels[mine, i])
            found_weights.append(w0)
            continue
        graph = neighbour_graph(descriptors[mine], features)
        pair = Pair((X - middle) / half, (Y - middle) / half, w0, graph)
        solved, w = solve_pair(pair, _scaled(first[0], middle, half), settings)
        Ts[i] = _scaled(solved, -middle / half, 1 / half)
        sums[mine] += w
        counts[mine] += 1
        found_pixels.append(pixels[mine, i])
        found_weights.append(w)
    found_weights[0] = np.where(counts > 0, sums / np.maximum(counts, 1), w_init)
    return Window(tracks.frames, Ts, found_pixels, found_weights)


def _scaled(Ts: Array, middle: Array, unit: float) -> Array:
    """Transforms (..., 4, 4) in the coordinates (X - middle) / unit."""
    R, t = Ts[..., :3, :3], Ts[..., :3, 3]
    return se3.pose(R, (R @ middle + t - middle) / unit)


def dense_weights(
    features: Features,
    frame: int,
    foreground: NDArray[np.bool_],
    pixels: NDArray[np.int64],
    weights: Array,
    neighbours: int = FILL_NEIGHBOURS,
) -> Array:
    """The dense map w~_t (h, w) of one frame: weights at tracks, elsewhere the similarity-weighted mean of the nearest
    ones (supplement). The background has 0.5."""
    dense = np.full(foreground.shape, 0.5)
    if len(pixels) == 0:
        return dense
    wanted = np.argwhere(foreground)
    known, unknown = features.describe(frame, pixels), features.describe(frame, wanted)
    if neighbours < len(known):
        distance, near = cKDTree(known).query(unknown, k=neighbours)
        shape = (len(unknown), neighbours)
        filled = _mean(features, distance.reshape(shape) ** 2, weights[near.reshape(shape)])
    else:
        squared = cdist(unknown, known, "sqeuclidean")
        filled = _mean(features, squared, np.broadcast_to(weights, squared.shape))
    dense[tuple(wanted.T)] = filled
    covered = foreground[tuple(pixels.T)]
    dense[tuple(pixels[covered].T)] = weights[covered]
    return dense


def _mean(features: Features, squared: Array, weights: Array) -> Array:
    """(m,) similarity-weighted means; similarities are normalised by each row's largest."""
    s = features.similarity(squared - squared.min(1, keepdims=True)) + 1e-12
    return (s * weights).sum(1) / s.sum(1)


@dataclass(frozen=True)
class PartWeights:
    """The segmentation of a whole recording."""

    weights: NDArray[np.float32]
    """(n, h, w) dense w~: above 0.5 part 1."""
    motions: Array
    """(n, 2, 4, 4) of both parts from each frame to the next, metres; the last is the identity."""


def segment(
    evidence: Evidence,
    tracker: Tracker,
    features: Features,
    settings: PaperSegmentationSettings,
    rng: np.random.Generator,
) -> PartWeights:
    """Part weights of every frame, window after window, each from the dense map at the end of the one before.

    Windows share one frame. Where a window has too few tracks, the weights of the frame before are carried on by
    features alone. Raises UnsolvableError when no window can be solved.
    """
    scene = evidence.scene
    n = len(scene)
    weights = np.full(scene.mask.shape, 0.5, np.float32)
    motions = np.tile(np.eye(4), (n, 2, 1, 1))
    carried: Array | None = None
    t = most = 0
    while t < n - 1:
        tracks = tracker.follow(t, min(WINDOW - 1, n - 1 - t))
        most = max(most, int(tracks.visible[:, 1].sum()))
        window = solve_window(evidence, features, tracks, carried, settings, rng) if len(tracks.pixels) else None
        if window is None:
            if carried is not None:
                at = np.argwhere(scene.valid[t])
                at = at[np.sort(rng.permutation(len(at))[:MAX_TRACKS])]
                there = at + np.rint(tracker.step(t, 1)[tuple(at.T)][:, ::-1]).astype(int)
                there = np.clip(there, 0, np.array(scene.mask.shape[1:]) - 1)
                values = carried[tuple(at.T)]
                carried = dense_weights(features, t + 1, scene.valid[t + 1], there, values)
                weights[t + 1] = carried
            t += 1
            continue
        for i, frame in enumerate(map(int, window.frames)):
            if i == 0 and carried is not None:
                continue
            weights[frame] = dense_weights(features, frame, scene.valid[frame], window.pixels[i], window.weights[i])
        motions[t : t + len(window.frames) - 1] = window.Ts[1:] @ se3.inverse(window.Ts[:-1])
        t = int(window.frames[-1])
        carried = weights[t].astype(float)
    if carried is None:
        raise UnsolvableError(
            f"from no frame to the next can {MIN_TRACKS} points of the object be followed: {most} at most"
        )
    return PartWeights(weights, motions)


# --- what the later stages need ---------------------------------------------------------------------------------------


def part_poses(
    evidence: Evidence, tracker: Tracker, found: PartWeights, settings: ReconstructSettings, rng: np.random.Generator
) -> PartEstimate:
    """Poses of both parts in every frame under the paper's labels, and the joint.

    The "off-the-shelf pose estimators" (Sec. 3.3) are here our registration, started from the segmentation's motions,
    too; labels stay. The joint is chosen on all frames by `settings.joint`. Raises UnsolvableError when fewer than 4
    frames show two parts.
    """
    propagation = _GivenLabels(evidence, tracker, found, settings, rng)
    add_frames(propagation, len(evidence.scene))
    frames_with_both_parts(propagation.seen, propagation.done)
    propagation.set_joint(propagation.choose_joint())
    return PartEstimate(propagation.current_poses(), propagation.labels, propagation.logodds, propagation.seen)


class _GivenLabels(Propagation):
    """Propagation from frame 0 with given labels: poses only."""

    def __init__(
        self,
        evidence: Evidence,
        tracker: Tracker,
        found: PartWeights,
        settings: ReconstructSettings,
        rng: np.random.Generator,
    ) -> None:
        w = np.clip(found.weights, _MIN_WEIGHT, 1 - _MIN_WEIGHT)
        self.given = np.where(evidence.scene.mask, np.log(w / (1 - w)), 0).astype(np.float32)
        self.motions = found.motions
        start = Seed(0, np.zeros(0, np.int64), np.zeros((0, 2, 4, 4)), self.given[0], 0.0, 0)
        super().__init__(evidence, tracker, start, settings, rng)

    def label_frame(self, frame: int) -> None:
        self.set_labels(frame, self.given[frame])

    def carry_labels(self, frame: int, neighbour: int) -> NDArray[np.uint8]:
        return np.where(self.evidence.scene.mask[frame], np.where(self.given[frame] > 0, 2, 1), 0).astype(np.uint8)

    def predict_part_poses(self, k: int, frame: int, neighbour: int) -> list[Array]:
        initial_guesses = super().predict_part_poses(k, frame, neighbour)
        return (
            [*initial_guesses, self.motions[neighbour, k] @ self.Ts[k, neighbour]]
            if frame > neighbour
            else initial_guesses
        )
