"""Loads this asset into SAPIEN 3 and restores what its URDF loader drops. Tested with SAPIEN 3.0.3 on a CPU.

SAPIEN drops a URDF's friction and velocity limit, has friction of 0.05 of the joint's load, damps every link by 5 % a
second, and lets slow bodies sleep. Here the joint has the asset's own damping, spring and armature. Coulomb friction is
a second drive between the two links, a damper limited to the friction's size.

That limit is an impulse, set for the scene's time step: call `load` after `scene.set_timestep`.
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
    info = json.loads((here / "joint.json").read_text())
    if info["base"] == "fixed" and fixed is False:
        raise ValueError(f"{info['urdf']} was exported with a fixed base and cannot move freely")
    if info["trust"].startswith("doubtful"):
        warnings.warn(f"{info['urdf']} was made of a reconstruction that is {info['trust']}", stacklevel=2)
    if ignored := [name for name, word in info["effects"].items() if word not in PLAYED]:
        warnings.warn(f"SAPIEN plays {info['urdf']} without {', '.join(ignored)}", stacklevel=2)

    loader = scene.create_urdf_loader()
    builders, _, _ = loader.parse(str(here.parent / info["urdf"]))
    try:
        scene.render_system  # noqa: B018
    except RuntimeError:  # a scene without a renderer takes no visuals
        for link in builders[0].link_builders:
            link.visual_records.clear()
    articulation = builders[0].build(fix_root_link=info["base"] == "fixed" if fixed is None else fixed)
    if pose is not None:
        articulation.set_root_pose(pose)

    for link in articulation.links:
        if surface := info["surfaces"].get(link.name):
            friction, restitution = surface["friction"], surface["restitution"]
            material = sapien.physx.PhysxMaterial(friction, friction, restitution)
            for shape in link.collision_shapes:
                shape.set_physical_material(material)
    articulation.set_sleep_threshold(0)
    for link in articulation.links:
        link.set_linear_damping(0)
        link.set_angular_damping(0)
    joint = next(j for j in articulation.active_joints if j.name == info["joint"])
    joint.set_friction(0)
    joint.set_drive_properties(stiffness=info["stiffness"], damping=info["damping"], mode="force")
    joint.set_drive_target(info["rest"])
    joint.set_armature([info["armature"]])
    if info["velocity"]:
        joint.set_max_velocity(info["velocity"])
    if info["friction"]:
        drive = sapien.physx.PhysxDriveComponent(joint.child_link)
        drive.parent = joint.parent_link
        drive.set_pose_in_parent(joint.pose_in_parent)
        drive.set_pose_in_child(joint.pose_in_child)
        limit = info["friction"] * scene.timestep
        act = drive.set_drive_property_twist if info["type"] == "revolute" else drive.set_drive_property_x
        act(0.0, info["friction"] / CREEP, limit, "force")
        joint.child_link.entity.add_component(drive)
    return articulation
