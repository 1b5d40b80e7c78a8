"""PyBullet: its own URDF loader, in a world without a window."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
import pybullet

from export.check.engines.base import GRAVITY, Setting, World
from export.check.engines.plain_urdf import write_plain_urdf
from freeart21 import se3
from freeart21.files.urdf import UrdfInertial, read_urdf_joints
from freeart21.se3 import Array

_STEP_S, _FRICTION = 0.001, 0.5
"""s: in steps of 2 ms a lighter's lid hopped by .002 rad for ever on the limit at which gravity held it."""
_NEAR_M = 0.01
"""Distance below an asset on the floor that is searched for the floor."""


def load(file: Path, folder: Path, setting: Setting) -> PybulletWorld:
    """The asset in a world of its own."""
    client = pybullet.connect(pybullet.DIRECT)
    pybullet.setGravity(0, 0, -GRAVITY if setting.gravity else 0.0, physicsClientId=client)
    pybullet.setPhysicsEngineParameter(fixedTimeStep=_STEP_S, numSolverIterations=100, physicsClientId=client)
    floor = None
    if setting.floor:
        plane = pybullet.createCollisionShape(pybullet.GEOM_PLANE, physicsClientId=client)
        floor = pybullet.createMultiBody(0, plane, physicsClientId=client)
        pybullet.changeDynamics(floor, -1, lateralFriction=_FRICTION, physicsClientId=client)
    flags = (
        pybullet.URDF_USE_INERTIA_FROM_FILE
        | pybullet.URDF_USE_SELF_COLLISION
        | pybullet.URDF_USE_SELF_COLLISION_EXCLUDE_PARENT
    )
    body = pybullet.loadURDF(
        str(write_plain_urdf(file, folder)), useFixedBase=setting.fixed, flags=flags, physicsClientId=client
    )
    return PybulletWorld(client, body, floor, setting, {j.name: j.friction for j in read_urdf_joints(file).values()})


class PybulletWorld(World):
    """See `World`. A link's index is that of its parent joint; the root has -1."""

    def __init__(self, client: int, body: int, floor: int | None, setting: Setting, friction: Mapping[str, float]):
        self.client, self.body, self.floor, self.fixed = client, body, floor, setting.fixed
        infos = [pybullet.getJointInfo(body, k, client) for k in range(pybullet.getNumJoints(body, client))]
        names = {-1: pybullet.getBodyInfo(body, client)[0].decode(), **{i[0]: i[12].decode() for i in infos}}
        self.index = {name: k for k, name in names.items()}
        self.root = names[-1]
        self.root_held = not setting.fixed and pybullet.getDynamicsInfo(body, -1, client)[0] == 0
        self.parents = {self.root: None} | {names[info[0]]: names[info[16]] for info in infos}
        moving = [i for i in infos if i[2] in (pybullet.JOINT_REVOLUTE, pybullet.JOINT_PRISMATIC)]
        self.number = {info[1].decode(): info[0] for info in moving}
        self.limits = {i[1].decode(): (float(i[8]), float(i[9])) if i[8] <= i[9] else (-np.inf, np.inf) for i in moving}
        for k in names:
            pybullet.changeDynamics(
                body, k, linearDamping=0, angularDamping=0, lateralFriction=_FRICTION, physicsClientId=client
            )
        for name, k in self.number.items():
            pybullet.setJointMotorControl2(
                body, k, pybullet.VELOCITY_CONTROL, force=friction.get(name, 0.0), physicsClientId=client
            )

    def inertials(self) -> dict[str, UrdfInertial]:
        """PyBullet reports no mass for a fixed root, which is left out."""
        found = {}
        for name, k in self.index.items():
            if k == -1 and self.fixed:
                continue
            info = pybullet.getDynamicsInfo(self.body, k, self.client)
            T = _pose(info[3], info[4])
            found[name] = UrdfInertial(float(info[0]), T[:3, 3], T[:3, :3] @ np.diag(info[2]) @ T[:3, :3].T)
        return found

    def put(self, q: Mapping[str, float], qd: Mapping[str, float] | None = None) -> None:
        for name, k in self.number.items():
            pybullet.resetJointState(self.body, k, q.get(name, 0.0), (qd or {}).get(name, 0.0), self.client)

    def place(self, T_world_root: Array) -> None:
        T = T_world_root @ self._T_root_centre()
        w, x, y, z = se3.wxyz(T)
        pybullet.resetBasePositionAndOrientation(self.body, T[:3, 3].tolist(), [x, y, z, w], self.client)
        pybullet.resetBaseVelocity(self.body, [0, 0, 0], [0, 0, 0], self.client)

    def state(self) -> tuple[dict[str, float], dict[str, float]]:
        at = {name: pybullet.getJointState(self.body, k, self.client)[:2] for name, k in self.number.items()}
        return {name: s[0] for name, s in at.items()}, {name: s[1] for name, s in at.items()}

    def poses(self) -> dict[str, Array]:
        base = _pose(*pybullet.getBasePositionAndOrientation(self.body, self.client))
        found = {self.root: base @ se3.inverse(self._T_root_centre())}
        for name, k in self.index.items():
            if k >= 0:
                state = pybullet.getLinkState(self.body, k, 0, 1, self.client)
                found[name] = _pose(state[4], state[5])
        return found

    def advance(self, seconds: float, push: Mapping[str, float] | None = None) -> None:
        for _ in range(max(1, round(seconds / _STEP_S))):
            for name, force in (push or {}).items():
                pybullet.setJointMotorControl2(
                    self.body, self.number[name], pybullet.TORQUE_CONTROL, force=force, physicsClientId=self.client
                )
            pybullet.stepSimulation(self.client)

    def lowest(self) -> float | None:
        """PyBullet wraps every mesh in a margin of 1 mm."""
        if self.floor is None:
            return None
        near = pybullet.getClosestPoints(self.body, self.floor, _NEAR_M, physicsClientId=self.client)
        return min((float(point[8]) for point in near), default=None)

    def _T_root_centre(self) -> Array:
        """(4, 4) frame that PyBullet uses as the root's pose: its centre of mass and principal axes."""
        info = pybullet.getDynamicsInfo(self.body, -1, self.client)
        return _pose(info[3], info[4])


def _pose(position: tuple[float, ...], xyzw: tuple[float, ...]) -> Array:
    x, y, z, w = xyzw
    return se3.pose_from_wxyz(np.array(position, float), np.array([w, x, y, z], float))
