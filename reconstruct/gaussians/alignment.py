"""Poses, states and joint from the model: Gauss-Newton on the pixels of all frames.

A small motion of a part shifts the rendered image along its gradient, so a frame's colour, depth and silhouette give
normal equations for the twists of both parts (direct alignment: Baker and Matthews 2004). The gradient is the mean of
the model's and the frame's, for second-order steps (Benhimane and Malis 2004). All frames together, through the joint's
Jacobian, give those of poses, states, axis and pivot.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any

import cv2
import numpy as np
from numba import njit
from numpy.typing import NDArray

from freeart21.se3 import Array, Bools, Floats, Ints
from reconstruct.gaussians.losses import COVERED, Target
from reconstruct.gaussians.rasteriser import Lens, Picture


@dataclass(frozen=True)
class Scales:
    """Standard deviations of the residuals of good pixels."""

    colour: float
    """sRGB, 0 to 1."""
    depth: float
    """Metres."""
    mask: float
    """Opacity."""


@dataclass(frozen=True)
class Terms:
    """A frame's contribution to the normal equations."""

    H: Array
    """(2, 6, 6) of left twists (v, w) of the reference and the moving part."""
    g: Array
    """(2, 6)."""
    cells: NDArray[np.int32]
    """(c,) surface patches that the frame shows, numbers below 2 CELLS; the upper half is the moving part's."""
    shared: Floats
    """(c, 27) for each patch: sums of the products of the Jacobians by its part's twist and by its own shift in the
    canonical frame (6 x 3), by its shift alone (upper half of 3 x 3), and with the residuals (3)."""
    cost: float
    """Sum of robust squared residuals, in standard deviations."""
    count: float
    """Number of residuals."""
    spread: Array
    """(3,) median absolute residuals of colour, depth and mask; NaN where there are none."""

    def before_a_fixed_model(self) -> Terms:
        """The same without the patches: the surface does not shift."""
        return replace(self, cells=self.cells[:0], shared=self.shared[:0])


def alignment_terms(
    picture: Picture, target: Target, lens: Lens, Ts: Array, scales: Scales, cell: float, coarseness: int = 1
) -> Terms:
    """Normal equations of a frame's two part poses Ts (2, 4, 4); `cell` is the edge of the surface's patches, metres.

    Blocks of `coarseness` pixels each way are averaged: an image gradient is only valid over about one pixel.
    """
    c = coarseness
    shown: tuple[Any, ...] = _coarser(picture, target, c)
    lens = Lens(lens.fx / c, lens.fy / c, lens.cx / c, lens.cy / c, lens.width // c, lens.height // c)
    H, g, sums = np.zeros((2, 6, 6)), np.zeros((2, 6)), np.zeros(2)
    kinds = np.full((lens.height, lens.width, 3), np.nan, np.float32)
    table = _TABLE
    touched = np.empty(lens.height * lens.width, np.int32)
    count = _accumulate(  # type: ignore[call-arg]
        *shown, lens.fx, lens.fy, lens.cx, lens.cy, scales.colour, scales.depth, scales.mask, H, g, sums, kinds,
        np.linalg.inv(Ts), 1 / cell, table, touched,
    )  # fmt: skip
    cells = np.unique(touched[:count])
    shared = table[cells].astype(np.float32)
    table[cells] = 0
    spread = np.full(3, np.nan)
    for k in range(3):
        given = kinds[..., k][np.isfinite(kinds[..., k])]
        if len(given):
            spread[k] = np.median(given)
    return Terms(H, g, cells, shared, float(sums[0]), float(sums[1]), spread)


def _coarser(picture: Picture, target: Target, c: int) -> tuple[Floats, ...]:
    """Model's colour, depth, alpha and moving, and frame's colour, depth, foreground and surroundings, averaged over
    blocks of c x c pixels. Depths are means of the known ones, 0 where fewer than half are known."""
    seen = (picture.colour, picture.depth, picture.alpha, picture.moving, target.colour)
    if c == 1:
        return (*seen, target.depth, target.mask.astype(np.float32), target.around)
    h, w = (size // c for size in picture.alpha.shape)

    def mean(image: Any) -> Floats:
        return np.asarray(cv2.resize(image[: h * c, : w * c], (w, h), interpolation=cv2.INTER_AREA), np.float32)

    def known(depth: Floats) -> Floats:
        share = mean((depth > 0).astype(np.float32))
        return np.where(share > 0.5, mean(depth) / np.maximum(share, 0.5), 0).astype(np.float32)

    return (*map(mean, seen), known(target.depth), mean(target.mask.astype(np.float32)), known(target.around))


CELLS = 1 << 15
"""Hash table size for patches of a part's surface; patches that collide are merged."""
_TABLE = np.zeros((2 * CELLS, 27))
SUBPIXEL = 0.3
"""Position error of sampled edges, pixels: residuals grow with the gradient by so much."""


@dataclass(frozen=True)
class ReducedEquations:
    """Normal equations A x = -b of all twists, with the patches eliminated, and the way back to the patches."""

    A: Array
    """(2, 6n, 6n) of both parts."""
    b: Array
    """(2, 6n)."""
    own: Array
    """(2 CELLS, 27) sums over all frames of `Terms.shared`."""
    terms: dict[int, Terms]

    def shifts(self, twists: tuple[Array, Array]) -> Array:
        """(2 CELLS, 3) metres, canonical frame: shifts of the patches for pose changes `twists` (6n,) of the parts."""
        right = self.own[:, 24:].copy()
        for i, t in self.terms.items():
            x = np.stack([part[6 * i : 6 * i + 6] for part in twists])[t.cells // CELLS]
            right[t.cells] += np.einsum("ca,cab->cb", x, t.shared[:, :18].reshape(-1, 6, 3))
        known, H = _patches(self.own)
        found = np.zeros((2 * CELLS, 3))
        found[known] = -np.linalg.solve(H, right[known][..., None])[..., 0]
        return found


def _patches(own: Array) -> tuple[NDArray[np.int64], Array]:
    """Numbers (c,) of the observed patches, and their damped normal matrices (c, 3, 3)."""
    trace = own[:, [18, 21, 23]].sum(1)
    known = np.flatnonzero(trace > 0)
    upper = np.array([[18, 19, 20], [19, 21, 22], [20, 22, 23]])
    return known, own[known][:, upper] + HOLD * trace[known, None, None] * np.eye(3)


def eliminate_patches(terms: dict[int, Terms], n: int) -> ReducedEquations:
    """The normal equations of all frames, with every surface patch free to shift.

    With a fixed model, every frame would be pulled back to where it was when the model was trained, and a drift along
    the video would only shrink by a twentieth per round. The patches are eliminated by Schur's complement, like points
    in bundle adjustment (Triggs et al. 2000).
    """
    A, b = np.zeros((2, 6 * n, 6 * n)), np.zeros((2, 6 * n))
    own = np.zeros((2 * CELLS, 27))
    for i, t in terms.items():
        at = slice(6 * i, 6 * i + 6)
        A[:, at, at] += t.H
        b[:, at] += t.g
        own[t.cells] += t.shared
    known, H = _patches(own)
    back = np.linalg.inv(np.linalg.cholesky(H))
    sides = np.einsum("cij,cj->ci", back, own[known, 24:])
    for part in range(2):
        mine = np.flatnonzero(known // CELLS == part)
        for begin in range(0, len(mine), CHUNK):
            some = mine[begin : begin + CHUNK]
            low, high = known[some[0]], known[some[-1]]
            B = np.zeros((len(some), 3, 6 * n), np.float32)
            for i, t in terms.items():
                here = slice(*np.searchsorted(t.cells, (low, high + 1)))
                row = np.searchsorted(known[some], t.cells[here])
                products = t.shared[here, :18].reshape(-1, 6, 3)
                B[row, :, 6 * i : 6 * i + 6] = back[some[row]] @ np.swapaxes(products, 1, 2)
            flat = B.reshape(-1, 6 * n)
            A[part] -= flat.T @ flat
            b[part] -= flat.T @ sides[some].reshape(-1).astype(np.float32)
    return ReducedEquations(A, b, own, terms)


CHUNK = 2048
"""Patches that are eliminated at a time: 40 MB for 300 frames."""
HOLD = 1e-3
"""Damping of a patch's normal matrix, relative to its trace."""


def patch_numbers(points: NDArray[Any], moving: NDArray[np.bool_], cell: float) -> NDArray[np.int64]:
    """(N,) patches of points (N, 3) of the canonical frame, of the moving part where `moving` (N,)."""
    i, j, k = np.floor(np.asarray(points, float) / cell).astype(np.int64).T
    return (((i * 73856093) ^ (j * 19349663) ^ (k * 83492791)) & (CELLS - 1)) + moving * CELLS


@njit(nogil=True, cache=True)
def _accumulate(
    colour: Floats, depth: Floats, alpha: Floats, moving: Floats, seen: Floats, measured: Floats, mask: Bools,
    around: Floats, fx: float, fy: float, cx: float, cy: float, s_colour: float, s_depth: float, s_mask: float,
    H: Array, g: Array, sums: Array, kinds: Floats, back: Array, per_cell: int, table: Array, touched: Ints,
) -> int:  # pragma: no cover  # fmt: skip
    """Sums over pixels; `kinds` (h, w, 3) gets absolute residuals of colour, depth and mask."""
    h, w = alpha.shape
    au, av, az, J = np.zeros(6), np.zeros(6), np.zeros(6), np.zeros(6)
    count = 0
    for y in range(1, h - 1):
        for x in range(1, w - 1):
            A = alpha[y, x]
            if A < 0.02:
                continue
            z = depth[y, x] / A
            if mask[y, x] < 0.5 and around[y, x] > 0 and around[y, x] < z:
                continue
            part = 1 if moving[y, x] > 0.5 * A else 0
            px, py = (x + 0.5 - cx) / fx * z, (y + 0.5 - cy) / fy * z
            # by twists (v, w): dP = v + w x P
            az[2], az[3], az[4] = 1.0, py, -px
            iu, iv = fx / z, fy / z
            ru, rv = px / z, py / z
            au[0], au[2], au[3], au[4], au[5] = iu, -iu * ru, -iu * ru * py, iu * (z + ru * px), -iu * py
            av[1], av[2], av[3], av[4], av[5] = iv, -iv * rv, -iv * (z + rv * py), iv * rv * px, iv * px
            T = back[part]
            i = math.floor((T[0, 0] * px + T[0, 1] * py + T[0, 2] * z + T[0, 3]) * per_cell)
            j = math.floor((T[1, 0] * px + T[1, 1] * py + T[1, 2] * z + T[1, 3]) * per_cell)
            k = math.floor((T[2, 0] * px + T[2, 1] * py + T[2, 2] * z + T[2, 3]) * per_cell)
            cell = (((i * 73856093) ^ (j * 19349663) ^ (k * 83492791)) & (CELLS - 1)) + part * CELLS
            patch = table[cell]
            touched[count] = cell
            count += 1
            # silhouette
            r = A - mask[y, x]
            gx, gy = 0.5 * (alpha[y, x + 1] - alpha[y, x - 1]), 0.5 * (alpha[y + 1, x] - alpha[y - 1, x])
            if gx * gx + gy * gy > 1e-4:
                for k in range(6):
                    J[k] = -(gx * au[k] + gy * av[k])
                _add(H[part], g[part], patch, T, J, r, s_mask, sums)
                kinds[y, x, 2] = abs(r)
            inside = (
                A > COVERED
                and alpha[y, x + 1] > COVERED
                and alpha[y, x - 1] > COVERED
                and alpha[y + 1, x] > COVERED
                and alpha[y - 1, x] > COVERED
            )
            if not inside or mask[y, x] < 1:
                continue
            zr, zl = depth[y, x + 1] / alpha[y, x + 1], depth[y, x - 1] / alpha[y, x - 1]
            zd, zu = depth[y + 1, x] / alpha[y + 1, x], depth[y - 1, x] / alpha[y - 1, x]
            if min(mask[y, x + 1], mask[y, x - 1], mask[y + 1, x], mask[y - 1, x]) == 1:
                gx = gy = r = 0.0
                for c in range(3):
                    m = colour[y, x, c] / A
                    mx = colour[y, x + 1, c] / alpha[y, x + 1] - colour[y, x - 1, c] / alpha[y, x - 1]
                    my = colour[y + 1, x, c] / alpha[y + 1, x] - colour[y - 1, x, c] / alpha[y - 1, x]
                    gx += (mx + seen[y, x + 1, c] - seen[y, x - 1, c]) / 12
                    gy += (my + seen[y + 1, x, c] - seen[y - 1, x, c]) / 12
                    r += (m - seen[y, x, c]) / 3
                for q in range(6):
                    J[q] = -(gx * au[q] + gy * av[q])
                sigma = math.sqrt(s_colour * s_colour + SUBPIXEL * SUBPIXEL * (gx * gx + gy * gy))
                _add(H[part], g[part], patch, T, J, r, sigma, sums)
                kinds[y, x, 0] = abs(r)
            if measured[y, x] > 0:
                gx, gy = 0.5 * (zr - zl), 0.5 * (zd - zu)
                tilt = math.sqrt(1 + (gx * fx / z) ** 2 + (gy * fy / z) ** 2)
                if tilt < 10:
                    r = (z - measured[y, x]) / tilt
                    for q in range(6):
                        J[q] = (az[q] - gx * au[q] - gy * av[q]) / tilt
                    _add(H[part], g[part], patch, T, J, r, s_depth, sums)
                    kinds[y, x, 1] = abs(r)
    return count


@njit(nogil=True, cache=True)
def _add(
    H: Array, g: Array, patch: Array, T: Array, J: Array, r: float, sigma: float, sums: Array,
) -> None:  # pragma: no cover  # fmt: skip
    """Add one residual with Cauchy's weight.

    T takes the camera to the canonical frame, so a patch's shift there is one of the camera's by T's transposed
    rotation.
    """
    e = r / (2 * sigma)
    weight = 1 / (sigma * sigma * (1 + e * e))
    s0 = T[0, 0] * J[0] + T[0, 1] * J[1] + T[0, 2] * J[2]
    s1 = T[1, 0] * J[0] + T[1, 1] * J[1] + T[1, 2] * J[2]
    s2 = T[2, 0] * J[0] + T[2, 1] * J[1] + T[2, 2] * J[2]
    for a in range(6):
        wj = weight * J[a]
        g[a] += wj * r
        for b in range(6):
            H[a, b] += wj * J[b]
        patch[3 * a] += wj * s0
        patch[3 * a + 1] += wj * s1
        patch[3 * a + 2] += wj * s2
    patch[18] += weight * s0 * s0
    patch[19] += weight * s0 * s1
    patch[20] += weight * s0 * s2
    patch[21] += weight * s1 * s1
    patch[22] += weight * s1 * s2
    patch[23] += weight * s2 * s2
    patch[24] += weight * s0 * r
    patch[25] += weight * s1 * r
    patch[26] += weight * s2 * r
    sums[0] += 4 * math.log1p(e * e)
    sums[1] += 1
