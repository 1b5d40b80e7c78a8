"""Loads an asset's URDF into SAPIEN as one free joint without any loss or limit of the engine's own."""

from __future__ import annotations

import copy
import tempfile
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from freeart21 import processes, se3
from freeart21.asset import Asset
from freeart21.errors import FreeArtError
from freeart21.files.urdf import Urdf, UrdfJoint, UrdfLink, UrdfShape, format_urdf, subtree_links
from freeart21.files.urdf_files import find_file

UNREACHED = 1e4
"""rad or m: engine limits that no joint reaches."""
_MAX_SPEED = 1e6  # rad/s or m/s: the engine's speed limits are raised to this
_COLLISION_GROUPS = [1, 1, 1 << 15, 0]  # a common bit of the third word: links of assets never collide with each other


def physics_scene(gravity: NDArray[np.float32]) -> Any:
    """A scene without a graphics device, under `gravity` (3,) m/s^2.

    SAPIEN takes gravity from a setting of the whole process, which is restored here.
    """
    import sapien

    before = sapien.physx.get_scene_config()
    config = copy.copy(before)
    config.gravity = gravity
    sapien.physx.set_scene_config(config)
    try:
        return sapien.Scene([sapien.physx.PhysxCpuSystem()])
    finally:
        sapien.physx.set_scene_config(before)


def build_articulation(
    asset: Asset,
    urdf: Urdf,
    joint: UrdfJoint,
    scene: Any,
    *,
    fixed_base: bool,
    visuals: bool,
    collisions: bool,
    settable_limits: bool,
) -> Any:
    """SAPIEN's articulation of `asset` in `scene`: only `joint` moves, all others are frozen.

    Args:
        asset: its `held` says where the other joints are frozen; else at the position nearest to zero in their limits.
        urdf: the asset's, read.
        joint: the one that moves.
        scene: a `sapien.Scene`.
        fixed_base: fix the root link to the world.
        visuals: load visual meshes.
        collisions: load collision shapes also of links with an `<inertial>`.
        settable_limits: make a joint whose engine limits can be set later; they are `UNREACHED` until then.

    Raises FreeArtError when the URDF is not one tree with the asset's links, or SAPIEN cannot read a file.
    """
    _check_tree(asset, urdf)
    beyond = subtree_links(urdf.joints, joint.child)
    if (asset.reference_link in beyond) == (asset.moving_link in beyond):
        raise FreeArtError(
            f"{asset.urdf}: links '{asset.reference_link}' and '{asset.moving_link}' are on the same "
            f"side of joint '{joint.name}', expected one on each side"
        )
    robot, joints = _urdf_for_sapien(asset, urdf, visuals, collisions), urdf.joints
    builder = _articulation_builder(asset.urdf, robot, scene)
    for link in builder.link_builders:
        link.collision_groups = _COLLISION_GROUPS
        record = link.joint_record
        if record.name == joint.name:
            record.limits = [[-UNREACHED, UNREACHED]] if settable_limits else [[-np.inf, np.inf]]
            if joint.joint_type == "revolute":
                record.joint_type = "revolute_unwrapped"
        elif record.name in joints and joints[record.name].joint_type:
            other = joints[record.name]
            _freeze(record, asset.held.get(other.name, float(np.clip(0.0, other.lower, other.upper))))
    try:
        articulation = builder.build(fix_root_link=fixed_base)
    except Exception as error:  # SAPIEN raises Exception itself
        raise _cannot_load(asset.urdf, error) from error
    if visuals:
        read_files_now(articulation)
    _remove_losses(articulation)
    return articulation


def read_files_now(articulation: Any) -> None:
    """Let SAPIEN read mesh files and pictures now, not at the first view: the files may be temporary."""
    import sapien

    for link in articulation.links:
        body = link.entity.find_component_by_type(sapien.render.RenderBodyComponent)
        for shape in body.render_shapes if body is not None else ():
            _ = getattr(shape, "parts", None)


def links_from(articulation: Any, first: str) -> list[Any]:
    """The link named `first` and all links that descend from it."""
    names, links = {first}, []
    for link in articulation.links:  # parents come before children
        if link.name in names or (link.parent is not None and link.parent.name in names):
            names.add(link.name)
            links.append(link)
    return links


def _articulation_builder(urdf: Path, robot: Urdf, scene: Any) -> Any:
    """SAPIEN's articulation builder of the rewritten URDF `robot`."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "asset.urdf"
        path.write_bytes(format_urdf(robot))
        try:
            articulations, actors, _ = scene.create_urdf_loader().parse(str(path))
        except Exception as error:  # SAPIEN raises Exception itself
            raise _cannot_load(urdf, error) from error
    if len(articulations) != 1 or actors:
        raise FreeArtError(
            f"{urdf} holds {len(articulations)} articulations and {len(actors)} loose bodies, expected one articulation"
        )
    return articulations[0]


def _cannot_load(urdf: Path, error: Exception) -> FreeArtError:
    return FreeArtError(f"{urdf} cannot be loaded by SAPIEN: {processes.one_line(error)}")


def _remove_losses(articulation: Any) -> None:
    """Switch off the engine's own sleeping, damping, friction, armature and speed limits."""
    articulation.set_sleep_threshold(0.0)
    for link in articulation.links:
        link.set_linear_damping(0.0)
        link.set_angular_damping(0.0)
        link.set_max_linear_velocity(_MAX_SPEED)
        link.set_max_angular_velocity(_MAX_SPEED)
    for joint in articulation.active_joints:
        joint.set_friction(0.0)
        joint.set_armature(np.zeros(joint.dof, np.float32))
        joint.set_max_velocity(_MAX_SPEED)


def _freeze(record: Any, q: float) -> None:
    """Turn a movable joint of a builder into a fixed one at position `q`: its axis is the x axis of its frame."""
    import sapien

    motion = se3.exp_se3(np.eye(6)[0] * q if record.joint_type == "prismatic" else np.eye(6)[3] * q)
    record.pose_in_parent = record.pose_in_parent * sapien.Pose(motion.astype(np.float32))
    record.joint_type, record.limits = "fixed", []


def _urdf_for_sapien(asset: Asset, urdf: Urdf, visuals: bool, collisions: bool) -> Urdf:
    """The URDF with absolute file names and complete limits, without what the simulation does not need."""

    def with_file(_: str, shape: UrdfShape) -> UrdfShape:
        names = (
            str(find_file(asset.urdf, name, asset.root)) if name else "" for name in (shape.filename, shape.texture)
        )
        filename, texture = names
        return replace(shape, filename=filename, texture=texture)

    def needed(link: UrdfLink) -> UrdfLink:
        has_mass = link.inertial is not None and link.inertial.mass > 0
        return replace(
            link,
            visuals=link.visuals if visuals else (),
            collisions=link.collisions if collisions or not has_mass else (),
        )

    joints = {
        joint.name: replace(
            joint, limited=joint.type != "continuous", mimic=None, damping=0.0, friction=0.0, effort=None, velocity=None
        )
        for joint in urdf.joints.values()
    }
    named = urdf.with_shapes(with_file)
    return replace(named, links={n: needed(link) for n, link in named.links.items()}, joints=joints, mujoco={})


def _check_tree(asset: Asset, urdf: Urdf) -> None:
    """FreeArtError unless the URDF has one root, the asset's links and joints of known types."""
    for joint in urdf.joints.values():
        if joint.joint_type is None and joint.type != "fixed":
            raise FreeArtError(
                f"{urdf.path}: joint '{joint.name}' has type '{joint.type}', expected fixed, revolute, continuous or "
                "prismatic"
            )
    for link in (urdf.root, asset.reference_link, asset.moving_link):  # `root` raises unless there is one
        if link not in urdf.links:
            raise FreeArtError(f"{urdf.path} has no link '{link}'; links: {', '.join(urdf.links)}")
