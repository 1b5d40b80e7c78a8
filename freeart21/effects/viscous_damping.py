"""Viscous damping: force against the motion, proportional to speed."""

from dataclasses import dataclass
from typing import Any, ClassVar

from freeart21.effects.base import Acts, Alternative, Effect, OperatingPoint, parameter


@dataclass(frozen=True)
class ViscousDamping(Effect):
    """force = -coefficient * qd."""

    name: ClassVar[str] = "viscous_damping"
    acts: ClassVar[Acts] = "force"
    label: ClassVar[str] = "viscous damping"
    drivetrain: ClassVar[bool] = True
    joint_word: ClassVar[str | None] = "damping"
    dissipates: ClassVar[bool] = True
    common: ClassVar[bool] = True
    basis_of: ClassVar[tuple[str, ...]] = ("velocity",)
    model_error: ClassVar[tuple[float, float]] = (0.2, 0.1)  # oils are shear-thinning; films are even

    coefficient: float = parameter("N*m*s/rad", "N*s/m", 0.0, 1e4, "force per speed", scale=0.1)

    def alternatives(self, at: OperatingPoint) -> list[Alternative]:
        """Drag as strong at half the top speed."""
        return [Alternative("quadratic_drag", {"coefficient": 2 * self.coefficient / at.speed})]

    @staticmethod
    def law(q: Any, qd: Any, load: Any, memory: Any, coefficient: Any) -> Any:
        return -coefficient * qd

    def damping(self) -> float:
        return self.coefficient

    def urdf_dynamics(self) -> dict[str, float]:
        return {"damping": self.coefficient}

    def mjcf_joint(self) -> dict[str, float | tuple[float, ...]]:
        return {"damping": self.coefficient}
