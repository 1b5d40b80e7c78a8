"""Actuator gain: the actuator's force is a multiple of the commanded one."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from freeart21.effects.base import Acts, Alternative, Effect, OperatingPoint, parameter

MOST_USUAL = 1.5
"""Largest plausible factor, from tolerances of voltage and windings. By inverse dynamics a hobby servo's logs have 1.0
to 1.5; more stands for a loss outside the model."""


@dataclass(frozen=True)
class ActuatorGain(Effect):
    """Force of the actuator = factor * commanded force (of its position law or effort)."""

    name: ClassVar[str] = "actuator_gain"
    acts: ClassVar[Acts] = "command"
    label: ClassVar[str] = "a drive weaker or stronger than commanded"
    drivetrain: ClassVar[bool] = True
    neutral: ClassVar[float] = 1.0
    common: ClassVar[bool] = True
    model_error: ClassVar[tuple[float, float]] = (0.05, 0.05)  # motors saturate a little

    factor: float = parameter("1", "1", 0.0, 100.0, "force per commanded force", scale=1.0)

    def alternatives(self, at: OperatingPoint) -> list[Alternative]:
        """Gravity times 1 / factor, which moves the same with 1 / factor times the inertia. For a hanging hinge and a
        weaker drive also the spring that this is in small motions."""
        more = 1 / max(self.factor, 1e-9) - 1
        cosine, sine, constant = (more * term for term in at.gravity)
        if at.joint_type != "revolute":
            return [Alternative("gravity_offset", {"constant": constant})]
        found = [Alternative("gravity_offset", {"cosine": cosine, "sine": sine})]
        stiffness, rest = float(np.hypot(cosine, sine)), float(np.arctan2(cosine, -sine))
        if more > 0 and stiffness > 0:
            found.append(Alternative("return_spring", {"stiffness": stiffness, "rest": rest}))
        return found

    def gain(self) -> float:
        return self.factor

    def is_plausible(self) -> bool:
        return 1 / MOST_USUAL < self.factor < MOST_USUAL
