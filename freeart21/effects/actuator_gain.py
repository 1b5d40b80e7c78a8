"""Actuator gain: the actuator gives another force than was commanded."""

from dataclasses import dataclass
from typing import ClassVar

from freeart21.effects.base import Acts, Effect, parameter

MOST_USUAL = 1.5
"""Times what it is told that a drive gives at most, by what its voltage and its windings may be off. By inverse
dynamics a hobby servo's logs have 1.0 to 1.5; more stands for a loss that is not the model's."""


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

    def is_usual(self) -> bool:
        return 1 / MOST_USUAL < self.factor < MOST_USUAL
