"""Quadratic drag: force against the motion, proportional to speed squared, like that of air."""

from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from freeart21.effects.base import Acts, Alternative, Effect, OperatingPoint, parameter


@dataclass(frozen=True)
class QuadraticDrag(Effect):
    """force = -coefficient * qd * |qd|: the drag equation with density, area, drag coefficient and lever arms in one
    number. URDF cannot express it, MJCF only from MuJoCo 3.7 on."""

    name: ClassVar[str] = "quadratic_drag"
    acts: ClassVar[Acts] = "force"
    label: ClassVar[str] = "drag that grows with the square of speed"
    joint_word: ClassVar[str | None] = "drag"
    dissipates: ClassVar[bool] = True
    common: ClassVar[bool] = True
    basis_of: ClassVar[tuple[str, ...]] = ("velocity",)
    model_error: ClassVar[tuple[float, float]] = (0.2, 0.1)  # the power is not quite 2

    coefficient: float = parameter("N*m*s^2/rad^2", "N*s^2/m^2", 0.0, 1e4, "force per speed squared", scale=0.01)

    def alternatives(self, at: OperatingPoint) -> list[Alternative]:
        """Damping as strong at half the top speed."""
        return [Alternative("viscous_damping", {"coefficient": 0.5 * at.speed * self.coefficient})]

    @staticmethod
    def law(q: Any, qd: Any, load: Any, memory: Any, coefficient: Any) -> Any:
        return -coefficient * qd * np.abs(qd)

    def mjcf_joint(self) -> dict[str, float | tuple[float, ...]]:
        return {"damping": (0.0, self.coefficient)}
