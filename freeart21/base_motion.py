"""Forces on a joint whose base moves, in the base's frame.

There a mass m at x, moving at u, feels -m (a + alpha x x + omega x (omega x x) + 2 omega x u) (Goldstein, Classical
Mechanics, 4.10). For one joint this is a force over position alone: the Coriolis force is perpendicular to the joint's
motion.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from freeart21.mechanics import JointMechanics
from freeart21.se3 import Array

N_TERMS = 8
"""Rows of `base_motion_terms`."""


@dataclass(frozen=True)
class FrameMotion:
    """Motion of the frame of a joint's parent link, in its own directions; (n, 3) each."""

    acceleration: Array
    """m/s^2, of its origin."""
    rate: Array
    """rad/s."""
    rate_change: Array
    """rad/s^2."""
    gravity: Array
    """m/s^2, in this frame."""


def base_motion_terms(mechanics: JointMechanics, motion: FrameMotion) -> Array:
    """(8, n) coefficients of the base's force on the joint, for `base_motion_force`.

    The first two rows scale with the part's mass moment about the joint (like its weight), the others with its inertia
    or mass, so both can be corrected separately.
    """
    joint, w, dw = mechanics.joint, motion.rate, motion.rate_change
    n, zero = joint.axis, np.zeros(len(w))
    fallen = motion.gravity - mechanics.gravity
    if joint.type == "prismatic":
        P, m = mechanics.moment_zero, mechanics.mass
        lost = m * (motion.acceleration - fallen) + np.cross(dw, P) + np.cross(w, np.cross(w, P))
        return np.stack([zero, zero, -lost @ n, zero, zero, zero, zero, m * ((w * w).sum(1) - (w @ n) ** 2)])
    field = fallen - motion.acceleration - np.cross(dw, joint.pivot) - np.cross(w, np.cross(w, joint.pivot))
    arm = mechanics.moment(0.0)
    across = arm - (arm @ n) * n
    cosine, sine = (np.cross(n, part) for part in (across, np.cross(n, across)))
    if mechanics.tensor_zero is None:
        raise ValueError("a revolute joint on a base that turns needs JointMechanics.tensor_zero")
    tensor = mechanics.tensor_zero
    h = tensor @ n
    side = h - (h @ n) * n
    turned = np.cross(n, side)
    flat = w - np.outer(w @ n, n)
    u = np.cross(n, w)
    along = lambda a, b: np.einsum("ni,ij,nj->n", a, tensor, b)  # noqa: E731
    return np.stack([
        field @ cosine,
        field @ sine,
        -(h @ n) * (dw @ n),
        -dw @ side - (w @ n) * (u @ side),
        -dw @ turned - (w @ n) * (u @ turned),
        -along(flat, u),
        -0.5 * (along(flat, flat) - along(u, u)),
        zero,
    ])  # fmt: skip


def base_motion_force(terms: Array, q: ArrayLike) -> Array:
    """(n,) N*m or N at positions `q` (n,)."""
    q = np.asarray(q, float)
    cosine, sine, constant, cos1, sin1, cos2, sin2, linear = terms
    c, s = np.cos(q), np.sin(q)
    own = constant + cos1 * c + sin1 * s + cos2 * np.cos(2 * q) + sin2 * np.sin(2 * q) + linear * q
    return np.asarray(cosine * c + sine * s + own)
