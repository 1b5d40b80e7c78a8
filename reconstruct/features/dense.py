"""Features of a network that describes a whole picture at once."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from freeart21.se3 import Floats
from reconstruct.features.base import Descriptors, Features
from reconstruct.tracks import bilinear


class DenseFeatures(Features):
    """Unit descriptors, interpolated between the centres of the network's cells."""

    def describe_picture(self, picture: NDArray[np.uint8]) -> Floats:
        """(h', w', d) descriptors of a picture (h, w, 3), on a grid of cells that covers it."""
        raise NotImplementedError

    def describe(self, frame: int, pixels: NDArray[np.integer[Any]]) -> Descriptors:
        """(m, d) unit descriptors; see `Features`."""
        picture = self.scene.rgb[frame]
        cells = self.describe_picture(picture)
        ratio = np.array(cells.shape[1::-1]) / np.array(picture.shape[1::-1])
        at = (np.asarray(pixels)[:, ::-1] + 0.5) * ratio - 0.5
        found = bilinear(cells, at).astype(float)
        return found / np.maximum(np.linalg.norm(found, axis=1, keepdims=True), 1e-9)

    def similarity(self, squared_distance: NDArray[np.float64]) -> NDArray[np.float64]:
        """The cosine, 0 where it is negative: the paper's."""
        return np.clip(1 - squared_distance / 2, 0, 1)
