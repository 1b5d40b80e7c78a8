"""Actuator gain: the actuator gives another force than was commanded."""

from dataclasses import dataclass
from typing import ClassVar

from freeart21.effects.base import Acts, Effect, parameter


@dataclass(frozen=True)
class ActuatorGain(Effect):
    """Force of the actuator = factor * the force that its law or its commanded effort asks for."""

    name: ClassVar[str] = "actuator_gain"
    acts: ClassVar[Acts] = "command"
    plain: ClassVar[str] = "a drive weaker or stronger than told"
    of_drive: ClassVar[bool] = True
    neutral: ClassVar[float] = 1.0
    common: ClassVar[bool] = True
    departs: ClassVar[tuple[float, float]] = (0.05, 0.05)  # motors saturate a little

    factor: float = parameter("1", "1", 0.0, 100.0, "force per commanded force", scale=1.0)

    def gain(self) -> float:
        return self.factor
