"""The scripted motions of the recorder."""

from __future__ import annotations

from freeart21.camera import Camera
from freeart21.errors import FreeArtError
from freeart21.joint import Joint
from freeart21.mesh import Mesh
from freeart21.se3 import Array
from generator.motion.plan import MOTIONS, PRESETS, Plan, Preset
from generator.motion.tumble import hull_points, joint_course, motion_range, plan_tumble

__all__ = [
    "MOTIONS",
    "PRESETS",
    "Plan",
    "Preset",
    "hull_points",
    "joint_course",
    "motion_range",
    "plan_motion",
    "plan_tumble",
]


def plan_motion(
    style: str,
    meshes: tuple[Mesh, Mesh],
    joint: Joint,
    camera: Camera,
    frames: int,
    fps: float,
    seed: int,
    preset: Preset = PRESETS["handheld"],
    states: Array | None = None,
    hard: bool | None = None,
) -> Plan:
    """The motion `style` of an object: a plan of `frames` poses and states, all of which follow from the seed.

    Args:
        style: one of MOTIONS.
        meshes: the sides of the joint, parent and child, in the object's frame, of the preset's size.
        joint: what moves the second mesh.
        camera: intrinsics; the object stays inside its picture.
        frames: 2 or more.
        fps: frames a second.
        seed: of everything random.
        preset: size and distance.
        states: (frames,) joint states to take, rad or m, instead of planned ones; 'release' needs them.
        hard: whether the smaller part is to be hidden for long; None lets the seed decide.

    Raises FreeArtError for an unknown style and for states that do not fit.
    """
    if style not in MOTIONS:
        raise FreeArtError(f"unknown motion '{style}'; motions: {', '.join(MOTIONS)}")
    return plan_tumble(meshes, joint, camera, frames, fps, seed)
