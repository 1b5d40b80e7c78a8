"""The features `dinov2`: DINOv2's dense descriptors, by the user's own weights."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from freeart21.se3 import Floats
from reconstruct.features.dense import DenseFeatures
from reconstruct.priors import dino
from reconstruct.scene import Scene
from reconstruct.settings import FeatureSettings


class Dinov2(DenseFeatures):
    """One cell a patch of the enlarged crop."""

    name = "dinov2"

    @classmethod
    def weights_digest(cls) -> str:
        """See `Features`."""
        return dino.V2.weights()[0].digest()

    def __init__(self, scene: Scene, settings: FeatureSettings) -> None:
        super().__init__(scene, settings)
        dino.load_network(dino.V2)

    def describe_picture(self, picture: NDArray[np.uint8]) -> Floats:
        """See `DenseFeatures`."""
        return dino.describe_densely(dino.V2, picture)
