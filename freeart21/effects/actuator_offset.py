"""Actuator offset: the actuator gives a constant force besides what was commanded, as a current sensor whose zero is
off makes it do."""

from dataclasses import dataclass
from typing import ClassVar

from freeart21.effects.base import Acts, Effect, parameter


@dataclass(frozen=True)
class ActuatorOffset(Effect):
    """Force of the actuator = what its law or its commanded effort asks for + bias, while it is on.

    What is always on and stands still cannot tell it from a pull of gravity or of a spring: runs with the actuator off,
    or over a range in which those change, do. Of a slider that is always on, it is `gravity_offset`'s constant. Under
    a position law alone it is a command that is off by bias / stiffness.
    """

    name: ClassVar[str] = "actuator_offset"
    acts: ClassVar[Acts] = "command"
    label: ClassVar[str] = "a drive that pushes a little without being told"
    needs_effort: ClassVar[bool] = True
    common: ClassVar[bool] = True
    model_error: ClassVar[tuple[float, float]] = (0.05, 0.05)  # a zero that drifts; not measured

    bias: float = parameter("N*m", "N", -1e4, 1e4, "force without a command", scale=0.1)

    def bias_force(self) -> float:
        return self.bias
