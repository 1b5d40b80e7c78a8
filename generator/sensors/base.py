"""What a sensor model is."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar, Literal

import numpy as np
from numpy.typing import NDArray

from freeart21.joint import Joint
from freeart21.mesh import Mesh
from freeart21.se3 import Array
from generator.motion import Plan
from generator.scene import Scene, Skin


@dataclass(frozen=True)
class Video:
    """What a sensor films."""

    scene: Scene
    plan: Plan
    joint: Joint
    meshes: tuple[Mesh, Mesh]
    """Parent side and child side in the object's frame at joint state zero."""
    seed: int
    """Of everything random."""


class SensorModel:
    """One thing that a camera, or what is before it, adds to a clean video. A subclass overrides what it changes."""

    name: ClassVar[str]
    replaces: ClassVar[Literal["depth", "all"] | None] = None
    """'depth': gives depth of its own, so that no other such sensor may be joined; 'all': joined with no other."""
    occludes: ClassVar[bool] = False
    """Whether it may hide the object in some frames."""
    averages: ClassVar[bool] = False
    """Whether a frame is the mean of several renderings (`sub_frames`)."""

    def __init__(self, video: Video) -> None:
        self.video = video

    def pieces(self) -> Sequence[Sequence[Skin]]:
        """Rigid things that stand in the scene besides the object."""
        return ()

    def depth(self, depth: NDArray[np.float32], rng: np.random.Generator) -> NDArray[np.float32]:
        """(height, width) depth as measured, m, 0 where there is none, of what was rendered; `rng` of the frame."""
        return depth

    def piece_poses(self, t: float, T_camera_object: Array, state: float) -> Array:
        """(k, 4, 4) camera from each of `pieces` at time `t`, in frames."""
        return np.zeros((0, 4, 4))

    def sub_frames(self, motion_px: float) -> int:
        """How many renderings make up a frame in which the picture moves by `motion_px`; odd."""
        return 1
