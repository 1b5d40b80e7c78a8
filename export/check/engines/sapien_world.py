"""SAPIEN: its own URDF loader, in a scene of physics alone."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import sapien

from export.check.engines.base import GRAVITY, Setting, World
from export.check.engines.plain_urdf import write_plain_urdf
from freeart21 import se3
from freeart21.files.urdf import UrdfInertial, read_urdf_joints
from freeart21.se3 import Array

_STEP_S, _FRICTION = 0.002, 0.5
_STIFF = 1e4
"""Damping over force limit, s/rad, of the saturated damper that models Coulomb friction (for SAPIEN 3.0.3)."""


def load(file: Path, folder: Path, setting: Setting) -> SapienWorld:
    """The asset in a scene of its own."""
    config = sapien.physx.PhysxSceneConfig()
    config.gravity = np.array([0, 0, -GRAVITY if setting.gravity else 0.0], np.float32)
    body = sapien.physx.PhysxBodyConfig()
    body.solver_position_iterations, body.sleep_threshold = 25, 0.0
    shape = sapien.physx.PhysxShapeConfig()
    shape.contact_offset = 0.002
    sapien.physx.set_scene_config(config)
    sapien.physx.set_body_config(body)
    sapien.physx.set_shape_config(shape)
    sapien.physx.set_default_material(_FRICTION, _FRICTION, 0.0)
    scene = sapien.Scene([sapien.physx.PhysxCpuSystem()])
    scene.physx_system.timestep = _STEP_S
    if setting.floor:
        scene.add_ground(0.0, render=False)
    loader = scene.create_urdf_loader()
    loader.fix_root_link = setting.fixed
    loaded = loader.load(str(write_plain_urdf(file, folder)))
    if loaded is None or not hasattr(loaded, "active_joints"):
        raise ValueError("SAPIEN made no articulation of it")
    return SapienWorld(scene, loaded, {j.name: j.friction for j in read_urdf_joints(file).values()})


class SapienWorld(World):
    """See `World`."""

    def __init__(self, scene: Any, articulation: Any, friction: Mapping[str, float]):
        self.scene, self.articulation = scene, articulation
        self.links = {link.name: link for link in articulation.links}
        self.parents = {name: link.parent.name if link.parent else None for name, link in self.links.items()}
        ends = {joint.name: np.asarray(joint.limits, float).reshape(-1) for joint in articulation.active_joints}
        self.limits = {name: (float(pair[0]), float(pair[1])) for name, pair in ends.items()}
        articulation.set_sleep_threshold(0.0)
        for link in articulation.links:
            link.set_linear_damping(0.0)
            link.set_angular_damping(0.0)
        for joint in articulation.active_joints:
            joint.set_friction(0.0)
            limit = friction.get(joint.name, 0.0)
            if limit > 0:
                joint.set_drive_properties(0.0, _STIFF * limit, limit, "force")
                joint.set_drive_velocity_target(0.0)

    def inertials(self) -> dict[str, UrdfInertial]:
        found = {}
        for name, link in self.links.items():
            pose = link.cmass_local_pose
            T = se3.pose_from_wxyz(np.asarray(pose.p, float), np.asarray(pose.q, float))
            tensor = T[:3, :3] @ np.diag(np.asarray(link.inertia, float)) @ T[:3, :3].T
            found[name] = UrdfInertial(float(link.mass), T[:3, 3], tensor)
        return found

    def put(self, q: Mapping[str, float], qd: Mapping[str, float] | None = None) -> None:
        self.articulation.set_qpos(np.array([q.get(name, 0.0) for name in self.limits], np.float32))
        self.articulation.set_qvel(np.array([(qd or {}).get(name, 0.0) for name in self.limits], np.float32))

    def place(self, T_world_root: Array) -> None:
        self.articulation.set_root_pose(sapien.Pose(np.asarray(T_world_root, np.float32)))
        self.articulation.set_root_linear_velocity(np.zeros(3, np.float32))
        self.articulation.set_root_angular_velocity(np.zeros(3, np.float32))

    def state(self) -> tuple[dict[str, float], dict[str, float]]:
        q, qd = (np.asarray(v, float).tolist() for v in (self.articulation.qpos, self.articulation.qvel))
        return dict(zip(self.limits, q, strict=True)), dict(zip(self.limits, qd, strict=True))

    def poses(self) -> dict[str, Array]:
        at = {name: link.entity_pose for name, link in self.links.items()}
        return {n: se3.pose_from_wxyz(np.asarray(p.p, float), np.asarray(p.q, float)) for n, p in at.items()}

    def advance(self, seconds: float, push: Mapping[str, float] | None = None) -> None:
        forces = np.array([(push or {}).get(name, 0.0) for name in self.limits], np.float32)
        for _ in range(max(1, round(seconds / _STEP_S))):
            self.articulation.set_qf(forces)
            self.scene.step()
