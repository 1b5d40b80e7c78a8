"""The sensor `hand`: a hand holds the object and hides some of it (`generator.hand`).

It has depth and is no part of the mask.
"""

from __future__ import annotations

from collections.abc import Sequence

from freeart21.se3 import Array
from generator.hand import HandMotion
from generator.scene import Skin
from generator.sensors.base import SensorModel, Video


class Hand(SensorModel):
    """A hand with a forearm."""

    name = "hand"
    occludes = True

    def __init__(self, video: Video) -> None:
        super().__init__(video)
        self._hand = HandMotion(video.plan, video.joint, video.meshes, video.scene.camera, video.seed)

    def pieces(self) -> Sequence[Sequence[Skin]]:
        """See `SensorModel.pieces`: palm, bones of the fingers and forearm."""
        return self._hand.hand.pieces()

    def piece_poses(self, t: float, T_camera_object: Array, state: float) -> Array:
        """See `SensorModel.piece_poses`."""
        return self._hand.poses(t, T_camera_object, state)
