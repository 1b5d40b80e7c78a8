"""Axis tilt: the joint's axis has another direction than in the asset."""

from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np
from numpy.typing import ArrayLike

from freeart21 import se3
from freeart21.effects.base import Acts, Effect, Kind, parameter, perpendiculars
from freeart21.mechanics import JointMechanics
from freeart21.se3 import Array


@dataclass(frozen=True)
class AxisTilt(Effect):
    """True axis = exp([about_first * first + about_second * second]x) axis, with `first, second =
    perpendiculars(axis)`, through the same pivot. URDF's joint origin can express it."""

    name: ClassVar[str] = "axis_tilt"
    kind: ClassVar[Kind] = "kinematics"
    acts: ClassVar[Acts] = "pose"
    label: ClassVar[str] = "an axis that points elsewhere"

    about_first: float = parameter("rad", "rad", -0.8, 0.8, "turn of the axis about the first direction", scale=0.02)
    about_second: float = parameter("rad", "rad", -0.8, 0.8, "turn of the axis about the second direction", scale=0.02)

    def displacement(self, q: ArrayLike, t: ArrayLike, mechanics: JointMechanics) -> Array:
        joint, (first, second) = mechanics.joint, perpendiculars(mechanics.joint.axis)
        axis = se3.exp_so3(self.about_first * first + self.about_second * second) @ joint.axis
        return np.asarray(replace(joint, axis=axis).transform(q) @ se3.inverse(joint.transform(q)))
