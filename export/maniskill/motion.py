"""Motion of a carried object: smooth and random from a seed."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike

from freeart21 import se3
from freeart21.se3 import Array

SECONDS_A_LEG = 1.5
"""From one pose to the next, as in the handheld styles of `generator.motion`, which turn an object once in several
seconds."""
TURN = np.radians(75.0)
"""Largest rotation from the initial pose."""
SHIFT = 0.4
"""Largest displacement from there, over the object's diagonal."""


@dataclass(frozen=True)
class CarriedMotion:
    """Poses of a rigid body, `SECONDS_A_LEG` apart, connected by screw motions of minimum jerk."""

    poses: Array
    """(n, 4, 4) T_world_body."""

    @cached_property
    def _twists(self) -> Array:
        """(n - 1, 6) screw from pose to pose, in the body's frame."""
        return np.asarray(se3.log_se3(se3.inverse(self.poses[:-1]) @ self.poses[1:]))

    def at(self, t: float) -> tuple[Array, Array, Array]:
        """At `t` s: (4, 4) T_world_body, (3,) m/s of the body's origin and (3,) rad/s, world axes.

        It is at rest before the first and after the last pose.
        """
        i = int(t // SECONDS_A_LEG)
        if not 0 <= i < len(self._twists):
            return np.asarray(self.poses[0 if i < 0 else -1]), np.zeros(3), np.zeros(3)
        s = t / SECONDS_A_LEG - i
        way, rate = s**3 * (10 - 15 * s + 6 * s * s), 30 * (s * (1 - s)) ** 2
        pose = np.asarray(self.poses[i] @ se3.exp_se3(way * self._twists[i]))
        velocity = rate / SECONDS_A_LEG * self._twists[i].reshape(2, 3) @ pose[:3, :3].T
        return pose, velocity[0], velocity[1]


def draw_motion(
    rng: np.random.RandomState, start: Array, centre: ArrayLike, size: float, seconds: float
) -> CarriedMotion:
    """A random motion of `seconds` s from the pose `start` (4, 4), about `centre` (3,), world frame, for an object of
    `size` m.

    Every `SECONDS_A_LEG` it reaches a pose rotated by up to `TURN` about a random axis and shifted by up to `SHIFT`
    sizes.
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
    return CarriedMotion(np.asarray(poses, float))
