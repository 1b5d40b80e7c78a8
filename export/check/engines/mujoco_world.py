"""MuJoCo: MJCF as it is, URDF through MuJoCo's own compiler."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from export.check.engines.base import GRAVITY, Setting, World
from export.check.engines.plain_urdf import write_plain_urdf
from export.check.mjcf_tree import read_inertial
from freeart21 import se3
from freeart21.files.urdf import UrdfInertial, read_root_tag, read_urdf
from freeart21.se3 import Array

_LARGEST_STEP_S = 0.002


def load(file: Path, folder: Path, setting: Setting) -> MujocoWorld:
    """The asset in a scene of its own."""
    urdf = read_root_tag(file) == "robot"
    on_world = urdf and "world" in read_urdf(file).links  # MuJoCo takes that link for its world
    if urdf:
        compiler = {"fusestatic": "false", "strippath": "false", "discardvisual": "true"}
        file = write_plain_urdf(file, folder, compiler)
    spec = mujoco.MjSpec.from_file(str(file))
    tops = list(spec.worldbody.bodies)
    if len(tops) != 1:
        raise ValueError(f"its world has {len(tops)} bodies, expected one")
    root = tops[0]
    free = [joint for joint in root.joints if joint.type == mujoco.mjtJoint.mjJNT_FREE]
    jointed = len(root.joints) > len(free)
    for key in list(spec.keys):  # their size no longer fits
        spec.delete(key)
    if setting.fixed:
        for joint in free:
            spec.delete(joint)
        if urdf or free:  # unlike other engines, MuJoCo lets a fixed base collide with its neighbours
            _exclude_neighbours(spec, root)
        if not on_world:
            root.pos, root.quat = [0, 0, 0], [1, 0, 0, 0]
    elif not free and not jointed:
        root.add_freejoint()
    if setting.floor:
        spec.worldbody.add_geom(
            name="floor of the check", type=mujoco.mjtGeom.mjGEOM_PLANE, size=[0, 0, 1], contype=1, conaffinity=1
        )
        for geom in spec.geoms:  # a geom that collides with anything collides with the plane
            if geom.contype or geom.conaffinity:
                geom.contype |= 1
    spec.option.gravity = [0, 0, -GRAVITY if setting.gravity else 0.0]
    spec.option.timestep = min(spec.option.timestep, _LARGEST_STEP_S)
    for joint in (
        spec.joints if urdf else ()
    ):  # a URDF's limits are hard; MuJoCo's default (20 ms) yields to light links
        joint.solref_limit = [2 * spec.option.timestep, 1]
    spec.option.enableflags |= int(mujoco.mjtEnableBit.mjENBL_ENERGY)
    return MujocoWorld(spec.compile(), root.name, jointed)


def _exclude_neighbours(spec: Any, root: Any) -> None:
    waiting = [root]
    while waiting:
        body = waiting.pop()
        for child in body.bodies:
            spec.add_exclude(bodyname1=body.name, bodyname2=child.name)
            waiting.append(child)


class MujocoWorld(World):
    """See `World`."""

    def __init__(self, model: Any, root: str, root_held: bool):
        self.model, self.data = model, mujoco.MjData(model)
        names = [model.body(b).name for b in range(model.nbody)]
        self.root, self.root_held = root, root_held
        self.parents = {
            names[b]: None if names[b] == root else names[model.body_parentid[b]] for b in range(1, model.nbody)
        }
        kinds = (int(mujoco.mjtJoint.mjJNT_HINGE), int(mujoco.mjtJoint.mjJNT_SLIDE))
        moving = [j for j in range(model.njnt) if int(model.jnt_type[j]) in kinds]
        ends = {j: model.jnt_range[j].tolist() if model.jnt_limited[j] else (-np.inf, np.inf) for j in moving}
        self.limits = {model.joint(j).name: (lower, upper) for j, (lower, upper) in ends.items()}
        mujoco.mj_forward(model, self.data)

    def inertials(self) -> dict[str, UrdfInertial]:
        return {self.model.body(b).name: read_inertial(self.model, b) for b in range(1, self.model.nbody)}

    def put(self, q: Mapping[str, float], qd: Mapping[str, float] | None = None) -> None:
        for name in self.limits:
            self.data.joint(name).qpos[0] = q.get(name, 0.0)
            self.data.joint(name).qvel[0] = (qd or {}).get(name, 0.0)
        mujoco.mj_forward(self.model, self.data)

    def place(self, T_world_root: Array) -> None:
        at = self.model.body(self.root).jntadr[0]
        address = self.model.jnt_qposadr[at]
        self.data.qpos[address : address + 7] = [*T_world_root[:3, 3], *se3.wxyz(T_world_root)]
        mujoco.mj_forward(self.model, self.data)

    def state(self) -> tuple[dict[str, float], dict[str, float]]:
        q = {name: float(self.data.joint(name).qpos[0]) for name in self.limits}
        return q, {name: float(self.data.joint(name).qvel[0]) for name in self.limits}

    def poses(self) -> dict[str, Array]:
        mujoco.mj_kinematics(self.model, self.data)
        return {n: se3.pose(self.data.body(n).xmat.reshape(3, 3), self.data.body(n).xpos) for n in self.parents}

    def advance(self, seconds: float, push: Mapping[str, float] | None = None) -> None:
        for name in self.limits:
            address = self.model.jnt_dofadr[self.model.joint(name).id]
            self.data.qfrc_applied[address] = (push or {}).get(name, 0.0)
        mujoco.mj_step(self.model, self.data, max(1, round(seconds / self.model.opt.timestep)))

    def energy(self) -> float | None:
        """Potential energy of gravity and springs, and kinetic energy."""
        mujoco.mj_forward(self.model, self.data)
        return float(self.data.energy.sum())

    def lowest(self) -> float | None:
        heights = [
            self._lowest(g)
            for g in range(self.model.ngeom)
            if (self.model.geom_contype[g] or self.model.geom_conaffinity[g]) and self.model.geom_bodyid[g]
        ]
        return min(heights, default=None)

    def _lowest(self, g: int) -> float:
        model, R, at = self.model, self.data.geom_xmat[g].reshape(3, 3), self.data.geom_xpos[g][2]
        size, down = model.geom_size[g], np.abs(R[2])
        match mujoco.mjtGeom(int(model.geom_type[g])):
            case mujoco.mjtGeom.mjGEOM_MESH:
                first, count = (int(a[model.geom_dataid[g]]) for a in (model.mesh_vertadr, model.mesh_vertnum))
                return float((model.mesh_vert[first : first + count] @ R[2]).min() + at)
            case mujoco.mjtGeom.mjGEOM_BOX:
                return float(at - down @ size)
            case mujoco.mjtGeom.mjGEOM_SPHERE:
                return float(at - size[0])
            case mujoco.mjtGeom.mjGEOM_CAPSULE:
                return float(at - size[0] - down[2] * size[1])
            case mujoco.mjtGeom.mjGEOM_CYLINDER:
                return float(at - np.hypot(*R[2, :2]) * size[0] - down[2] * size[1])
            case mujoco.mjtGeom.mjGEOM_ELLIPSOID:
                return float(at - np.linalg.norm(R[2] * size))
        return float(at)
