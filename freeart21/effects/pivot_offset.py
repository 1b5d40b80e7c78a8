"""Pivot offset: a hinge's axis is shifted from where the asset has it."""

from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np
from numpy.typing import ArrayLike

from freeart21 import se3
from freeart21.effects.base import Acts, Effect, Kind, parameter, perpendiculars
from freeart21.mechanics import JointMechanics
from freeart21.se3 import Array


@dataclass(frozen=True)
class PivotOffset(Effect):
    """True pivot = pivot + along_first * first + along_second * second, with `first, second = perpendiculars(axis)`. A
    slider has no pivot. URDF's joint origin can express it."""

    name: ClassVar[str] = "pivot_offset"
    kind: ClassVar[Kind] = "kinematics"
    acts: ClassVar[Acts] = "pose"
    label: ClassVar[str] = "an axis that lies elsewhere"
    joint_types: ClassVar[tuple[str, ...]] = ("revolute",)

    along_first: float = parameter("m", None, -10.0, 10.0, "shift along the first direction", scale=0.005)
    along_second: float = parameter("m", None, -10.0, 10.0, "shift along the second direction", scale=0.005)

    def displacement(self, q: ArrayLike, t: ArrayLike, mechanics: JointMechanics) -> Array:
        joint, (first, second) = mechanics.joint, perpendiculars(mechanics.joint.axis)
        pivot = joint.pivot + self.along_first * first + self.along_second * second
        return np.asarray(replace(joint, pivot=pivot).transform(q) @ se3.inverse(joint.transform(q)))
