"""What a rasteriser of Gaussians is: one function, `Rasterise`, that backends provide (`numba_backend`,
`gsplat_backend`).

Colour, depth and opacity by front-to-back blending of Gaussians projected to the picture (Kerbl et al. 2023; Zwicker
et al. 2001), with the constants of gsplat so that the backends agree.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from freeart21.se3 import Array

Floats = NDArray[np.float32]

DILATION = 0.3
"""Square pixels added to every projected covariance (gsplat's eps2d)."""
THIN = 0.01
"""Square pixels added to the covariance that a Gaussian's slope of depth is of: a tenth of a pixel, so that a disc seen
edge on has one. It leaves .03 and .24 pixels of error on planes tilted by 40 and 65 degrees, of .59 and 1.5 without a
slope."""
FAINTEST, DENSEST = 1 / 255, 0.999
"""Of a Gaussian at a pixel: a smaller opacity is left out, a larger one is cut (gsplat's)."""
OPAQUE = 1e-4
"""Transmittance at which a pixel is closed (gsplat's)."""
NEAR = 0.01
"""Metres: nearer Gaussians are left out (gsplat's near plane)."""


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
    """(M,) 0 or 1: which of the two poses places it."""

    def __len__(self) -> int:
        return len(self.means)


@dataclass(frozen=True)
class Picture:
    """What a window shows; float32. Nothing is put behind: a picture before white is colour + (1 - alpha) white."""

    colour: Floats
    """(h, w, 3) sum over Gaussians of blending weight times colour."""
    depth: Floats
    """(h, w) sum of blending weight times the Gaussian's depth there, metres: over alpha it is a depth.

    That is the mean depth of what of it is seen at a pixel: of a disc, its plane's. Were it the depth of the Gaussian's
    mean, what comes first would count more where a surface is tilted, by .6 pixels' breadth of depth between a
    face seen frontally and one at 60 degrees (torch_lighter), and poses would follow (RaDe-GS: Zhang et al. 2024).
    """
    alpha: Floats
    """(h, w) sum of blending weights, 0 to 1."""
    moving: Floats
    """(h, w) sum of blending weights of the Gaussians under motion 1."""


@dataclass(frozen=True)
class SplatGradients:
    """Derivatives of a scalar by everything that was drawn; float32 but for the twists."""

    means: Floats
    quaternions: Floats
    scales: Floats
    opacities: Floats
    colours: Floats
    twists: Array
    """(2, 6) by left twists (v, w) of the two poses: T becomes exp(twist) T."""
    screen: Floats
    """(M,) length of the derivative by the projected mean, per pixel: what densification goes by."""
    drawn: NDArray[np.bool_]
    """(M,) whether it was in the picture at all."""


Pull = Callable[[Floats, Floats, Floats], SplatGradients]
"""Derivatives by `Picture.colour` (h, w, 3), `.depth` (h, w) and `.alpha` (h, w) to those by what was drawn. May be
called once."""

Rasterise = Callable[[Splats, Array, Lens], tuple[Picture, Pull]]
"""(splats, poses (2, 4, 4) camera from canonical, lens) to the picture and the way back."""
