"""The source `tracked`, the default: no poses but those that the solver tracks itself."""

from __future__ import annotations

import numpy as np

from freeart21.se3 import Array
from reconstruct.pose_sources.base import PoseSource
from reconstruct.scene import Scene


class Tracked(PoseSource):
    """No body."""

    name = "tracked"

    def poses(self, scene: Scene) -> Array:
        """See `PoseSource`."""
        return np.zeros((0, len(scene), 4, 4))
