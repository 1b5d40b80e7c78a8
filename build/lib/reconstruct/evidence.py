"""What pixels say about motions between frames, with every scale taken from the scene."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, TypeVar

import cv2
import numpy as np
from numpy.typing import NDArray

from freeart21.se3 import Array
from reconstruct import kernels
from reconstruct.scene import Scene
from reconstruct.settings import EvidenceSettings, LabelSettings

Float = TypeVar("Float", np.float32, np.float64)

Pixels = NDArray[np.integer[Any]]
"""(m, 2) row and column."""

Samples = dict[int, NDArray[np.int32]]
"""Frame to its sample pixels (m, 2): row and column."""


@dataclass(frozen=True)
class Records:
    """What registration reads of samples, gathered once for many calls: see `Evidence.records`."""

    pixels: NDArray[np.float32]
    """(m, 10) records of the samples' pixels, one frame after the other."""
    offsets: NDArray[np.int64]
    """(n + 1,) where each frame's begin."""


class Evidence:
    """The scene's answer to questions about motion; holds no state of its own."""

    def __init__(self, scene: Scene, settings: EvidenceSettings, labels: LabelSettings) -> None:
        self.scene, self.settings, self.label_settings = scene, settings, labels
        self.unit = float(np.hypot(scene.footprint, 2 * scene.noise))
        """Metres: the footprint, widened by the noise that planes leave; gates are multiples of it."""
        self.sigma = float(np.hypot(settings.sigma * scene.footprint, scene.noise))
        """Metres: standard deviation of point-to-plane residuals."""

    def register(
        self,
        source: NDArray[np.int64],
        target: NDArray[np.int64],
        T: Array,
        samples: Samples | Records,
        gate: float,
        labels: NDArray[np.uint8] | None = None,
        part: int = 0,
    ) -> tuple[Array, Array, Array]:
        """Gauss-Newton terms H (p, 6, 6), g (p, 6) for left twists of T (p, 4, 4) = T_target_source, and stats (p, 4).

        `gate` is in units. With `labels` (n, h, w) and `part` 1 or 2, samples do not meet the other part; label 0 is
        either's. Statistics are inliers, projected, cost and outside.
        """
        scene, s = self.scene, self.settings
        records = samples if isinstance(samples, Records) else self.records(samples)
        H, g, stats = np.zeros((len(source), 6, 6)), np.zeros((len(source), 6)), np.zeros((len(source), 4))
        arguments = (
            np.asarray(source, np.int64),
            np.asarray(target, np.int64),
            np.ascontiguousarray(T, float),
            records.pixels,
            records.offsets,
            scene.pixels.reshape(-1, scene.pixels.shape[-1]),
            *scene.mask.shape[1:],
            _NO_LABELS if labels is None else labels.reshape(-1),
            0 if labels is None else part,
            scene.fx,
            scene.fy,
            scene.cx,
            scene.cy,
            gate * self.unit,
            self.sigma,
            s.sigma_colour,
            s.colour_weight,
            s.sigma_silhouette,
            H,
            g,
            stats,
        )
        kernels.in_threads(lambda begin, end: kernels.register_pairs(begin, end, *arguments), len(source), 50)
        return H, g, stats

    def records(self, samples: Samples) -> Records:
        """What `register` reads of the samples' pixels."""
        scene = self.scene
        counts = np.zeros(len(scene) + 1, np.int64)
        for frame, pixels in samples.items():
            counts[frame + 1] = len(pixels)
        h, w = scene.mask.shape[1:]
        places = np.concatenate([np.zeros((0, 2), np.int64), *(samples[frame] for frame in sorted(samples))])
        rows = np.repeat(np.arange(len(scene)) * h, counts[1:]) + places[:, 0]
        found = scene.pixels.reshape(h * w * len(scene), -1).take(rows * w + places[:, 1], axis=0)
        return Records(found, np.cumsum(counts))

    def costs(
        self,
        frame: int,
        others: NDArray[np.int64],
        T: Array,
        pixels: Pixels,
        logodds: NDArray[np.float32] | None = None,
        label_weight: float = 0.0,
    ) -> Array:
        """(p, s, k) cost of `pixels` (p, 2: row, column) of `frame` under motions T (s, k, 4, 4) to `others` (s,)."""
        scene, s = self.scene, self.settings
        costs = np.zeros((len(pixels), len(others), T.shape[1]))
        arguments = (
            frame,
            np.asarray(others, np.int64),
            np.ascontiguousarray(T, float),
            np.ascontiguousarray(pixels, np.int64),
            scene.pixels.reshape(-1, scene.pixels.shape[-1]),
            *scene.mask.shape[1:],
            _NO_ODDS if logodds is None else logodds.reshape(-1),
            0.0 if logodds is None else label_weight,
            scene.fx,
            scene.fy,
            scene.cx,
            scene.cy,
            1.5 * self.sigma,
            2 * s.sigma_colour,
            s.cap,
            costs,
        )
        kernels.in_threads(lambda begin, end: kernels.pixel_costs(begin, end, *arguments), len(pixels), 2000)
        return costs

    def smoothed(self, frame: int, unary: Array) -> NDArray[np.float32]:
        """Log-odds (h, w) of `frame` after relaxation of `unary` (h, w) among like neighbours."""
        scene, s = self.scene, self.label_settings
        valid = scene.valid[frame]
        starts, ends, weights = kernels.neighbours(
            valid,
            scene.points[frame],
            scene.normals[frame],
            scene.features[frame],
            s.reach * scene.diagonal,
            2 * self.unit,
        )
        logodds = np.zeros(valid.shape, np.float32)
        logodds[valid] = kernels.relax(unary[valid], starts, ends, weights, s.smoothness, s.rounds)
        return logodds

    def pixel_logodds(self, frame: int, others: NDArray[np.int64], T: Array) -> NDArray[np.float32]:
        """Smoothed log-odds (h, w) that pixels of `frame` move by T[:, 1] rather than T[:, 0] to `others`."""
        measured = self.measured(frame)
        costs = self.costs(frame, others, T, np.argwhere(measured))
        unary = np.zeros(measured.shape)
        unary[measured] = np.clip((costs[:, :, 0] - costs[:, :, 1]).sum(1) / np.sqrt(len(others)), -6, 6)
        return self.smoothed(frame, spread(unary, measured))

    def measured(self, frame: int) -> NDArray[np.bool_]:
        """(h, w) pixels that are asked: all, or every other one when there are many."""
        valid = self.scene.valid[frame]
        if valid.sum() <= self.label_settings.dense_pixels:
            return valid
        return np.asarray(valid & (np.indices(valid.shape).sum(0) % 2 == 0))

    def usable(self, frame: int, mask: NDArray[np.bool_]) -> NDArray[np.bool_]:
        """The pixels of `mask` (h, w) to register with: away from depth steps, or any when those are too few.

        A face seen at a grazing angle is all depth step, and yet the best there is.
        """
        everything = mask & self.scene.valid[frame]
        inner = everything & ~self.scene.edge[frame]
        enough = self.settings.enough_pixels
        return everything if inner.sum() < enough <= everything.sum() else inner


_NO_LABELS = np.zeros(1, np.uint8)
_NO_ODDS = np.zeros(1, np.float32)


def spread(values: NDArray[Float], measured: NDArray[np.bool_]) -> NDArray[Float]:
    """`values` (h, w) blurred a little among `measured` pixels, which fills those between."""
    weight = np.maximum(cv2.GaussianBlur(measured.astype(values.dtype), (0, 0), 0.8), 0.05)
    return np.asarray(cv2.GaussianBlur(np.where(measured, values, 0), (0, 0), 0.8) / weight, values.dtype)


def evenly(frames: NDArray[np.int64], most: int) -> NDArray[np.int64]:
    """At most `most` of the frames, evenly drawn."""
    if len(frames) <= most:
        return frames
    return frames[np.linspace(0, len(frames) - 1, most).round().astype(int)]


def draw(mask: NDArray[np.bool_], most: int, rng: np.random.Generator) -> NDArray[np.int32]:
    """At most `most` pixels (m, 2: row, column) of a mask (h, w), drawn evenly."""
    pixels = np.argwhere(mask).astype(np.int32)
    return pixels if len(pixels) <= most else pixels[np.sort(rng.choice(len(pixels), most, replace=False))]
