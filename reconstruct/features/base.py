"""Interface of pixel features."""

from __future__ import annotations

from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from reconstruct.scene import Scene
from reconstruct.settings import FeatureSettings

Descriptors = NDArray[np.float64]


class Features:
    """Descriptors of pixels; their Euclidean distance measures dissimilarity. The paper uses DINO's."""

    name: ClassVar[str]

    def __init__(self, scene: Scene, settings: FeatureSettings) -> None:
        self.scene, self.settings = scene, settings

    @classmethod
    def weights_digest(cls) -> str:
        """SHA-256, hexadecimal, of weights that the user brings; empty without such."""
        return ""

    def describe(self, frame: int, pixels: NDArray[np.integer[Any]]) -> Descriptors:
        """(m, d) descriptors of `pixels` (m, 2), row and column, of one frame: phi_t(u) of the supplement."""
        raise NotImplementedError

    def similarity(self, squared_distance: NDArray[np.float64]) -> NDArray[np.float64]:
        """s_t(u, p) of the supplement, 0 to 1, from squared distances of descriptors of one frame.

        For unit descriptors the cosine is 1 - squared_distance / 2.
        """
        raise NotImplementedError
