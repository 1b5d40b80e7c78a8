"""Sag: the joint yields under the moving part's weight, like a drooping door or a tipping drawer."""

from dataclasses import dataclass
from typing import ClassVar

from numpy.typing import ArrayLike

from freeart21 import se3
from freeart21.effects.base import Acts, Effect, Kind, parameter
from freeart21.mechanics import JointMechanics
from freeart21.se3 import Array


@dataclass(frozen=True)
class Sag(Effect):
    """Rotation about the pivot by compliance * M, with M the component of gravity's moment across the axis
    (`JointMechanics.gravity_moment`): a bearing of equal stiffness in both directions across its axis."""

    name: ClassVar[str] = "sag"
    kind: ClassVar[Kind] = "kinematics"
    acts: ClassVar[Acts] = "pose"
    label: ClassVar[str] = "sagging under its weight"
    experiment: ClassVar[str] = (
        "Tip the base by some 30 degrees and record again: a joint that sags follows gravity, crooked parts do not."
    )

    compliance: float = parameter("rad/(N*m)", "rad/(N*m)", 0.0, 1000.0, "turn per moment", scale=1e-3)

    def displacement(self, q: ArrayLike, t: ArrayLike, mechanics: JointMechanics) -> Array:
        joint = mechanics.joint
        moment = mechanics.gravity_moment(q)
        across = moment - (moment @ joint.axis)[..., None] * joint.axis
        R = se3.exp_so3(self.compliance * across)
        return se3.pose(R, joint.pivot - R @ joint.pivot)
