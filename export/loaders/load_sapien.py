"""This asset in SAPIEN 3, with what its URDF loader drops put back. Measured with SAPIEN 3.0.3 on a CPU.

SAPIEN drops a URDF's friction and velocity limit, has friction of 0.05 of the joint's load, damps every link by 5 % a
second and lets slow bodies fall asleep. Here the joint has the asset's own damping, spring and armature, and Coulomb
friction by a second drive between the two links, a damper that is cut off at the friction's size.

The size of that cut is an impulse, so it is set for the scene's time step: call `load` after `scene.set_timestep`.
"""

from __future__ import annotations

import json
import warnings
from pathlib import Path
from typing import Any

PLAYED = {"damping", "friction", "armature", "stiffness"}
CREEP = 1e-6  # rad/s or m/s at which the friction's damper is cut off


def load(scene: Any, pose: Any = None, fixed: bool | None = None) -> Any:
    """The articulation in `scene` (a sapien.Scene), its root at `pose`; `fixed` None takes the asset's own base."""
    import sapien

    here = Path(__file__).resolve().parent
    said = json.loads((here / "joint.json").read_text())
    if said["base"] == "fixed" and fixed is False:
        raise ValueError(f"{said['urdf']} was exported with a fixed base and cannot move freely")
    if said["trust"].startswith("doubtful"):
        warnings.warn(f"{said['urdf']} was made of a reconstruction that is {said['trust']}", stacklevel=2)
    if left := [name for name, word in said["effects"].items() if word not in PLAYED]:
        warnings.warn(f"SAPIEN plays {said['urdf']} without {', '.join(left)}", stacklevel=2)

    loader = scene.create_urdf_loader()
    builders, _, _ = loader.parse(str(here.parent / said["urdf"]))
    try:
        scene.render_system  # noqa: B018
    except RuntimeError:  # a scene of physics only could not take what is for the eye
        for link in builders[0].link_builders:
            link.visual_records.clear()
    articulation = builders[0].build(fix_root_link=said["base"] == "fixed" if fixed is None else fixed)
    if pose is not None:
        articulation.set_root_pose(pose)

    articulation.set_sleep_threshold(0)
    for link in articulation.links:
        link.set_linear_damping(0)
        link.set_angular_damping(0)
    joint = next(j for j in articulation.active_joints if j.name == said["joint"])
    joint.set_friction(0)
    joint.set_drive_properties(stiffness=said["stiffness"], damping=said["damping"], mode="force")
    joint.set_drive_target(said["rest"])
    joint.set_armature([said["armature"]])
    if said["velocity"]:
        joint.set_max_velocity(said["velocity"])
    if said["friction"]:
        drive = sapien.physx.PhysxDriveComponent(joint.child_link)
        drive.parent = joint.parent_link
        drive.set_pose_in_parent(joint.pose_in_parent)
        drive.set_pose_in_child(joint.pose_in_child)
        limit = said["friction"] * scene.timestep
        act = drive.set_drive_property_twist if said["type"] == "revolute" else drive.set_drive_property_x
        act(0.0, said["friction"] / CREEP, limit, "force")
        joint.child_link.entity.add_component(drive)
    return articulation
