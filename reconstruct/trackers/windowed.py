"""Trackers that see a window of frames at once and follow given points through it."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from freeart21.se3 import Floats
from reconstruct.scene import Scene
from reconstruct.settings import TrackSettings
from reconstruct.tracks import Tracker, Tracks, crop_shift, filter_tracks, lift_to_3d

NEIGHBOURS = 3
"""Followed points whose displacements a pixel between them takes, weighted by nearness."""


class WindowTracker(Tracker):
    """One that follows points through a window; between neighbouring frames, from points to all pixels."""

    def __init__(self, scene: Scene, settings: TrackSettings) -> None:
        super().__init__(scene, settings)
        self._steps: dict[tuple[int, int], NDArray[np.float16]] = {}

    def track(
        self, frames: NDArray[np.int64], at: NDArray[np.float64]
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Where points (p, 2), column and row in the first of `frames` (s + 1,), are in each: (p, s + 1, 2), and
        the confidence (p, s + 1), 0 to 1, that they are seen there."""
        raise NotImplementedError

    def step(self, frame: int, direction: int) -> Floats:
        """See `Tracker`; zeros where there is no neighbour. Kept in half floats, exact to 0.01 pixels."""
        key = frame, direction
        if key not in self._steps:
            there = 0 <= frame + direction < len(self.scene)
            shape = (*self.scene.mask.shape[1:], 2)
            self._steps[key] = (self.dense_step(frame, direction) if there else np.zeros(shape)).astype(np.float16)
        return self._steps[key].astype(np.float32)

    def dense_step(self, frame: int, direction: int) -> NDArray[np.floating[Any]]:
        """(h, w, 2) displacements of all pixels, from points on a grid of `settings.stride`."""
        pixels = self.grid(frame)
        positions, _ = self.track(np.array([frame, frame + direction]), pixels[:, ::-1].astype(float))
        field = np.tile(crop_shift(self.scene, frame, frame + direction), (*self.scene.mask.shape[1:], 1))
        wanted = np.argwhere(self.scene.mask[frame])
        if len(pixels) and len(wanted):
            distance, near = cKDTree(pixels).query(wanted, k=min(NEIGHBOURS, len(pixels)))
            distance, near = distance.reshape(len(wanted), -1), near.reshape(len(wanted), -1)
            weight = 1 / np.maximum(distance, 1e-3)
            moved = (positions[:, 1] - positions[:, 0])[near]
            field[tuple(wanted.T)] = (weight[..., None] * moved).sum(1) / weight.sum(1)[:, None]
        return field

    def grid(self, frame: int) -> NDArray[np.int64]:
        """Valid pixels (p, 2), row and column, on a grid of `settings.stride`."""
        stride = self.settings.stride
        valid = self.scene.valid[frame] & ~self.scene.edge[frame]
        return np.argwhere(valid[::stride, ::stride]) * stride

    def follow(
        self, start: int, steps: int, direction: int = 1, pixels: NDArray[np.integer[Any]] | None = None
    ) -> Tracks:
        """See `Tracker`; all valid pixels on a grid of `settings.stride` when none are given."""
        scene = self.scene
        at = (self.grid(start) if pixels is None else pixels)[:, ::-1].astype(float)
        frames = start + direction * np.arange(steps + 1)
        frames = frames[(frames >= 0) & (frames < len(scene))]
        if len(frames) > 1 and len(at):
            positions, confidence = self.track(frames, at)
        else:
            positions, confidence = np.tile(at[:, None], (1, len(frames), 1)), np.ones((len(at), len(frames)))
        positions[:, 0], confidence[:, 0] = at, 1
        h, w = scene.mask.shape[1:]
        x, y = np.moveaxis(np.rint(positions).astype(int), -1, 0)
        inside = (x >= 0) & (y >= 0) & (x < w) & (y < h)
        depth = scene.points[frames[None], np.clip(y, 0, h - 1), np.clip(x, 0, w - 1), 2]
        points = np.stack([lift_to_3d(scene, int(f), positions[:, s]) for s, f in enumerate(frames)], 1)
        confidence = np.minimum.accumulate(confidence, axis=1)
        visible = filter_tracks(points, confidence, inside & (depth > 0), self.settings)
        return Tracks(frames, positions, visible, points, confidence)
