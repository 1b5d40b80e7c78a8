"""Matchers: points of one frame found again in another, however far apart in time."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from freeart21.se3 import Floats
from reconstruct.priors import lightglue, xfeat
from reconstruct.scene import Scene

LEAST_COSINE = 0.82
"""Least similarity of XFeat's matches; the authors'."""


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
    """Matches between any two frames of a scene, on the object alone. Every frame is described once, by keypoints."""

    load: Callable[[], Any]
    """Loads the networks; FreeArtError says what is missing."""
    detect: Callable[[NDArray[np.uint8]], tuple[NDArray[np.float64], Floats]]
    """Keypoints (k, 2), column and row in a picture (h, w, 3), and their descriptors (k, d)."""

    def __init__(self, scene: Scene) -> None:
        self.scene = scene
        self.load()
        self._known: dict[int, tuple[NDArray[np.float64], Floats]] = {}

    def match(self, first: int, second: int) -> Matches:
        """Points seen in both frames, each at most once in either."""
        (here, a), (there, b) = self.describe(first), self.describe(second)
        if not len(a) or not len(b):
            return Matches.none()
        pairs, confidence = self.pair(here, a, there, b)
        return Matches(here[pairs[:, 0]], there[pairs[:, 1]], confidence)

    def pair(
        self, here: NDArray[np.float64], a: Floats, there: NDArray[np.float64], b: Floats
    ) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
        """Pairs (m, 2) of the numbers of keypoints (k, 2) that are the same point, by their descriptors (k, d), and
        their confidence (m,)."""
        raise NotImplementedError

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


class LightGlue(Matcher):
    """ALIKED's keypoints, matched by LightGlue, which sees all of both frames at once: for frames far apart, some 1 s
    of processor time a pair."""

    load = staticmethod(lightglue.load_networks)
    detect = staticmethod(lightglue.detect)

    def pair(
        self, here: NDArray[np.float64], a: Floats, there: NDArray[np.float64], b: Floats
    ) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
        """See `Matcher`; the confidence is LightGlue's."""
        h, w = self.scene.mask.shape[1:]
        return lightglue.match(here, a, there, b, (w, h))


class Xfeat(Matcher):
    """Mutual nearest neighbours among XFeat's keypoints on the object."""

    load = staticmethod(xfeat.load_network)
    detect = staticmethod(xfeat.detect)

    def pair(
        self, here: NDArray[np.float64], a: Floats, there: NDArray[np.float64], b: Floats
    ) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
        """See `Matcher`; the confidence is the cosine of the descriptors."""
        cosine = a @ b.T
        forward, back = cosine.argmax(1), cosine.argmax(0)
        i = np.flatnonzero((back[forward] == np.arange(len(a))) & (cosine.max(1) > LEAST_COSINE))
        j = forward[i]
        return np.stack([i, j], 1), np.clip(cosine[i, j].astype(float), 0, 1)


MATCHERS: dict[str, type[Matcher]] = {"lightglue": LightGlue, "xfeat": Xfeat}
