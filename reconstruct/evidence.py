"""Costs of pixels under motions between frames, and registration."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, TypeVar

import cv2
import numpy as np
from numpy.typing import NDArray

from freeart21.joint import Joint
from freeart21.se3 import Array
from reconstruct import kernels, registration
from reconstruct.scene import Scene
from reconstruct.settings import EvidenceSettings, LabelSettings

Float = TypeVar("Float", np.float32, np.float64)

SIGMA = 0.8
"""Footprints: standard deviation of point-to-plane residuals of a clean sensor. Depth noise adds in quadrature."""
SIGMA_COLOUR = 3.0
"""Standard deviation of colour residuals, CIELAB units."""
SIGMA_SILHOUETTE = 2.0
"""Standard deviation, pixels, of points outside the mask."""
MAX_COST = 6.0
"""Largest cost of a pixel."""
ENOUGH_PIXELS = 60
"""With fewer pixels of a part away from depth steps, those at depth steps are used, too."""
SMOOTHNESS, SMOOTHING_ROUNDS = 0.5, 10
"""Mean-field smoothing of a seed's labels: weight of one similar neighbour, in log-odds, and iterations."""
NEIGHBOUR_REACH = 0.12
"""Object diagonals over which neighbouring pixels influence each other's label."""
DENSE_PIXELS = 12_000
"""Of a larger foreground only every other pixel is measured."""

Pixels = NDArray[np.integer[Any]]
"""(m, 2) row and column."""

Samples = dict[int, NDArray[np.int32]]
"""Frame to its sample pixels (m, 2): row and column."""


@dataclass(frozen=True)
class Records:
    """The records of sample pixels, gathered once for many calls of `Evidence.register`."""

    pixels: NDArray[np.float32]
    """(m, 10) records of the samples, frame after frame; see `Scene.pixels`."""
    offsets: NDArray[np.int64]
    """(n + 1,) where each frame's records begin."""
    per_error: float
    """Records that share one error of the depth, at least 1; see `Scene.correlation_area`."""


@dataclass(frozen=True)
class PartReferences:
    """What a frame is registered to: frames that show the part, its poses there, and records of its pixels."""

    frames: NDArray[np.int64]
    """(s,)"""
    Ts_part: Array
    """(s, 4, 4) T_part_camera of these frames."""
    records: Records


class Evidence:
    """Costs and registration on one scene. Keeps no results."""

    def __init__(
        self, scene: Scene, settings: EvidenceSettings, labels: LabelSettings, given_poses: Array | None = None
    ) -> None:
        self.scene, self.settings, self.label_settings = scene, settings, labels
        self.given_poses = np.zeros((0, len(scene), 4, 4)) if given_poses is None else given_poses
        """(b, n, 4, 4) camera from body, of b bodies that another program tracked; NaN where unknown."""
        self.unit = float(np.hypot(scene.footprint, 2 * scene.noise))
        """Metres: footprint and depth noise in quadrature; gates are multiples of it."""
        self.sigma = float(np.hypot(SIGMA * scene.footprint, scene.noise))
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

        `gate` is in units. With `labels` (n, h, w) and `part` 1 or 2, samples are not matched to the other part; label
        0 matches either. The statistics are numbers of inliers, projected and outside samples around the cost: inliers,
        projected, cost, outside. Depths that share one error weigh as one; colours and silhouettes have errors of their
        own.
        """
        scene = self.scene
        records = samples if isinstance(samples, Records) else self.records(samples)
        H, g, stats = np.zeros((len(source), 6, 6)), np.zeros((len(source), 6)), np.zeros((len(source), 4))
        pairs = (np.asarray(source, np.int64), np.asarray(target, np.int64), np.ascontiguousarray(T, float))
        own = (_NO_LABELS, 0) if labels is None else (labels.reshape(-1), part)
        samples_read = (records.pixels, records.offsets, *self._pixels)
        scales = (gate * self.unit, self._sigma_of(records), *self._sigmas)
        arguments = (*pairs, *samples_read, *own, *scene.lens, *scales, H, g, stats)
        kernels.run_in_threads(lambda begin, end: kernels.register_pairs(begin, end, *arguments), len(source), 50)
        return H, g, stats

    def register_pose(
        self,
        T: Array,
        frame: int,
        references: PartReferences,
        gates: tuple[float, ...],
        labels: NDArray[np.uint8] | None = None,
        part: int = 0,
    ) -> tuple[Array, Array]:
        """T (4, 4) = T_camera_part in `frame` after one Gauss-Newton step a gate, and the last summed statistics (4,).

        See `register` for gates, `labels`, `part` and statistics.
        """
        arguments: tuple[Any, ...] = (
            *(np.ascontiguousarray(T, float), references.frames, frame, references.Ts_part, np.array(gates, float)),
            *(references.records.pixels, references.records.offsets, *self._pixels),
            *((_NO_LABELS, 0) if labels is None else (labels.reshape(-1), part)),
            *(*self.scene.lens, self.unit, self._sigma_of(references.records), *self._sigmas),
        )
        T, statistics = registration.register_pose(*arguments)
        return T, statistics

    def register_jointed_pose(
        self,
        T: Array,
        q: float,
        joint: Joint,
        frame: int,
        references: tuple[PartReferences, PartReferences],
        gates: tuple[float, ...],
        labels: NDArray[np.uint8],
        prior: tuple[float, float],
        most: float,
        at_rest: bool,
    ) -> tuple[Array, float]:
        """T (4, 4) = T_camera_reference and state q in `frame` after one Gauss-Newton step a gate.

        `prior` is a weight and the state that it draws to; the state changes by at most `most` a step, or not at all
        with `at_rest`. See `register` for gates and labels.
        """
        first, second = references
        arguments: tuple[Any, ...] = (
            *(np.ascontiguousarray(T, float), float(q), joint.screw),
            *(frame, np.array(gates, float), np.array(prior, float), at_rest, most),
            *((first.frames, second.frames), (first.Ts_part, second.Ts_part)),
            *((first.records.pixels, second.records.pixels), (first.records.offsets, second.records.offsets)),
            *(*self._pixels, labels.reshape(-1), *self.scene.lens, self.unit),
            *((self._sigma_of(first.records), self._sigma_of(second.records)), *self._sigmas),
        )
        T, q = registration.register_jointed_pose(*arguments)
        return T, q

    def _sigma_of(self, records: Records) -> float:
        """Standard deviation of point-to-plane residuals, metres, with which records of one error weigh as one."""
        return self.sigma * math.sqrt(records.per_error)

    @property
    def _sigmas(self) -> tuple[float, float, float]:
        """Standard deviations of the other residuals and the weight of colour, as kernels read them."""
        return SIGMA_COLOUR, self.settings.colour_weight, SIGMA_SILHOUETTE

    @property
    def _pixels(self) -> tuple[NDArray[np.float32], int, int]:
        """The scene's pixel records (n h w, 10) with h and w, as kernels read them."""
        scene = self.scene
        return scene.pixels.reshape(-1, scene.pixels.shape[-1]), scene.mask.shape[1], scene.mask.shape[2]

    def records(self, samples: Samples) -> Records:
        """The records of the samples' pixels, as `register` reads them."""
        scene = self.scene
        counts = np.zeros(len(scene) + 1, np.int64)
        for frame, pixels in samples.items():
            counts[frame + 1] = len(pixels)
        h, w = scene.mask.shape[1:]
        places = np.concatenate([np.zeros((0, 2), np.int64), *(samples[frame] for frame in sorted(samples))])
        rows = np.repeat(np.arange(len(scene)) * h, counts[1:]) + places[:, 0]
        found = scene.pixels.reshape(h * w * len(scene), -1).take(rows * w + places[:, 1], axis=0)
        return Records(found, np.cumsum(counts), self._records_per_error(np.cumsum(counts), places))

    def _records_per_error(self, offsets: NDArray[np.int64], places: Pixels) -> float:
        """Pixels `places` (m, 2) per square of the correlation area that holds any of them, in its frame.

        `offsets` (n + 1,) are where each frame's pixels begin.
        """
        if self.scene.correlation_area <= 1 or not len(places):
            return 1.0
        squares = (places / math.sqrt(self.scene.correlation_area)).astype(np.int64)
        frames = np.repeat(np.arange(len(offsets) - 1), np.diff(offsets))
        return len(places) / len(np.unique(np.column_stack([frames, squares]), axis=0))

    def costs(
        self,
        frame: int,
        others: NDArray[np.int64],
        T: Array,
        pixels: Pixels,
        logodds: NDArray[np.float32] | None = None,
        label_weight: float = 0.0,
    ) -> Array:
        """(p, s, k) costs of `pixels` (p, 2: row, column) of `frame` under motions T (s, k, 4, 4) to `others` (s,)."""
        costs = np.zeros((len(pixels), len(others), T.shape[1]))
        motions = (frame, np.asarray(others, np.int64), np.ascontiguousarray(T, float))
        places = np.ascontiguousarray(pixels, np.int64)
        beliefs = (_NO_ODDS, 0.0) if logodds is None else (logodds.reshape(-1), label_weight)
        scales = (1.5 * self.sigma, 2 * SIGMA_COLOUR, MAX_COST)
        arguments = (*motions, places, *self._pixels, *beliefs, *self.scene.lens, *scales, costs)
        kernels.run_in_threads(lambda begin, end: kernels.pixel_costs(begin, end, *arguments), len(pixels), 2000)
        return costs

    def smooth_logodds(self, frame: int, unary: Array) -> NDArray[np.float32]:
        """Log-odds (h, w) of `frame`: `unary` (h, w) smoothed over similar neighbours."""
        logodds = np.zeros(unary.shape, np.float32)
        box, weights = self.neighbour_weights(frame)
        valid = self.scene.valid[frame][box]
        smooth = kernels.relax(unary[box], valid, weights, SMOOTHNESS, SMOOTHING_ROUNDS)
        logodds[box] = np.where(valid, smooth, 0)
        return logodds

    def neighbour_weights(self, frame: int) -> tuple[tuple[slice, slice], NDArray[np.float32]]:
        """The box (rows, columns) of the valid pixels of `frame`, and weights (6, h, w) of similar neighbours in it.

        See `kernels.neighbours`.
        """
        scene, valid = self.scene, self.scene.valid[frame]
        rows, columns = (np.flatnonzero(valid.any(axis)) for axis in (1, 0))
        box = np.s_[rows[0] : rows[-1] + 1, columns[0] : columns[-1] + 1] if len(rows) else np.s_[:0, :0]
        surface = valid[box], scene.points[frame][box], scene.normals[frame][box], scene.features[frame][box]
        return box, np.asarray(kernels.neighbours(*surface, NEIGHBOUR_REACH * scene.diagonal, 2 * self.unit))

    def pixel_logodds(self, frame: int, others: NDArray[np.int64], T: Array) -> NDArray[np.float32]:
        """Smoothed log-odds (h, w) that pixels of `frame` move by T[:, 1] rather than T[:, 0] to `others`."""
        measured = self.measured_pixels(frame)
        costs = self.costs(frame, others, T, np.argwhere(measured))
        unary = np.zeros(measured.shape)
        unary[measured] = np.clip((costs[:, :, 0] - costs[:, :, 1]).sum(1) / np.sqrt(len(others)), -6, 6)
        return self.smooth_logodds(frame, fill_between(unary, measured))

    def measured_pixels(self, frame: int) -> NDArray[np.bool_]:
        """(h, w) pixels whose costs are computed: all valid ones, or every other one when there are many."""
        valid = self.scene.valid[frame]
        if valid.sum() <= DENSE_PIXELS:
            return valid
        return np.asarray(valid & (np.indices(valid.shape).sum(0) % 2 == 0))

    def usable_pixels(self, frame: int, mask: NDArray[np.bool_]) -> NDArray[np.bool_]:
        """Pixels of `mask` (h, w) to register with: those away from depth steps, or all when those are too few.

        A face seen at a grazing angle is at depth steps throughout.
        """
        everything = mask & self.scene.valid[frame]
        inner = everything & ~self.scene.edge[frame]
        return everything if inner.sum() < ENOUGH_PIXELS <= everything.sum() else inner


_NO_LABELS = np.zeros(1, np.uint8)
_NO_ODDS = np.zeros(1, np.float32)


def fill_between(values: NDArray[Float], measured: NDArray[np.bool_]) -> NDArray[Float]:
    """`values` (h, w) blurred over `measured` pixels, which fills the pixels between."""
    weight = np.maximum(cv2.GaussianBlur(measured.astype(values.dtype), (0, 0), 0.8), 0.05)
    return np.asarray(cv2.GaussianBlur(np.where(measured, values, 0), (0, 0), 0.8) / weight, values.dtype)


def sample_evenly(frames: NDArray[np.int64], most: int) -> NDArray[np.int64]:
    """At most `most` of the frames, evenly spaced."""
    if len(frames) <= most:
        return frames
    return frames[np.linspace(0, len(frames) - 1, most).round().astype(int)]


def sample_pixels(mask: NDArray[np.bool_], most: int, rng: np.random.Generator) -> NDArray[np.int32]:
    """At most `most` random pixels (m, 2: row, column) of a mask (h, w)."""
    places = np.flatnonzero(mask)  # with the rest a third of the time of np.argwhere
    if len(places) > most:
        places = places[np.sort(rng.choice(len(places), most, replace=False))]
    return np.stack(np.divmod(places, mask.shape[1]), 1).astype(np.int32)
