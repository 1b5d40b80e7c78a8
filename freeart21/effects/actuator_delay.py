"""Actuator delay: commands act later."""

from dataclasses import dataclass
from typing import ClassVar

from freeart21.effects.base import Acts, Effect, parameter


@dataclass(frozen=True)
class ActuatorDelay(Effect):
    """The actuator's force at time t follows the command of t - seconds and the joint's state at t."""

    name: ClassVar[str] = "actuator_delay"
    acts: ClassVar[Acts] = "command"
    label: ClassVar[str] = "a drive that acts late"
    model_error: ClassVar[tuple[float, float]] = (0.05, 0.05)  # part of it may be a first-order lag

    seconds: float = parameter("s", "s", 0.0, 10.0, "time from command to force", scale=0.01)

    def delay(self) -> float:
        return self.seconds
