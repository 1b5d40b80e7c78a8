"""The rasteriser on a CPU: tiles in parallel, Gaussians front to back within a tile, row by row of each one's ellipse.

A Gaussian's row of pixels is contiguous in memory, and each tile has its own buffer for a Gaussian's derivatives, so
that threads share nothing and the result does not depend on them. A loop over pixels, each with its list of Gaussians,
was five times slower.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

from freeart21.se3 import Array, Floats, Ints
from reconstruct.gaussians.rasteriser import (
    DENSEST,
    DILATION,
    FAINTEST,
    NEAR,
    OPAQUE,
    THIN,
    Backward,
    Lens,
    Picture,
    SplatGradients,
    Splats,
)
from reconstruct.kernels import run_in_threads

TILE = 32
"""Pixels, each way: 16 took a third longer, 64 leaves too few tiles for two threads in a small window."""
_LANES = 8
"""Pixels processed at a time, masked beyond the ellipse, so that the loop vectorises: most rows are one such stretch.
A tile's buffers are longer by one."""
_PIECES = 16
"""Stride with which tiles are dealt to threads: neighbours, of similar cost, go to different threads."""

_F = np.float32
_U = np.uint64
"""Unsigned index type: with a signed one, which may count from the end, the loop does not vectorise."""
_DENSEST, _OPAQUE, _DILATION, _THIN, _NEAR = _F(DENSEST), _F(OPAQUE), _F(DILATION), _F(THIN), _F(NEAR)

# record of a drawn Gaussian, in the order of depth
_X, _Y, _Q0, _Q1, _Q2, _OPACITY, _RED, _GREEN, _BLUE, _DEPTH, _MOVING, _REACH, _ACROSS, _DOWN, _FIELDS = range(15)
_SUMS = 12
"""Derivatives of a Gaussian in a tile: by mean (2), conic (3), depth and its slopes (3), colour (3), opacity."""


def rasterise(splats: Splats, Ts: Array, lens: Lens) -> tuple[Picture, Backward]:
    """See `rasteriser.Rasterise`."""
    m, (h, w) = len(splats), (lens.height, lens.width)
    poses = np.ascontiguousarray(Ts, np.float32)
    frame = (_F(lens.fx), _F(lens.fy), _F(lens.cx), _F(lens.cy), w, h)
    shape = (splats.means, splats.quaternions, splats.scales, splats.opacities, splats.colours, splats.motion)
    records, boxes = np.empty((m, _FIELDS), np.float32), np.empty((m, 4), np.int32)
    run_in_threads(lambda begin, end: _project(begin, end, *shape, poses, *frame, records, boxes), m, 500)
    drawn = np.flatnonzero(boxes[:, 0] < boxes[:, 1])
    order = _by_depth(drawn, records[drawn, _DEPTH])
    records, boxes = records[order], boxes[order]
    across, down = -(-w // TILE), -(-h // TILE)
    starts, entries = _bin(boxes, across, down)
    tiles = np.concatenate([np.arange(k, across * down, _PIECES) for k in range(_PIECES)])
    colour, depth = np.zeros((h, w, 3), np.float32), np.zeros((h, w), np.float32)
    left, moving = np.ones((h, w), np.float32), np.zeros((h, w), np.float32)
    pictures = (colour, depth, left, moving)
    run_in_threads(lambda a, b: _blend(tiles[a:b], across, starts, entries, records, boxes, *pictures), len(tiles), 2)
    alpha = 1 - left

    def pull(d_colour: Floats, d_depth: Floats, d_alpha: Floats) -> SplatGradients:
        given = [np.ascontiguousarray(d, np.float32) for d in (d_colour, d_depth, d_alpha)]
        buffer = np.zeros((len(entries), _SUMS), np.float32)
        arguments = (starts, entries, records, boxes, colour, depth, left, given[0], given[1], given[2], buffer)
        run_in_threads(lambda a, b: _blend_back(tiles[a:b], across, *arguments), len(tiles), 2)
        flat = np.zeros((len(order), _SUMS), np.float32)
        _gather(entries, buffer, flat)
        means, quaternions, scales = (np.zeros((m, k), np.float32) for k in (3, 4, 3))
        twists = np.zeros((len(order), 6))
        back = (order, records, flat, *shape[:3], splats.motion, poses, *frame[:4], means, quaternions, scales, twists)
        run_in_threads(lambda a, b: _project_back(a, b, *back), len(order), 500)
        opacities, colours = np.zeros(m, np.float32), np.zeros((m, 3), np.float32)
        screen, shown = np.zeros(m, np.float32), np.zeros(m, bool)
        opacities[order], colours[order], shown[order] = flat[:, 11], flat[:, 8:11], True
        screen[order] = np.hypot(flat[:, 0], flat[:, 1])
        second = splats.motion[order] == 1
        both = np.stack([twists[~second].sum(0), twists[second].sum(0)])
        return SplatGradients(means, quaternions, scales, opacities, colours, both, screen, shown)

    return Picture(colour, depth, alpha, moving), pull


def _by_depth(numbers: NDArray[np.int64], depths: Floats) -> NDArray[np.int64]:
    """`numbers` (n,), which are sorted, ordered by their positive depths; ties by number.

    The bits of positive floats sort like the floats; sorting packed keys takes an eighth of a stable argsort.
    """
    keys = depths.view(np.uint32).astype(np.uint64) << np.uint64(32) | np.arange(len(numbers), dtype=np.uint64)
    keys.sort()
    return numbers[(keys & np.uint64(0xFFFFFFFF)).astype(np.int64)]


@njit(nogil=True, cache=True, error_model="numpy", fastmath=True)
def _matrix(q: Floats, R: Floats) -> np.float32:  # pragma: no cover
    """Fill R with the rotation of a quaternion, wxyz, of any length; returns one over its length."""
    n = _F(1) / math.sqrt(q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3])
    w, x, y, z = q[0] * n, q[1] * n, q[2] * n, q[3] * n
    two, one = _F(2), _F(1)
    R[0, 0], R[0, 1], R[0, 2] = one - two * (y * y + z * z), two * (x * y - w * z), two * (x * z + w * y)
    R[1, 0], R[1, 1], R[1, 2] = two * (x * y + w * z), one - two * (x * x + z * z), two * (y * z - w * x)
    R[2, 0], R[2, 1], R[2, 2] = two * (x * z - w * y), two * (y * z + w * x), one - two * (x * x + y * y)
    return n


@njit(nogil=True, cache=True, error_model="numpy", fastmath=True)
def _project(
    begin: int, end: int, means: Floats, quaternions: Floats, scales: Floats, opacities: Floats, colours: Floats,
    motion: NDArray[np.uint8], poses: Floats, fx: np.float32, fy: np.float32, cx: np.float32, cy: np.float32,
    width: int, height: int, records: Floats, boxes: NDArray[np.int32],
) -> None:  # pragma: no cover  # fmt: skip
    """Records of the Gaussians begin to end, and the bounding boxes (x0, x1, y0, y1; ends excluded) of their ellipses.

    The image covariance is that of the projection linearised at the mean (EWA: Zwicker et al. 2001).
    """
    R = np.empty((3, 3), np.float32)
    for g in range(begin, end):
        boxes[g, 0], boxes[g, 1], boxes[g, 2], boxes[g, 3] = 0, 0, 0, 0
        E = poses[motion[g]]
        m0, m1, m2 = means[g, 0], means[g, 1], means[g, 2]
        z = E[2, 0] * m0 + E[2, 1] * m1 + E[2, 2] * m2 + E[2, 3]
        o = opacities[g]
        if z < _NEAR or o <= _F(FAINTEST):
            continue
        x = E[0, 0] * m0 + E[0, 1] * m1 + E[0, 2] * m2 + E[0, 3]
        y = E[1, 0] * m0 + E[1, 1] * m1 + E[1, 2] * m2 + E[1, 3]
        iz = _F(1) / z
        u, v = fx * x * iz + cx, fy * y * iz + cy
        _matrix(quaternions[g], R)
        j00, j02, j11, j12 = fx * iz, -fx * x * iz * iz, fy * iz, -fy * y * iz * iz
        a = b = c = with_u = with_v = _F(0)
        for k in range(3):
            s = scales[g, k]
            e0 = E[0, 0] * R[0, k] + E[0, 1] * R[1, k] + E[0, 2] * R[2, k]
            e1 = E[1, 0] * R[0, k] + E[1, 1] * R[1, k] + E[1, 2] * R[2, k]
            e2 = E[2, 0] * R[0, k] + E[2, 1] * R[1, k] + E[2, 2] * R[2, k]
            p, q = (j00 * e0 + j02 * e2) * s, (j11 * e1 + j12 * e2) * s
            a += p * p
            b += p * q
            c += q * q
            with_u += p * e2 * s
            with_v += q * e2 * s
        thin = (a + _THIN) * (c + _THIN) - b * b
        across, down = ((c + _THIN) * with_u - b * with_v) / thin, ((a + _THIN) * with_v - b * with_u) / thin
        a += _DILATION
        c += _DILATION
        det = a * c - b * b
        if not det > _F(0):
            continue
        reach = _F(2) * math.log(o / _F(FAINTEST))
        rx, ry = math.sqrt(reach * a), math.sqrt(reach * c)
        half = _F(0.5)
        if not (u + rx > _F(0) and v + ry > _F(0) and u - rx < _F(width) and v - ry < _F(height)):
            continue
        x0, x1 = max(0, math.ceil(u - rx - half)), min(width, math.floor(u + rx - half) + 1)
        y0, y1 = max(0, math.ceil(v - ry - half)), min(height, math.floor(v + ry - half) + 1)
        if x0 >= x1 or y0 >= y1:
            continue
        boxes[g, 0], boxes[g, 1], boxes[g, 2], boxes[g, 3] = x0, x1, y0, y1
        r = records[g]
        r[_X], r[_Y], r[_Q0], r[_Q1], r[_Q2] = u, v, c / det, -b / det, a / det
        r[_OPACITY], r[_DEPTH], r[_MOVING], r[_REACH] = o, z, _F(motion[g]), reach
        r[_RED], r[_GREEN], r[_BLUE] = colours[g, 0], colours[g, 1], colours[g, 2]
        r[_ACROSS], r[_DOWN] = across, down


@njit(nogil=True, cache=True)
def _bin(boxes: NDArray[np.int32], across: int, down: int) -> tuple[Ints, Ints]:  # pragma: no cover
    """(tiles + 1,) start of each tile's entries, and (entries,) record numbers, front to back."""
    counts = np.zeros(across * down + 1, np.int64)
    for g in range(boxes.shape[0]):
        for ty in range(boxes[g, 2] // TILE, (boxes[g, 3] - 1) // TILE + 1):
            for tx in range(boxes[g, 0] // TILE, (boxes[g, 1] - 1) // TILE + 1):
                counts[ty * across + tx + 1] += 1
    starts = np.cumsum(counts)
    at = starts.copy()
    entries = np.empty(starts[-1], np.int32)
    for g in range(boxes.shape[0]):
        for ty in range(boxes[g, 2] // TILE, (boxes[g, 3] - 1) // TILE + 1):
            for tx in range(boxes[g, 0] // TILE, (boxes[g, 1] - 1) // TILE + 1):
                t = ty * across + tx
                entries[at[t]] = g
                at[t] += 1
    return starts, entries


@njit(nogil=True, cache=True, error_model="numpy", fastmath=True, inline="always")
def _exp(x: np.float32) -> np.float32:  # pragma: no cover
    """exp(x) for x from -5.6 to 0, with relative error 2e-6; math.exp prevents vectorisation."""
    t = x * _F(0.125) + _F(0.35)
    p = _F(0.00590244011) * t + _F(0.0295423057)
    p = p * t + _F(0.117446174)
    p = p * t + _F(0.352335755)
    p = p * t + _F(0.704688118)
    p = p * t + _F(0.704688146)
    p = p * p
    p = p * p
    return p * p


@njit(nogil=True, cache=True, error_model="numpy", fastmath=True, inline="always")
def _span(r: Floats, y: int, left: int, right: int) -> tuple[int, int, float]:  # pragma: no cover
    """The pixels (begin, end) of row y within [left, right) in a record's ellipse, and the row's distance from its
    centre."""
    dy = _F(y) + _F(0.5) - r[_Y]
    mid = -r[_Q1] * dy / r[_Q0]
    half = mid * mid - (r[_Q2] * dy * dy - r[_REACH]) / r[_Q0]
    if half <= _F(0):
        return 0, 0, dy
    half = math.sqrt(half)
    at = r[_X] + mid - _F(0.5)
    return max(left, math.ceil(at - half)), min(right, math.floor(at + half) + 1), dy


# planes of a tile: transmittance, negative where the pixel is closed, and what is summed or given there
_T, _R, _G, _B, _D, _M, _BEHIND = 0, 1, 2, 3, 4, 5, 5


@njit(nogil=True, cache=True, error_model="numpy", fastmath=True)
def _blend(
    tiles: Ints, across: int, starts: Ints, entries: Ints, records: Floats, boxes: NDArray[np.int32],
    colour: Floats, depth: Floats, left: Floats, moving: Floats,
) -> None:  # pragma: no cover  # fmt: skip
    """Draw some tiles into the images, which are initially black and transparent."""
    height, width = left.shape
    S = np.empty((TILE, 6, TILE + _LANES), np.float32)
    for tile in tiles:
        if starts[tile] == starts[tile + 1]:
            continue
        bx, by = (tile % across) * TILE, (tile // across) * TILE
        ex, ey = min(bx + TILE, width), min(by + TILE, height)
        S[:] = _F(0)
        S[: ey - by, _T, : ex - bx] = _F(1)
        for number in range(starts[tile], starts[tile + 1]):
            if number % 256 == 255 and _closed(S):
                break
            g = entries[number]
            r = records[g]
            q0, q1, q2, o, mx = r[_Q0], r[_Q1], r[_Q2], r[_OPACITY], r[_X] - _F(bx) - _F(0.5)
            red, green, blue, second = r[_RED], r[_GREEN], r[_BLUE], r[_MOVING]
            depth_here, z_across, z_down = r[_DEPTH], r[_ACROSS], r[_DOWN]
            for y in range(max(by, boxes[g, 2]), min(ey, boxes[g, 3])):
                x0, x1, dy = _span(r, y, bx, ex)
                if x0 >= x1:
                    continue
                base, slope = _F(-0.5) * q2 * dy * dy, q1 * dy
                z_row = depth_here + z_down * dy
                ty, x0, x1 = _U(y - by), x0 - bx, x1 - bx
                for first in range(x0, x1, _LANES):
                    from_mean, end = _F(first) - mx, np.int32(x1 - first)
                    for lane in range(_U(_LANES)):
                        at, k = _U(first) + lane, np.int32(lane)
                        dx = from_mean + _F(k)
                        al = min(_DENSEST, o * _exp(max(_F(-5.6), min(_F(0), base - (_F(0.5) * q0 * dx + slope) * dx))))
                        al = al if k < end else _F(0)
                        T = S[ty, _T, at]
                        after = T * (_F(1) - al)
                        live = after > _OPAQUE
                        weight = al * T if live else _F(0)
                        S[ty, _T, at] = after if live else -abs(T)
                        S[ty, _R, at] += weight * red
                        S[ty, _G, at] += weight * green
                        S[ty, _B, at] += weight * blue
                        S[ty, _D, at] += weight * (z_row + z_across * dx)
                        S[ty, _M, at] += weight * second
        for y in range(by, ey):
            for x in range(bx, ex):
                here = S[y - by, :, x - bx]
                left[y, x], depth[y, x], moving[y, x] = abs(here[_T]), here[_D], here[_M]
                colour[y, x, 0], colour[y, x, 1], colour[y, x, 2] = here[_R], here[_G], here[_B]


@njit(nogil=True, cache=True)
def _closed(S: Floats) -> bool:  # pragma: no cover
    """Whether all pixels of a tile are opaque."""
    for y in range(TILE):
        for x in range(TILE):
            if S[y, _T, x] > 0:
                return False
    return True


@njit(nogil=True, cache=True, error_model="numpy", fastmath=True)
def _blend_back(
    tiles: Ints, across: int, starts: Ints, entries: Ints, records: Floats, boxes: NDArray[np.int32],
    colour: Floats, depth: Floats, left: Floats, d_colour: Floats, d_depth: Floats, d_alpha: Floats, buffer: Floats,
) -> None:  # pragma: no cover  # fmt: skip
    """Derivatives (`_SUMS`) of some tiles, one entry per row.

    Front to back again: what lies behind a Gaussian is the total minus what is in front of it and itself.
    """
    height, width = left.shape
    S = np.empty((TILE, 6, TILE + _LANES), np.float32)
    for tile in tiles:
        if starts[tile] == starts[tile + 1]:
            continue
        bx, by = (tile % across) * TILE, (tile // across) * TILE
        ex, ey = min(bx + TILE, width), min(by + TILE, height)
        S[:] = _F(0)
        S[: ey - by, _T, : ex - bx] = _F(1)
        for y in range(by, ey):
            for x in range(bx, ex):
                here = S[y - by, :, x - bx]
                here[_R], here[_G], here[_B] = d_colour[y, x, 0], d_colour[y, x, 1], d_colour[y, x, 2]
                here[_D] = d_depth[y, x]
                here[_BEHIND] = (
                    colour[y, x, 0] * here[_R]
                    + colour[y, x, 1] * here[_G]
                    + colour[y, x, 2] * here[_B]
                    + depth[y, x] * here[_D]
                    - left[y, x] * d_alpha[y, x]
                )
        for number in range(starts[tile], starts[tile + 1]):
            if number % 256 == 255 and _closed(S):
                break
            g = entries[number]
            r = records[g]
            q0, q1, q2, o, mx = r[_Q0], r[_Q1], r[_Q2], r[_OPACITY], r[_X] - _F(bx) - _F(0.5)
            red, green, blue = r[_RED], r[_GREEN], r[_BLUE]
            depth_here, z_across, z_down = r[_DEPTH], r[_ACROSS], r[_DOWN]
            by_red = by_green = by_blue = by_z = by_across = by_down = _F(0)
            s, sx, sy, sxx, sxy, syy = _F(0), _F(0), _F(0), _F(0), _F(0), _F(0)  # of the exponent's derivative
            for y in range(max(by, boxes[g, 2]), min(ey, boxes[g, 3])):
                x0, x1, dy = _span(r, y, bx, ex)
                if x0 >= x1:
                    continue
                base, slope = _F(-0.5) * q2 * dy * dy, q1 * dy
                z_row = depth_here + z_down * dy
                ty, x0, x1 = _U(y - by), x0 - bx, x1 - bx
                m0 = m1 = m2 = z0 = z1 = _F(0)
                for first in range(x0, x1, _LANES):
                    from_mean, end = _F(first) - mx, np.int32(x1 - first)
                    for lane in range(_U(_LANES)):
                        at, k = _U(first) + lane, np.int32(lane)
                        dx = from_mean + _F(k)
                        al = min(_DENSEST, o * _exp(max(_F(-5.6), min(_F(0), base - (_F(0.5) * q0 * dx + slope) * dx))))
                        al = al if k < end else _F(0)
                        T = S[ty, _T, at]
                        after = T * (_F(1) - al)
                        live = after > _OPAQUE
                        weight = al * T if live else _F(0)
                        S[ty, _T, at] = after if live else -abs(T)
                        d_red, d_green, d_blue, d_z = S[ty, _R, at], S[ty, _G, at], S[ty, _B, at], S[ty, _D, at]
                        by_red += weight * d_red
                        by_green += weight * d_green
                        by_blue += weight * d_blue
                        z0 += weight * d_z
                        z1 += weight * d_z * dx
                        value = red * d_red + green * d_green + blue * d_blue + (z_row + z_across * dx) * d_z
                        behind = S[ty, _BEHIND, at] - weight * value
                        S[ty, _BEHIND, at] = behind
                        d = al * (T * value - behind / (_F(1) - al)) if live & (al < _DENSEST) else _F(0)
                        m0 += d
                        m1 += d * dx
                        m2 += d * dx * dx
                s += m0
                sx += m1
                sy += m0 * dy
                sxx += m2
                sxy += m1 * dy
                syy += m0 * dy * dy
                by_z += z0
                by_across += z1
                by_down += z0 * dy
            row = buffer[number]
            row[0], row[1] = q0 * sx + q1 * sy, q2 * sy + q1 * sx
            row[2], row[3], row[4] = _F(-0.5) * sxx, -sxy, _F(-0.5) * syy
            row[5], row[6], row[7] = by_z, by_across, by_down
            row[8], row[9], row[10], row[11] = by_red, by_green, by_blue, s / o


@njit(nogil=True, cache=True)
def _gather(entries: Ints, buffer: Floats, flat: Floats) -> None:  # pragma: no cover
    """Sums of the entries of each record."""
    for number in range(entries.shape[0]):
        for k in range(_SUMS):
            flat[entries[number], k] += buffer[number, k]


@njit(nogil=True, cache=True, error_model="numpy", fastmath=True)
def _project_back(
    begin: int, end: int, order: Ints, records: Floats, flat: Floats, means: Floats, quaternions: Floats,
    scales: Floats, motion: NDArray[np.uint8], poses: Floats, fx: np.float32, fy: np.float32, cx: np.float32,
    cy: np.float32, d_means: Floats, d_quaternions: Floats, d_scales: Floats, twists: Array,
) -> None:  # pragma: no cover  # fmt: skip
    """Derivatives of the records begin to end, propagated back through the projection."""
    R, D, Q = np.empty((3, 3), np.float32), np.empty((3, 3), np.float32), np.empty(4, np.float32)
    e = np.empty(3, np.float32)
    for n in range(begin, end):
        g = order[n]
        E = poses[motion[g]]
        m0, m1, m2 = means[g, 0], means[g, 1], means[g, 2]
        x = E[0, 0] * m0 + E[0, 1] * m1 + E[0, 2] * m2 + E[0, 3]
        y = E[1, 0] * m0 + E[1, 1] * m1 + E[1, 2] * m2 + E[1, 3]
        z = records[n, _DEPTH]
        iz = _F(1) / z
        j00, j02, j11, j12 = fx * iz, -fx * x * iz * iz, fy * iz, -fy * y * iz * iz
        length = _matrix(quaternions[g], R)
        for k in range(4):
            Q[k] = quaternions[g, k] * length
        k0, k1, k2 = records[n, _Q0], records[n, _Q1], records[n, _Q2]
        d0, d1, d2 = flat[n, 2], _F(0.5) * flat[n, 3], flat[n, 4]
        p00, p01, p10, p11 = k0 * d0 + k1 * d1, k0 * d1 + k1 * d2, k1 * d0 + k2 * d1, k1 * d1 + k2 * d2
        da, db, dc = -(p00 * k0 + p01 * k1), -(p00 * k1 + p01 * k2), -(p10 * k1 + p11 * k2)  # by the covariance
        # the slopes are (covariance with THIN)^-1 (covariances of depth with the picture's axes)
        a = b = c = _F(0)
        for k in range(3):
            s = scales[g, k]
            for i in range(3):
                e[i] = E[i, 0] * R[0, k] + E[i, 1] * R[1, k] + E[i, 2] * R[2, k]
            p, q = (j00 * e[0] + j02 * e[2]) * s, (j11 * e[1] + j12 * e[2]) * s
            a += p * p
            b += p * q
            c += q * q
        a += _THIN
        c += _THIN
        thin, across, down = a * c - b * b, records[n, _ACROSS], records[n, _DOWN]
        by_u, by_v = (c * flat[n, 6] - b * flat[n, 7]) / thin, (a * flat[n, 7] - b * flat[n, 6]) / thin
        da -= by_u * across
        db -= _F(0.5) * (by_u * down + by_v * across)
        dc -= by_v * down
        dj00 = dj02 = dj11 = dj12 = _F(0)
        v0 = v1 = v2 = _F(0)  # torque of the covariance on the twist's rotation
        for k in range(3):
            s = scales[g, k]
            for i in range(3):
                e[i] = E[i, 0] * R[0, k] + E[i, 1] * R[1, k] + E[i, 2] * R[2, k]
            p, q = (j00 * e[0] + j02 * e[2]) * s, (j11 * e[1] + j12 * e[2]) * s
            t = e[2] * s
            dp, dq, dt = _F(2) * (da * p + db * q) + by_u * t, _F(2) * (db * p + dc * q) + by_v * t, by_u * p + by_v * q
            d_scales[g, k] = (dp * p + dq * q + dt * t) / s
            dj00 += dp * e[0] * s
            dj02 += dp * e[2] * s
            dj11 += dq * e[1] * s
            dj12 += dq * e[2] * s
            f0, f1, f2 = dp * j00 * s, dq * j11 * s, (dp * j02 + dq * j12 + dt) * s  # by e
            v0 += e[1] * f2 - e[2] * f1
            v1 += e[2] * f0 - e[0] * f2
            v2 += e[0] * f1 - e[1] * f0
            for i in range(3):
                D[i, k] = E[0, i] * f0 + E[1, i] * f1 + E[2, i] * f2
        du, dv = flat[n, 0] - flat[n, 5] * across, flat[n, 1] - flat[n, 5] * down
        dx = du * j00 - dj02 * fx * iz * iz
        dy = dv * j11 - dj12 * fy * iz * iz
        dz = (
            du * j02
            + dv * j12
            + flat[n, 5]
            - (dj00 * fx + dj11 * fy) * iz * iz
            + _F(2) * (dj02 * fx * x + dj12 * fy * y) * iz * iz * iz
        )
        for k in range(3):
            d_means[g, k] = E[0, k] * dx + E[1, k] * dy + E[2, k] * dz
        twists[n, 0], twists[n, 1], twists[n, 2] = dx, dy, dz
        twists[n, 3], twists[n, 4], twists[n, 5] = y * dz - z * dy + v0, z * dx - x * dz + v1, x * dy - y * dx + v2
        w, a, b, c = Q[0], Q[1], Q[2], Q[3]
        two = _F(2)
        h0 = two * (-c * D[0, 1] + b * D[0, 2] + c * D[1, 0] - a * D[1, 2] - b * D[2, 0] + a * D[2, 1])
        h1 = two * (
            b * D[0, 1] + c * D[0, 2] + b * D[1, 0] - two * a * D[1, 1] - w * D[1, 2] + c * D[2, 0] + w * D[2, 1]
            - two * a * D[2, 2]
        )  # fmt: skip
        h2 = two * (
            -two * b * D[0, 0] + a * D[0, 1] + w * D[0, 2] + a * D[1, 0] + c * D[1, 2] - w * D[2, 0] + c * D[2, 1]
            - two * b * D[2, 2]
        )  # fmt: skip
        h3 = two * (
            -two * c * D[0, 0] - w * D[0, 1] + a * D[0, 2] + w * D[1, 0] - two * c * D[1, 1] + b * D[1, 2]
            + a * D[2, 0] + b * D[2, 1]
        )  # fmt: skip
        along = h0 * w + h1 * a + h2 * b + h3 * c
        d_quaternions[g, 0] = (h0 - along * w) * length
        d_quaternions[g, 1] = (h1 - along * a) * length
        d_quaternions[g, 2] = (h2 - along * b) * length
        d_quaternions[g, 3] = (h3 - along * c) * length
