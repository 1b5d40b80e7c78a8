"""DINOv2 (Oquab et al. 2024) and DINOv3 (Simeoni et al. 2025): descriptors that are similar within a part.

Both by their own repositories (facebookresearch/dinov2 at b8931f7, dinov3 at 6876159: hubconf.py, hub/backbones.py,
models/vision_transformer.py): a picture from 0 to 1 minus ImageNet's mean over its standard deviation, sides multiples
of the patch; `get_intermediate_layers(x, n=1, reshape=True)` gives the normed last layer (1, d, h / patch, w / patch).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from freeart21.errors import FreeArtError
from freeart21.se3 import Floats
from reconstruct.priors.weights import BroughtWeights, Checkout, enlarge, inference, load_into, normalise, to_tensor

ENLARGEMENT = 3.0
"""A crop is enlarged so many times, for a descriptor every five pixels. Not measured: no weights were at hand."""


@dataclass(frozen=True)
class Dino:
    """One generation of DINO."""

    checkout: Checkout
    patch: int
    """Pixels per descriptor, each way."""
    files: tuple[tuple[str, str], ...]
    """Published file and entry of hubconf.py, small to large."""
    source: str

    def weights(self) -> tuple[BroughtWeights, str]:
        """The largest of the files that are there, and its entry; FreeArtError says where the smallest is to be had."""
        offered = [(BroughtWeights(file, self.source), entry) for file, entry in self.files]
        return next((known for known in reversed(offered) if known[0].is_there()), offered[0])


V2 = Dino(
    Checkout("dinov2", "https://github.com/facebookresearch/dinov2"),
    14,
    tuple((f"dinov2_{size}14_pretrain.pth", f"dinov2_{size}14") for size in ("vits", "vitb", "vitl")),
    "https://github.com/facebookresearch/dinov2 (Apache-2.0)",
)
V3 = Dino(
    Checkout("dinov3", "https://github.com/facebookresearch/dinov3"),
    16,
    (
        ("dinov3_vits16_pretrain_lvd1689m-08c60483.pth", "dinov3_vits16"),
        ("dinov3_vitb16_pretrain_lvd1689m-73cec8be.pth", "dinov3_vitb16"),
        ("dinov3_vitl16_pretrain_lvd1689m-8aa4cbdd.pth", "dinov3_vitl16"),
    ),
    "https://ai.meta.com/resources/models-and-libraries/dinov3-downloads (DINOv3 licence, on request)",
)


@lru_cache(2)
def load_network(dino: Dino) -> Any:
    """The network with its weights; FreeArtError says what is missing."""
    brought, entry = dino.weights()
    weights = brought.read()
    return load_into(dino.checkout.load_hub(entry), weights, brought.file)


def describe_densely(dino: Dino, picture: NDArray[np.uint8]) -> Floats:
    """(h', w', d) unit descriptors of a picture (h, w, 3) that is enlarged ENLARGEMENT times, one a patch."""
    import torch

    network, enlarged = load_network(dino), enlarge(picture, ENLARGEMENT, dino.patch)
    with inference():
        (found,) = network.get_intermediate_layers(normalise(to_tensor(enlarged)), n=1, reshape=True)
        found = torch.nn.functional.normalize(found.float(), dim=1)
    expected = tuple(side // dino.patch for side in enlarged.shape[:2])
    if tuple(found.shape[2:]) != expected:
        raise FreeArtError(
            f"{dino.checkout.folder} gave descriptors of {tuple(found.shape)}, expected (1, d, {expected})"
        )
    return np.asarray(found[0].permute(1, 2, 0).numpy(), np.float32)
