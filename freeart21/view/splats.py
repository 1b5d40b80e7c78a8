"""Gaussians in the 3D view: the input of its script, 27 to 30 bytes each."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from freeart21.gaussians import FAINT_COPY, TURNED_AWAY, Gaussians
from freeart21.view.document import embed_array

MAX_SPLATS = 80_000
"""Gaussians in a page: 3 MB."""


@dataclass(frozen=True)
class SplatLayers:
    """Gaussians that can be drawn in place of the surfaces of two layers."""

    gaussians: Gaussians
    """In the frame of both links at state zero."""
    links: tuple[int, int]
    """The links of the reference and the moving part."""
    layers: tuple[int, int]
    """The layers of their surfaces."""
    max_count: int = MAX_SPLATS
    """Most Gaussians that are shown."""


def largest_gaussians(gaussians: Gaussians, count: int) -> Gaussians:
    """The `count` Gaussians with the largest opacity times area of the largest section."""
    if len(gaussians) <= count:
        return gaussians
    widths = np.sort(gaussians.scales.astype(float), 1)
    cover = gaussians.opacities * widths[:, 1] * widths[:, 2]
    return gaussians.chosen(np.sort(np.argsort(-cover, kind="stable")[:count]))


def splat_data(layers: SplatLayers) -> dict[str, Any]:
    """Input of the script, quantised below what is visible.

    Scales are logarithms between the smallest and the largest, 8 bits; of quaternions and normals, 127 is 1.
    """
    gaussians = largest_gaussians(layers.gaussians, layers.max_count)
    logs = np.log(np.maximum(gaussians.scales.astype(float), 1e-9))
    least, most = (float(logs.min()), float(logs.max())) if len(logs) else (0.0, 0.0)
    return {
        "links": layers.links,
        "layers": layers.layers,
        "scales_between": [least, most],
        "means": embed_array(gaussians.means, "f32"),
        "scales": embed_array(np.rint((logs - least) / max(most - least, 1e-9) * 255), "u8"),
        "quaternions": embed_array(np.rint(gaussians.quaternions * 127 + 128), "u8"),
        "colours": embed_array(np.rint(gaussians.colours.clip(0, 1) * 255), "u8"),
        "opacities": embed_array(np.rint(gaussians.opacities.clip(0, 1) * 255), "u8"),
        "light": gaussians.light,
        "normals": None if gaussians.light is None else embed_array(np.rint(gaussians.normals * 127 + 128), "u8"),
        "turned_away": TURNED_AWAY,
        "faint_copy": FAINT_COPY,
        "part_weights": embed_array(np.rint(gaussians.part_weights.clip(0, 1) * 255), "u8"),
    }
