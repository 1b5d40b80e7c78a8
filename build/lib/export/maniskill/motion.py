"""How an object is carried through the air: smooth, drawn from a seed, or as it was recorded."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike

from freeart21 import se3
from freeart21.errors import FreeArtError
from freeart21.se3 import Array

SECONDS_A_LEG = 1.5
"""From one pose to the next: as `generator.motion`'s handheld styles, which turn an object once in several seconds."""
TURN = np.radians(75.0)
"""Largest turn away from where the object began."""
SHIFT = 0.4
"""Largest way from there, in diagonals of the object."""


@dataclass(frozen=True)
class CarriedMotion:
    """Poses of a rigid body at instants, between which it goes along a screw, at rest in none or all of them."""

    times_s: Array
    """(n,) rising."""
    poses: Array
    """(n, 4, 4) T_world_body."""
    rests: bool = False
    """Whether speed is 0 at each pose (minimum jerk between them), or what the poses make it."""

    def __post_init__(self) -> None:
        times, poses = np.asarray(self.times_s, float).reshape(-1), se3.check_poses("motion poses", self.poses)
        if len(times) != len(poses) or not len(times) or (np.diff(times) <= 0).any() or not np.isfinite(times).all():
            raise FreeArtError(f"a motion has {len(poses)} poses at {len(times)} times, expected as many, times rising")
        object.__setattr__(self, "times_s", times)
        object.__setattr__(self, "poses", poses)

    @cached_property
    def _twists(self) -> Array:
        """(n - 1, 6) of the screws from pose to pose, in the body's frame."""
        return np.asarray(se3.log_se3(se3.inverse(self.poses[:-1]) @ self.poses[1:]))

    def at(self, t: float) -> tuple[Array, Array, Array]:
        """At `t` s: (4, 4) T_world_body, (3,) m/s of the body's origin and (3,) rad/s, world axes.

        Before the first and after the last instant it stands still.
        """
        if not self.times_s[0] <= t < self.times_s[-1]:
            return np.asarray(self.poses[0 if t < self.times_s[0] else -1]), np.zeros(3), np.zeros(3)
        i = int(np.searchsorted(self.times_s, t, side="right")) - 1
        leg = self.times_s[i + 1] - self.times_s[i]
        s = (t - self.times_s[i]) / leg
        way, rate = (s**3 * (10 - 15 * s + 6 * s * s), 30 * (s * (1 - s)) ** 2) if self.rests else (s, 1.0)
        pose = np.asarray(self.poses[i] @ se3.exp_se3(way * self._twists[i]))
        velocity = rate / leg * self._twists[i].reshape(2, 3) @ pose[:3, :3].T
        return pose, velocity[0], velocity[1]


def drawn_motion(
    rng: np.random.RandomState, start: Array, centre: ArrayLike, size: float, seconds: float
) -> CarriedMotion:
    """A motion of `seconds` from the pose `start` (4, 4) on: about `centre` (3,), world frame, of an object of
    `size` m.

    Every `SECONDS_A_LEG` it is at a pose turned by up to `TURN` about any axis and shifted by up to `SHIFT` sizes.
    """
    n = int(np.ceil(seconds / SECONDS_A_LEG)) + 1
    poses = [np.asarray(start, float)]
    to_centre = np.eye(4)
    to_centre[:3, 3] = centre
    for _ in range(n):
        axis, way = rng.normal(size=3), rng.normal(size=3)
        turn = TURN * rng.uniform(0.3, 1.0) * axis / np.linalg.norm(axis)
        moved = se3.exp_se3(np.concatenate([np.zeros(3), turn]))
        moved[:3, 3] = SHIFT * size * rng.uniform() * way / np.linalg.norm(way)
        poses.append(to_centre @ moved @ se3.inverse(to_centre) @ poses[0])
    return CarriedMotion(SECONDS_A_LEG * np.arange(n + 1, dtype=float), np.asarray(poses, float), rests=True)
