"""Return spring: a force towards a rest position, in proportion to the distance from it."""

from dataclasses import dataclass
from typing import ClassVar, Literal

from freeart21.effects.base import Effect, parameter


@dataclass(frozen=True)
class ReturnSpring(Effect):
    """force = -stiffness * (q - rest). URDF has no word for it."""

    name: ClassVar[str] = "return_spring"
    acts: ClassVar[Literal["force", "drive"]] = "force"

    stiffness: float = parameter("N*m/rad", "N/m", 0.0, 1e6, "force per displacement")
    rest: float = parameter("rad", "m", -100.0, 100.0, "position without force")

    def force(self, q: float, qd: float, t: float) -> float:
        return -self.stiffness * (q - self.rest)

    def mjcf_joint(self) -> dict[str, float]:
        return {"stiffness": self.stiffness, "springref": self.rest}
