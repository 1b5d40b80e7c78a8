"""Image losses of the model: L1 + SSIM of colour, depth, foreground mask (paper, End-to-end Optimization)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from freeart21.se3 import Array, Bools, Floats
from reconstruct.gaussians.rasteriser import Picture
from reconstruct.kernels import run_in_threads
from reconstruct.settings import GaussianSettings

C1, C2 = 0.01**2, 0.03**2
"""SSIM's constants, for colours from 0 to 1 (Wang et al. 2004)."""
WINDOW, SIGMA = 11, 1.5
"""SSIM's window and its sigma, pixels (Kerbl et al. 2023)."""
COVERED = 0.5
"""Opacity above which a pixel of the model has a depth."""

_F = np.float32
_COVERED = _F(COVERED)
_U = np.uint64
"""Unsigned index type: with a signed one, which may count from the end, a loop does not vectorise."""
_R = WINDOW // 2
_TAPS = np.exp(-0.5 * (np.arange(_R + 1) / SIGMA) ** 2)
_TAPS = (_TAPS / (2 * _TAPS.sum() - _TAPS[0])).astype(np.float32)
"""Of the window, from its middle outwards."""


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
    h, w = picture.alpha.shape
    pixels = h * w
    seen, wanted = np.empty((3, h, w), np.float32), np.empty((3, h, w), np.float32)
    d_colour, hidden, sums = np.empty((h, w, 3), np.float32), np.empty((h, w), np.bool_), np.zeros(3)
    d_depth, d_alpha = np.empty((h, w), np.float32), np.empty((h, w), np.float32)
    rates = np.array([settings.depth / (pixels * unit), settings.mask / pixels], np.float32)
    measured = target.colour, target.depth, target.mask, target.around
    _compare(
        picture.colour, picture.depth, picture.alpha, *measured, background, rates, seen, wanted, hidden, d_depth,
        d_alpha, sums,
    )  # fmt: skip
    similar, d_similar = _similarity(seen, wanted)
    share = settings.ssim
    weights = np.array([(1 - share) / seen.size, share / seen.size], np.float32)
    _combine(seen, wanted, hidden, d_similar, background, weights, d_colour, d_alpha)
    l_1, off, outside = sums
    return Loss(
        (1 - share) * l_1 / seen.size + share * (1 - similar),
        off / pixels / unit,
        outside / pixels,
        d_colour,
        d_depth,
        d_alpha,
    )


def ssim(seen: Floats, wanted: Floats) -> tuple[float, Floats]:
    """Mean structural similarity of two images (h, w, 3), and the derivative of its sum by `seen`."""
    x, y = (np.ascontiguousarray(np.moveaxis(image, 2, 0), np.float32) for image in (seen, wanted))
    value, d = _similarity(x, y)
    return value, np.moveaxis(d, 0, 2)


def _similarity(seen: Floats, wanted: Floats) -> tuple[float, Floats]:
    """`ssim` of images (3, h, w)."""
    values, d = np.zeros(len(seen)), np.empty_like(seen)
    run_in_threads(lambda begin, end: _similarities(begin, end, seen, wanted, values, d), len(seen), 2)
    return float(values.sum()) / seen.size, d


@njit(nogil=True, cache=True, error_model="numpy")
def _compare(
    colour: Floats, depth: Floats, alpha: Floats, measured_colour: Floats, measured_depth: Floats, mask: Bools,
    around: Floats, background: Floats, rates: Floats, seen: Floats, wanted: Floats, hidden: Bools, d_depth: Floats,
    d_alpha: Floats, sums: Array,
) -> None:  # pragma: no cover  # fmt: skip
    """Both images before the background, and the depth's and the mask's losses with their derivatives.

    `sums` are the absolute differences of colour, depth and mask; `rates` the weights of the last two.
    """
    h, w = alpha.shape
    for y in range(h):
        for x in range(w):
            A = alpha[y, x]
            covered = _COVERED < A
            z = depth[y, x] / A if covered else _F(0)
            behind = not mask[y, x] and around[y, x] > 0 and around[y, x] < z
            hidden[y, x] = behind
            for c in range(3):
                s = colour[y, x, c] + (_F(1) - A) * background[c]
                t = measured_colour[y, x, c] if mask[y, x] else background[c]
                t = s if behind else t
                seen[c, y, x], wanted[c, y, x] = s, t
                sums[0] += abs(s - t)
            by_alpha = by_depth = _F(0)
            if covered and measured_depth[y, x] > 0:
                off = z - measured_depth[y, x]
                sums[1] += abs(off)
                by_depth = rates[0] * _F(np.sign(off)) / A
                by_alpha = -by_depth * z
            if not behind:
                off = A - _F(mask[y, x])
                sums[2] += abs(off)
                by_alpha += rates[1] * _F(np.sign(off))
            d_depth[y, x], d_alpha[y, x] = by_depth, by_alpha


@njit(nogil=True, cache=True, error_model="numpy")
def _combine(
    seen: Floats, wanted: Floats, hidden: Bools, d_similar: Floats, background: Floats, weights: Floats,
    d_colour: Floats, d_alpha: Floats,
) -> None:  # pragma: no cover  # fmt: skip
    """Derivatives by colour; those by what the background shows are added to `d_alpha`."""
    h, w = hidden.shape
    for y in range(h):
        for x in range(w):
            for c in range(3):
                d = weights[0] * _F(np.sign(seen[c, y, x] - wanted[c, y, x])) - weights[1] * d_similar[c, y, x]
                d = _F(0) if hidden[y, x] else d
                d_colour[y, x, c] = d
                d_alpha[y, x] -= d * background[c]


@njit(nogil=True, cache=True, error_model="numpy", fastmath=True)
def _similarities(
    begin: int, end: int, seen: Floats, wanted: Floats, values: Array, d: Floats
) -> None:  # pragma: no cover
    """Sums of the structural similarity of some channels, and its derivatives by `seen`."""
    h, w = seen.shape[1:]
    beside, row = np.zeros((h + 2 * _R, w), np.float32), np.zeros(w + 2 * _R, np.float32)
    maps, blurred = np.empty((5, h, w), np.float32), np.empty((5, h, w), np.float32)
    two, c1, c2 = _F(2), _F(C1), _F(C2)
    for channel in range(begin, end):
        x, y = seen[channel], wanted[channel]
        for i in range(_U(h)):
            for j in range(_U(w)):
                a, b = x[i, j], y[i, j]
                maps[0, i, j], maps[1, i, j], maps[2, i, j], maps[3, i, j], maps[4, i, j] = a, b, a * a, b * b, a * b
        for k in range(5):
            _blur(maps[k], beside, row, blurred[k])
        for i in range(_U(h)):
            total = _F(0)
            for j in range(_U(w)):
                mx, my = blurred[0, i, j], blurred[1, i, j]
                xx, yy, xy = blurred[2, i, j] - mx * mx, blurred[3, i, j] - my * my, blurred[4, i, j] - mx * my
                a1, a2 = two * mx * my + c1, two * xy + c2
                b1, b2 = mx * mx + my * my + c1, xx + yy + c2
                under = _F(1) / (b1 * b2)
                value = a1 * a2 * under
                by_xx, by_xy = -value / b2, two * a1 * under
                total += value
                maps[0, i, j] = two * my * a2 * under - two * mx * value / b1 - two * mx * by_xx - my * by_xy
                maps[1, i, j], maps[2, i, j] = by_xx, by_xy
            values[channel] += total
        for k in range(3):
            _blur(maps[k], beside, row, blurred[k])
        for i in range(_U(h)):
            for j in range(_U(w)):
                d[channel, i, j] = blurred[0, i, j] + two * x[i, j] * blurred[1, i, j] + y[i, j] * blurred[2, i, j]


@njit(nogil=True, cache=True, error_model="numpy", fastmath=True)
def _blur(image: Floats, beside: Floats, row: Floats, blurred: Floats) -> None:  # pragma: no cover
    """`blurred` becomes the window's means of an image (h, w), black beyond its border.

    `beside` (h + 2 R, w) and `row` (w + 2 R,) are room to work in, with zeros beyond the border.
    """
    h, w = image.shape
    t0, t1, t2, t3, t4, t5 = _TAPS[0], _TAPS[1], _TAPS[2], _TAPS[3], _TAPS[4], _TAPS[5]
    for i in range(h):
        row[_R : _R + w] = image[i]
        out = beside[i + _R]
        for j in range(_U(w)):
            a = t5 * (row[j] + row[j + _U(10)]) + t4 * (row[j + _U(1)] + row[j + _U(9)])
            b = t3 * (row[j + _U(2)] + row[j + _U(8)]) + t2 * (row[j + _U(3)] + row[j + _U(7)])
            out[j] = a + b + t1 * (row[j + _U(4)] + row[j + _U(6)]) + t0 * row[j + _U(5)]
    for i in range(h):
        r0, r1, r2, r3, r4, r5 = beside[i], beside[i + 1], beside[i + 2], beside[i + 3], beside[i + 4], beside[i + 5]
        r6, r7, r8, r9, r10 = beside[i + 6], beside[i + 7], beside[i + 8], beside[i + 9], beside[i + 10]
        out = blurred[i]
        for j in range(_U(w)):
            a = t5 * (r0[j] + r10[j]) + t4 * (r1[j] + r9[j]) + t3 * (r2[j] + r8[j])
            out[j] = a + t2 * (r3[j] + r7[j]) + t1 * (r4[j] + r6[j]) + t0 * r5[j]
