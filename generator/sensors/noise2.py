"""The sensor `noise2`: depth with Gaussian noise of 2 % of itself."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from generator.sensors.base import SensorModel

NOISE2_SHARE = 0.02
"""Standard deviation of the depth, as a share of the depth."""


class Noise2(SensorModel):
    """Noise drawn afresh for every pixel; it knows no edges, angles or materials."""

    name = "noise2"
    replaces = "depth"

    def depth(self, depth: NDArray[np.float32], rng: np.random.Generator) -> NDArray[np.float32]:
        """See `SensorModel.depth`; 0 stays 0."""
        noise = rng.standard_normal(depth.shape, np.float32)
        return depth * (np.float32(1) + np.float32(NOISE2_SHARE) * noise)
