"""An invisible hand that moves the object's root link along a motion or on command."""

from __future__ import annotations

from typing import Any

import numpy as np
import sapien

from export.maniskill._body import Body
from export.maniskill.motion import CarriedMotion
from freeart21 import se3
from freeart21.se3 import Array

_RATE = 2 * np.pi * 40.0
"""rad/s: the grip is a critically damped drive of 40 Hz on the root link's mass; objects stayed within 1.1 mm and 6
mrad of the target."""


class Hand:
    """A drive between world and root link. It also tracks the target's velocity, so it does not lag."""

    def __init__(self, scene: Any, body: Body):
        self._body = body
        root = body.simulated.articulation.root
        self._drive = scene.sub_scenes[0].create_drive(None, sapien.Pose(), root.entity, sapien.Pose())
        for which in "x", "y", "z", "slerp":
            grip = getattr(self._drive, f"set_drive_property_{which}")
            grip(_RATE**2, 2 * _RATE, np.finfo(np.float32).max, "acceleration")
        self._motion: CarriedMotion | None = None
        self._target = np.eye(4)

    def follow(self, motion: CarriedMotion) -> None:
        """Follow `motion` from now on; its times are the body's clock."""
        self._motion = motion

    def lead(self) -> None:
        """Stop following; move only by `go`."""
        self._motion, self._target = None, self._body.root_pose

    def go(self, shift: Array, turn: Array) -> None:
        """Move the target by `shift` (3,) m and `turn` (3, 3) about its origin, world axes."""
        self._target = se3.pose(turn @ self._target[:3, :3], self._target[:3, 3] + shift)

    def catch(self) -> None:
        """Hold the object where it is now, unless the hand follows a motion."""
        if self._motion is None:
            self._target = self._body.root_pose

    def move(self, time_s: float, dt: float) -> None:
        """Set the target for the end of a step of `dt` s that begins at `time_s`."""
        still = np.zeros(3)
        pose, linear, angular = (self._target, still, still) if self._motion is None else self._motion.at(time_s + dt)
        self._drive.set_drive_target(sapien.Pose(pose.astype(np.float32)))
        self._drive.set_drive_velocity_target(linear.astype(np.float32), angular.astype(np.float32))
