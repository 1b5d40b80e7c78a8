"""Screw pitch: a hinge that also moves along its axis, or a slider that also turns about it."""

from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np
from numpy.typing import ArrayLike

from freeart21.effects.base import Acts, Effect, Kind, parameter
from freeart21.mechanics import JointMechanics
from freeart21.se3 import Array


@dataclass(frozen=True)
class ScrewPitch(Effect):
    """Revolute: shift of pitch * q along the axis. Prismatic: rotation by pitch * q about the axis through the joint's
    origin. The helical pair."""

    name: ClassVar[str] = "screw_pitch"
    kind: ClassVar[Kind] = "kinematics"
    acts: ClassVar[Acts] = "pose"
    label: ClassVar[str] = "a thread: it shifts along its axis as it turns"

    pitch: float = parameter("m/rad", "rad/m", -100.0, 100.0, "second motion per first", scale=0.005)

    def displacement(self, q: ArrayLike, t: ArrayLike, mechanics: JointMechanics) -> Array:
        joint = mechanics.joint
        other = replace(joint, type="prismatic" if joint.type == "revolute" else "revolute")
        return other.transform(self.pitch * np.asarray(q, float))
