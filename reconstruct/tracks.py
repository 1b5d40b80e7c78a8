"""Pixel tracks over short windows, lifted to 3D, behind one interface, with the supplement's filters.

`reconstruct.trackers` has the trackers.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from typing import Any, ClassVar

import cv2
import numpy as np
from numpy.typing import NDArray

from freeart21.se3 import Floats
from reconstruct.scene import Scene
from reconstruct.settings import TrackSettings


@dataclass(frozen=True)
class Flow:
    """Displacements between neighbouring crops, pixels (column, row); half floats, exact to 0.01 pixels."""

    forward: NDArray[np.float16]
    """(n, h, w, 2) from frame i to i + 1; the last frame has zeros."""
    backward: NDArray[np.float16]
    """(n, h, w, 2) from frame i to i - 1; the first frame has zeros."""

    def step(self, frame: int, direction: int) -> Floats:
        """The field (h, w, 2) from `frame` in time direction +1 or -1."""
        return (self.forward if direction > 0 else self.backward)[frame].astype(np.float32)


@dataclass(frozen=True)
class Tracks:
    """Pixels of one frame followed over a window: p tracks, s steps."""

    frames: NDArray[np.int64]
    """(s + 1,) frame indices; tracks start in the first."""
    pixels: NDArray[np.float64]
    """(p, s + 1, 2) column and row in the crop of each frame."""
    visible: NDArray[np.bool_]
    """(p, s + 1) true until a filter drops the track."""
    points: NDArray[np.float64]
    """(p, s + 1, 3) metres, camera frame; only valid where visible."""
    confidence: NDArray[np.float64]
    """(p, s + 1) the tracker's confidence, 0 to 1, in each position: c_{t,p} of the supplement."""


class Tracker:
    """Interface of a tracker; one file of `reconstruct.trackers` each. Pixels are of the scene's crops."""

    name: ClassVar[str]

    def __init__(self, scene: Scene, settings: TrackSettings) -> None:
        self.scene, self.settings = scene, settings

    def step(self, frame: int, direction: int) -> Floats:
        """Displacements (h, w, 2), column and row, of all pixels of `frame` to its neighbour in time, +1 or -1."""
        raise NotImplementedError

    def follow(
        self, start: int, steps: int, direction: int = 1, pixels: NDArray[np.integer[Any]] | None = None
    ) -> Tracks:
        """Filtered tracks from `start` over at most `steps` frames in time `direction`.

        `pixels` (p, 2) are rows and columns to follow; the tracker's own choice when not given.
        """
        raise NotImplementedError


def optical_flow(scene: Scene) -> Flow:
    """DIS optical flow (Kroeger et al. 2016) both ways between all neighbouring frames, with a black background."""
    dis = cv2.DISOpticalFlow.create(cv2.DISOPTICAL_FLOW_PRESET_MEDIUM)
    grey = [
        np.where(m, 40 + 0.84 * cv2.cvtColor(c, cv2.COLOR_RGB2GRAY), 0).astype(np.uint8)
        for c, m in zip(scene.rgb, scene.mask, strict=True)
    ]
    n, h, w = scene.mask.shape
    forward, backward = np.zeros((n, h, w, 2), np.float16), np.zeros((n, h, w, 2), np.float16)
    for i in range(n - 1):
        shift = crop_shift(scene, i, i + 1)
        moved = cv2.warpAffine(grey[i + 1], np.array([[1, 0, -shift[0]], [0, 1, -shift[1]]], float), (w, h))
        forward[i] = dis.calc(grey[i], moved, np.zeros((h, w, 2), np.float32)) + shift
        moved = cv2.warpAffine(grey[i], np.array([[1, 0, shift[0]], [0, 1, shift[1]]], float), (w, h))
        backward[i + 1] = dis.calc(grey[i + 1], moved, np.zeros((h, w, 2), np.float32)) - shift
    return Flow(forward, backward)


def crop_shift(scene: Scene, i: int, j: int) -> NDArray[np.float64]:
    """(2,) crop displacement, column and row, from frame i to j of a point that is fixed in the full image."""
    return (scene.origin[i] - scene.origin[j]) / scene.factor


def lift_to_3d(scene: Scene, frame: int, pixels: NDArray[np.float64]) -> NDArray[np.float64]:
    """Camera-frame points (p, 3) where the rays of sub-pixel crop positions (p, 2) meet the nearest pixel's plane."""
    x = np.clip(np.rint(pixels[:, 0]).astype(int), 0, scene.mask.shape[2] - 1)
    y = np.clip(np.rint(pixels[:, 1]).astype(int), 0, scene.mask.shape[1] - 1)
    point, normal = scene.points[frame, y, x].astype(float), scene.normals[frame, y, x].astype(float)
    ray = np.stack(
        [
            (pixels[:, 0] - scene.cx[frame]) / scene.fx,
            (pixels[:, 1] - scene.cy[frame]) / scene.fy,
            np.ones(len(pixels)),
        ],
        1,
    )
    facing = (normal * ray).sum(1)
    z = (normal * point).sum(1) / np.where(facing < -0.15, facing, -1.0)
    near = (facing < -0.15) & (np.abs(z - point[:, 2]) < 4 * scene.footprint)
    return ray * np.where(near, z, np.maximum(point[:, 2], 0))[:, None]


def follow(
    scene: Scene,
    flow: Flow,
    start: int,
    steps: int,
    settings: TrackSettings,
    direction: int = 1,
    pixels: NDArray[np.integer[Any]] | None = None,
) -> Tracks:
    """Tracks from `start` over `steps` frames in time `direction`, filtered.

    `pixels` (p, 2) are rows and columns to follow; all valid ones on a grid of `settings.stride` when not given. The
    confidence is 1 / (1 + (r / max_round_trip)^2), with the forward-backward disagreement r in pixels, at its worst so
    far: 0.5, the paper's threshold, where r is `max_round_trip`.
    """
    if pixels is None:
        grid = scene.valid[start] & ~scene.edge[start]
        pixels = np.argwhere(grid[:: settings.stride, :: settings.stride]) * settings.stride
    h, w = scene.mask.shape[1:]
    frames = start + direction * np.arange(steps + 1)
    frames = frames[(frames >= 0) & (frames < len(scene))]
    at = pixels[:, ::-1].astype(float)
    path, on_object, trust = [at], [np.ones(len(at), bool)], [np.ones(len(at))]
    for a, b in pairwise(map(int, frames)):
        there = at + bilinear(flow.step(a, direction), at)
        back = bilinear(flow.step(b, -direction), there)
        x, y = np.rint(there).astype(int).T
        inside = (x >= 0) & (y >= 0) & (x < w) & (y < h)
        on_object.append(np.zeros(len(at), bool))
        on_object[-1][inside] = scene.points[b, y[inside], x[inside], 2] > 0
        round_trip = np.linalg.norm(there + back - at, axis=1)
        trust.append(np.minimum(trust[-1], 1 / (1 + (round_trip / settings.max_round_trip) ** 2)))
        path.append(there)
        at = there
    stack, confidence = np.stack(path, 1), np.stack(trust, 1)
    points = np.stack([lift_to_3d(scene, int(f), stack[:, s]) for s, f in enumerate(frames)], 1)
    visible = filter_tracks(points, confidence, np.stack(on_object, 1), settings)
    return Tracks(frames, stack, visible, points, confidence)


def filter_tracks(
    points: NDArray[np.float64],
    confidence: NDArray[np.float64],
    on_object: NDArray[np.bool_],
    settings: TrackSettings,
) -> NDArray[np.bool_]:
    """(p, s + 1) visible steps of tracks by the supplement's Trajectory Filtering, each filter with its switch.

    `on_object` (p, s + 1) has no switch: off the foreground mask, or without depth, there is no point.
    """
    visible = np.logical_and.accumulate(on_object, axis=1)
    if settings.visibility_filter:
        visible &= filter_by_confidence(confidence, settings.tau_c)
    if settings.displacement_filter:
        visible &= filter_by_displacement(points, visible, settings.tau_v)
    return visible


def filter_by_confidence(confidence: NDArray[np.float64], tau_c: float) -> NDArray[np.bool_]:
    """(p, s + 1) S_vis of the supplement: false from the first step on whose confidence is not above `tau_c`."""
    return np.logical_and.accumulate(confidence > tau_c, axis=1)


def filter_by_displacement(points: NDArray[np.float64], visible: NDArray[np.bool_], tau_v: float) -> NDArray[np.bool_]:
    """(p, s + 1) S_final of the supplement: false from the first step on that is longer than mu_v + tau_v sigma_v.

    Mean and standard deviation are those of the 3D displacements between visible neighbours.
    """
    length = np.linalg.norm(np.diff(points, axis=1), axis=2)
    used = visible[:, 1:] & visible[:, :-1]
    if not used.any():
        return visible
    bound = length[used].mean() + tau_v * length[used].std() + 1e-12
    return np.concatenate([visible[:, :1], np.logical_and.accumulate(length <= bound, axis=1)], 1)


def bilinear(field: Floats, at: NDArray[np.float64]) -> NDArray[np.float64]:
    """Values (p, c) of a field (h, w, c) at positions (p, 2) in columns and rows, clamped to the image."""
    h, w = field.shape[:2]
    x, y = np.clip(at[:, 0], 0, w - 1.001), np.clip(at[:, 1], 0, h - 1.001)
    x0, y0 = x.astype(int), y.astype(int)
    a, b = (x - x0)[:, None], (y - y0)[:, None]
    top = (1 - a) * field[y0, x0] + a * field[y0, x0 + 1]
    bottom = (1 - a) * field[y0 + 1, x0] + a * field[y0 + 1, x0 + 1]
    return (1 - b) * top + b * bottom
