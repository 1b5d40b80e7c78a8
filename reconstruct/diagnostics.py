"""What the solver can say of its own answer without a truth: how well all frames agree with each other.

Samples of every frame are carried into the frames that `poses.choose_pairs` pairs it with by the free poses, and looked
up there, once by the free poses, once by those that obey the joint. Nothing of the answer depends on it.
"""

from __future__ import annotations

import resource
import sys

import numpy as np
from numpy.typing import NDArray
from scipy.special import expit

from freeart21 import se3
from freeart21.files.diagnostics import Diagnostics
from freeart21.se3 import Array
from reconstruct.evidence import Evidence, Samples
from reconstruct.growth import Grown
from reconstruct.poses import FreePoses, choose_pairs, part_samples
from reconstruct.scene import full_masks
from reconstruct.settings import PoseSettings

SAMPLES = 100
"""Pixels a frame and part."""
OFF_MASK = 1.5
"""Pixels from the mask beyond which a sample is off it: more than rounding to whole pixels explains."""
LEAST = 20
"""Fewer samples that could meet the surface tell nothing."""


def diagnose(
    evidence: Evidence,
    grown: Grown,
    free: tuple[FreePoses, ...],
    settings: PoseSettings,
    seed: int = 0,
    size: tuple[int, int] | None = None,
) -> Diagnostics:
    """Residuals, inliers and confidence of every frame and part.

    A sample is an inlier when it meets its own part's surface within the joint adjustment's first gate: wide enough to
    tell a bad frame from a good one. With the full picture's `size` (width, height) the maps of confidence are made,
    too.
    """
    scene, rng = evidence.scene, np.random.default_rng([seed, 21])
    gate = settings.gate * evidence.unit
    columns = []
    for k, jointed in enumerate((grown.poses.Ts, grown.poses.Ts_moving)):
        samples = part_samples(evidence, grown.labels, k + 1, SAMPLES, rng, grown.seen[:, k])
        pairs = choose_pairs(free[k].Ts, grown.seen[:, k], settings)
        by_free = agreement(evidence, grown.labels, k + 1, free[k].Ts, samples, pairs, gate)
        by_joint = agreement(evidence, grown.labels, k + 1, jointed, samples, pairs, gate)
        columns.append(np.column_stack([by_free, by_joint[:, 2]]))
    inliers, outside, residual, jointed_residual = np.stack(columns, 2).transpose(1, 0, 2)
    probability = label_probability(grown.labels, grown.logodds)
    maps = np.rint(255 * probability).astype(np.uint8)
    return Diagnostics(
        _pixels(grown.labels, scene.factor),
        _means(grown.labels, probability),
        inliers,
        outside,
        residual,
        jointed_residual,
        gate,
        scene.footprint,
        scene.noise,
        scene.diagonal,
        peak_bytes(),
        None if size is None else full_masks(scene, maps, *size),
    )


def agreement(
    evidence: Evidence,
    labels: NDArray[np.uint8],
    part: int,
    Ts: Array,
    samples: Samples,
    pairs: tuple[NDArray, NDArray],
    gate: float,
) -> Array:
    """(n, 3) of every frame: share of inliers, share outside the mask, root mean square of the inliers, metres.

    `Ts` (n, 4, 4) are T_camera_part, `pairs` (source, target) frames, `gate` in metres. Samples that face away in the
    target, or fall on the other part or behind a hand, are hidden there and do not count. NaN with fewer than LEAST
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
    """Most memory that this process has held, bytes."""
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return int(peak) if sys.platform == "darwin" else 1024 * int(peak)


def _pixels(labels: NDArray[np.uint8], factor: int) -> Array:
    counts = np.stack([(labels == k).sum((1, 2)) for k in (1, 2)], 1)
    return counts.astype(float) * factor**2


def label_probability(labels: NDArray[np.uint8], logodds: NDArray[np.float32]) -> NDArray[np.float32]:
    """(n, h, w) probability of the label that each pixel was given, by the log-odds of the second part; 0 for none."""
    toward = np.where(labels == 2, logodds, -logodds)
    return np.where(labels > 0, expit(toward), 0).astype(np.float32)


def _means(labels: NDArray[np.uint8], values: NDArray[np.float32]) -> Array:
    """(n, 2) mean of `values` (n, h, w) over each part; NaN where it has no pixels."""
    masks = np.stack([labels == k for k in (1, 2)], 1)
    counts = masks.sum((2, 3)).astype(float)
    sums = np.einsum("nkhw,nhw->nk", masks, values.astype(float))
    return np.divide(sums, counts, out=np.full_like(counts, np.nan), where=counts > 0)
