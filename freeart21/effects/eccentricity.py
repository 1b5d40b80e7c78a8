"""Eccentricity: a hinge's pin is out of round, so the pivot wanders as the joint turns."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import ArrayLike

from freeart21 import se3
from freeart21.effects.base import Acts, Effect, Kind, parameter, perpendiculars
from freeart21.mechanics import JointMechanics
from freeart21.se3 import Array


@dataclass(frozen=True)
class Eccentricity(Effect):
    """Shift by amplitude * (cos(2 q + phase) * first + sin(2 q + phase) * second), in the basis `perpendiculars(axis)`.

    Two turns of the shift per turn of the joint: the first harmonic that no ideal hinge explains (none, or one, is a
    pivot offset).
    """

    name: ClassVar[str] = "eccentricity"
    kind: ClassVar[Kind] = "kinematics"
    acts: ClassVar[Acts] = "pose"
    label: ClassVar[str] = "a pin out of round"
    polar: ClassVar[bool] = True
    joint_types: ClassVar[tuple[str, ...]] = ("revolute",)

    amplitude: float = parameter("m", None, 0.0, 1.0, "how far the pivot wanders", scale=0.002)
    phase: float = parameter("rad", None, -7.0, 7.0, "direction of the shift at q = 0", scale=1.0)

    def displacement(self, q: ArrayLike, t: ArrayLike, mechanics: JointMechanics) -> Array:
        first, second = perpendiculars(mechanics.joint.axis)
        angle = 2 * np.asarray(q, float)[..., None] + self.phase
        shift = self.amplitude * (np.cos(angle) * first + np.sin(angle) * second)
        return se3.pose(np.broadcast_to(np.eye(3), (*shift.shape[:-1], 3, 3)), shift)
