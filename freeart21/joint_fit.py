"""The joint between two rigid parts from their relative poses: a hinge and a slider fitted, and one chosen.

`Ts` (n, 4, 4) are relative poses T_reference_moving. The canonical frames of the two parts need not agree: an ideal
joint gives T_i = J(q_i) G with a constant G, and translations t_i = p + R_i v. FreeArtGS's t_i = c + (I - R_i) p
(arXiv 2603.22102) holds only when both parts share the gauge of the first frame; its closed forms and its rule of the
type are here, too.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from freeart21 import se3
from freeart21.errors import FreeArtError
from freeart21.joint import JOINT_TYPES, Joint, JointType
from freeart21.se3 import Array

LEAST_POSES = 4
MOST_POSES = 150
"""Most poses, evenly spaced, in the search of `fit_joint`; states are estimated for all."""
MIN_ROTATION_DEG = 10.0
"""theta_th of the paper's type rule."""
MAX_LINEARITY = 0.05
"""rho_th of the paper's type rule."""
_MOST_MODES = 15
"""Degree of the fastest function of the state that a tracker's drift is."""
_LEAST_MOTION = 1e-6
"""Of the lever: below it a part does not move, and a pose is exact."""


@dataclass(frozen=True)
class JointFit:
    """A joint of one type fitted to relative poses."""

    type: JointType
    axis: Array
    """(3,) unit, reference frame."""
    pivot: Array
    """(3,) metres, reference frame; a point on the axis."""
    states: Array
    """(n,) rad or m, one per relative pose."""
    T_zero: Array
    """(4, 4) T_reference_moving at state zero."""
    residuals: Array
    """(n,) metres: rms displacement of the moving part's points from where the joint puts them."""

    @property
    def residual(self) -> float:
        """Median residual, metres."""
        return float(np.median(self.residuals))

    def joint(self) -> Joint:
        """The joint, limited to the observed range."""
        return Joint("joint", self.type, self.axis, self.pivot, float(self.states.min()), float(self.states.max()))


def fit_joint(Ts: Array, centre: Array, lever: float) -> tuple[JointFit, JointFit]:
    """The joint that explains relative poses (n, 4, 4) of successive frames, and the best one of the other type.

    `centre` and `lever` are as of `fit_joint_of_type`. States rise over the frames. The type is that of larger evidence
    (`log_evidences`). Raises FreeArtError for too few poses, or when the part does not move.
    """
    if len(Ts) < LEAST_POSES:
        raise FreeArtError(f"joint: {len(Ts)} poses are too few to fit a joint, expected {LEAST_POSES}")
    Ts = se3.orthonormalised(Ts)
    few = Ts[np.unique(np.linspace(0, len(Ts) - 1, min(len(Ts), MOST_POSES)).round().astype(int))]
    body = _points_around(centre, lever)
    if np.ptp(se3.transform(few, np.broadcast_to(body, (len(few), 6, 3))), axis=0).max() < _LEAST_MOTION * lever:
        raise FreeArtError("joint: the moving part does not move against the reference part")
    fits = [fit_joint_of_type(few, kind, centre, lever) for kind in JOINT_TYPES]
    best, other = (fits[k] for k in np.argsort(log_evidences(fits, few, centre, lever))[::-1])
    return _with_all_states(best, Ts, body), _with_all_states(other, Ts, body)


def log_evidences(fits: Sequence[JointFit], Ts: Array, centre: Array, lever: float) -> Array:
    """(k,) logarithms of the marginal likelihoods of fits to the same poses, by Laplace's approximation.

    Types of joint differ in smooth functions of the state, so only these are compared: the residuals' components along
    polynomials. A tracker's errors are smooth, too: they drift as the part moves, and a far hinge takes the drift for
    an arc. So each octave of degrees has a noise level of its own, estimated from the residuals; a drift, which is of
    low degree, counts as the few independent numbers that it is, five a polynomial. All directions of an axis are
    equally likely. A hinge is on or near the part: the distance of its pivot from the part's centre has a plane Cauchy
    distribution of the part's size, whose share beyond a distance r is lever / r.
    """
    body, near = _points_around(centre, lever), min(fits, key=lambda fit: fit.residual)
    weights = np.minimum(1, 3 * near.residual / np.maximum(near.residuals, 1e-300))[:, None]  # of frames gone wild
    found = []
    for fit in fits:
        count = 4 if fit.type == "revolute" else 2
        errors = weights * _misplacements(fit, Ts, body).reshape(len(Ts), -1)
        J = _parameter_derivatives(fit, Ts, body).reshape(len(Ts), -1)
        evidence, information = 0.0, np.zeros((J.shape[1] // errors.shape[1],) * 2)
        for modes in _smooth_modes(near.states):
            variance = max(float(((modes.T @ errors) ** 2).mean()), (_LEAST_MOTION * lever) ** 2)
            evidence -= 5 / 2 * modes.shape[1] * float(np.log(variance))
            rows = (modes.T @ J).reshape(-1, len(information))
            information += 5 / errors.shape[1] / variance * rows.T @ rows
        coupling = information[:count, count:]
        shared = np.linalg.pinv(information[count:, count:], rcond=1e-12, hermitian=True)
        own = np.linalg.eigvalsh(information[:count, :count] - coupling @ shared @ coupling.T)
        volume = float((count / 2 - 1) * np.log(2 * np.pi) - np.log(np.maximum(own, 1e-300)).sum() / 2)
        if fit.type == "revolute":
            away = se3.transform(fit.T_zero, centre) - fit.pivot
            far = float(np.hypot(np.linalg.norm(away - (away @ fit.axis) * fit.axis), lever))
            volume = min(volume + float(np.log(lever / (2 * np.pi * far**3))), float(np.log(lever / far)))
        found.append(evidence + volume)
    return np.array(found)


def _smooth_modes(states: Array) -> list[Array]:
    """Orthonormal polynomials of the states (n,): degree 1, degrees 2 and 3, 4 to 7 and so on, each (n, k)."""
    centred = (states - states.mean()) / max(float(np.abs(states - states.mean()).max()), 1e-300)
    most = min(_MOST_MODES, len(states) // 2)
    modes = np.linalg.qr(np.polynomial.legendre.legvander(centred, most))[0]
    return [modes[:, 2**k : 2 ** (k + 1)] for k in range(most.bit_length())]


def _with_all_states(fit: JointFit, Ts: Array, body: Array) -> JointFit:
    """The fit with the states of all poses `Ts` (n, 4, 4), zero in the first one and rising."""
    fit = replace(fit, states=estimate_states(fit, Ts, body))
    if np.polyfit(np.arange(len(Ts)), fit.states, 1)[0] < 0:
        fit = replace(fit, axis=-fit.axis, states=-fit.states)
    return _shift_zero_to_first(replace(fit, residuals=np.sqrt((_misplacements(fit, Ts, body) ** 2).sum(2).mean(1))))


def rotation_amplitude(Ts: Array) -> float:
    """Degrees: range of the angles to the mean rotation, without outliers by the IQR rule (the paper's Joint Type)."""
    R = se3.project_so3(Ts[:, :3, :3])
    mean = se3.project_so3(R.sum(0))
    angles = se3.rotation_angle(R @ mean.T)
    low, high = np.percentile(angles, [25, 75])
    inliers = angles[(angles >= low - 1.5 * (high - low)) & (angles <= high + 1.5 * (high - low))]
    return float(np.degrees(np.ptp(inliers)))


def translation_linearity(Ts: Array) -> float:
    """(lambda_2 + lambda_3) / lambda_1 of the translations' covariance: small on a line (supplement, Joint Type)."""
    x = Ts[:, :3, 3] - Ts[:, :3, 3].mean(0)
    values = np.linalg.eigvalsh(x.T @ x)
    return float((values[0] + values[1]) / (values[2] + 1e-12))


def paper_joint_type(Ts: Array) -> JointType:
    """Prismatic when the rotation amplitude is small or the translations are collinear (supplement, Joint Type)."""
    straight = translation_linearity(Ts) < MAX_LINEARITY
    return "prismatic" if rotation_amplitude(Ts) < MIN_ROTATION_DEG or straight else "revolute"


def find_inlier_poses(Ts: Array, sigmas: float = 2.0) -> NDArray[np.bool_]:
    """(n,) poses whose step from their neighbours is within `sigmas` standard deviations (paper, Noise Resistance).

    The smaller of a pose's two steps counts, so that the good neighbour of a bad pose is kept.
    """
    if len(Ts) < 4:
        return np.ones(len(Ts), bool)
    step = np.linalg.norm(np.diff(Ts[:, :3, 3], axis=0), axis=1)
    nearest = np.minimum(np.append(step, np.inf), np.append(np.inf, step))
    bound = nearest.mean() + sigmas * nearest.std()
    return nearest <= bound + 1e-12


def revolute_axis(Rs: Array, weights: Array | None = None, robust: bool = True) -> Array:
    """The unit axis (3,) that all pairwise relative rotations of `Rs` (n, 3, 3) leave fixed.

    Smallest eigenvector of sum w_ij (R_ij - I)^T (R_ij - I), R_ij = R_i R_j^T (supplement, Joint Axis). When `robust`,
    pairs are reweighted by a Cauchy-like kernel of |(R_ij - I) u|.
    """
    pairs = np.einsum("iab,jcb->ijac", Rs, Rs) - np.eye(3)
    w0 = np.ones(len(Rs)) if weights is None else np.asarray(weights, float)
    base = np.outer(w0, w0)
    w = base
    for _ in range(15 if robust else 1):
        A = np.einsum("ij,ijab,ijac->bc", w, pairs, pairs)
        u = np.linalg.eigh(A)[1][:, 0]
        error = np.linalg.norm(pairs @ u, axis=2)
        scale = 1.5 * np.median(error[base > 0]) + 1e-12
        w = base / (1 + (error / scale) ** 2) ** 2
    return u


def revolute_pivot(Ts: Array, axis: Array, weights: Array | None = None, robust: bool = True) -> tuple[Array, Array]:
    """A pivot p (3,) and the offset v (3,) with t_i = p + R_i v; p is perpendicular to the axis.

    Along the axis p and v are one unknown: p gets none of it.
    """
    R, t = Ts[:, :3, :3], Ts[:, :3, 3]
    A = np.concatenate([np.broadcast_to(np.eye(3), R.shape), R], 2)
    w0 = np.ones(len(Ts)) if weights is None else np.asarray(weights, float)
    w = w0
    for _ in range(15 if robust else 1):
        N = np.einsum("n,nij,nik->jk", w, A, A)
        N[:3, :3] += np.outer(axis, axis) * np.trace(N)
        solution = np.linalg.lstsq(N, np.einsum("n,nij,ni->j", w, A, t), rcond=1e-10)[0]
        error = np.linalg.norm(A @ solution - t, axis=1)
        scale = 1.5 * np.median(error) + 1e-12
        w = w0 / (1 + (error / scale) ** 2) ** 2
    p, v = solution[:3], solution[3:]
    return p - (p @ axis) * axis, v


def prismatic_axis(positions: Array, weights: Array | None = None, robust: bool = True) -> tuple[Array, Array]:
    """First principal direction (3,) and mean (3,) of positions (n, 3), robustly reweighted (supplement, Prismatic)."""
    w0 = np.ones(len(positions)) if weights is None else np.asarray(weights, float)
    w = w0
    for _ in range(15 if robust else 1):
        mean = w @ positions / w.sum()
        x = positions - mean
        axis = np.linalg.eigh((x * w[:, None]).T @ x)[1][:, 2]
        error = np.linalg.norm(x - np.outer(x @ axis, axis), axis=1)
        scale = 1.5 * np.median(error) + 1e-12
        w = w0 / (1 + (error / scale) ** 2) ** 2
    return axis, mean


def fit_joint_of_type(Ts: Array, kind: JointType, centre: Array, lever: float, robust: bool = True) -> JointFit:
    """A joint of type `kind` fitted to relative poses (n, 4, 4): closed form, then robust least squares.

    `centre` (3,) is the moving part's middle in its own canonical frame and `lever`, metres, its radius: residuals are
    displacements of points at that radius, so that rotation and translation errors compare. `robust`: poses that jump
    are left out, and weights fall with the residual. States count from the first pose.
    """
    Ts = se3.orthonormalised(Ts)
    w = np.ones(len(Ts))
    if robust:
        inliers = w * find_inlier_poses(Ts)
        w = inliers if (inliers > 0).sum() >= 4 else w
    R, body = Ts[:, :3, :3], _points_around(centre, lever)
    if kind == "prismatic":
        positions = R @ centre + Ts[:, :3, 3]
        axis, mean = prismatic_axis(positions, w, robust)
        R_zero = se3.project_so3(np.einsum("n,nij->ij", w, R))
        pivot, T_zero = mean, se3.pose(R_zero, mean - R_zero @ centre)
    else:
        axis = revolute_axis(R, w, robust)
        pivot, v = revolute_pivot(Ts, axis, w, robust)
        along = w @ (Ts[:, :3, 3] @ axis - (R @ v) @ axis) / w.sum()
        R_zero = _mean_rotation_about(R, axis, w)
        T_zero = se3.pose(R_zero, pivot + along * axis + R_zero @ v)
    fit = JointFit(kind, axis, pivot, np.zeros(len(Ts)), T_zero, np.zeros(len(Ts)))
    return _shift_zero_to_first(_refine_fit(fit, Ts, body, w))


def estimate_states(fit: JointFit, Ts: Array, body: Array) -> Array:
    """(n,) states that bring the moving part's points `body` (b, 3) nearest to where `Ts` (n, 4, 4) put them."""
    at_zero = se3.transform(fit.T_zero, body)
    observed = se3.transform(Ts, np.broadcast_to(body, (len(Ts), *body.shape)))
    if fit.type == "prismatic":
        return ((observed - at_zero) @ fit.axis).mean(1)
    a, b = at_zero - fit.pivot, observed - fit.pivot
    a, b = a - np.outer(a @ fit.axis, fit.axis), b - (b @ fit.axis)[..., None] * fit.axis
    turn = np.arctan2((np.cross(np.broadcast_to(a, b.shape), b) @ fit.axis).sum(1), (a * b).sum((1, 2)))
    return np.unwrap(turn)


def _points_around(centre: Array, lever: float) -> Array:
    """(6, 3) points at `lever`, metres, from `centre` along the axes."""
    return np.asarray(centre + lever * np.concatenate([np.eye(3), -np.eye(3)]))


def _misplacements(fit: JointFit, Ts: Array, body: Array) -> Array:
    """(n, b, 3) metres: where `Ts` put the points `body`, less where the joint puts them."""
    observed = se3.transform(Ts, np.broadcast_to(body, (len(Ts), *body.shape)))
    return observed - se3.transform(fit.joint().transform(fit.states), se3.transform(fit.T_zero, body)[None])


def _moved_fit(fit: JointFit, x: Array, Ts: Array, body: Array) -> JointFit:
    """The fit with its parameters moved by `x`, states in closed form: axis (2), of a hinge pivot (2, in sizes of the
    body), T_zero (6, translation in sizes)."""
    across = np.linalg.svd(fit.axis[None])[2][1:]
    size = float(np.linalg.norm(body - body.mean(0), axis=1).mean())
    axis = fit.axis + x[:2] @ across
    pivot = fit.pivot + (size * x[2:4] @ across if fit.type == "revolute" else 0)
    T_zero = se3.exp_se3(x[-6:] * np.repeat([size, 1.0], 3)) @ fit.T_zero
    new = replace(fit, axis=axis / np.linalg.norm(axis), pivot=pivot, T_zero=T_zero)
    return replace(new, states=estimate_states(new, Ts, body))


def _refine_fit(fit: JointFit, Ts: Array, body: Array, weights: Array) -> JointFit:
    """Robust least squares over axis, pivot and T_zero; the states follow in closed form."""
    from scipy.optimize import least_squares

    size = float(np.linalg.norm(body - body.mean(0), axis=1).mean())
    start = np.zeros(10 if fit.type == "revolute" else 8)
    root = np.sqrt(weights / weights.max())

    def errors(x: Array) -> Array:
        return _misplacements(_moved_fit(fit, x, Ts, body), Ts, body)

    scale = max(1.5 * float(np.median(np.linalg.norm(errors(start), axis=2))), 1e-9 * size)
    solved = least_squares(
        lambda x: (errors(x) * root[:, None, None]).ravel() / scale, start, loss="cauchy", max_nfev=40
    )
    best = _moved_fit(fit, solved.x, Ts, body)
    return replace(best, residuals=np.sqrt((errors(solved.x) ** 2).sum(2).mean(1)))


def _parameter_derivatives(fit: JointFit, Ts: Array, body: Array) -> Array:
    """(3 b n, 8 or 10) derivatives of `_misplacements` by the parameters of `_moved_fit`, the pivot's in metres."""
    size = float(np.linalg.norm(body - body.mean(0), axis=1).mean())
    count, step = (10 if fit.type == "revolute" else 8), 1e-6
    rows = [
        (_misplacements(_moved_fit(fit, sign * step * unit, Ts, body), Ts, body)).ravel()
        for unit in np.eye(count)
        for sign in (1, -1)
    ]
    J = (np.array(rows[::2]) - np.array(rows[1::2])).T / (2 * step)
    if fit.type == "revolute":
        J[:, 2:4] /= size
    return np.asarray(J)


def _shift_zero_to_first(fit: JointFit) -> JointFit:
    """The same fit with state zero at the first pose."""
    shift = fit.joint().transform(fit.states[0])
    return replace(fit, states=fit.states - fit.states[0], T_zero=shift @ fit.T_zero)


def _mean_rotation_about(R: Array, axis: Array, weights: Array) -> Array:
    """The rotation R_0 (3, 3) closest to exp(-angle_i axis) R_i, with free angles."""
    R_zero = R[len(R) // 2]
    for _ in range(10):
        angle = se3.log_so3(R @ R_zero.T) @ axis
        R_zero = se3.project_so3(np.einsum("n,nij->ij", weights, se3.exp_so3(-angle[:, None] * axis) @ R))
    return R_zero
