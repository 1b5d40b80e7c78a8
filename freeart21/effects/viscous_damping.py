"""Viscous damping: a force against the motion, in proportion to its speed."""

from dataclasses import dataclass
from typing import ClassVar, Literal

from freeart21.effects.base import Effect, parameter


@dataclass(frozen=True)
class ViscousDamping(Effect):
    """force = -coefficient * qd."""

    name: ClassVar[str] = "viscous_damping"
    acts: ClassVar[Literal["force", "drive"]] = "force"

    coefficient: float = parameter("N*m*s/rad", "N*s/m", 0.0, 1e4, "force per speed")

    def force(self, q: float, qd: float, t: float) -> float:
        return -self.coefficient * qd

    def urdf_dynamics(self) -> dict[str, float]:
        return {"damping": self.coefficient}

    def mjcf_joint(self) -> dict[str, float]:
        return {"damping": self.coefficient}
