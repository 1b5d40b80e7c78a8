"""SE(3): rigid poses as 4x4 matrices. `T_a_b` maps points in frame b to frame a; twists are (v, w), translation first.

Every function takes stacks: poses (..., 4, 4), twists (..., 6), points (..., 3).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from freeart21.errors import FreeArtError

Array = NDArray[np.float64]
Floats = NDArray[np.float32]
Ints = NDArray[np.int64]
Bools = NDArray[np.bool_]

_SMALL_ANGLE = 1e-4  # rad: below it closed forms lose digits and Taylor series are exact to 1e-16


def pose(R: ArrayLike, t: ArrayLike) -> Array:
    """The pose (..., 4, 4) with rotation `R` (..., 3, 3) and translation `t` (..., 3), metres."""
    R, t = np.asarray(R, float), np.asarray(t, float)
    T = np.zeros((*np.broadcast_shapes(R.shape[:-2], t.shape[:-1]), 4, 4))
    T[..., :3, :3], T[..., :3, 3], T[..., 3, 3] = R, t, 1.0
    return T


def inverse(T: ArrayLike) -> Array:
    """The inverse of rigid poses `T` (..., 4, 4)."""
    T = np.asarray(T, float)
    R_inv = np.swapaxes(T[..., :3, :3], -1, -2)
    return pose(R_inv, -np.einsum("...ij,...j->...i", R_inv, T[..., :3, 3]))


def transform(T: ArrayLike, points: ArrayLike) -> Array:
    """`points` (..., 3) in b, mapped to a by `T` = T_a_b (4, 4); for a stack of poses give points (..., n, 3)."""
    T, points = np.asarray(T, float), np.asarray(points, float)
    R, t = T[..., :3, :3], T[..., :3, 3]
    return points @ np.swapaxes(R, -1, -2) + (t if T.ndim == 2 else t[..., None, :])


def hat(w: ArrayLike) -> Array:
    """The skew matrix (..., 3, 3) with hat(w) @ x = w x x."""
    w = np.asarray(w, float)
    W = np.zeros((*w.shape[:-1], 3, 3))
    W[..., 2, 1], W[..., 0, 2], W[..., 1, 0] = w[..., 0], w[..., 1], w[..., 2]
    return W - np.swapaxes(W, -1, -2)


def exp_so3(w: ArrayLike) -> Array:
    """Rotation (..., 3, 3) about w by |w| radians (Rodrigues)."""
    w = np.asarray(w, float)
    a, b, _ = _series(np.linalg.norm(w, axis=-1))
    W = hat(w)
    return np.eye(3) + a[..., None, None] * W + b[..., None, None] * (W @ W)


def log_so3(R: ArrayLike) -> Array:
    """The rotation vector (..., 3), angle in [0, pi], of `R` (..., 3, 3); exact from angle 0 to pi.

    Goes through the unit quaternion of largest component (Shepperd 1978), so that it holds at pi, where the
    antisymmetric part of R vanishes.
    """
    R = np.asarray(R, float)
    m = np.diagonal(R, axis1=-2, axis2=-1)
    trace = m.sum(-1, keepdims=True)
    squares = np.concatenate([1 + trace, 1 + 2 * m - trace], -1)  # 4 times the squared w, x, y, z
    S, A = R + np.swapaxes(R, -1, -2), R - np.swapaxes(R, -1, -2)
    wx, wy, wz = A[..., 2, 1], A[..., 0, 2], A[..., 1, 0]
    xy, xz, yz = S[..., 0, 1], S[..., 0, 2], S[..., 1, 2]
    d0, d1, d2, d3 = np.moveaxis(squares, -1, 0)
    candidates = np.stack(
        [
            np.stack([d0, wx, wy, wz], -1),
            np.stack([wx, d1, xy, xz], -1),
            np.stack([wy, xy, d2, yz], -1),
            np.stack([wz, xz, yz, d3], -1),
        ],
        -2,
    )
    best = np.argmax(squares, -1)[..., None, None]
    q = np.take_along_axis(candidates, np.broadcast_to(best, (*best.shape[:-1], 4)), -2)[..., 0, :]
    q = q / np.linalg.norm(q, axis=-1, keepdims=True)
    q = np.where(q[..., :1] < 0, -q, q)
    s = np.linalg.norm(q[..., 1:], axis=-1, keepdims=True)
    angle = 2 * np.arctan2(s, q[..., :1])
    return q[..., 1:] * np.where(s > 1e-12, angle / np.maximum(s, 1e-12), 2.0)


def exp_se3(twist: ArrayLike) -> Array:
    """The pose (..., 4, 4) reached by the constant twist (v, w) (..., 6) in unit time."""
    twist = np.asarray(twist, float)
    v, w = twist[..., :3], twist[..., 3:]
    _, b, c = _series(np.linalg.norm(w, axis=-1))
    W = hat(w)
    V = np.eye(3) + b[..., None, None] * W + c[..., None, None] * (W @ W)
    return pose(exp_so3(w), np.einsum("...ij,...j->...i", V, v))


def log_se3(T: ArrayLike) -> Array:
    """The twist (v, w) (..., 6) with exp_se3(twist) = T and |w| in [0, pi]."""
    T = np.asarray(T, float)
    w = log_so3(T[..., :3, :3])
    angle = np.linalg.norm(w, axis=-1)
    safe = np.where(angle < _SMALL_ANGLE, 1.0, angle)
    closed = (1 - 0.5 * safe / np.tan(0.5 * safe)) / safe**2
    k = np.where(angle < _SMALL_ANGLE, 1 / 12 + angle**2 / 720, closed)
    W = hat(w)
    V_inv = np.eye(3) - 0.5 * W + k[..., None, None] * (W @ W)
    return np.concatenate([np.einsum("...ij,...j->...i", V_inv, T[..., :3, 3]), w], -1)


def adjoint(T: ArrayLike) -> Array:
    """Ad(T) (..., 6, 6): T exp(x) T^-1 = exp(Ad(T) x) for twists x = (v, w)."""
    T = np.asarray(T, float)
    R = T[..., :3, :3]
    A = np.zeros((*T.shape[:-2], 6, 6))
    A[..., :3, :3] = A[..., 3:, 3:] = R
    A[..., :3, 3:] = hat(T[..., :3, 3]) @ R
    return A


def project_so3(M: ArrayLike) -> Array:
    """The rotation nearest to `M` (..., 3, 3) in the chordal (Frobenius) norm."""
    U, _, Vt = np.linalg.svd(np.asarray(M, float))
    U = U.copy()
    U[..., :, 2] *= np.linalg.det(U @ Vt)[..., None]
    return U @ Vt


def orthonormalised(T: ArrayLike) -> Array:
    """`T` (..., 4, 4) with its rotation projected to SO(3): call it after a chain of compositions."""
    T = np.asarray(T, float)
    return pose(project_so3(T[..., :3, :3]), T[..., :3, 3])


def rotation_angle(R: ArrayLike) -> Array:
    """Geodesic angle (...), radians in [0, pi], of rotations (..., 3, 3)."""
    return np.linalg.norm(log_so3(R), axis=-1)


def mean_pose(Ts: ArrayLike, sigma: float | None = 2.0) -> Array:
    """Robust mean (4, 4) of poses (n, 4, 4): chordal L2 for the rotation, arithmetic for the translation.

    Poses whose rotation or translation is further from the current mean than `sigma` times the root mean square are
    left out, until the set no longer changes. `sigma=None` keeps all.
    """
    Ts = np.asarray(Ts, float)
    inliers = np.ones(len(Ts), bool)
    for _ in range(20):
        mean = pose(project_so3(Ts[inliers, :3, :3].sum(0)), Ts[inliers, :3, 3].mean(0))
        if sigma is None:
            return mean
        angle = rotation_angle(Ts[:, :3, :3] @ mean[:3, :3].T)
        shift = np.linalg.norm(Ts[:, :3, 3] - mean[:3, 3], axis=-1)
        now = np.ones(len(Ts), bool)
        for distance in (angle, shift):
            spread = np.sqrt(np.mean(distance[inliers] ** 2))
            now &= distance <= sigma * spread + 1e-12
        if not now.any() or np.array_equal(now, inliers):
            return mean
        inliers = now
    return mean


def fit_rigid(source: ArrayLike, target: ArrayLike, weights: ArrayLike | None = None) -> Array:
    """The pose (..., 4, 4) that takes points `source` (..., m, 3) to `target`, by least squares with `weights` (..., m)
    (Arun, Huang and Blostein 1987)."""
    source, target = np.asarray(source, float), np.asarray(target, float)
    w = np.ones(source.shape[:-1]) if weights is None else np.asarray(weights, float)
    source, target = np.broadcast_to(source, (*w.shape, 3)), np.broadcast_to(target, (*w.shape, 3))
    w = w / np.maximum(w.sum(-1, keepdims=True), 1e-300)
    a, b = (w[..., None] * source).sum(-2), (w[..., None] * target).sum(-2)
    M = np.swapaxes(w[..., None] * (target - b[..., None, :]), -1, -2) @ (source - a[..., None, :])
    R = project_so3(M)
    return pose(R, b - np.einsum("...ij,...j->...i", R, a))


def rotation_from_wxyz(wxyz: ArrayLike) -> Array:
    """The rotation (..., 3, 3) of a quaternion (..., 4) in w, x, y, z order, of any length."""
    q = np.asarray(wxyz, float)
    w, x, y, z = np.moveaxis(q / np.linalg.norm(q, axis=-1, keepdims=True), -1, 0)
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]
    return np.stack([np.stack(row, -1) for row in rows], -2)


def pose_from_wxyz(position: ArrayLike, wxyz: ArrayLike) -> Array:
    """The pose (..., 4, 4) of a position (..., 3) and a quaternion (..., 4) in w, x, y, z order, of any length."""
    return pose(rotation_from_wxyz(wxyz), position)


def wxyz(T: ArrayLike) -> Array:
    """The unit quaternion (..., 4) in w, x, y, z order, w >= 0, of poses or rotations."""
    rotvec = log_so3(np.asarray(T, float)[..., :3, :3])
    angle = np.linalg.norm(rotvec, axis=-1, keepdims=True)
    return np.concatenate([np.cos(angle / 2), rotvec * 0.5 * np.sinc(angle / (2 * np.pi))], -1)


def check_poses(name: str, Ts: ArrayLike, tolerance: float = 1e-4) -> Array:
    """`Ts` (..., 4, 4) as float64, or FreeArtError naming the first one that is not a rigid pose."""
    Ts = np.asarray(Ts, float)
    if Ts.shape[-2:] != (4, 4):
        raise FreeArtError(f"{name} has shape {Ts.shape}, expected (..., 4, 4)")
    flat = Ts.reshape(-1, 4, 4)
    for i, T in enumerate(flat):
        where = f"{name}[{i}]" if Ts.ndim > 2 else name
        if not (np.abs(T) < 1e100).all():
            raise FreeArtError(f"{where} has entries that are not finite, or beyond 1e100")
        error = np.abs(T[:3, :3] @ T[:3, :3].T - np.eye(3)).max()
        if error > tolerance or np.linalg.det(T[:3, :3]) < 0 or np.abs(T[3] - [0, 0, 0, 1]).max() > 1e-9:
            raise FreeArtError(
                f"{where} is not a rigid pose: R R^T differs from the identity by {error:.2g}, "
                f"det {np.linalg.det(T[:3, :3]):.3g}, last row {T[3].tolist()}"
            )
    return Ts


def _series(angle: Array) -> tuple[Array, Array, Array]:
    """sin(a)/a, (1-cos(a))/a^2 and (a-sin(a))/a^3."""
    small = angle < _SMALL_ANGLE
    a = np.where(small, 1.0, angle)
    return (
        np.where(small, 1 - angle**2 / 6, np.sin(a) / a),
        np.where(small, 0.5 - angle**2 / 24, 0.5 * (np.sin(a / 2) / (a / 2)) ** 2),
        np.where(small, 1 / 6 - angle**2 / 120, (a - np.sin(a)) / a**3),
    )
