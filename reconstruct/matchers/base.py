"""Interface of a matcher: points of one frame found again in another, however far apart in time."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from freeart21.se3 import Floats
from reconstruct.scene import Scene


@dataclass(frozen=True)
class Matches:
    """Points of the object in two frames; pixels of each frame's crop."""

    here: NDArray[np.float64]
    """(m, 2) column and row in the first frame."""
    there: NDArray[np.float64]
    """(m, 2) column and row in the second frame."""
    confidence: NDArray[np.float64]
    """(m,) 0 to 1."""

    def __len__(self) -> int:
        return len(self.here)

    @classmethod
    def none(cls) -> Matches:
        """No match."""
        return cls(np.zeros((0, 2)), np.zeros((0, 2)), np.zeros(0))


class Matcher:
    """Matches between any two frames of a scene, on the object alone."""

    name: ClassVar[str]

    def __init__(self, scene: Scene) -> None:
        self.scene = scene

    def match(self, first: int, second: int) -> Matches:
        """Points seen in both frames, each at most once in either."""
        raise NotImplementedError


class KeypointMatcher(Matcher):
    """One that describes every frame once, by keypoints."""

    load: Callable[[], Any]
    """Loads the networks; FreeArtError says what is missing."""
    detect: Callable[[NDArray[np.uint8]], tuple[NDArray[np.float64], Floats]]
    """Keypoints (k, 2), column and row in a picture (h, w, 3), and their descriptors (k, d)."""

    def __init__(self, scene: Scene) -> None:
        super().__init__(scene)
        self.load()
        self._known: dict[int, tuple[NDArray[np.float64], Floats]] = {}

    def describe(self, frame: int) -> tuple[NDArray[np.float64], Floats]:
        """Keypoints (k, 2) on the object in one frame, and their descriptors (k, d)."""
        if frame not in self._known:
            at, descriptors = self.detect(self.scene.rgb[frame])
            kept = on_object(self.scene, frame, at)
            self._known[frame] = at[kept], descriptors[kept]
        return self._known[frame]


def on_object(scene: Scene, frame: int, at: NDArray[np.float64]) -> NDArray[np.bool_]:
    """(m,) whether columns and rows (m, 2) lie on the object of one frame, where it has depth."""
    x, y = np.rint(at).astype(int).T
    found = (x >= 0) & (y >= 0) & (x < scene.mask.shape[2]) & (y < scene.mask.shape[1])
    found[found] = scene.valid[frame, y[found], x[found]]
    return found
