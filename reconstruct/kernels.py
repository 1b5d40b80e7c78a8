"""Hot loops: registration of pixels between frames, what a pixel says about a motion, relaxation of labels.

All work on the arrays of a `Scene` and poses `T` that take camera-frame points of a source frame to a target frame.
"""

from __future__ import annotations

import math
import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from itertools import pairwise

import numpy as np
from numba import njit

NEAR = 1e-6

_THREADS = min(8, len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1)
_POOL = ThreadPoolExecutor(_THREADS)


def in_threads(work: Callable[[int, int], object], n: int, worth: int) -> None:
    """Call `work(begin, end)` on pieces of range(n), in threads when n is at least `worth`.

    Pieces write to places of their own, so the outcome does not depend on the number of threads. Kernels release the
    interpreter lock; small work stays in this thread, where it is faster.
    """
    if n < worth or _THREADS == 1:
        work(0, n)
        return
    bounds = np.linspace(0, n, 2 * _THREADS + 1).astype(int)
    for done in [_POOL.submit(work, int(a), int(b)) for a, b in pairwise(bounds)]:
        done.result()


@njit(nogil=True, cache=True)
def register_pairs(  # pragma: no cover
    begin,
    end,
    source,
    target,
    T,
    samples,
    offsets,
    points,
    normals,
    features,
    outside,
    labels,
    part,
    fx,
    fy,
    cx,
    cy,
    gate,
    sigma,
    sigma_colour,
    colour_weight,
    sigma_silhouette,
    H,
    g,
    stats,
):
    """Gauss-Newton terms of the frame pairs begin to end for the left twist (v, w) of T[p] = T_target_source.

    `samples[offsets[i]:offsets[i + 1]]` are rows and columns in frame i. With `part` > 0 a sample does not meet target
    pixels labelled as the other part (label 0 is either's). Terms per sample: point-to-plane by projective association
    with Tukey's weight, colour along its gradient, and the distance to the mask where it falls outside. Fills
    H (p, 6, 6), g (p, 6) and stats (p, 4): inliers, projected, cost, outside.
    """
    h, w = points.shape[1], points.shape[2]
    for p in range(begin, end):
        i, j = source[p], target[p]
        R = T[p]
        A = np.zeros((6, 6))
        b = np.zeros(6)
        J = np.zeros(6)
        inliers, projected, out, cost = 0, 0, 0, 0.0
        for s in range(offsets[i], offsets[i + 1]):
            y, x = samples[s, 0], samples[s, 1]
            a0, a1, a2 = points[i, y, x, 0], points[i, y, x, 1], points[i, y, x, 2]
            m0, m1, m2 = normals[i, y, x, 0], normals[i, y, x, 1], normals[i, y, x, 2]
            Y0 = R[0, 0] * a0 + R[0, 1] * a1 + R[0, 2] * a2 + R[0, 3]
            Y1 = R[1, 0] * a0 + R[1, 1] * a1 + R[1, 2] * a2 + R[1, 3]
            Y2 = R[2, 0] * a0 + R[2, 1] * a1 + R[2, 2] * a2 + R[2, 3]
            if Y2 < NEAR:
                continue
            M0 = R[0, 0] * m0 + R[0, 1] * m1 + R[0, 2] * m2
            M1 = R[1, 0] * m0 + R[1, 1] * m1 + R[1, 2] * m2
            M2 = R[2, 0] * m0 + R[2, 1] * m1 + R[2, 2] * m2
            u, v = fx * Y0 / Y2 + cx[j], fy * Y1 / Y2 + cy[j]
            xi, yi = math.floor(u + 0.5), math.floor(v + 0.5)
            if xi < 2 or yi < 2 or xi >= w - 2 or yi >= h - 2:
                continue
            projected += 1
            if outside[j, yi, xi] > 0.5:
                r = outside[j, yi, xi]
                out += 1
                weight = 1.0 / (sigma_silhouette * sigma_silhouette)
                if r > 3.0 * sigma_silhouette:
                    weight *= 3.0 * sigma_silhouette / r
                gx = 0.5 * (outside[j, yi, xi + 1] - outside[j, yi, xi - 1]) * fx / Y2
                gy = 0.5 * (outside[j, yi + 1, xi] - outside[j, yi - 1, xi]) * fy / Y2
                _point_row(J, gx, gy, -(gx * Y0 + gy * Y1) / Y2, Y0, Y1, Y2)
                _add(A, b, J, r, weight)
                cost += 0.5 * weight * r * r
                continue
            facing = -(M0 * Y0 + M1 * Y1 + M2 * Y2) / math.sqrt(Y0 * Y0 + Y1 * Y1 + Y2 * Y2)
            if facing < 0.15 or points[j, yi, xi, 2] <= 0 or (part > 0 and labels[j, yi, xi] == 3 - part):
                continue
            n0, n1, n2 = normals[j, yi, xi, 0], normals[j, yi, xi, 1], normals[j, yi, xi, 2]
            if n0 * M0 + n1 * M1 + n2 * M2 < 0.7:
                continue
            r = n0 * (Y0 - points[j, yi, xi, 0]) + n1 * (Y1 - points[j, yi, xi, 1]) + n2 * (Y2 - points[j, yi, xi, 2])
            if abs(r) > gate:
                continue
            tukey = 1 - (r / gate) ** 2
            weight = tukey * tukey / (sigma * sigma)
            _point_row(J, n0, n1, n2, Y0, Y1, Y2)
            _add(A, b, J, r, weight)
            inliers += 1
            cost += 0.5 * weight * r * r
            if colour_weight <= 0 or outside[j, yi - 1, xi] + outside[j, yi + 1, xi] > 0:
                continue
            if outside[j, yi, xi - 1] + outside[j, yi, xi + 1] > 0:
                continue
            x0, y0 = math.floor(u), math.floor(v)
            fu, fv = u - x0, v - y0
            for c in range(3):
                gx = 0.5 * (features[j, yi, xi + 1, c] - features[j, yi, xi - 1, c])
                gy = 0.5 * (features[j, yi + 1, xi, c] - features[j, yi - 1, xi, c])
                if gx * gx + gy * gy < 0.04:
                    continue
                value = (1 - fv) * ((1 - fu) * features[j, y0, x0, c] + fu * features[j, y0, x0 + 1, c])
                value += fv * ((1 - fu) * features[j, y0 + 1, x0, c] + fu * features[j, y0 + 1, x0 + 1, c])
                r = value - features[i, y, x, c]
                if abs(r) > 4 * sigma_colour:
                    continue
                tukey = 1 - (r / (4 * sigma_colour)) ** 2
                weight = colour_weight * tukey * tukey / (sigma_colour * sigma_colour)
                g0, g1 = gx * fx / Y2, gy * fy / Y2
                _point_row(J, g0, g1, -(g0 * Y0 + g1 * Y1) / Y2, Y0, Y1, Y2)
                _add(A, b, J, r, weight)
                cost += 0.5 * weight * r * r
        for q in range(6):
            g[p, q] = b[q]
            for q2 in range(6):
                H[p, q, q2] = A[min(q, q2), max(q, q2)]
        stats[p, 0], stats[p, 1], stats[p, 2], stats[p, 3] = inliers, projected, cost, out


@njit(inline="always")
def _point_row(J, n0, n1, n2, Y0, Y1, Y2):  # pragma: no cover
    """Derivative of n . Y by the left twist (v, w): (n, Y x n)."""
    J[0], J[1], J[2] = n0, n1, n2
    J[3], J[4], J[5] = Y1 * n2 - Y2 * n1, Y2 * n0 - Y0 * n2, Y0 * n1 - Y1 * n0


@njit(inline="always")
def _add(A, b, J, r, weight):  # pragma: no cover
    for q in range(6):
        wj = weight * J[q]
        b[q] += wj * r
        for q2 in range(q, 6):
            A[q, q2] += wj * J[q2]


@njit(nogil=True, cache=True)
def pixel_costs(  # pragma: no cover
    begin,
    end,
    frame,
    others,
    T,
    pixels,
    points,
    normals,
    features,
    outside,
    logodds,
    label_weight,
    fx,
    fy,
    cx,
    cy,
    sigma,
    sigma_colour,
    cap,
    costs,
):
    """What pixels begin to end (p, 2: row, column) of `frame` cost under motions T (s, k, 4, 4) to `others` (s,).

    Outside the mask: the distance to it. In front of the surface there: a violation of free space. Behind it: hidden,
    a constant. On it: point-to-plane, normal and colour differences, and `label_weight` times the disagreement of the
    hypothesis k (0 reference, 1 moving) with the other frame's `logodds` (> 0: moving). Fills costs (p, s, k).
    """
    h, w = points.shape[1], points.shape[2]
    for p in range(begin, end):
        y, x = pixels[p, 0], pixels[p, 1]
        a0, a1, a2 = points[frame, y, x, 0], points[frame, y, x, 1], points[frame, y, x, 2]
        m0, m1, m2 = normals[frame, y, x, 0], normals[frame, y, x, 1], normals[frame, y, x, 2]
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
                z = points[j, yi, xi, 2]
                if z <= 0:
                    costs[p, s, k] = min(cap, 0.7 * max(outside[j, yi, xi] - 0.5, 0.0))
                    continue
                M0 = R[0, 0] * m0 + R[0, 1] * m1 + R[0, 2] * m2
                M1 = R[1, 0] * m0 + R[1, 1] * m1 + R[1, 2] * m2
                M2 = R[2, 0] * m0 + R[2, 1] * m1 + R[2, 2] * m2
                n0, n1, n2 = normals[j, yi, xi, 0], normals[j, yi, xi, 1], normals[j, yi, xi, 2]
                r = n0 * (Y0 - points[j, yi, xi, 0]) + n1 * (Y1 - points[j, yi, xi, 1]) + n2 * (Y2 - z)
                facing = -(M0 * Y0 + M1 * Y1 + M2 * Y2) / math.sqrt(Y0 * Y0 + Y1 * Y1 + Y2 * Y2)
                if facing < 0.1:
                    behind = (Y2 - z) / sigma
                    costs[p, s, k] = 0.5 if behind > -3 else min(cap, 0.5 * behind * behind)
                    continue
                if z + 6 * sigma < Y2 and r < -3 * sigma:
                    costs[p, s, k] = 0.8
                    continue
                same = n0 * M0 + n1 * M1 + n2 * M2
                shape = min(0.6 * cap, 0.5 * (r / sigma) ** 2 + 2.0 * max(0.0, 0.8 - same))
                difference = 0.0
                for c in range(3):
                    d = features[j, yi, xi, c] - features[frame, y, x, c]
                    difference += d * d
                cost = shape + min(0.2 * cap, 0.25 * difference / (sigma_colour * sigma_colour))
                if label_weight > 0 and shape < 2.0:
                    against = -logodds[j, yi, xi] if k == 1 else logodds[j, yi, xi]
                    cost += label_weight * min(max(against, 0.0), 3.0)
                costs[p, s, k] = cost


@njit(nogil=True, cache=True)
def neighbours(valid, points, normals, features, reach, flatness):  # pragma: no cover
    """The graph of like neighbours of one frame, as compressed rows over the valid pixels in reading order.

    Neighbours stand 1, 3 and 6 steps up, down, right and left. An edge's weight in [0, 1] falls with distance (over
    `reach`), bend, distance from the common plane (over `flatness`) and colour, and halves with each longer step.
    Returns starts (p + 1,), ends and weights of the edges worth keeping.
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
                distance = bend = colour = 0.0
                off = off2 = 0.0
                for c in range(3):
                    d = points[yy, xx, c] - points[y, x, c]
                    distance += d * d
                    bend += normals[y, x, c] * normals[yy, xx, c]
                    off += normals[y, x, c] * d
                    off2 += normals[yy, xx, c] * d
                    e = features[yy, xx, c] - features[y, x, c]
                    colour += e * e
                off = max(abs(off), abs(off2)) / flatness
                exponent = distance / (reach * reach) + (1 - bend) / 0.35 + colour / 200.0 + off * off
                if exponent < 4.0:
                    ends[edges] = number[yy, xx]
                    weights[edges] = math.exp(-exponent) / (1 if q < 4 else (2 if q < 8 else 4))
                    edges += 1
            starts[number[y, x] + 1] = edges
    return starts, ends[:edges], weights[:edges]


@njit(nogil=True, cache=True)
def relax(unary, starts, ends, weights, smoothness, rounds):  # pragma: no cover
    """Mean-field log-odds (p,): unary plus `smoothness` times the beliefs of the neighbours, `rounds` times."""
    current = unary.copy()
    belief = np.zeros(len(unary))
    for _ in range(rounds):
        for p in range(len(unary)):
            belief[p] = math.tanh(0.5 * current[p])
        for p in range(len(unary)):
            pull = 0.0
            for e in range(starts[p], starts[p + 1]):
                pull += weights[e] * belief[ends[e]]
            current[p] = unary[p] + smoothness * pull
    return current
