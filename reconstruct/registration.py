"""Compiled Gauss-Newton of one frame: its pose, or its pose and joint state, through a sequence of gates.

A frame is registered thousands of times, each time by a few thousand samples, so the loop over the gates is compiled as
a whole. Poses and twists are those of `freeart21.se3`; results agree with it to rounding.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

from freeart21.se3 import Array, Floats, Ints
from reconstruct.kernels import register_pairs

MAX_TURN = 0.1
"""Radians by which one step turns a part at most."""


@njit(nogil=True, cache=True)
def register_pose(
    T: Array, source: Ints, frame: int, to_part: Array, gates: Array, samples: Floats, offsets: Ints, pixels: Floats,
    h: int, w: int, labels: NDArray[np.uint8], part: int, fx: float, fy: float, cx: Array, cy: Array, unit: float,
    sigma: float, sigma_colour: float, colour_weight: float, sigma_silhouette: float,
) -> tuple[Array, Array]:  # pragma: no cover  # fmt: skip
    """A part's pose T (4, 4) in `frame` after one step a gate (in units of `unit`, metres), and the last statistics.

    The samples are those of the frames `source` (s,), whose pixels `to_part` (s, 4, 4) takes to the part. See
    `kernels.register_pairs` for the other arguments and the statistics (4,).
    """
    A, b, statistics = np.zeros((6, 6)), np.zeros(6), np.zeros(4)
    for gate in gates:
        A[:], b[:] = 0, 0
        statistics = _add_pairs(
            A, b, T, source, frame, to_part, samples, offsets, pixels, h, w, labels, part, fx, fy, cx, cy, gate * unit,
            sigma, sigma_colour, colour_weight, sigma_silhouette,
        )  # fmt: skip
        T = _move(_limited_step(A, b), T)
    return T, statistics


@njit(nogil=True, cache=True)
def register_jointed_pose(
    T: Array, q: float, screw: Array, frame: int, gates: Array, prior: Array, at_rest: bool, most: float,
    source: tuple[Ints, Ints], to_part: tuple[Array, Array], samples: tuple[Floats, Floats],
    offsets: tuple[Ints, Ints], pixels: Floats, h: int, w: int, labels: NDArray[np.uint8], fx: float, fy: float,
    cx: Array, cy: Array, unit: float, sigma: tuple[float, float], sigma_colour: float, colour_weight: float,
    sigma_silhouette: float,
) -> tuple[Array, float]:  # pragma: no cover  # fmt: skip
    """The first part's pose T (4, 4) and the state q in `frame`, the second part at T exp(q screw), after one step a
    gate.

    `prior` is a weight and the state that it draws to. `at_rest` holds the state, which otherwise changes by at most
    `most` a step. `source`, `to_part`, `samples`, `offsets` and `sigma` are those of each part; see
    `register_pose`.
    """
    A, b = np.zeros((7, 7)), np.zeros(7)
    H, g, screw_here = np.zeros((6, 6)), np.zeros(6), np.zeros(6)
    for gate in gates:
        A[:], b[:] = 0, 0
        A[6, 6], b[6] = prior[0], prior[0] * (q - prior[1])
        for k in range(2):
            H[:], g[:] = 0, 0
            T_k = T if k == 0 else _compose(T, _exp_se3(q * screw))
            _add_pairs(
                H, g, T_k, source[k], frame, to_part[k], samples[k], offsets[k], pixels, h, w, labels, k + 1, fx, fy,
                cx, cy, gate * unit, sigma[k], sigma_colour, colour_weight, sigma_silhouette,
            )  # fmt: skip
            A[:6, :6] += H
            b[:6] += g
            if k == 1:
                _act(T, screw, screw_here)
                for i in range(6):
                    along = 0.0
                    for j in range(6):
                        along += H[i, j] * screw_here[j]
                    A[i, 6] += along
                    A[6, i] += along
                    A[6, 6] += screw_here[i] * along
                    b[6] += screw_here[i] * g[i]
        T, q = step_with_joint(T, q, A, b, most, at_rest)
    return T, q


@njit(nogil=True, cache=True)
def step_with_joint(
    T: Array, q: float, A: Array, b: Array, most: float, at_rest: bool
) -> tuple[Array, float]:  # pragma: no cover
    """T (4, 4) and q after one damped step of A x = -b, x = (left twist of T, change of q); `A` and `b` are changed."""
    if at_rest:
        A[6], A[:, 6], b[6] = 0, 0, 0
    x = _limited_step(A, b)
    return _move(x, T), q + min(max(x[6], -most), most)


@njit(nogil=True, cache=True)
def _add_pairs(
    A: Array, b: Array, T: Array, source: Ints, frame: int, to_part: Array, samples: Floats, offsets: Ints,
    pixels: Floats, h: int, w: int, labels: NDArray[np.uint8], part: int, fx: float, fy: float, cx: Array, cy: Array,
    gate: float, sigma: float, sigma_colour: float, colour_weight: float, sigma_silhouette: float,
) -> Array:  # pragma: no cover  # fmt: skip
    """Add the terms of all pairs to A (6, 6) and b (6,); returns the sums of their statistics (4,)."""
    n = len(source)
    H, g, statistics = np.zeros((n, 6, 6)), np.zeros((n, 6)), np.zeros((n, 4))
    relative, target = np.empty((n, 4, 4)), np.full(n, frame)
    for p in range(n):
        relative[p] = _compose(T, to_part[p])
    register_pairs(
        0, n, source, target, relative, samples, offsets, pixels, h, w, labels, part, fx, fy, cx, cy, gate, sigma,
        sigma_colour, colour_weight, sigma_silhouette, H, g, statistics,
    )  # fmt: skip
    total = np.zeros(4)
    for p in range(n):
        A += H[p]
        b += g[p]
        total += statistics[p]
    return total


@njit(nogil=True, cache=True)
def _limited_step(A: Array, b: Array) -> Array:  # pragma: no cover
    """x of A x = -b, slightly damped, its rotation x[3:6] at most MAX_TURN; 0 without evidence.

    `A` is symmetric and, with the damping, positive definite: elimination needs no pivots.
    """
    n = len(b)
    x, M, largest = -b, A.copy(), 0.0
    for i in range(n):
        largest = max(largest, A[i, i])
    if not largest > 0:
        x[:] = 0
        return x
    for i in range(n):
        M[i, i] += 1e-3 * A[i, i] + 1e-9 * largest
    for i in range(n):
        for j in range(i + 1, n):
            share = M[j, i] / M[i, i]
            for c in range(i + 1, n):
                M[j, c] -= share * M[i, c]
            x[j] -= share * x[i]
    for i in range(n - 1, -1, -1):
        for c in range(i + 1, n):
            x[i] -= M[i, c] * x[c]
        x[i] /= M[i, i]
    turn = math.sqrt(x[3] ** 2 + x[4] ** 2 + x[5] ** 2)
    x[:6] *= min(1.0, MAX_TURN / max(turn, 1e-12))
    return x


@njit(nogil=True, cache=True)
def _move(x: Array, T: Array) -> Array:  # pragma: no cover
    """exp(x) T for the first six of `x`, its rotation orthonormal again.

    One Newton step towards the nearest rotation: the error of a product of rotations, 1e-15, is squared.
    """
    moved = _compose(_exp_se3(x), T)
    R = moved[:3, :3].copy()
    for i in range(3):
        for j in range(3):
            moved[i, j] = 1.5 * R[i, j]
            for c in range(3):
                moved[i, j] -= 0.5 * R[i, c] * (R[0, c] * R[0, j] + R[1, c] * R[1, j] + R[2, c] * R[2, j])
    return moved


@njit(nogil=True, cache=True)
def _exp_se3(x: Array) -> Array:  # pragma: no cover
    """The pose (4, 4) of the twist (v, w) in the first six of `x`; see `se3.exp_se3`."""
    v0, v1, v2, w0, w1, w2 = x[0], x[1], x[2], x[3], x[4], x[5]
    angle = math.sqrt(w0 * w0 + w1 * w1 + w2 * w2)
    if angle < 1e-4:  # `se3._series`
        a, b, c = 1 - angle**2 / 6, 0.5 - angle**2 / 24, 1 / 6 - angle**2 / 120
    else:
        half = math.sin(angle / 2) / (angle / 2)
        a, b, c = math.sin(angle) / angle, 0.5 * half * half, (angle - math.sin(angle)) / angle**3
    W = np.array([[0.0, -w2, w1], [w2, 0.0, -w0], [-w1, w0, 0.0]])
    v = np.array([v0, v1, v2])
    T = np.eye(4)
    for i in range(3):
        for j in range(3):
            square = W[i, 0] * W[0, j] + W[i, 1] * W[1, j] + W[i, 2] * W[2, j]
            T[i, j] += a * W[i, j] + b * square
            T[i, 3] += ((1.0 if i == j else 0.0) + b * W[i, j] + c * square) * v[j]
    return T


@njit(nogil=True, cache=True)
def _compose(A: Array, B: Array) -> Array:  # pragma: no cover
    """The product of two poses (4, 4)."""
    C = np.eye(4)
    for i in range(3):
        for j in range(4):
            C[i, j] = A[i, 0] * B[0, j] + A[i, 1] * B[1, j] + A[i, 2] * B[2, j] + (A[i, 3] if j == 3 else 0.0)
    return C


@njit(nogil=True, cache=True)
def _act(T: Array, twist: Array, moved: Array) -> None:  # pragma: no cover
    """Fill `moved` (6,) with Ad(T) twist."""
    for i in range(3):
        moved[i] = T[i, 0] * twist[0] + T[i, 1] * twist[1] + T[i, 2] * twist[2]
        moved[3 + i] = T[i, 0] * twist[3] + T[i, 1] * twist[4] + T[i, 2] * twist[5]
    moved[0] += T[1, 3] * moved[5] - T[2, 3] * moved[4]
    moved[1] += T[2, 3] * moved[3] - T[0, 3] * moved[5]
    moved[2] += T[0, 3] * moved[4] - T[1, 3] * moved[3]
