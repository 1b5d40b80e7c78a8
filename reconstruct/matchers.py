"""Matchers: points of one frame found again in another."""

from __future__ import annotations

from dataclasses import dataclass
from types import ModuleType

import numpy as np
from numpy.typing import NDArray

from freeart21.se3 import Floats
from reconstruct.priors import lightglue, xfeat
from reconstruct.scene import Scene

NETWORKS: dict[str, ModuleType] = {"lightglue": lightglue, "xfeat": xfeat}
"""By name: each loads its network (`load_network`), finds keypoints with descriptors (`detect`) and pairs them
(`match`)."""


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


class Matcher:
    """Matches between any two frames of a scene, on the object alone. Every frame is described once, by keypoints."""

    def __init__(self, name: str, scene: Scene) -> None:
        """`name`: one of NETWORKS; FreeArtError says what it lacks."""
        self.network, self.scene = NETWORKS[name], scene
        self.network.load_network()
        self._known: dict[int, tuple[NDArray[np.float64], Floats]] = {}

    def match(self, first: int, second: int) -> Matches:
        """Points seen in both frames, each at most once in either."""
        (here, a), (there, b) = self.describe(first), self.describe(second)
        h, w = self.scene.mask.shape[1:]
        if not len(a) or not len(b):
            return Matches(np.zeros((0, 2)), np.zeros((0, 2)), np.zeros(0))
        pairs, confidence = self.network.match(here, a, there, b, (w, h))
        return Matches(here[pairs[:, 0]], there[pairs[:, 1]], confidence)

    def describe(self, frame: int) -> tuple[NDArray[np.float64], Floats]:
        """Keypoints (k, 2) on the object in one frame, where it has depth, and their descriptors (k, d)."""
        if frame not in self._known:
            at, descriptors = self.network.detect(self.scene.rgb[frame])
            x, y = np.rint(at).astype(int).T
            found = (x >= 0) & (y >= 0) & (x < self.scene.mask.shape[2]) & (y < self.scene.mask.shape[1])
            found[found] = self.scene.valid[frame, y[found], x[found]]
            self._known[frame] = at[found], descriptors[found]
        return self._known[frame]
