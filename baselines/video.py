"""The keyframes of a sequence in memory, and the points that their pixels show."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from freeart21.recording import Frame, Recording
from freeart21.se3 import Array


class UnsolvableError(Exception):
    """No answer: a stage and one readable line."""

    def __init__(self, stage: str, reason: str) -> None:
        super().__init__(reason)
        self.stage, self.reason = stage, reason


@dataclass(frozen=True)
class Video:
    """Every k-th frame of a recording, and the last one."""

    recording: Recording
    numbers: NDArray[np.int64]
    """(F,) numbers of the keyframes in the recording."""
    frames: tuple[Frame, ...]
    """(F) keyframes."""
    size: float
    """Diagonal, metres, of the box around the points of the first keyframe, without the outer 1 % a side."""

    def lift(self, k: int, at: Array) -> Array:
        """(P, 3) points, metres, in the camera at image positions `at` (P, 2) of keyframe `k`; NaN without depth."""
        return lift(self.recording.camera.K, self.frames[k], at)


def read_video(recording: Recording, every: int) -> Video:
    """Every `every`-th frame of `recording`, and the last one. Raises UnsolvableError without depth on the object."""
    numbers = np.unique([*range(0, len(recording), every), len(recording) - 1])
    frames = tuple(recording.frame(int(number)) for number in numbers)
    K = recording.camera.K
    for frame in frames:
        points = lift_all(K, frame)
        if len(points) >= 100:
            low, high = np.quantile(points, [0.01, 0.99], axis=0)
            return Video(recording, numbers, frames, float(np.linalg.norm(high - low)))
    raise UnsolvableError("reading", "no keyframe has 100 pixels of the object with depth")


def lift(K: Array, frame: Frame, at: Any) -> Array:
    """(P, 3) points in the camera at image positions `at` (P, 2), by the depth of the pixel they are in; NaN off the
    mask or without depth."""
    at = np.asarray(at, float).reshape(-1, 2)
    column, row = np.floor(at).astype(int).T
    height, width = frame.depth.shape
    inside = (column >= 0) & (row >= 0) & (column < width) & (row < height)
    column, row = np.where(inside, column, 0), np.where(inside, row, 0)
    z = np.where(inside & frame.mask[row, column] & (frame.depth[row, column] > 0), frame.depth[row, column], np.nan)
    return np.stack([(at[:, 0] - K[0, 2]) / K[0, 0] * z, (at[:, 1] - K[1, 2]) / K[1, 1] * z, z], 1).astype(float)


def lift_all(K: Array, frame: Frame) -> Array:
    """(P, 3) points in the camera of all foreground pixels with depth, row by row."""
    row, column = np.nonzero(frame.mask & (frame.depth > 0))
    return lift(K, frame, np.stack([column, row], 1) + 0.5)
