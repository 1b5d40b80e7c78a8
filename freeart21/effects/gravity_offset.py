"""Gravity offset: error of gravity's torque or force in the asset."""

from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from freeart21.effects.base import Acts, Alternative, Effect, OperatingPoint, parameter


@dataclass(frozen=True)
class GravityOffset(Effect):
    """force = cosine * cos(q) + sine * sin(q) on a revolute joint, constant on a prismatic one.

    Any error of mass, centre of mass and tilt of the base changes gravity's torque by just these terms, so the joint's
    motion alone does not separate these causes. The change of inertia is not included. URDF's <inertial> and MJCF's can
    express one cause, once it is known.
    """

    name: ClassVar[str] = "gravity_offset"
    acts: ClassVar[Acts] = "force"
    label: ClassVar[str] = "a pull of gravity other than the model's"
    common: ClassVar[bool] = True
    speed_dependent: ClassVar[bool] = False
    model_error: ClassVar[tuple[float, float]] = (0.0, 0.1)  # base or rails bend

    cosine: float = parameter("N*m", None, -1e4, 1e4, "torque at q = 0", scale=0.1, default=0.0)
    sine: float = parameter("N*m", None, -1e4, 1e4, "torque at q = 90 degrees", scale=0.1, default=0.0)
    constant: float = parameter(None, "N", -1e4, 1e4, "force along the axis", scale=0.1, default=0.0)

    def alternatives(self, at: OperatingPoint) -> list[Alternative]:
        """A zero error of the sensor, for a hinge's gravity of another direction; see there."""
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
