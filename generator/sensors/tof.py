"""The sensor `tof`: depth as a time-of-flight camera measures it (`generator.tof`)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from generator.sensors.base import SensorModel, Video
from generator.tof import TimeOfFlight, infrared_albedo


class Tof(SensorModel):
    """A camera of the Femto Bolt class; the seed is its specimen."""

    name = "tof"
    replaces = "depth"

    def __init__(self, video: Video) -> None:
        super().__init__(video)
        self._camera = TimeOfFlight(video.scene.camera, video.seed)

    def depth(self, depth: NDArray[np.float32], rng: np.random.Generator) -> NDArray[np.float32]:
        """See `SensorModel.depth`."""
        base, gloss = self.video.scene.materials()
        return self._camera.measure(depth, infrared_albedo(base), gloss, rng)
