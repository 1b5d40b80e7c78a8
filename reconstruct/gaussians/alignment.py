"""Poses, states and joint from the model as it stands: Gauss-Newton on the pixels of all frames.

A small motion of a part shifts what the model shows along the picture's gradient; so colour, depth and silhouette of a
frame give normal equations for the twists of both parts (direct alignment: Baker and Matthews 2004; the gradient is
the mean of model's and frame's, which makes steps second order: Benhimane and Malis 2004), and all frames together,
through the joint's Jacobian, those of poses, states, axis and pivot.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from freeart21.se3 import Array
from reconstruct.gaussians.losses import COVERED, Target
from reconstruct.gaussians.rasteriser import Lens, Picture


@dataclass(frozen=True)
class Scales:
    """Standard deviations of residuals of good pixels."""

    colour: float
    """sRGB, 0 to 1."""
    depth: float
    """Metres."""
    mask: float
    """Opacity."""


@dataclass(frozen=True)
class Terms:
    """What a frame says of its poses."""

    H: Array
    """(2, 6, 6) of left twists (v, w) of the reference and the moving part."""
    g: Array
    """(2, 6)."""
    cells: NDArray[np.int32]
    """(c,) of the model's surface that the frame shows, numbers below 2 CELLS; the upper half is the moving part's."""
    shared: Array
    """(c, 2, 8) for each of them, of colour and of depth: sums of weight times Jacobian (6), of weights, and of weight
    times residual: what the model's own colour and depth there, were they free, would take back."""
    cost: float
    """Sum of robust squares, in standard deviations."""
    count: float
    """Of them."""
    spread: Array
    """(3,) medians of absolute residuals of colour, depth and mask; NaN where there are none."""


def alignment_terms(picture: Picture, target: Target, lens: Lens, Ts: Array, scales: Scales, cell: float) -> Terms:
    """Normal equations of a frame's two part poses Ts (2, 4, 4); `cell` is the size of the surface's cells, metres."""
    H, g, sums = np.zeros((2, 6, 6)), np.zeros((2, 6)), np.zeros(2)
    kinds = np.full((*picture.alpha.shape, 3), np.nan, np.float32)
    table = _TABLE
    touched = np.empty(2 * picture.alpha.size, np.int32)
    count = _accumulate(
        picture.colour, picture.depth, picture.alpha, picture.moving, target.colour, target.depth, target.mask,
        target.around, lens.fx, lens.fy, lens.cx, lens.cy, scales.colour, scales.depth, scales.mask, H, g, sums, kinds,
        np.linalg.inv(Ts), 1 / cell, table, touched,
    )  # fmt: skip
    cells = np.unique(touched[:count])
    cells = cells[table[cells, :, 6].sum(1) > 0]
    shared = table[cells]
    table[cells] = 0
    spread = np.full(3, np.nan)
    for k in range(3):
        given = kinds[..., k][np.isfinite(kinds[..., k])]
        if len(given):
            spread[k] = np.median(given)
    return Terms(H, g, cells, shared, float(sums[0]), float(sums[1]), spread)


CELLS = 1 << 15
"""Places for cells of a part's surface; those that share one by chance are taken as one."""
_TABLE = np.zeros((2 * CELLS, 2, 8))
SUBPIXEL = 0.3
"""Pixels by which a sampled edge is off: residuals grow with the gradient by so much."""


def reduced(terms: dict[int, Terms], n: int) -> tuple[Array, Array]:
    """Normal matrices (2, 6n, 6n) and right sides (2, 6n) of both parts' twists, the model's cells eliminated.

    With the model held as it stands, it would pull every frame back to where it was when it was learned: of each step
    only a twentieth was left. Its colour and depth in each cell are unknowns of their own here, and taken out by
    Schur's complement, as the structure in bundle adjustment (Triggs et al. 2000).
    """
    A, b = np.zeros((2, 6 * n, 6 * n)), np.zeros((2, 6 * n))
    total = np.zeros((2 * CELLS, 2, 2))
    for i, t in terms.items():
        at = slice(6 * i, 6 * i + 6)
        A[:, at, at] += t.H
        b[:, at] += t.g
        total[t.cells] += t.shared[:, :, 6:]
    for part in range(2):
        known = (
            np.flatnonzero(
                total[part * CELLS : (part + 1) * CELLS, 0, 0] + total[part * CELLS : (part + 1) * CELLS, 1, 0]
            )
            + part * CELLS
        )
        row = np.full(2 * CELLS, -1)
        row[known] = np.arange(len(known))
        for kind in range(2):
            B = np.zeros((len(known), 6 * n), np.float32)
            root = 1 / np.sqrt(np.maximum(total[known, kind, 0], 1e-30))
            for i, t in terms.items():
                mine = (t.cells >= part * CELLS) & (t.cells < (part + 1) * CELLS)
                r = row[t.cells[mine]]
                B[r, 6 * i : 6 * i + 6] = t.shared[mine, kind, :6] * root[r][:, None]
            A[part] -= B.T @ B
            b[part] -= B.T @ (total[known, kind, 1] * root).astype(np.float32)
    return A, b


@njit(nogil=True, cache=True)
def _accumulate(
    colour, depth, alpha, moving, seen, measured, mask, around, fx, fy, cx, cy, s_colour, s_depth, s_mask, H, g, sums,
    kinds, back, per_cell, table, touched,
):  # pragma: no cover  # fmt: skip
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
            if not mask[y, x] and around[y, x] > 0 and around[y, x] < z:
                continue
            part = 1 if moving[y, x] > 0.5 * A else 0
            px, py = (x + 0.5 - cx) / fx * z, (y + 0.5 - cy) / fy * z
            # by twists (v, w): dP = v + w x P
            az[2], az[3], az[4] = 1.0, py, -px
            iu, iv = fx / z, fy / z
            ru, rv = px / z, py / z
            au[0], au[2], au[3], au[4], au[5] = iu, -iu * ru, -iu * ru * py, iu * (z + ru * px), -iu * py
            av[1], av[2], av[3], av[4], av[5] = iv, -iv * rv, -iv * (z + rv * py), iv * rv * px, iv * px
            # silhouette
            r = A - (1.0 if mask[y, x] else 0.0)
            gx, gy = 0.5 * (alpha[y, x + 1] - alpha[y, x - 1]), 0.5 * (alpha[y + 1, x] - alpha[y - 1, x])
            if gx * gx + gy * gy > 1e-4:
                for k in range(6):
                    J[k] = -(gx * au[k] + gy * av[k])
                _add(H[part], g[part], J, r, s_mask, sums)
                kinds[y, x, 2] = abs(r)
            inside = (
                A > COVERED
                and alpha[y, x + 1] > COVERED
                and alpha[y, x - 1] > COVERED
                and alpha[y + 1, x] > COVERED
                and alpha[y - 1, x] > COVERED
            )
            if not inside or not mask[y, x]:
                continue
            T = back[part]
            i = math.floor((T[0, 0] * px + T[0, 1] * py + T[0, 2] * z + T[0, 3]) * per_cell)
            j = math.floor((T[1, 0] * px + T[1, 1] * py + T[1, 2] * z + T[1, 3]) * per_cell)
            k = math.floor((T[2, 0] * px + T[2, 1] * py + T[2, 2] * z + T[2, 3]) * per_cell)
            cell = ((i * 73856093) ^ (j * 19349663) ^ (k * 83492791)) & (CELLS - 1)
            if part == 1:
                cell += CELLS
            if table[cell, 0, 6] == 0 and table[cell, 1, 6] == 0:
                touched[count] = cell
                count += 1
            zr, zl = depth[y, x + 1] / alpha[y, x + 1], depth[y, x - 1] / alpha[y, x - 1]
            zd, zu = depth[y + 1, x] / alpha[y + 1, x], depth[y - 1, x] / alpha[y - 1, x]
            if mask[y, x + 1] and mask[y, x - 1] and mask[y + 1, x] and mask[y - 1, x]:
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
                weight = _add(H[part], g[part], J, r, sigma, sums)
                for q in range(6):
                    table[cell, 0, q] += weight * J[q]
                table[cell, 0, 6] += weight
                table[cell, 0, 7] += weight * r
                kinds[y, x, 0] = abs(r)
            if measured[y, x] > 0:
                gx, gy = 0.5 * (zr - zl), 0.5 * (zd - zu)
                tilt = math.sqrt(1 + (gx * fx / z) ** 2 + (gy * fy / z) ** 2)
                if tilt < 10:
                    r = (z - measured[y, x]) / tilt
                    for q in range(6):
                        J[q] = (az[q] - gx * au[q] - gy * av[q]) / tilt
                    weight = _add(H[part], g[part], J, r, s_depth, sums)
                    for q in range(6):
                        table[cell, 1, q] += weight * J[q]
                    table[cell, 1, 6] += weight
                    table[cell, 1, 7] += weight * r
                    kinds[y, x, 1] = abs(r)
    return count


@njit(nogil=True, cache=True)
def _add(H, g, J, r, sigma, sums):  # pragma: no cover
    """One residual under Cauchy's weight, which is returned."""
    e = r / (2 * sigma)
    weight = 1 / (sigma * sigma * (1 + e * e))
    for a in range(6):
        wj = weight * J[a]
        g[a] += wj * r
        for b in range(6):
            H[a, b] += wj * J[b]
    sums[0] += 4 * math.log1p(e * e)
    sums[1] += 1
    return weight
