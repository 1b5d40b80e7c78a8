"""The tracker `dis`: dense optical flow between neighbouring frames, chained."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from freeart21.se3 import Floats
from reconstruct.scene import Scene
from reconstruct.settings import TrackSettings
from reconstruct.tracks import Flow, Tracker, Tracks, follow, optical_flow


class FlowTracker(Tracker):
    """Chained flow between neighbouring frames, with confidence from forward-backward consistency."""

    flow: Flow

    def step(self, frame: int, direction: int) -> Floats:
        """See `Tracker`."""
        return self.flow.step(frame, direction)

    def follow(
        self, start: int, steps: int, direction: int = 1, pixels: NDArray[np.integer[Any]] | None = None
    ) -> Tracks:
        """See `Tracker`; all valid pixels on a grid of `settings.stride` when none are given."""
        return follow(self.scene, self.flow, start, steps, self.settings, direction, pixels)


class Dis(FlowTracker):
    """The default: DIS flow."""

    name = "dis"

    def __init__(self, scene: Scene, settings: TrackSettings) -> None:
        super().__init__(scene, settings)
        self.flow = optical_flow(scene)
