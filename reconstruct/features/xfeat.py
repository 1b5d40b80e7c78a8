"""The features `xfeat`: XFeat's dense descriptors (extra `priors`)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from freeart21.se3 import Floats
from reconstruct.features.dense import DenseFeatures
from reconstruct.priors import xfeat
from reconstruct.scene import Scene
from reconstruct.settings import FeatureSettings


class Xfeat(DenseFeatures):
    """64 numbers, one cell every 4 pixels of the crop."""

    name = "xfeat"

    def __init__(self, scene: Scene, settings: FeatureSettings) -> None:
        super().__init__(scene, settings)
        xfeat.load_network()

    def describe_picture(self, picture: NDArray[np.uint8]) -> Floats:
        """See `DenseFeatures`."""
        return xfeat.describe_densely(picture)
