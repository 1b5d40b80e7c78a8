"""The sensor `blur`: light is averaged over the exposure; poses, states, depth and mask are those of its middle."""

from __future__ import annotations

import numpy as np

from generator.sensors.base import SensorModel


class Blur(SensorModel):
    """An open shutter."""

    name = "blur"
    averages = True

    def sub_frames(self, motion_px: float) -> int:
        """One a pixel, odd, at most 9: the middle one is where depth and truth are taken."""
        return min(2 * int(np.ceil((motion_px - 0.5) / 2)) + 1, 9) if motion_px > 0.5 else 1
