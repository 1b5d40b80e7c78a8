"""Gravity offset: gravity pulls otherwise than the asset's masses say."""

from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from freeart21.effects.base import Acts, Alternative, Effect, OperatingPoint, parameter


@dataclass(frozen=True)
class GravityOffset(Effect):
    """force = cosine * cos(q) + sine * sin(q) on a revolute joint, the constant on a prismatic one.

    Any error of mass, of centre of mass and of the base's tilt changes gravity's torque by just this, since the torque
    of m g at an arm that turns by q has no other terms; the joint's motion alone cannot tell these causes apart. What
    such an error does to the inertia is not in it. URDF's <inertial> and MJCF's can hold one cause, once it is known.
    """

    name: ClassVar[str] = "gravity_offset"
    acts: ClassVar[Acts] = "force"
    label: ClassVar[str] = "a pull of gravity other than the model's"
    common: ClassVar[bool] = True
    speed_dependent: ClassVar[bool] = False
    model_error: ClassVar[tuple[float, float]] = (0.0, 0.1)  # base or rails bend a little

    cosine: float = parameter("N*m", None, -1e4, 1e4, "torque at q = 0", scale=0.1, default=0.0)
    sine: float = parameter("N*m", None, -1e4, 1e4, "torque at q = 90 degrees", scale=0.1, default=0.0)
    constant: float = parameter(None, "N", -1e4, 1e4, "force along the axis", scale=0.1, default=0.0)

    def alternatives(self, at: OperatingPoint) -> list[Alternative]:
        """A sensor whose zero is off, for a hinge's gravity that pulls from elsewhere: see there."""
        cosine, sine, _ = at.gravity
        was = complex(cosine, sine)
        if at.joint_type != "revolute" or was == 0:
            return []
        turn = float(np.angle((was + complex(self.cosine, self.sine)) / was))
        return [Alternative("encoder_offset", {"offset": turn}, -turn)]

    @staticmethod
    def law(q: Any, qd: Any, load: Any, memory: Any, cosine: Any, sine: Any, constant: Any) -> Any:
        return cosine * np.cos(q) + sine * np.sin(q) + constant

    def steepness(self) -> float:
        return float(np.hypot(self.cosine, self.sine))
