"""Features of pixels for the paper's segmentation, in the place of its learned ones."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from freeart21.se3 import Array, Floats
from reconstruct.scene import Scene

COLOUR, GRADIENT, PLACE, NORMAL, CURVATURE = 10.0, 10.0, 0.1, 0.7, 0.2
"""The difference of each cue that counts as one unit of distance: CIELAB units with lightness damped, grey levels per
pixel, object diagonals, length of the difference of two unit normals, and 0 on a plane towards 1 where normals
differ."""


def describe(scene: Scene, frame: int, pixels: NDArray[np.integer[Any]]) -> Array:
    """phi_t(u) of the supplement: (m, 12) descriptors of `pixels` (m, 2), row and column, of one frame.

    Colour, gradients, place, normal and curvature. Place is the camera-frame point relative to the object's middle in
    that frame, in object diagonals, since the object's motion is not known yet. So descriptors compare within a frame,
    not between distant frames.
    """
    points = scene.points[frame].astype(float)
    centre = np.median(points[scene.valid[frame]], axis=0) if scene.valid[frame].any() else np.zeros(3)
    cues = [
        (scene.features[frame], COLOUR),
        (_gradients(scene, frame), GRADIENT),
        ((points - centre) / scene.diagonal, PLACE),
        (scene.normals[frame], NORMAL),
        (_curvature(scene, frame)[..., None], CURVATURE),
    ]
    at = tuple(np.asarray(pixels).T)
    return np.concatenate([cue[at].astype(float) / scale for cue, scale in cues], 1)


def similarity(squared_distance: Array) -> Array:
    """s_t(u, p) of the supplement, 0 to 1, from squared distances of descriptors of one frame: a Gaussian, the cosine
    in the feature space of that kernel."""
    return np.exp(-0.5 * squared_distance)


def _gradients(scene: Scene, frame: int) -> Floats:
    """(h, w, 2) square roots of the structure tensor's eigenvalues, grey levels per pixel: edges, then corners."""
    grey = cv2.cvtColor(scene.rgb[frame], cv2.COLOR_RGB2GRAY).astype(np.float32)
    inner = cv2.erode(scene.mask[frame].astype(np.uint8), np.ones((3, 3), np.uint8))
    gx, gy = (cv2.Sobel(grey, cv2.CV_32F, *d, scale=0.125) * inner for d in ((1, 0), (0, 1)))
    xx, xy, yy = (cv2.GaussianBlur(a * b, (0, 0), 1.5) for a, b in ((gx, gx), (gx, gy), (gy, gy)))
    middle, spread = 0.5 * (xx + yy), np.sqrt(0.25 * (xx - yy) ** 2 + xy**2)
    return np.sqrt(np.maximum(np.stack([middle + spread, middle - spread], -1), 0))


def _curvature(scene: Scene, frame: int) -> Floats:
    """(h, w) 0 on a plane, towards 1 where the normals round a pixel differ."""
    mean = cv2.GaussianBlur(scene.normals[frame], (0, 0), 2.0)
    weight = cv2.GaussianBlur(scene.valid[frame].astype(np.float32), (0, 0), 2.0)
    return np.clip(1 - np.linalg.norm(mean, axis=2) / np.maximum(weight, 1e-3), 0, 1).astype(np.float32)
