"""A joint fitted to measured poses of two parts, for methods that follow parts and name no joint.

Such a joint is ours and not the method's, and is marked so wherever it is used. It is the robust least-squares hinge or
slider: points about the moving part's middle are carried by the measured motion M_i and by the joint, J(q_i) M, and
differ by metres; frames that are far off count less (Cauchy weights). States q_i are the best for each frame given the
rest (closed form), so that axis, pivot and the part's place M at state zero are all that is searched.

A hinge has two numbers more than a slider, its pivot, and with that far away it moves like one. So it must explain
the motion better by more than two free numbers do: by Schwarz's criterion, with a quarter of the frames as samples,
since what a tracker gets wrong in one frame it gets wrong in the next.
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
"""Rotation over the whole motion below which no hinge is looked for."""
MOST_FRAMES = 150
"""Frames that the search looks at, spread evenly; states are found for all."""
_ROUNDS = 5  # of weights, each with a few steps of the search
_FAR = 100.0  # part sizes from the middle beyond which a pivot says nothing


@dataclass(frozen=True)
class Fit:
    """A joint and what it makes of the motion."""

    joint: Joint
    """In the reference part's frame."""
    states: Array
    """(n,) rad or m from the first frame's; they rise from there to the last on the whole."""
    T_reference_moving: Array
    """(4, 4) where the moving part's own frame stands at state zero."""
    residual: float
    """Metres: the median over frames of the root mean square distance that the fit leaves."""
    other_residual: float
    """The same of the other joint type; infinite where it was not looked for."""


def fit_joint(name: str, motion: Array, centre: Array, size: float) -> Fit:
    """The hinge or slider that best explains `motion` (n, 4, 4), reference frame from the moving part's own frame.

    `centre` (3,) is the moving part's middle in its own frame and `size` its extent, metres: errors are measured on
    points that far about it. Raises FreeArtError when there are too few frames or the part does not move.
    """
    motion = np.asarray(motion, float)
    if len(motion) < LEAST_FRAMES:
        raise FreeArtError(f"joint '{name}': {len(motion)} poses are too few to fit a joint, expected {LEAST_FRAMES}")
    size = max(float(size), 1e-6)
    points = centre + 0.5 * size * np.concatenate([np.eye(3), -np.eye(3)])
    few = motion[np.unique(np.linspace(0, len(motion) - 1, min(len(motion), MOST_FRAMES)).round().astype(int))]
    slider = _Search("prismatic", few, points, size)
    searches = [slider]
    if _turn(few) > LEAST_TURN:
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
    states = _states(best.kind, axis, pivot, home, motion, points)
    if np.polyfit(np.arange(len(states)), states, 1)[0] < 0:
        axis, states = -axis, -states
    zero = Joint(name, best.kind, axis, pivot, -np.inf, np.inf).transform(states[0])
    home, states = zero @ home, states - states[0]
    joint = Joint(name, best.kind, axis, pivot, float(states.min()), float(states.max()))
    return Fit(joint, states, home, best.residual, min(others, default=np.inf))


def _turn(motion: Array) -> float:
    """Largest rotation, rad, between the motion's middle and its frames, the worst twentieth left out."""
    angles = se3.rotation_angle(motion[:, :3, :3] @ motion[_medoid(motion)][:3, :3].T)
    return float(np.quantile(angles, 0.95))


def _medoid(motion: Array) -> int:
    """The frame whose rotation is nearest to all others': the middle of the motion, blind to wild frames."""
    flat = motion[:, :3, :3].reshape(len(motion), 9)
    return int(np.linalg.norm(flat[:, None] - flat[None], axis=-1).sum(1).argmin())


class _Search:
    """The best joint of one type, from a closed-form beginning."""

    def __init__(self, kind: JointType, motion: Array, points: Array, size: float) -> None:
        self.kind, self._motion, self._points, self._size = kind, motion, points, size
        self._carried = se3.transform(motion, np.repeat(points[None], len(motion), 0))
        middle = self._carried.mean(1)
        self._home = motion[_medoid(motion)]
        if kind == "prismatic":
            spread = middle - np.median(middle, 0)
            self._axis = np.linalg.svd(spread * _weights(spread)[:, None])[2][0]
            self._pivot = np.median(middle, 0)
        else:
            self._axis = _hinge_axis(motion)
            self._pivot = _hinge_pivot(motion @ se3.inverse(self._home), self._axis, middle.mean(0), size)
        self.moved = float(np.linalg.norm(np.ptp(middle, axis=0)))
        self._across = np.linalg.svd(self._axis[None])[2][1:]
        x, weights = np.zeros(10), self._weights(np.zeros(10))
        for _ in range(_ROUNDS):
            x = least_squares(lambda y, w=weights: self._off(y) * w, x, max_nfev=8, method="trf").x
            weights = self._weights(x)
        self.residual = float(np.median(self._rms(x)))
        self.axis, self.pivot, self.home = self._at(x)

    def _weights(self, x: Array) -> Array:
        """(18 n,) square roots of the weights of all coordinates: Cauchy's, three medians wide, one a frame."""
        rms = self._rms(x)
        wide = max(3 * float(np.median(rms)), 1e-9 * self._size)
        return np.repeat(1 / np.sqrt(1 + (rms / wide) ** 2), 3 * len(self._points))

    def _rms(self, x: Array) -> Array:
        """(n,) metres that the joint at `x` leaves in each frame."""
        return np.asarray(np.sqrt((self._off(x).reshape(len(self._motion), -1) ** 2).sum(1) / len(self._points)))

    def _at(self, x: Array) -> tuple[Array, Array, Array]:
        axis = se3.exp_so3(x[0] * self._across[0] + x[1] * self._across[1]) @ self._axis
        pivot = self._pivot
        if self.kind == "revolute":
            pivot = pivot + self._size * (x[2] * self._across[0] + x[3] * self._across[1])
        shift = self._home[:3, :3] @ self._points.mean(0) + self._home[:3, 3]  # turn about the part, not the origin
        R = se3.exp_so3(x[4:7]) @ self._home[:3, :3]
        return axis, pivot, se3.pose(R, shift - R @ self._points.mean(0) + self._size * x[7:10])

    def _off(self, x: Array) -> Array:
        axis, pivot, home = self._at(x)
        states = _states(self.kind, axis, pivot, home, self._motion, self._points)
        joint = Joint("", self.kind, axis, pivot, -np.inf, np.inf)
        placed = se3.transform(home, self._points)
        return (se3.transform(joint.transform(states), np.repeat(placed[None], len(states), 0)) - self._carried).ravel()


def _states(kind: JointType, axis: Array, pivot: Array, home: Array, motion: Array, points: Array) -> Array:
    """(n,) the states that bring the points placed at `home` nearest to where `motion` carries them: least squares."""
    carried = se3.transform(motion, np.repeat(points[None], len(motion), 0))
    placed = se3.transform(home, points)
    if kind == "prismatic":
        return np.asarray((carried - placed).mean(1) @ axis)
    a, b = placed - pivot, carried - pivot
    a, b = a - (a @ axis)[:, None] * axis, b - (b @ axis)[..., None] * axis
    return np.arctan2((np.cross(a[None], b) @ axis).sum(1), (a[None] * b).sum((1, 2)))


def _weights(spread: Array) -> Array:
    """(n,) weights that keep wild rows from deciding: 1 up to three median lengths, then falling."""
    lengths = np.linalg.norm(spread, axis=1)
    return np.minimum(1.0, 3 * max(float(np.median(lengths)), 1e-12) / np.maximum(lengths, 1e-12))


def _hinge_axis(motion: Array) -> Array:
    """The direction about which all frames are turned against each other, by the rotations between all pairs."""
    few = motion[np.unique(np.linspace(0, len(motion) - 1, min(len(motion), 100)).round().astype(int)), :3, :3]
    i, j = np.triu_indices(len(few), 1)
    turns = se3.log_so3(few[i] @ np.swapaxes(few[j], -1, -2))
    lengths = np.linalg.norm(turns, axis=1)
    turns = turns[lengths > 0.3 * np.quantile(lengths, 0.9)]
    turns = turns / np.linalg.norm(turns, axis=1, keepdims=True)
    weights = np.ones(len(turns))
    for _ in range(10):  # pairs with a lost frame turn about anything: they count less the farther they point away
        axis = np.asarray(np.linalg.eigh((turns * weights[:, None]).T @ turns)[1][:, 2])
        off = np.linalg.norm(np.cross(turns, axis), axis=1)
        weights = 1 / (1 + (off / max(float(np.median(off)), 1e-9)) ** 2)
    return axis


def _hinge_pivot(moved: Array, axis: Array, middle: Array, size: float) -> Array:
    """The point (3,) that the displacements `moved` (n, 4, 4) leave in place across `axis`, near `middle`."""
    across = np.linalg.svd(axis[None])[2][1:].T
    A = ((np.eye(3) - moved[:, :3, :3]) @ across).reshape(-1, 2)
    b = (moved[:, :3, 3] - np.einsum("nij,j->ni", np.eye(3) - moved[:, :3, :3], middle)).reshape(-1)
    found = least_squares(lambda p: A @ p - b, np.zeros(2), loss="soft_l1", f_scale=0.05 * size).x
    return np.asarray(middle + across @ np.clip(found, -_FAR * size, _FAR * size))
