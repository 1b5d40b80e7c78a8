"""The features `hand_made`: colour, gradients and 3D geometry."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from reconstruct.features.base import Descriptors, Features


class HandMade(Features):
    """Colour, gradients, place, normal and curvature, each scaled by its typical difference between two surfaces.

    Place is the camera-frame point relative to the object's middle in that frame, in object diagonals, since the
    object's motion is not known yet. So descriptors compare within a frame, not between distant frames.
    """

    name = "hand_made"

    def describe(self, frame: int, pixels: NDArray[np.integer[Any]]) -> Descriptors:
        """(m, 3 + 2 + 3 + 3 + 1) descriptors; see `Features`. A cue whose scale is 0 is left out."""
        scene, s = self.scene, self.settings
        points = scene.points[frame].astype(float)
        centre = np.median(points[scene.valid[frame]], axis=0) if scene.valid[frame].any() else np.zeros(3)
        cues = [
            (scene.features[frame], s.colour),
            (self._gradients(frame), s.gradient),
            ((points - centre) / scene.diagonal, s.place),
            (scene.normals[frame], s.normal),
            (self._curvature(frame)[..., None], s.curvature),
        ]
        at = tuple(np.asarray(pixels).T)
        return np.concatenate([cue[at].astype(float) / scale for cue, scale in cues if scale > 0], 1)

    def similarity(self, squared_distance: NDArray[np.float64]) -> NDArray[np.float64]:
        """A Gaussian of the distance: the cosine in the feature space of that kernel."""
        return np.exp(-0.5 * squared_distance)

    def _gradients(self, frame: int) -> NDArray[np.float32]:
        """(h, w, 2) square roots of the structure tensor's eigenvalues, grey levels per pixel: edges, then corners."""
        grey = cv2.cvtColor(self.scene.rgb[frame], cv2.COLOR_RGB2GRAY).astype(np.float32)
        inner = cv2.erode(self.scene.mask[frame].astype(np.uint8), np.ones((3, 3), np.uint8))
        gx, gy = (cv2.Sobel(grey, cv2.CV_32F, *d, scale=0.125) * inner for d in ((1, 0), (0, 1)))
        xx, xy, yy = (cv2.GaussianBlur(a * b, (0, 0), 1.5) for a, b in ((gx, gx), (gx, gy), (gy, gy)))
        middle, spread = 0.5 * (xx + yy), np.sqrt(0.25 * (xx - yy) ** 2 + xy**2)
        return np.sqrt(np.maximum(np.stack([middle + spread, middle - spread], -1), 0))

    def _curvature(self, frame: int) -> NDArray[np.float32]:
        """(h, w) 0 on a plane, towards 1 where the normals round a pixel differ."""
        normals = self.scene.normals[frame]
        mean = cv2.GaussianBlur(normals, (0, 0), 2.0)
        weight = cv2.GaussianBlur(self.scene.valid[frame].astype(np.float32), (0, 0), 2.0)
        return np.clip(1 - np.linalg.norm(mean, axis=2) / np.maximum(weight, 1e-3), 0, 1).astype(np.float32)
