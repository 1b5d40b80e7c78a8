"""The closed-form joint of FreeArtGS (arXiv 2603.22102, sec. 3.3 and appendix "Joint Type Estimation")."""

from __future__ import annotations

import numpy as np

from baselines.video import UnsolvableError
from freeart21 import se3
from freeart21.joint import Joint, JointType
from freeart21.se3 import Array, Bools

PRISMATIC_SPAN_DEG = 10.0
"""The paper's theta_th: below it, a motion is a translation."""
PRISMATIC_LINEARITY = 0.05
"""The paper's rho_th: below it, translations lie on a line."""
OUTLIER_SIGMA = 2.0
"""The paper's filter of translations."""
LEAST_FRAMES = 4


def fit_joint(Ts: Array, centre: Array, size: float, by_paper: bool) -> tuple[Joint, Array]:
    """The joint, and the states (n,) in rad or m, of relative poses `Ts` (n, 4, 4), reference from moving.

    `centre` (3,), metres, is the moving part's in its own frame: translations are those of this point, so that they do
    not depend on where the origin is; `size`, metres, is the part's. The type is chosen by the paper's two cues or, not
    `by_paper`, by which of both fits the poses better (Schwarz's criterion): the cues take short arcs for lines. Raises
    UnsolvableError for too few poses.
    """
    if len(Ts) < LEAST_FRAMES:
        raise UnsolvableError("joint", f"both parts were found in {len(Ts)} keyframes, expected {LEAST_FRAMES}")
    path = se3.transform(Ts, np.repeat(centre[None, None], len(Ts), 0))[:, 0]
    off = np.linalg.norm(path - np.median(path, 0), axis=1)
    good = off <= np.median(off) + OUTLIER_SIGMA * max(float(path.std(0).max()), 1e-9)
    if by_paper:
        fit = _fit_slider if choose_type(Ts[good], path[good]) == "prismatic" else _fit_hinge
        return fit(Ts, path, good)
    points = centre + size / 2 * np.concatenate([np.eye(3), -np.eye(3)])
    measured = se3.transform(Ts[good], np.repeat(points[None], good.sum(), 0))
    fits = [_fit_slider(Ts, path, good), _fit_hinge(Ts, path, good)]
    costs = []
    for parameters, (joint, states) in zip((2, 4), fits, strict=True):
        home = se3.inverse(joint.transform(states[good])) @ Ts[good]
        T = se3.pose(se3.project_so3(home[:, :3, :3].sum(0)), np.median(home[:, :3, 3], 0))
        miss = measured - se3.transform(joint.transform(states[good]) @ T, np.repeat(points[None], good.sum(), 0))
        square = np.median((miss**2).sum(2).mean(1)) + (1e-6 * size) ** 2
        costs.append(good.sum() * np.log(square) + parameters * np.log(good.sum()))
    return fits[int(np.argmin(costs))]


def _fit_slider(Ts: Array, path: Array, good: Bools) -> tuple[Joint, Array]:
    """The direction of most variance of `path` (n, 3) and the states along it, 0 in the first frame."""
    axis = np.linalg.svd(path[good] - path[good].mean(0))[2][0]
    states = (path - path[0]) @ axis
    return Joint("joint", "prismatic", axis, path[0], float(states.min()), float(states.max())), states


def _fit_hinge(Ts: Array, path: Array, good: Bools) -> tuple[Joint, Array]:
    """The axis of all rotations from frame to frame, the angles that explain them, and the pivot across the axis."""
    R = Ts[:, :3, :3]
    steps = se3.log_so3(R[good][None] @ np.swapaxes(R[good][:, None], -1, -2))
    axis = np.linalg.eigh(np.einsum("ija,ijb->ab", steps, steps))[1][:, -1]
    to_all = se3.log_so3(R[:, None] @ np.swapaxes(R[good][None], -1, -2)) @ axis  # [j, i]: from i to j
    states = np.median(to_all + to_all.mean(1)[good], axis=1)
    states = states - states[0]
    pivot = _fit_pivot(Ts[good] @ se3.inverse(Ts[good][0]), axis, path[good].mean(0))
    return Joint("joint", "revolute", axis, pivot, float(states.min()), float(states.max())), states


def choose_type(Ts: Array, path: Array) -> JointType:
    """The paper's two cues: the span of rotation (without outliers beyond 1.5 interquartile ranges), and how nearly
    the positions `path` (n, 3) lie on a line."""
    mean = se3.project_so3(Ts[:, :3, :3].sum(0))
    twists = se3.log_so3(Ts[:, :3, :3] @ mean.T)
    axis = np.linalg.eigh(twists.T @ twists)[1][:, -1]
    angles = twists @ axis  # with its sign: the paper's unsigned one halves the span
    low, high = np.quantile(angles, [0.25, 0.75])
    inliers = angles[(angles >= low - 1.5 * (high - low)) & (angles <= high + 1.5 * (high - low))]
    values = np.linalg.eigvalsh(np.cov((path - path.mean(0)).T))
    linearity = (values[0] + values[1]) / (values[2] + 1e-12)
    small = np.degrees(np.ptp(inliers)) < PRISMATIC_SPAN_DEG
    return "prismatic" if small or linearity < PRISMATIC_LINEARITY else "revolute"


def _fit_pivot(Ts: Array, axis: Array, near: Array) -> Array:
    """The point (3,) that `Ts` (n, 4, 4) leave where it is, in the plane across `axis` through `near`."""
    across = np.linalg.svd(axis[None])[2][1:].T  # (3, 2)
    A = (np.eye(3) - Ts[:, :3, :3]).reshape(-1, 3)
    b = Ts[:, :3, 3].reshape(-1) - A @ near
    return np.asarray(near + across @ np.linalg.lstsq(A @ across, b, rcond=None)[0])
