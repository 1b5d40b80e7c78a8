"""An invisible hand that moves the object's root link along a motion or on command."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np
import sapien

from export.maniskill._body import Body
from export.maniskill._body_batch import BodyBatch
from export.maniskill.motion import CarriedMotion
from freeart21 import se3
from freeart21.se3 import Array

_RATE = 2 * np.pi * 40.0
"""rad/s: the grip is a critically damped drive of 40 Hz on the root link's mass; objects stayed within 1.1 mm and 6
mrad of the target."""


class Hand:
    """A drive between world and root link in each of n environments. It also tracks the target's velocity, so it does
    not lag."""

    def __init__(self, scene: Any, body: Body | BodyBatch):
        self._body = body
        self._drives, self._offsets = [], []
        for sub_scene, articulation in zip(scene.sub_scenes, body.articulations, strict=True):
            drive = sub_scene.create_drive(None, sapien.Pose(), articulation.root.entity, sapien.Pose())
            for which in "x", "y", "z", "slerp":
                grip = getattr(drive, f"set_drive_property_{which}")
                grip(_RATE**2, 2 * _RATE, np.finfo(np.float32).max, "acceleration")
            self._drives.append(drive)
            # GPU scenes share one engine; SAPIEN shifts the poses of bodies, but not those of drives
            self._offsets.append(scene.px.get_scene_offset(sub_scene) if scene.gpu_sim_enabled else np.zeros(3))
        self._motions: list[CarriedMotion | None] = [None] * body.n
        self._targets = np.tile(np.eye(4), (body.n, 1, 1))

    def follow(self, rows: Iterable[int], motions: Sequence[CarriedMotion]) -> None:
        """In the environments `rows` (m,) follow `motions` (m,) from now on; their times are the body's clocks."""
        for i, motion in zip(rows, motions, strict=True):
            self._motions[i] = motion

    def lead(self) -> None:
        """Stop following, where the body is `restarted`; move only by `go`."""
        poses = self._body.root_poses()
        for i in self._body.restarted.nonzero()[:, 0].tolist():
            self._motions[i], self._targets[i] = None, poses[i]

    def go(self, shift: Array, turn: Array) -> None:
        """Move the targets by `shift` (n, 3) m and `turn` (n, 3, 3) about their origins, world axes."""
        self._targets = se3.pose(turn @ self._targets[:, :3, :3], self._targets[:, :3, 3] + shift)

    def catch(self, rows: Iterable[int]) -> None:
        """Hold the object where it is now in the environments `rows`, unless the hand follows a motion there."""
        poses = self._body.root_poses()
        for i in rows:
            if self._motions[i] is None:
                self._targets[i] = poses[i]

    def move(self, dt: float) -> None:
        """Set the targets for the end of a step of `dt` s that begins now."""
        still = np.zeros(3)
        for i, (drive, time_s) in enumerate(zip(self._drives, self._body.times_s().tolist(), strict=True)):
            motion = self._motions[i]
            pose, linear, angular = (self._targets[i], still, still) if motion is None else motion.at(time_s + dt)
            target = sapien.Pose(pose.astype(np.float32))
            target.p = target.p + self._offsets[i]
            drive.set_drive_target(target)
            drive.set_drive_velocity_target(linear.astype(np.float32), angular.astype(np.float32))
