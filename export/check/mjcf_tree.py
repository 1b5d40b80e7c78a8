"""Bodies and joints of an MJCF as a tree, as MuJoCo reads it.

Bodies have at most one hinge or slide each (and a free joint at the top); everything else raises UnsupportedMjcf.
"""

from __future__ import annotations

from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np

from export.check.tree import Tree
from freeart21 import se3
from freeart21.errors import FreeArtError
from freeart21.files.urdf import UrdfInertial, UrdfJoint


class UnsupportedMjcf(Exception):
    """The file has what a tree cannot express."""


def read_mjcf_tree(mjcf: Path) -> Tree:
    """The tree of bodies below the world's only child. Its files must have been checked (`subject.find_subject`).

    Raises UnsupportedMjcf, or FreeArtError for what MuJoCo refuses.
    """
    model = _read_spec(mjcf, compiled=True)
    tops = [b for b in range(1, model.nbody) if model.body_parentid[b] == 0]
    if len(tops) != 1:
        raise UnsupportedMjcf(f"its world has {len(tops)} bodies")
    names = [model.body(b).name for b in range(model.nbody)]
    if not all(names[1:]):
        raise UnsupportedMjcf("a body has no name")
    joints, inertials = {}, {}
    for b in range(1, model.nbody):
        if model.body_mass[b] > 0:
            inertials[names[b]] = read_inertial(model, b)
        if b != tops[0]:
            joint = _read_joint(model, b, names)
            joints[joint.name] = joint
        elif model.body_dofnum[b] not in (0, 6):
            raise UnsupportedMjcf(f"body '{names[b]}' is attached to the world by a joint")
    return Tree(names[tops[0]], tuple(names[1:]), joints, inertials)


def read_inertial(model: Any, b: int) -> UrdfInertial:
    """Mass properties of body `b` of a mujoco.MjModel."""
    R = se3.rotation_from_wxyz(model.body_iquat[b])
    tensor = R @ np.diag(model.body_inertia[b]) @ R.T
    return UrdfInertial(float(model.body_mass[b]), model.body_ipos[b].copy(), tensor)


def count_shapes(mjcf: Path) -> dict[str, Counter[str]]:
    """Body name to its geoms, by mesh file or by the primitive's name, with their numbers."""
    spec = _read_spec(mjcf, compiled=False)
    files = {mesh.name: mesh.file for mesh in spec.meshes}
    return {
        body.name: Counter(files.get(g.meshname) or g.type.name.removeprefix("mjGEOM_").lower() for g in body.geoms)
        for body in spec.bodies
    }


def _read_spec(mjcf: Path, compiled: bool) -> Any:
    import mujoco

    try:
        spec = mujoco.MjSpec.from_file(str(mjcf))
        return spec.compile() if compiled else spec
    except ValueError as error:
        raise FreeArtError(f"{mjcf} cannot be read by MuJoCo: {' '.join(str(error).split())[:300]}") from error


def _read_joint(model: Any, b: int, names: list[str]) -> UrdfJoint:
    """The joint, or the rigid connection, of body `b` to its parent."""
    import mujoco

    T = se3.pose(se3.rotation_from_wxyz(model.body_quat[b]), model.body_pos[b])
    parent, child, count = names[model.body_parentid[b]], names[b], int(model.body_jntnum[b])
    if count == 0:
        return UrdfJoint(f"{child} (welded)", "fixed", parent, child, T, np.eye(3)[2])
    j = int(model.body_jntadr[b])
    kinds = {int(mujoco.mjtJoint.mjJNT_HINGE): "revolute", int(mujoco.mjtJoint.mjJNT_SLIDE): "prismatic"}
    kind: Any = kinds.get(int(model.jnt_type[j]))
    if count > 1 or kind is None or model.qpos0[model.jnt_qposadr[j]]:
        raise UnsupportedMjcf(f"body '{child}' has other joints than one hinge or slide without ref")
    lower, upper = model.jnt_range[j].tolist() if model.jnt_limited[j] else (-np.inf, np.inf)
    dof = int(model.jnt_dofadr[j])
    damping, friction = float(model.dof_damping[dof]), float(model.dof_frictionloss[dof])
    name, axis, pivot = model.joint(j).name or f"{child} (joint)", model.jnt_axis[j].copy(), model.jnt_pos[j].copy()
    return UrdfJoint(name, kind, parent, child, T, axis, lower, upper, True, None, None, damping, friction, pivot=pivot)
