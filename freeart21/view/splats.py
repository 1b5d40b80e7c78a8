"""Gaussians in the 3D view: the input of its script, 21 to 24 bytes each."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from freeart21.gaussians import FAINT_COPY, TURNED_AWAY, Gaussians
from freeart21.view.document import embed_array

MAX_SPLATS = 80_000
"""Gaussians in a page: 2.3 MB."""


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

    Positions have 16 bits over their bounding box, or are 32-bit floats where outliers would make that too coarse.
    Scales are logarithms between the smallest and the largest, 8 bits; of quaternions and normals, 127 is 1.
    """
    gaussians = largest_gaussians(layers.gaussians, layers.max_count)
    means = gaussians.means.astype(float)
    logs = np.log(np.maximum(gaussians.scales.astype(float), 1e-9))
    low, high = (means.min(0), means.max(0)) if len(means) else (np.zeros(3), np.zeros(3))
    if len(means) and (high - low).max() / 65535 > 0.2 * np.median(gaussians.scales):
        low, high = np.zeros(3), np.full(3, 65535.0)
        places = embed_array(means, "f32")
    else:
        places = embed_array(np.rint((means - low) / np.where(high > low, high - low, 1) * 65535), "u16")
    least, most = (float(logs.min()), float(logs.max())) if len(logs) else (0.0, 0.0)
    return {
        "links": layers.links,
        "layers": layers.layers,
        "low": low,
        "high": high,
        "scales_between": [least, most],
        "means": places,
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
