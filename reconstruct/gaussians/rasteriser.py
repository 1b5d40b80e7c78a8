"""Interface of a rasteriser of Gaussians: one function, `Rasterise` (backends: `numba_backend`, `gsplat_backend`).

Colour, depth and opacity by front-to-back blending of projected Gaussians (Kerbl et al. 2023; Zwicker et al. 2001),
with gsplat's constants so that the backends agree.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from freeart21.se3 import Array, Floats

DILATION = 0.3
"""Square pixels added to every projected covariance (gsplat's eps2d)."""
THIN = 0.01
"""Square pixels added to the covariance from which a Gaussian's depth slope is computed: a tenth of a pixel, so that a
disc seen edge-on has a slope. On planes tilted by 40 and 65 degrees it leaves 0.03 and 0.24 pixels of error; without
slopes 0.59 and 1.5."""
FAINTEST, DENSEST = 1 / 255, 0.999
"""Opacities of a Gaussian at a pixel: smaller ones are skipped, larger ones cut (gsplat's)."""
OPAQUE = 1e-4
"""Transmittance below which a pixel is finished (gsplat's)."""
NEAR = 0.01
"""Metres: nearer Gaussians are skipped (gsplat's near plane)."""


@dataclass(frozen=True)
class Lens:
    """A pinhole camera's window, pixels; pixel centres at +0.5."""

    fx: float
    fy: float
    cx: float
    cy: float
    width: int
    height: int


@dataclass(frozen=True)
class Splats:
    """M Gaussians to draw, each under one of two motions; float32, C order."""

    means: Floats
    """(M, 3) metres, canonical frame."""
    quaternions: Floats
    """(M, 4) wxyz, of any length but zero."""
    scales: Floats
    """(M, 3) metres, above zero."""
    opacities: Floats
    """(M,) 0 to 1."""
    colours: Floats
    """(M, 3)."""
    motion: NDArray[np.uint8]
    """(M,) 0 or 1: the pose that places it."""

    def __len__(self) -> int:
        return len(self.means)


@dataclass(frozen=True)
class Picture:
    """A rendered window; float32. Without background: on white it is colour + (1 - alpha) white."""

    colour: Floats
    """(h, w, 3) sum over Gaussians of blending weight times colour."""
    depth: Floats
    """(h, w) sum of blending weight times the Gaussian's depth at the pixel, metres; a depth when divided by alpha.

    A Gaussian's depth is the mean of its visible mass at a pixel: for a disc, its plane's. The depth of its mean would
    favour the nearer Gaussians on tilted surfaces, by 0.6 pixels' breadth between a frontal face and one at 60 degrees
    (torch_lighter), and bias the poses (RaDe-GS: Zhang et al. 2024).
    """
    alpha: Floats
    """(h, w) sum of blending weights, 0 to 1."""
    moving: Floats
    """(h, w) sum of blending weights of the Gaussians under motion 1."""


@dataclass(frozen=True)
class SplatGradients:
    """Derivatives of a scalar by all that was drawn; float32 except the twists."""

    means: Floats
    quaternions: Floats
    scales: Floats
    opacities: Floats
    colours: Floats
    twists: Array
    """(2, 6) by left twists (v, w) of the two poses: T becomes exp(twist) T."""
    screen: Floats
    """(M,) length of the derivative by the projected mean, per pixel, for densification."""
    drawn: NDArray[np.bool_]
    """(M,) whether it was in the image at all."""


Backward = Callable[[Floats, Floats, Floats], SplatGradients]
"""From derivatives by `Picture.colour` (h, w, 3), `.depth` (h, w) and `.alpha` (h, w) to those by the splats. Can be
called once."""

Rasterise = Callable[[Splats, Array, Lens], tuple[Picture, Backward]]
"""(splats, poses (2, 4, 4) camera from canonical, lens) to the image and its backward pass."""
