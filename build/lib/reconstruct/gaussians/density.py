"""More Gaussians where pictures ask for them, none where they are not seen (Kerbl et al. 2023, Adaptive Control)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from freeart21.gaussians import rotations
from freeart21.se3 import Array
from reconstruct.gaussians.model import Parameters, sigmoid

FAINT = 0.05
"""Opacity below which a Gaussian is taken away."""
SHRUNK = 1.6
"""By which the two halves of a split Gaussian are smaller (Kerbl et al. 2023)."""


SPLIT = 0.06
"""Share of the Gaussians that is split at a time."""


def grown_and_pruned(
    parameters: Parameters, pull: Array, looks: Array, most: int
) -> tuple[Parameters, NDArray[np.int64], NDArray[np.bool_]]:
    """Those that are pulled most split in two, up to `most` in all, and faint and unseen ones gone.

    `pull` (N,) are mean lengths of the derivatives by the projected means, `looks` (N,) the pictures that showed each.
    Also which Gaussian each of the new ones came from (M,), and whether it begins anew (M,).
    """
    sound = (sigmoid(parameters.opacity_logits) > FAINT) & (looks > 0)
    room = max(0, min(most - int(sound.sum()), round(SPLIT * int(sound.sum()))))
    order = np.argsort(np.where(sound, -pull, np.inf), kind="stable")
    chosen = order[:room]
    which = np.concatenate([np.flatnonzero(sound), chosen])
    new = parameters.kept(which)
    halves = np.zeros(len(parameters), bool)
    halves[chosen] = True
    fresh = halves[which]
    # along the longest axis, half a standard deviation each way
    longest = np.argmax(new.log_scales[fresh], 1)
    axes = np.take_along_axis(rotations(new.quaternions[fresh]), longest[:, None, None], 2)[..., 0]
    length = np.exp(np.take_along_axis(new.log_scales[fresh], longest[:, None], 1))
    side = np.where(np.arange(len(which)) < int(sound.sum()), -0.5, 0.5)[fresh]
    new.means[fresh] += (side[:, None] * length * axes).astype(np.float32)
    new.log_scales[fresh] -= np.float32(np.log(SHRUNK))
    return new, which, fresh
