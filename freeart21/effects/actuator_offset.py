"""Actuator offset: the actuator adds a constant force, for example by the zero error of its current sensor."""

from dataclasses import dataclass
from typing import ClassVar

from freeart21.effects.base import Acts, Effect, FitRange, OperatingPoint, parameter


@dataclass(frozen=True)
class ActuatorOffset(Effect):
    """Force of the actuator = commanded force + bias, while it is on.

    An actuator that is always on, with the joint at rest, does not separate it from gravity or a spring. Runs with the
    actuator off, or over a range where those change, do. On a slider that is always on it equals `gravity_offset`'s
    constant. With a position law alone it is a command error of bias / stiffness.
    """

    name: ClassVar[str] = "actuator_offset"
    acts: ClassVar[Acts] = "command"
    label: ClassVar[str] = "a drive that pushes without a command"
    needs_effort: ClassVar[bool] = True
    common: ClassVar[bool] = True
    model_error: ClassVar[tuple[float, float]] = (0.05, 0.05)  # a zero that drifts; not measured

    bias: float = parameter("N*m", "N", -1e4, 1e4, "force without a command", scale=0.1)

    @classmethod
    def fit_range(cls, name: str, at: OperatingPoint) -> FitRange:
        return super().fit_range(name, at)._replace(size=0.1 * at.force)

    def bias_force(self) -> float:
        return self.bias
