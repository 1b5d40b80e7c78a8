"""How well all frames of a result agree, measured without ground truth. The result does not depend on it.

Samples of every frame are carried to the frames that `poses.choose_pairs` pairs it with, and compared there: once by
the free poses, once by those under the joint.
"""

from __future__ import annotations

import resource
import sys
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.special import expit

from freeart21 import se3
from freeart21.files.diagnostics import Diagnostics
from freeart21.se3 import Array
from reconstruct.evidence import Evidence, Pixels, Samples, sample_evenly, sample_pixels
from reconstruct.labels import discriminative_frames, part_motions
from reconstruct.poses import GATE, FreePoses, choose_pairs, part_samples
from reconstruct.propagation import PartEstimate, body_points
from reconstruct.rigid import view_angle
from reconstruct.scene import uncrop_masks
from reconstruct.settings import PoseSettings

SAMPLES = 100
"""Pixels per frame and part."""
OFF_MASK = 1.5
"""Pixels from the mask beyond which a sample is off it: more than rounding to whole pixels explains."""
LEAST = 20
"""With fewer samples a figure is NaN."""
MOST_FRAMES = 150
"""Frames, evenly spaced, for which a third motion and each part's own motion are tested."""
NEARBY, SAME_VIEW = (2, 4, 8, 12, 20), 0.6
"""Frame offsets, and radians between views, within which a frame's pixels are compared."""
MISFIT = 2.5
"""Cost above which a pixel does not follow a motion: more than two standard deviations, and not hidden."""
STATES, AS_WELL, BARRIER = 36, 0.5, 1.3
"""States tried each way over half a turn or the range of motion; mean pixel cost up to which a state explains a frame
(that of one standard deviation); and the ratio to it that states in between must exceed. Measured on a fan: 0.05 at its
own state, 0.1 to 0.3 at 45 degrees, 0.8 to 1.7 between."""


def diagnose(
    evidence: Evidence,
    estimate: PartEstimate,
    free: tuple[FreePoses, ...],
    settings: PoseSettings,
    seed: int = 0,
    size: tuple[int, int] | None = None,
) -> Diagnostics:
    """Residuals, inliers and confidence of every frame and part.

    A sample is an inlier when it meets its own part's surface within the first gate of the joint adjustment, wide
    enough to tell bad frames from good ones. With the full image's `size` (width, height), confidence maps are
    included.
    """
    scene, rng = evidence.scene, np.random.default_rng([seed, 21])
    gate = GATE * evidence.unit
    columns = []
    for k, jointed in enumerate((estimate.poses.Ts, estimate.poses.Ts_moving)):
        samples = part_samples(evidence, estimate.labels, k + 1, SAMPLES, rng, estimate.seen[:, k])
        pairs = choose_pairs(free[k].Ts, estimate.seen[:, k], settings)
        by_free = measure_agreement(evidence, estimate.labels, k + 1, free[k].Ts, samples, pairs, gate)
        by_joint = measure_agreement(evidence, estimate.labels, k + 1, jointed, samples, pairs, gate)
        columns.append(np.column_stack([by_free, by_joint[:, 2]]))
    inliers, outside, residual, jointed_residual = np.stack(columns, 2).transpose(1, 0, 2)
    probability = label_probability(estimate.labels, estimate.logodds)
    maps = np.rint(255 * probability).astype(np.uint8)
    return Diagnostics(
        _pixels(estimate.labels, scene.factor),
        _means(estimate.labels, probability),
        inliers,
        outside,
        residual,
        jointed_residual,
        gate,
        scene.footprint,
        scene.noise,
        scene.diagonal,
        peak_bytes(),
        None if size is None else uncrop_masks(scene, maps, *size),
        **(
            _consistency_figures(evidence, estimate, np.stack([f.Ts for f in free]), rng)
            if estimate.seen.all(1).any()
            else {}
        ),
    )


def measure_agreement(
    evidence: Evidence,
    labels: NDArray[np.uint8],
    part: int,
    Ts: Array,
    samples: Samples,
    pairs: tuple[NDArray[Any], NDArray[Any]],
    gate: float,
) -> Array:
    """(n, 3) for every frame: share of inliers, share outside the mask, rms of the inliers' residuals, metres.

    `Ts` (n, 4, 4) are T_camera_part, `pairs` (source, target) frames, `gate` in metres. Samples that are hidden in the
    target, because they face away, fall on the other part or lie behind a hand, do not count. NaN with fewer than LEAST
    that count.
    """
    scene = evidence.scene
    h, w = scene.mask.shape[1:]
    found = np.full((len(Ts), 3), np.nan)
    for i, pixels in samples.items():
        others = pairs[1][pairs[0] == i]
        if not len(others) or not len(pixels):
            continue
        T = Ts[others] @ se3.inverse(Ts[i])
        y, x = pixels.T
        X = se3.transform(T, scene.points[i, y, x][None])
        N = scene.normals[i, y, x] @ np.swapaxes(T[:, :3, :3], 1, 2)
        j = np.broadcast_to(others[:, None], X.shape[:2])
        with np.errstate(divide="ignore", invalid="ignore"):
            u = np.floor(scene.fx * X[..., 0] / X[..., 2] + scene.cx[j] + 0.5)
            v = np.floor(scene.fy * X[..., 1] / X[..., 2] + scene.cy[j] + 0.5)
        inside = (X[..., 2] > 0) & (u >= 0) & (v >= 0) & (u < w) & (v < h)
        facing = (N * X).sum(-1) < -0.15 * np.linalg.norm(X, axis=-1)
        X, N, j = X[inside & facing], N[inside & facing], j[inside & facing]
        at = (j, v[inside & facing].astype(int), u[inside & facing].astype(int))
        depth = scene.points[at][:, 2]
        off = (scene.outside[at] > OFF_MASK) & ~((depth < 0) & (X[:, 2] > -depth - gate))
        own = (depth > 0) & (labels[at] != 3 - part)
        counted = int((off | own).sum())
        if counted < LEAST:
            continue
        there = scene.normals[at]
        r = (there * (X - scene.points[at])).sum(-1)
        met = own & ~off & ((there * N).sum(-1) > 0.7) & (np.abs(r) <= gate)
        rms = float(np.sqrt((r[met] ** 2).mean())) if met.any() else np.nan
        found[i] = met.sum() / counted, off.sum() / counted, rms
    return found


def peak_bytes() -> int:
    """Peak memory of this process, bytes."""
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return int(peak) if sys.platform == "darwin" else 1024 * int(peak)


def _pixels(labels: NDArray[np.uint8], factor: int) -> Array:
    counts = np.stack([(labels == k).sum((1, 2)) for k in (1, 2)], 1)
    return counts.astype(float) * factor**2


def label_probability(labels: NDArray[np.uint8], logodds: NDArray[np.float32]) -> NDArray[np.float32]:
    """(n, h, w) probability of each pixel's label by the log-odds of the second part; 0 without a label."""
    toward = np.where(labels == 2, logodds, -logodds)
    return np.where(labels > 0, expit(toward), 0).astype(np.float32)


def _means(labels: NDArray[np.uint8], values: NDArray[np.float32]) -> Array:
    """(n, 2) mean of `values` (n, h, w) over each part; NaN where it has no pixels."""
    masks = np.stack([labels == k for k in (1, 2)], 1)
    counts = masks.sum((2, 3)).astype(float)
    sums = np.einsum("nkhw,nhw->nk", masks, values.astype(float))
    return np.divide(sums, counts, out=np.full_like(counts, np.nan), where=counts > 0)


# --- what only a right answer leaves (freeart21.trust) ----------------------------------------------------------------


def _consistency_figures(
    evidence: Evidence, estimate: PartEstimate, Ts: Array, rng: np.random.Generator
) -> dict[str, Array]:
    """Further fields of `Diagnostics`, by name; `Ts` (2, n, 4, 4) are T_camera_part."""
    body = body_points(evidence, estimate.labels, Ts[1], estimate.seen[:, 1])
    return {
        "unexplained": unexplained(evidence, Ts, estimate.seen, rng),
        "other_motion_cost": other_motion_cost(evidence, estimate, Ts, body, rng),
        "rival_distance": rival_distance(evidence, estimate, rng),
    }


def unexplained(evidence: Evidence, Ts: Array, seen: NDArray[np.bool_], rng: np.random.Generator) -> Array:
    """(n,) share of a frame's pixels that in a quarter of the frames nearby follow neither part's motion.

    `Ts` (2, n, 4, 4) are T_camera_part, `seen` (n, 2). Pixels that leave the image are not judged. NaN where no frame
    nearby has a similar view. A correct result has next to none; a third motion leaves all pixels that follow it.
    """
    n, shares = len(seen), np.full(len(seen), np.nan)
    known = np.asarray(seen.all(1))
    for i in map(int, sample_evenly(np.flatnonzero(known), MOST_FRAMES)):
        others = np.array([j for d in NEARBY for j in (i - d, i + d) if 0 <= j < n and known[j]], np.int64)
        turn = np.min([view_angle(T[others, :3, :3], T[i, :3, :3]) for T in Ts], axis=0)
        others = others[turn < SAME_VIEW]
        pixels = sample_pixels(evidence.usable_pixels(i, evidence.scene.valid[i]), 6 * SAMPLES, rng)
        if len(others) < 2 or len(pixels) < LEAST:
            continue
        T = part_motions(Ts, i, others)
        costs = evidence.costs(i, others, T, pixels).min(2)
        costs[~_inside(evidence, i, others, T, pixels).all(2)] = np.nan
        costs = costs[np.isfinite(costs).sum(1) >= 2]
        if len(costs) >= LEAST:
            shares[i] = (_upper_quartiles(costs) > MISFIT).mean()
    return shares


def _upper_quartiles(values: Array) -> Array:
    """(p,) 75th percentiles of the numbers in each row of `values` (p, s), NaNs left out; each row has a number.

    As `np.nanpercentile`, which takes rows one by one: here all rows with as many numbers are taken together.
    """
    counts, quartiles = np.isfinite(values).sum(1), np.empty(len(values))
    ordered = np.sort(values, axis=1)  # NaNs last
    for count in np.unique(counts):
        rows = counts == count
        quartiles[rows] = np.percentile(ordered[rows, :count], 75, axis=1)
    return quartiles


def _inside(evidence: Evidence, frame: int, others: NDArray[np.int64], T: Array, pixels: Pixels) -> NDArray[np.bool_]:
    """(p, s, k) whether `pixels` (p, 2) of `frame`, moved by T (s, k, 4, 4), lie inside the images of `others`."""
    scene = evidence.scene
    h, w = scene.mask.shape[1:]
    X = se3.transform(T, scene.points[frame][tuple(pixels.T)][None, None]).transpose(2, 0, 1, 3)
    with np.errstate(divide="ignore", invalid="ignore"):
        u = scene.fx * X[..., 0] / X[..., 2] + scene.cx[others][:, None]
        v = scene.fy * X[..., 1] / X[..., 2] + scene.cy[others][:, None]
    return np.asarray((X[..., 2] > 0) & (u > -0.5) & (v > -0.5) & (u < w - 0.5) & (v < h - 0.5))


def other_motion_cost(
    evidence: Evidence, estimate: PartEstimate, Ts: Array, body: Array, rng: np.random.Generator
) -> Array:
    """(n, 2) mean cost of each part's samples under the other part's motion, over frames with another joint state.

    NaN where there are none. `Ts` (2, n, 4, 4) are T_camera_part, `body` points of the second part.
    """
    found = np.full((len(estimate.seen), 2), np.nan)
    known = np.asarray(estimate.seen.all(1))
    for i in map(int, sample_evenly(np.flatnonzero(known), MOST_FRAMES)):
        others = discriminative_frames(evidence, i, Ts, body, known, rng)
        for k in range(2):
            pixels = sample_pixels(evidence.usable_pixels(i, estimate.labels[i] == k + 1), 2 * SAMPLES, rng)
            if len(others) and len(pixels) >= LEAST:
                T = part_motions(Ts, i, others)[:, 1 - k :][:, :1]
                found[i, k] = evidence.costs(i, others, T, pixels).mean()
    return found


def rival_distance(evidence: Evidence, estimate: PartEstimate, rng: np.random.Generator) -> Array:
    """(n,) rad or m from a frame's state to the nearest other state that explains its moving part as well; 0 for none.

    Such a state costs little, in absolute terms or relative to the frame's own, and is separated from it by states that
    cost more. NaN in frames that are not tested.
    """
    poses, joint, found = estimate.poses, estimate.poses.joint, np.full(len(estimate.seen), np.nan)
    frames = np.flatnonzero(estimate.seen.all(1))
    span = np.pi if joint.type == "revolute" else float(np.ptp(poses.states[frames]))
    steps = np.linspace(0, span, STATES + 1)[1:]
    states = np.concatenate([-steps[::-1], [0.0], steps])
    for i in map(int, sample_evenly(frames, 24)):
        others = frames[np.abs(frames - i) > 1]
        turn = view_angle(poses.Ts[others, :3, :3], poses.Ts[i, :3, :3])
        others = others[np.argsort(turn, kind="stable")][:6]
        pixels = sample_pixels(evidence.usable_pixels(i, estimate.labels[i] == 2), 2 * SAMPLES, rng)
        if len(pixels) < LEAST or not len(others):
            continue
        here = se3.inverse(poses.Ts[i] @ joint.transform(poses.states[i] + states))
        costs = evidence.costs(i, others, poses.Ts_moving[others][:, None] @ here, pixels).mean((0, 1))
        found[i] = _nearest_rival_distance(costs, states)
    return found


def _nearest_rival_distance(costs: Array, states: Array) -> float:
    """Distance of the nearest of the states `states` (q,), relative to the own one, that is as good by `costs` (q,)."""
    own = int(np.argmin(np.abs(states)))
    enough = max(AS_WELL, 1.2 * float(costs[own]))
    found = []
    for side in (costs[own::-1], costs[own:]):
        barrier = np.flatnonzero(side > BARRIER * enough)
        beyond = np.flatnonzero(side <= enough)
        beyond = beyond[beyond > barrier[0]] if len(barrier) else beyond[:0]
        if len(beyond):
            basin = beyond[: int(np.argmax(np.append(np.diff(beyond), 2) > 1)) + 1]
            found.append(int(basin[np.argmin(side[basin])]))
    return min(found) * abs(float(states[own + 1] - states[own])) if found else 0.0
