"""Density control: split Gaussians with large gradients, remove faint and unseen ones (Kerbl et al. 2023)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from freeart21.se3 import Array, rotation_from_wxyz
from reconstruct.gaussians.model import Parameters, sigmoid

FAINT = 0.05
"""Opacity below which a Gaussian is removed."""
SHRUNK = 1.6
"""Factor by which the two halves of a split Gaussian are smaller (Kerbl et al. 2023)."""


SPLIT = 0.06
"""Share of the Gaussians that is split at a time."""


def densify_and_prune(
    parameters: Parameters, gradients: Array, views: Array, most: int
) -> tuple[Parameters, NDArray[np.int64], NDArray[np.bool_]]:
    """Split the Gaussians with the largest gradients in two, up to `most` in all, and remove faint and unseen ones.

    `gradients` (N,) are mean lengths of the derivatives by the projected means, `views` (N,) the number of images that
    showed each. Also returns the source of each new Gaussian (M,), and whether it is a half (M,).
    """
    visible = (sigmoid(parameters.opacity_logits) > FAINT) & (views > 0)
    splits = max(0, min(most - int(visible.sum()), round(SPLIT * int(visible.sum()))))
    order = np.argsort(np.where(visible, -gradients, np.inf), kind="stable")
    chosen = order[:splits]
    which = np.concatenate([np.flatnonzero(visible), chosen])
    new = parameters.select(which)
    halves = np.zeros(len(parameters), bool)
    halves[chosen] = True
    fresh = halves[which]
    # along the longest axis, half a standard deviation each way
    longest = np.argmax(new.log_scales[fresh], 1)
    axes = np.take_along_axis(rotation_from_wxyz(new.quaternions[fresh]), longest[:, None, None], 2)[..., 0]
    length = np.exp(np.take_along_axis(new.log_scales[fresh], longest[:, None], 1))
    side = np.where(np.arange(len(which)) < int(visible.sum()), -0.5, 0.5)[fresh]
    new.means[fresh] += (side[:, None] * length * axes).astype(np.float32)
    new.log_scales[fresh] -= np.float32(np.log(SHRUNK))
    return new, which, fresh
