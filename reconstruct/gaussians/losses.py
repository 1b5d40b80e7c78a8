"""Image losses of the model: L1 + SSIM of colour, depth, foreground mask (paper, End-to-end Optimization)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from freeart21.se3 import Floats
from reconstruct.gaussians.rasteriser import Picture
from reconstruct.settings import GaussianSettings

C1, C2 = 0.01**2, 0.03**2
"""SSIM's constants, for colours from 0 to 1 (Wang et al. 2004)."""
WINDOW, SIGMA = 11, 1.5
"""SSIM's window and its sigma, pixels (Kerbl et al. 2023)."""
COVERED = 0.5
"""Opacity above which a pixel of the model has a depth."""


@dataclass(frozen=True)
class Target:
    """A frame's window, as measured."""

    colour: Floats
    """(h, w, 3) sRGB, 0 to 1."""
    depth: Floats
    """(h, w) metres on the object; 0 where there is none or it is unreliable."""
    mask: NDArray[np.bool_]
    """(h, w) foreground."""
    around: Floats
    """(h, w) metres, measured depth off the object; 0 where there is none."""


@dataclass(frozen=True)
class Loss:
    """Mean losses over a window's pixels, and the derivatives of their weighted sum by the rendered image."""

    rgb: float
    depth: float
    mask: float
    d_colour: Floats
    d_depth: Floats
    d_alpha: Floats


def loss(picture: Picture, target: Target, background: Floats, unit: float, settings: GaussianSettings) -> Loss:
    """L_rgb + lambda_depth L_depth + lambda_mask L_mask before a `background` (3,); depth in `unit`s, metres.

    Pixels at which something else stands in front of the model do not count.
    """
    alpha, pixels = picture.alpha, picture.alpha.size
    covered = alpha > COVERED
    depth = np.where(covered, picture.depth / np.maximum(alpha, COVERED), 0)
    hidden = ~target.mask & (target.around > 0) & (target.around < depth)
    known = ~hidden
    seen = picture.colour + (1 - alpha)[..., None] * background
    wanted = np.where(target.mask[..., None], target.colour, background)
    wanted = np.where(hidden[..., None], seen, wanted)
    gap = seen - wanted
    l_1 = float(np.abs(gap).mean())
    similar, d_similar = ssim(seen, wanted)
    share = settings.ssim
    d_seen = ((1 - share) / gap.size) * np.sign(gap) - (share / gap.size) * d_similar
    d_seen = np.where(hidden[..., None], 0, d_seen).astype(np.float32)
    d_alpha = -(d_seen @ background)

    measured = covered & (target.depth > 0)
    off = np.where(measured, depth - target.depth, 0)
    d_depth = settings.depth / (pixels * unit) * np.sign(off)
    over = np.where(measured, 1 / np.maximum(alpha, COVERED), 0)
    d_alpha -= d_depth * depth * over
    d_depth = d_depth * over

    outside = np.where(known, alpha - target.mask, 0)
    d_alpha += settings.mask / pixels * np.sign(outside)
    return Loss(
        (1 - share) * l_1 + share * (1 - similar),
        float(np.abs(off).sum() / pixels / unit),
        float(np.abs(outside).mean()),
        d_seen,
        d_depth.astype(np.float32),
        d_alpha.astype(np.float32),
    )


def ssim(seen: Floats, wanted: Floats) -> tuple[float, Floats]:
    """Mean structural similarity of two images (h, w, 3), and the derivative of its sum by `seen`."""
    x, y = seen.astype(np.float32), wanted.astype(np.float32)
    mx, my = _blur(x), _blur(y)
    xx, yy, xy = _blur(x * x) - mx * mx, _blur(y * y) - my * my, _blur(x * y) - mx * my
    a1, a2 = 2 * mx * my + C1, 2 * xy + C2
    b1, b2 = mx * mx + my * my + C1, xx + yy + C2
    under = 1 / (b1 * b2)
    value = a1 * a2 * under
    by_xx, by_xy = -value / b2, 2 * a1 * under
    by_mx = 2 * my * a2 * under - 2 * mx * value / b1 - 2 * mx * by_xx - my * by_xy
    return float(value.mean()), _blur(by_mx) + 2 * x * _blur(by_xx) + y * _blur(by_xy)


def _blur(image: Any) -> Floats:
    return np.asarray(cv2.GaussianBlur(image, (WINDOW, WINDOW), SIGMA, borderType=cv2.BORDER_CONSTANT), np.float32)
