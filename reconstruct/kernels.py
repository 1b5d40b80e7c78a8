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

EDGE_ON = 0.1
"""Cosine between normal and view below which a surface counts as seen edge-on."""
HIDDEN = 0.8
"""Cost of a hidden pixel; see `pixel_costs`."""

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
    for p in range(begin, end):
        i, j = source[p], target[p]
        R00, R01, R02, t0 = T[p, 0, 0], T[p, 0, 1], T[p, 0, 2], T[p, 0, 3]
        R10, R11, R12, t1 = T[p, 1, 0], T[p, 1, 1], T[p, 1, 2], T[p, 1, 3]
        R20, R21, R22, t2 = T[p, 2, 0], T[p, 2, 1], T[p, 2, 2], T[p, 2, 3]
        A, b = np.zeros((6, 6)), np.zeros(6)
        inliers, projected, out, cost = 0, 0, 0, 0.0
        for s in range(offsets[i], offsets[i + 1]):
            a0, a1, a2 = samples[s, POINT], samples[s, POINT + 1], samples[s, POINT + 2]
            Y0 = R00 * a0 + R01 * a1 + R02 * a2 + t0
            Y1 = R10 * a0 + R11 * a1 + R12 * a2 + t1
            Y2 = R20 * a0 + R21 * a1 + R22 * a2 + t2
            if Y2 < NEAR:
                continue
            ex, ey = fx / Y2, fy / Y2  # pixels per metre
            u, v = ex * Y0 + cx[j], ey * Y1 + cy[j]
            xi, yi = math.floor(u + 0.5), math.floor(v + 0.5)
            if xi < 2 or yi < 2 or xi >= w - 2 or yi >= h - 2:
                continue
            projected += 1
            at = (j * h + yi) * w + xi
            r = pixels[at, OUTSIDE]
            if r > 0.5:
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
            rim = pixels[at - 1, OUTSIDE] + pixels[at + 1, OUTSIDE]
            rim += pixels[at - w, OUTSIDE] + pixels[at + w, OUTSIDE]
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
    for p in range(begin, end):
        here = (frame * h + places[p, 0]) * w + places[p, 1]
        a0, a1, a2 = pixels[here, POINT], pixels[here, POINT + 1], pixels[here, DEPTH]
        m0, m1, m2 = pixels[here, NORMAL], pixels[here, NORMAL + 1], pixels[here, NORMAL + 2]
        for s in range(others.shape[0]):
            j = others[s]
            for k in range(T.shape[1]):
                R = T[s, k]
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
) -> tuple[Ints, NDArray[np.int32], Floats]:  # pragma: no cover  # fmt: skip
    """Graph of similar neighbours in one frame, as compressed rows over the valid pixels in reading order.

    Neighbours stand 1, 3 and 6 steps up, down, right and left. An edge's weight in [0, 1] falls with distance (relative
    to `reach`), bend, distance from the common plane (relative to `flatness`) and colour difference, and halves with
    each longer step. Colours of direct neighbours are compared one pixel further out, since image edges are some pixels
    wide. Returns starts (p + 1,), ends and weights of the edges above a threshold.
    """
    h, w = valid.shape
    number = np.full((h, w), -1, np.int32)
    count = 0
    for y in range(h):
        for x in range(w):
            if valid[y, x]:
                number[y, x] = count
                count += 1
    starts = np.zeros(count + 1, np.int64)
    ends = np.zeros(12 * count, np.int32)
    weights = np.zeros(12 * count, np.float32)
    edges = 0
    for y in range(h):
        for x in range(w):
            if number[y, x] < 0:
                continue
            for q in range(12):
                step = 1 if q < 4 else (3 if q < 8 else 6)
                side = q % 4
                yy = y + (step if side == 0 else (-step if side == 1 else 0))
                xx = x + (step if side == 2 else (-step if side == 3 else 0))
                if yy < 0 or xx < 0 or yy >= h or xx >= w or number[yy, xx] < 0:
                    continue
                ya, xa, yb, xb = y, x, yy, xx
                if step == 1:
                    ya, xa, yb, xb = 2 * y - yy, 2 * x - xx, 2 * yy - y, 2 * xx - x
                    if ya < 0 or xa < 0 or ya >= h or xa >= w or number[ya, xa] < 0:
                        ya, xa = y, x
                    if yb < 0 or xb < 0 or yb >= h or xb >= w or number[yb, xb] < 0:
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
                    ends[edges] = number[yy, xx]
                    weights[edges] = math.exp(-exponent) / (1 if q < 4 else (2 if q < 8 else 4))
                    edges += 1
            starts[number[y, x] + 1] = edges
    return starts, ends[:edges], weights[:edges]


@njit(nogil=True, cache=True, error_model="numpy", fastmath={"contract"})
def relax(
    unary: Array, starts: Ints, ends: Ints, weights: Array, smoothness: float, rounds: int,
) -> Array:  # pragma: no cover  # fmt: skip
    """Mean-field log-odds (p,): unary plus `smoothness` times the beliefs of the neighbours, `rounds` iterations."""
    current = unary.copy()
    belief = np.zeros(len(unary))
    for _ in range(rounds):
        for p in range(len(unary)):
            belief[p] = 1 - 2 / (1 + math.exp(current[p]))  # tanh(current / 2)
        for p in range(len(unary)):
            pull = 0.0
            for e in range(starts[p], starts[p + 1]):
                pull += weights[e] * belief[ends[e]]
            current[p] = unary[p] + smoothness * pull
    return current
