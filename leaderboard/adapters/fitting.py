"""Fits a joint to measured poses of two parts, for methods that track parts without a joint.

A robust least-squares hinge or slider. Points around the moving part's centre are moved by the measured motion M_i and
by the joint, J(q_i) M; the residuals are metres, with Cauchy weights per frame. The states q_i are the closed-form
optimum of each frame, so that only axis, pivot and the part's pose M at state zero are searched.

A hinge has two parameters more than a slider (its pivot), and a distant pivot makes it a slider. It is chosen if it
explains the motion better by Schwarz's criterion, with a quarter of the frames as independent samples, since a
tracker's errors are correlated between frames.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.optimize import least_squares

from freeart21 import se3
from freeart21.errors import FreeArtError
from freeart21.joint import Joint, JointType
from freeart21.se3 import Array

LEAST_FRAMES = 3
LEAST_TURN = np.radians(1.0)
"""Rotation over the whole motion below which no hinge is fitted."""
MOST_FRAMES = 150
"""Most frames, evenly spaced, in the search; states are computed for all."""
_ROUNDS = 5  # of reweighting, each with a few steps of the search
_FARTHEST_PIVOT = 100.0  # part sizes


@dataclass(frozen=True)
class Fit:
    """A fitted joint."""

    joint: Joint
    """In the reference part's frame."""
    states: Array
    """(n,) rad or m, zero in the first frame, with a rising trend."""
    T_reference_moving: Array
    """(4, 4) pose of the moving part's own frame at state zero."""
    residual: float
    """Median over frames of the RMS distance, metres."""
    other_residual: float
    """The residual of the other joint type; infinite if that was not fitted."""


def fit_joint(name: str, motion: Array, centre: Array, size: float) -> Fit:
    """The hinge or slider that best explains `motion` (n, 4, 4), reference frame from the moving part's own frame.

    `centre` (3,) is the moving part's centre in its own frame and `size` its extent, metres: residuals are those of
    points at half that distance. Raises FreeArtError for too few frames or a part that does not move.
    """
    motion = np.asarray(motion, float)
    if len(motion) < LEAST_FRAMES:
        raise FreeArtError(f"joint '{name}': {len(motion)} poses are too few to fit a joint, expected {LEAST_FRAMES}")
    size = max(float(size), 1e-6)
    points = centre + 0.5 * size * np.concatenate([np.eye(3), -np.eye(3)])
    few = motion[np.unique(np.linspace(0, len(motion) - 1, min(len(motion), MOST_FRAMES)).round().astype(int))]
    slider = _Search("prismatic", few, points, size)
    searches = [slider]
    if _rotation_range(few) > LEAST_TURN:
        searches.append(_Search("revolute", few, points, size))
    if slider.moved < 1e-6 * size and len(searches) == 1:
        raise FreeArtError(f"joint '{name}': the moving part does not move against the reference part")
    samples = max(len(few) / 4, 2.0)
    scores = [
        samples * np.log(max(s.residual, 1e-9 * size) ** 2) + 2 * (s.kind == "revolute") * np.log(samples)
        for s in searches
    ]
    best = searches[int(np.argmin(scores))]
    others = [s.residual for s in searches if s is not best]
    axis, pivot, home = best.axis, best.pivot, best.home
    states = _best_states(best.kind, axis, pivot, home, motion, points)
    if np.polyfit(np.arange(len(states)), states, 1)[0] < 0:
        axis, states = -axis, -states
    zero = Joint(name, best.kind, axis, pivot, -np.inf, np.inf).transform(states[0])
    home, states = zero @ home, states - states[0]
    joint = Joint(name, best.kind, axis, pivot, float(states.min()), float(states.max()))
    return Fit(joint, states, home, best.residual, min(others, default=np.inf))


def _rotation_range(motion: Array) -> float:
    """95th percentile of the rotation, rad, between the medoid and each frame."""
    angles = se3.rotation_angle(motion[:, :3, :3] @ motion[_find_medoid(motion)][:3, :3].T)
    return float(np.quantile(angles, 0.95))


def _find_medoid(motion: Array) -> int:
    """The frame with the least summed rotation distance to all others: robust to outliers."""
    flat = motion[:, :3, :3].reshape(len(motion), 9)
    return int(np.linalg.norm(flat[:, None] - flat[None], axis=-1).sum(1).argmin())


class _Search:
    """The best joint of one type, from a closed-form initial guess."""

    def __init__(self, kind: JointType, motion: Array, points: Array, size: float) -> None:
        self.kind, self._motion, self._points, self._size = kind, motion, points, size
        self._measured = se3.transform(motion, np.repeat(points[None], len(motion), 0))
        middle = self._measured.mean(1)
        self._home = motion[_find_medoid(motion)]
        if kind == "prismatic":
            spread = middle - np.median(middle, 0)
            self._axis = np.linalg.svd(spread * _outlier_weights(spread)[:, None])[2][0]
            self._pivot = np.median(middle, 0)
        else:
            self._axis = _guess_hinge_axis(motion)
            self._pivot = _guess_hinge_pivot(motion @ se3.inverse(self._home), self._axis, middle.mean(0), size)
        self.moved = float(np.linalg.norm(np.ptp(middle, axis=0)))
        self._across = np.linalg.svd(self._axis[None])[2][1:]
        x, weights = np.zeros(10), self._weights(np.zeros(10))
        for _ in range(_ROUNDS):
            x = least_squares(lambda y, w=weights: self._residuals(y) * w, x, max_nfev=8, method="trf").x
            weights = self._weights(x)
        self.residual = float(np.median(self._rms(x)))
        self.axis, self.pivot, self.home = self._unpack(x)

    def _weights(self, x: Array) -> Array:
        """(18 n,) square roots of the weights of all coordinates: Cauchy weights per frame, of scale three medians."""
        rms = self._rms(x)
        wide = max(3 * float(np.median(rms)), 1e-9 * self._size)
        return np.repeat(1 / np.sqrt(1 + (rms / wide) ** 2), 3 * len(self._points))

    def _rms(self, x: Array) -> Array:
        """(n,) RMS residual of each frame, metres, for the parameters `x`."""
        return np.asarray(np.sqrt((self._residuals(x).reshape(len(self._motion), -1) ** 2).sum(1) / len(self._points)))

    def _unpack(self, x: Array) -> tuple[Array, Array, Array]:
        axis = se3.exp_so3(x[0] * self._across[0] + x[1] * self._across[1]) @ self._axis
        pivot = self._pivot
        if self.kind == "revolute":
            pivot = pivot + self._size * (x[2] * self._across[0] + x[3] * self._across[1])
        shift = self._home[:3, :3] @ self._points.mean(0) + self._home[:3, 3]  # rotate about the part, not the origin
        R = se3.exp_so3(x[4:7]) @ self._home[:3, :3]
        return axis, pivot, se3.pose(R, shift - R @ self._points.mean(0) + self._size * x[7:10])

    def _residuals(self, x: Array) -> Array:
        axis, pivot, home = self._unpack(x)
        states = _best_states(self.kind, axis, pivot, home, self._motion, self._points)
        joint = Joint("", self.kind, axis, pivot, -np.inf, np.inf)
        placed = se3.transform(home, self._points)
        return (
            se3.transform(joint.transform(states), np.repeat(placed[None], len(states), 0)) - self._measured
        ).ravel()


def _best_states(kind: JointType, axis: Array, pivot: Array, home: Array, motion: Array, points: Array) -> Array:
    """(n,) least-squares states that move the points, placed at `home`, to where `motion` moves them."""
    carried = se3.transform(motion, np.repeat(points[None], len(motion), 0))
    placed = se3.transform(home, points)
    if kind == "prismatic":
        return np.asarray((carried - placed).mean(1) @ axis)
    a, b = placed - pivot, carried - pivot
    a, b = a - (a @ axis)[:, None] * axis, b - (b @ axis)[..., None] * axis
    return np.asarray(np.arctan2((np.cross(a[None], b) @ axis).sum(1), (a[None] * b).sum((1, 2))))


def _outlier_weights(spread: Array) -> Array:
    """(n,) weights against outliers: 1 up to three median lengths, then inversely proportional."""
    lengths = np.linalg.norm(spread, axis=1)
    return np.asarray(np.minimum(1.0, 3 * max(float(np.median(lengths)), 1e-12) / np.maximum(lengths, 1e-12)))


def _guess_hinge_axis(motion: Array) -> Array:
    """Axis (3,) of the rotations between all pairs of frames, robust."""
    few = motion[np.unique(np.linspace(0, len(motion) - 1, min(len(motion), 100)).round().astype(int)), :3, :3]
    i, j = np.triu_indices(len(few), 1)
    turns = se3.log_so3(few[i] @ np.swapaxes(few[j], -1, -2))
    lengths = np.linalg.norm(turns, axis=1)
    turns = turns[lengths > 0.3 * np.quantile(lengths, 0.9)]
    turns = turns / np.linalg.norm(turns, axis=1, keepdims=True)
    weights = np.ones(len(turns))
    for _ in range(10):  # downweight pairs with an outlier frame, whose axis is arbitrary
        axis = np.asarray(np.linalg.eigh((turns * weights[:, None]).T @ turns)[1][:, 2])
        off = np.linalg.norm(np.cross(turns, axis), axis=1)
        weights = 1 / (1 + (off / max(float(np.median(off)), 1e-9)) ** 2)
    return axis


def _guess_hinge_pivot(moved: Array, axis: Array, middle: Array, size: float) -> Array:
    """The point (3,) near `middle` that the displacements `moved` (n, 4, 4) leave fixed, normal to `axis`."""
    across = np.linalg.svd(axis[None])[2][1:].T
    A = ((np.eye(3) - moved[:, :3, :3]) @ across).reshape(-1, 2)
    b = (moved[:, :3, 3] - np.einsum("nij,j->ni", np.eye(3) - moved[:, :3, :3], middle)).reshape(-1)
    found = least_squares(lambda p: A @ p - b, np.zeros(2), loss="soft_l1", f_scale=0.05 * size).x
    return np.asarray(middle + across @ np.clip(found, -_FARTHEST_PIVOT * size, _FARTHEST_PIVOT * size))
