"""Features of pixels, by name: descriptors whose Euclidean distance measures dissimilarity."""

from __future__ import annotations

from typing import Any, ClassVar

import cv2
import numpy as np
from numpy.typing import NDArray

from freeart21.errors import FreeArtError
from freeart21.se3 import Floats
from reconstruct.priors import dino, xfeat
from reconstruct.scene import Scene
from reconstruct.settings import FeatureSettings
from reconstruct.tracks import bilinear

Descriptors = NDArray[np.float64]


class Features:
    """Descriptors of pixels. The paper uses DINO's."""

    def __init__(self, scene: Scene, settings: FeatureSettings) -> None:
        self.scene, self.settings = scene, settings

    @classmethod
    def weights_digest(cls) -> str:
        """SHA-256, hexadecimal, of weights that the user brings; empty without such."""
        return ""

    def describe(self, frame: int, pixels: NDArray[np.integer[Any]]) -> Descriptors:
        """(m, d) descriptors of `pixels` (m, 2), row and column, of one frame: phi_t(u) of the supplement."""
        raise NotImplementedError

    def similarity(self, squared_distance: NDArray[np.float64]) -> NDArray[np.float64]:
        """s_t(u, p) of the supplement, 0 to 1, from squared distances of descriptors of one frame.

        For unit descriptors the cosine is 1 - squared_distance / 2.
        """
        raise NotImplementedError


class HandMade(Features):
    """Colour, gradients, place, normal and curvature, each scaled by its typical difference between two surfaces.

    Place is the camera-frame point relative to the object's middle in that frame, in object diagonals, since the
    object's motion is not known yet. So descriptors compare within a frame, not between distant frames.
    """

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


class Xfeat(DenseFeatures):
    """XFeat's (extra `priors`): 64 numbers, one cell every 4 pixels of the crop."""

    def __init__(self, scene: Scene, settings: FeatureSettings) -> None:
        super().__init__(scene, settings)
        xfeat.load_network()

    def describe_picture(self, picture: NDArray[np.uint8]) -> Floats:
        """See `DenseFeatures`."""
        return xfeat.describe_densely(picture)


class Dinov2(DenseFeatures):
    """DINOv2's, by the user's own weights: one cell a patch of the enlarged crop."""

    generation: ClassVar[dino.Dino] = dino.V2

    @classmethod
    def weights_digest(cls) -> str:
        """See `Features`."""
        return cls.generation.weights()[0].digest()

    def __init__(self, scene: Scene, settings: FeatureSettings) -> None:
        super().__init__(scene, settings)
        dino.load_network(self.generation)

    def describe_picture(self, picture: NDArray[np.uint8]) -> Floats:
        """See `DenseFeatures`."""
        return dino.describe_densely(self.generation, picture)


class Dinov3(Dinov2):
    """DINOv3's, as those of DINOv2."""

    generation = dino.V3


FEATURES: dict[str, type[Features]] = {"dinov2": Dinov2, "dinov3": Dinov3, "hand_made": HandMade, "xfeat": Xfeat}


def make_features(scene: Scene, settings: FeatureSettings) -> Features:
    """The features that `settings.model` names; FreeArtError lists the known ones."""
    if settings.model not in FEATURES:
        raise FreeArtError(f"unknown features '{settings.model}'; features: {', '.join(FEATURES)}")
    return FEATURES[settings.model](scene, settings)
