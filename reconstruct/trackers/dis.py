"""The tracker `dis`: dense optical flow between neighbouring frames, chained."""

from __future__ import annotations

from reconstruct.scene import Scene
from reconstruct.settings import TrackSettings
from reconstruct.tracks import Tracker, optical_flow


class Dis(Tracker):
    """The default: DIS flow, with confidence from forward-backward consistency."""

    name = "dis"

    def __init__(self, scene: Scene, settings: TrackSettings) -> None:
        super().__init__(scene, settings)
        self.flow = optical_flow(scene)
