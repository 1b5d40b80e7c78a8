"""Compiled loops: registration of pixels between frames, costs of pixels under motions, smoothing of labels.

All use the arrays of a `Scene`, and poses `T` that take camera-frame points of a source frame to a target frame.
"""

from __future__ import annotations

import math
import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from itertools import pairwise
from typing import TypeVar

import numpy as np
from numba import njit
from numpy.typing import NDArray

from freeart21.se3 import Array, Bools, Floats, Ints

T = TypeVar("T")

NEAR = 1e-6
"""Metres: points nearer to the camera are skipped."""

POINT, DEPTH, NORMAL, FEATURE, OUTSIDE = 0, 2, 3, 6, 9
"""Offsets of a pixel record's fields; see `Scene.pixels`. A point's depth is its third coordinate."""

BLOCK = 32
"""Samples that are projected before any of them is compared, so that memory is fetched for many at once."""
EDGE_ON = 0.1
"""Cosine between normal and view below which a surface counts as seen edge-on."""
HIDDEN = 0.8
"""Cost of a hidden pixel; see `pixel_costs`."""

STEPS = (1, 3, 6)
"""Pixels, down and right, to a pixel's neighbours in the graph of similar ones; see `neighbours`."""
BORDER = STEPS[-1]
"""Zeros round a padded image, so that every neighbour lies in it."""

_NO_ROWS = (0.0,) * 9

_THREADS = min(8, len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1)
_POOL, _FRAMES_POOL = ThreadPoolExecutor(_THREADS), ThreadPoolExecutor(_THREADS)


def run_in_threads(work: Callable[[int, int], object], n: int, worth: int) -> None:
    """Call `work(begin, end)` on pieces of range(n), in threads when n is at least `worth`.

    Pieces write to separate places, so the result does not depend on the number of threads. Kernels release the
    interpreter lock; small work stays in this thread, where it is faster.
    """
    if n < worth or _THREADS == 1:
        work(0, n)
        return
    bounds = np.linspace(0, n, 2 * _THREADS + 1).astype(int)
    for done in [_POOL.submit(work, int(a), int(b)) for a, b in pairwise(bounds)]:
        done.result()


def map_in_threads(work: Callable[[int], T], n: int) -> list[T]:
    """`work(i)` for all i in range(n), in threads; it may call `run_in_threads`, but not this."""
    return list(_FRAMES_POOL.map(work, range(n)))


@njit(nogil=True, cache=True, error_model="numpy", fastmath={"contract"})
def register_pairs(
    begin: int, end: int, source: Ints, target: Ints, T: Array, samples: Floats, offsets: Ints, pixels: Floats, h: int,
    w: int, labels: NDArray[np.uint8], part: int, fx: float, fy: float, cx: Array, cy: Array, gate: float, sigma: float,
    sigma_colour: float, colour_weight: float, sigma_silhouette: float, H: Array, g: Array, stats: Array,
) -> None:  # pragma: no cover  # fmt: skip
    """Gauss-Newton terms of the frame pairs begin to end for the left twist (v, w) of T[p] = T_target_source.

    `samples[offsets[i]:offsets[i + 1]]` are the records of pixels of frame i. With `part` > 0 a sample is not matched
    to target pixels labelled as the other part (label 0 matches either). Terms per sample: point-to-plane by projective
    association with Tukey's weight; colour along its gradient; and the distance to the mask for samples outside it that
    are not hidden by anything measured there. Fills H (p, 6, 6), g (p, 6) and stats (p, 4): inliers, projected, cost,
    outside.
    """
    places, numbers = np.empty((BLOCK, 6)), np.empty((BLOCK, 2), np.int64)
    for p in range(begin, end):
        i, j = source[p], target[p]
        R00, R01, R02, t0 = T[p, 0, 0], T[p, 0, 1], T[p, 0, 2], T[p, 0, 3]
        R10, R11, R12, t1 = T[p, 1, 0], T[p, 1, 1], T[p, 1, 2], T[p, 1, 3]
        R20, R21, R22, t2 = T[p, 2, 0], T[p, 2, 1], T[p, 2, 2], T[p, 2, 3]
        A, b = np.zeros((6, 6)), np.zeros(6)
        inliers, projected, out, cost = 0, 0, 0, 0.0
        for first in range(offsets[i], offsets[i + 1], BLOCK):
            met = 0
            for s in range(first, min(first + BLOCK, offsets[i + 1])):
                a0, a1, a2 = samples[s, POINT], samples[s, POINT + 1], samples[s, POINT + 2]
                Y0 = R00 * a0 + R01 * a1 + R02 * a2 + t0
                Y1 = R10 * a0 + R11 * a1 + R12 * a2 + t1
                Y2 = R20 * a0 + R21 * a1 + R22 * a2 + t2
                if Y2 < NEAR:
                    continue
                u, v = fx / Y2 * Y0 + cx[j], fy / Y2 * Y1 + cy[j]
                xi, yi = math.floor(u + 0.5), math.floor(v + 0.5)
                if xi < 2 or yi < 2 or xi >= w - 2 or yi >= h - 2:
                    continue
                at = (j * h + yi) * w + xi
                rim = pixels[at - 1, OUTSIDE] + pixels[at + 1, OUTSIDE]
                rim += pixels[at - w, OUTSIDE] + pixels[at + w, OUTSIDE]
                places[met, 0] = Y0
                places[met, 1] = Y1
                places[met, 2] = Y2
                places[met, 3] = u
                places[met, 4] = v
                places[met, 5] = rim
                numbers[met, 0], numbers[met, 1] = s, at
                met += 1
            projected += met
            for m in range(met):
                Y0, Y1, Y2 = places[m, 0], places[m, 1], places[m, 2]
                u, v, rim = places[m, 3], places[m, 4], places[m, 5]
                s, at = numbers[m, 0], numbers[m, 1]
                ex, ey = fx / Y2, fy / Y2  # pixels per metre
                if pixels[at, OUTSIDE] > 0.5:
                    r = pixels[at, OUTSIDE]
                    if -pixels[at, DEPTH] - gate < Y2 and pixels[at, DEPTH] < 0:
                        continue  # behind a hand
                    out += 1
                    weight = 1.0 / (sigma_silhouette * sigma_silhouette)
                    if r > 3.0 * sigma_silhouette:
                        weight *= 3.0 * sigma_silhouette / r
                    gx = 0.5 * ex * (pixels[at + 1, OUTSIDE] - pixels[at - 1, OUTSIDE])
                    gy = 0.5 * ey * (pixels[at + w, OUTSIDE] - pixels[at - w, OUTSIDE])
                    N = _add_row(_NO_ROWS, gx, gy, -(gx * Y0 + gy * Y1) / Y2, r, weight)
                    _add_point(A, b, N, Y0, Y1, Y2)
                    cost += 0.5 * weight * r * r
                    continue
                if pixels[at, DEPTH] <= 0 or (part > 0 and labels[at] == 3 - part):
                    continue
                m0, m1, m2 = samples[s, NORMAL], samples[s, NORMAL + 1], samples[s, NORMAL + 2]
                M0 = R00 * m0 + R01 * m1 + R02 * m2
                M1 = R10 * m0 + R11 * m1 + R12 * m2
                M2 = R20 * m0 + R21 * m1 + R22 * m2
                facing = -(M0 * Y0 + M1 * Y1 + M2 * Y2)
                if facing < 0.15 * math.sqrt(Y0 * Y0 + Y1 * Y1 + Y2 * Y2):
                    continue
                n0, n1, n2 = pixels[at, NORMAL], pixels[at, NORMAL + 1], pixels[at, NORMAL + 2]
                if n0 * M0 + n1 * M1 + n2 * M2 < 0.7:
                    continue
                r = n0 * (Y0 - pixels[at, POINT]) + n1 * (Y1 - pixels[at, POINT + 1]) + n2 * (Y2 - pixels[at, DEPTH])
                if abs(r) > gate:
                    continue
                tukey = 1 - (r / gate) ** 2
                weight = tukey * tukey / (sigma * sigma)
                N = _add_row(_NO_ROWS, n0, n1, n2, r, weight)
                inliers += 1
                cost += 0.5 * weight * r * r
                if colour_weight <= 0 or rim > 0:
                    _add_point(A, b, N, Y0, Y1, Y2)
                    continue
                x0, y0 = math.floor(u), math.floor(v)
                fu, fv = u - x0, v - y0
                corner = (j * h + y0) * w + x0
                for c in range(FEATURE, FEATURE + 3):
                    gx = 0.5 * (pixels[at + 1, c] - pixels[at - 1, c])
                    gy = 0.5 * (pixels[at + w, c] - pixels[at - w, c])
                    if gx * gx + gy * gy < 0.04:
                        continue
                    value = (1 - fv) * ((1 - fu) * pixels[corner, c] + fu * pixels[corner + 1, c])
                    value += fv * ((1 - fu) * pixels[corner + w, c] + fu * pixels[corner + w + 1, c])
                    r = value - samples[s, c]
                    if abs(r) > 4 * sigma_colour:
                        continue
                    tukey = 1 - (r / (4 * sigma_colour)) ** 2
                    weight = colour_weight * tukey * tukey / (sigma_colour * sigma_colour)
                    gx, gy = ex * gx, ey * gy
                    N = _add_row(N, gx, gy, -(gx * Y0 + gy * Y1) / Y2, r, weight)
                    cost += 0.5 * weight * r * r
                _add_point(A, b, N, Y0, Y1, Y2)
        for q in range(6):
            g[p, q] = b[q]
            for q2 in range(6):
                H[p, q, q2] = A[min(q, q2), max(q, q2)]
        stats[p, 0], stats[p, 1], stats[p, 2], stats[p, 3] = inliers, projected, cost, out


@njit(inline="always")
def _add_row(
    N: tuple[float, ...], n0: float, n1: float, n2: float, r: float, weight: float,
) -> tuple[float, ...]:  # pragma: no cover  # fmt: skip
    """The sums N = weight n n^T (upper triangle) and weight r n of rows n, as one tuple of nine."""
    w0, w1, w2 = weight * n0, weight * n1, weight * n2
    return (
        N[0] + w0 * n0,
        N[1] + w0 * n1,
        N[2] + w0 * n2,
        N[3] + w1 * n1,
        N[4] + w1 * n2,
        N[5] + w2 * n2,
        N[6] + w0 * r,
        N[7] + w1 * r,
        N[8] + w2 * r,
    )


@njit(inline="always")
def _add_point(A: Array, b: Array, N: tuple[float, ...], Y0: float, Y1: float, Y2: float) -> None:  # pragma: no cover
    """Add all rows n of one point Y to A and b.

    By the left twist (v, w) a row is (n, Y x n), so with K = hat(Y) their sum is [[N, N K^T], [K N, K N K^T]].
    """
    n00, n01, n02, n11, n12, n22, m0, m1, m2 = N
    A[0, 0] += n00
    A[0, 1] += n01
    A[0, 2] += n02
    A[1, 1] += n11
    A[1, 2] += n12
    A[2, 2] += n22
    k00, k01, k02 = Y1 * n02 - Y2 * n01, Y1 * n12 - Y2 * n11, Y1 * n22 - Y2 * n12
    k10, k11, k12 = Y2 * n00 - Y0 * n02, Y2 * n01 - Y0 * n12, Y2 * n02 - Y0 * n22
    k20, k21, k22 = Y0 * n01 - Y1 * n00, Y0 * n11 - Y1 * n01, Y0 * n12 - Y1 * n02
    A[0, 3] += k00
    A[1, 3] += k01
    A[2, 3] += k02
    A[0, 4] += k10
    A[1, 4] += k11
    A[2, 4] += k12
    A[0, 5] += k20
    A[1, 5] += k21
    A[2, 5] += k22
    A[3, 3] += Y1 * k02 - Y2 * k01
    A[3, 4] += Y2 * k00 - Y0 * k02
    A[3, 5] += Y0 * k01 - Y1 * k00
    A[4, 4] += Y2 * k10 - Y0 * k12
    A[4, 5] += Y0 * k11 - Y1 * k10
    A[5, 5] += Y0 * k21 - Y1 * k20
    b[0] += m0
    b[1] += m1
    b[2] += m2
    b[3] += Y1 * m2 - Y2 * m1
    b[4] += Y2 * m0 - Y0 * m2
    b[5] += Y0 * m1 - Y1 * m0


@njit(nogil=True, cache=True, error_model="numpy", fastmath={"contract"})
def pixel_costs(
    begin: int, end: int, frame: int, others: Ints, T: Array, places: Ints, pixels: Floats, h: int, w: int,
    logodds: Floats, label_weight: float, fx: float, fy: float, cx: Array, cy: Array, sigma: float, sigma_colour: float,
    cap: float, costs: Array,
) -> None:  # pragma: no cover  # fmt: skip
    """Costs of the pixels `places` begin to end (p, 2: row, column) of `frame` under motions T (s, k, 4, 4) to
    `others`.

    - Outside the mask: the distance to it.
    - In front of the surface there: violated free space; except for a surface seen edge-on, whose depth is uncertain.
    - Behind the surface, or behind something else: hidden, a constant.
    - On the surface: point-to-plane, normal and colour differences, and `label_weight` times the disagreement of the
      motion k (0 reference, 1 moving) with the other frame's `logodds` (> 0: moving).

    Fills costs (p, s, k).
    """
    for s in range(others.shape[0]):
        j = others[s]
        for k in range(T.shape[1]):
            R = T[s, k]
            for p in range(begin, end):
                here = (frame * h + places[p, 0]) * w + places[p, 1]
                a0, a1, a2 = pixels[here, POINT], pixels[here, POINT + 1], pixels[here, DEPTH]
                m0, m1, m2 = pixels[here, NORMAL], pixels[here, NORMAL + 1], pixels[here, NORMAL + 2]
                costs[p, s, k] = cap
                Y0 = R[0, 0] * a0 + R[0, 1] * a1 + R[0, 2] * a2 + R[0, 3]
                Y1 = R[1, 0] * a0 + R[1, 1] * a1 + R[1, 2] * a2 + R[1, 3]
                Y2 = R[2, 0] * a0 + R[2, 1] * a1 + R[2, 2] * a2 + R[2, 3]
                if Y2 < NEAR:
                    continue
                xi = math.floor(fx * Y0 / Y2 + cx[j] + 0.5)
                yi = math.floor(fy * Y1 / Y2 + cy[j] + 0.5)
                if xi < 0 or yi < 0 or xi >= w or yi >= h:
                    continue
                at = (j * h + yi) * w + xi
                z = pixels[at, DEPTH]
                if z <= 0:
                    costs[p, s, k] = min(cap, 0.7 * max(pixels[at, OUTSIDE] - 0.5, 0.0))
                    if z < 0 and -z - 3 * sigma < Y2:  # behind a hand
                        costs[p, s, k] = min(costs[p, s, k], HIDDEN)
                    continue
                M0 = R[0, 0] * m0 + R[0, 1] * m1 + R[0, 2] * m2
                M1 = R[1, 0] * m0 + R[1, 1] * m1 + R[1, 2] * m2
                M2 = R[2, 0] * m0 + R[2, 1] * m1 + R[2, 2] * m2
                n0, n1, n2 = pixels[at, NORMAL], pixels[at, NORMAL + 1], pixels[at, NORMAL + 2]
                r = n0 * (Y0 - pixels[at, POINT]) + n1 * (Y1 - pixels[at, POINT + 1]) + n2 * (Y2 - z)
                facing = -(M0 * Y0 + M1 * Y1 + M2 * Y2) / math.sqrt(Y0 * Y0 + Y1 * Y1 + Y2 * Y2)
                if facing < EDGE_ON:
                    behind = (Y2 - z) / sigma
                    costs[p, s, k] = 0.5 if behind > -3 or facing > -EDGE_ON else min(cap, 0.5 * behind * behind)
                    continue
                if z + 6 * sigma < Y2 and r < -3 * sigma:
                    costs[p, s, k] = HIDDEN
                    continue
                same = n0 * M0 + n1 * M1 + n2 * M2
                shape = min(0.6 * cap, 0.5 * (r / sigma) ** 2 + 2.0 * max(0.0, 0.8 - same))
                difference = 0.0
                for c in range(FEATURE, FEATURE + 3):
                    d = pixels[at, c] - pixels[here, c]
                    difference += d * d
                cost = shape + min(0.2 * cap, 0.25 * difference / (sigma_colour * sigma_colour))
                if label_weight > 0 and shape < 2.0:
                    against = -logodds[at] if k == 1 else logodds[at]
                    cost += label_weight * min(max(against, 0.0), 3.0)
                if z + 1.2 * sigma < Y2 and r < -0.8 * sigma:  # possibly hidden by a surface just in front
                    cost = min(cost, HIDDEN)
                costs[p, s, k] = cost


@njit(nogil=True, cache=True, error_model="numpy", fastmath={"contract"})
def neighbours(
    valid: Bools, points: Floats, normals: Floats, features: Floats, reach: float, flatness: float,
) -> Floats:  # pragma: no cover  # fmt: skip
    """Weights (6, h, w) of the edges from each pixel to similar ones 1 step down and right, then 3, then 6 steps.

    A weight in [0, 1] falls with distance (relative to `reach`), bend, distance from the common plane (relative to
    `flatness`) and colour difference, and halves with each longer step. Colours of direct neighbours are compared one
    pixel further out, since image edges are some pixels wide. 0 where either pixel is not `valid` (h, w) or the weight
    is below a threshold.
    """
    h, w = valid.shape
    weights = np.zeros((6, h, w), np.float32)
    for y in range(h):
        for x in range(w):
            if not valid[y, x]:
                continue
            for q in range(6):
                step = STEPS[q // 2]
                yy, xx = (y + step, x) if q % 2 == 0 else (y, x + step)
                if yy >= h or xx >= w or not valid[yy, xx]:
                    continue
                ya, xa, yb, xb = y, x, yy, xx
                if step == 1:
                    ya, xa, yb, xb = 2 * y - yy, 2 * x - xx, 2 * yy - y, 2 * xx - x
                    if ya < 0 or xa < 0 or not valid[ya, xa]:
                        ya, xa = y, x
                    if yb >= h or xb >= w or not valid[yb, xb]:
                        yb, xb = yy, xx
                distance = bend = colour = 0.0
                off = off2 = 0.0
                for c in range(3):
                    d = points[yy, xx, c] - points[y, x, c]
                    distance += d * d
                    bend += normals[y, x, c] * normals[yy, xx, c]
                    off += normals[y, x, c] * d
                    off2 += normals[yy, xx, c] * d
                    e = features[yb, xb, c] - features[ya, xa, c]
                    colour += e * e
                off = max(abs(off), abs(off2)) / flatness
                exponent = distance / (reach * reach) + (1 - bend) / 0.35 + colour / 120.0 + off * off
                if exponent < 4.0:
                    weights[q, y, x] = math.exp(-exponent) / (1 << q // 2)
    return weights


@njit(nogil=True, cache=True)
def padded(image: Array) -> Array:  # pragma: no cover
    """An image (h, w) with BORDER zeros on each side, row after row (m,)."""
    h, w = image.shape
    wide = np.zeros((h + 2 * BORDER, w + 2 * BORDER))
    wide[BORDER : BORDER + h, BORDER : BORDER + w] = image
    return wide.reshape(-1)


@njit(nogil=True, cache=True)
def padded_weights(weights: Floats) -> Floats:  # pragma: no cover
    """The weights (6, h, w) of `neighbours` as `add_neighbours` reads them (6, m)."""
    _, h, w = weights.shape
    wide = np.zeros((6, h + 2 * BORDER, w + 2 * BORDER), np.float32)
    wide[:, BORDER : BORDER + h, BORDER : BORDER + w] = weights
    return wide.reshape(6, -1)


@njit(nogil=True, cache=True)
def add_neighbours(sums: Array, values: Array, weights: Floats, width: int, sign: float) -> None:  # pragma: no cover
    """Add to `sums` (m,) the sum of each pixel's neighbours' `values` (m,) times `weights` (6, m), times `sign`.

    All are padded images, `width` wide without the padding. One loop over contiguous memory a direction: that of a
    sparse matrix took ten times as long.
    """
    row = width + 2 * BORDER
    first, count = BORDER * row, len(sums) - 2 * BORDER * row
    here = sums[first : first + count]
    for q in range(6):
        step = STEPS[q // 2] * (row if q % 2 == 0 else 1)
        ahead, behind = values[first + step : first + step + count], values[first - step : first - step + count]
        to, back = weights[q, first : first + count], weights[q, first - step : first - step + count]
        for i in range(count):
            here[i] = (here[i] + sign * (to[i] * ahead[i])) + sign * (back[i] * behind[i])


@njit(nogil=True, cache=True)
def relax(unary: Array, valid: Bools, weights: Floats, smoothness: float, rounds: int) -> Array:  # pragma: no cover
    """Mean-field log-odds (h, w) of the `valid` pixels: `unary` (h, w) plus `smoothness` times the beliefs of the
    neighbours by `weights` (6, h, w), `rounds` iterations."""
    h, w = unary.shape
    inside, own, edges = np.flatnonzero(padded(valid.astype(np.float64))), padded(unary), padded_weights(weights)
    current, belief, pull = own.copy(), np.zeros(len(own)), np.zeros(len(own))
    for _ in range(rounds):
        for p in inside:
            belief[p] = 1 - 2 / (1 + math.exp(current[p]))  # tanh(current / 2)
        pull[:] = 0
        add_neighbours(pull, belief, edges, w, 1.0)
        for p in inside:
            current[p] = own[p] + smoothness * pull[p]
    return current.reshape(h + 2 * BORDER, w + 2 * BORDER)[BORDER : BORDER + h, BORDER : BORDER + w]
