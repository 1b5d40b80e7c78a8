"""Coulomb friction: constant force against the motion, and up to that level at rest."""

from dataclasses import dataclass
from typing import Any, ClassVar

from freeart21.effects.base import Acts, Alternative, Effect, OperatingPoint, parameter


@dataclass(frozen=True)
class CoulombFriction(Effect):
    """force = -level * sign(qd) in motion, any force up to level at rest.

    In SAPIEN it is the joint's drive as a saturated damper: exact, with true sticking, without chatter.
    """

    name: ClassVar[str] = "coulomb_friction"
    acts: ClassVar[Acts] = "drive"
    label: ClassVar[str] = "dry friction"
    drivetrain: ClassVar[bool] = True
    joint_word: ClassVar[str | None] = "friction"
    dissipates: ClassVar[bool] = True
    common: ClassVar[bool] = True
    confounded_with: ClassVar[str | None] = "load_friction"
    basis_of: ClassVar[tuple[str, ...]] = ("velocity",)
    model_error: ClassVar[tuple[float, float]] = (0.1, 0.1)

    level: float = parameter("N*m", "N", 0.0, 1e4, "size of the friction force", scale=0.1)

    def alternatives(self, at: OperatingPoint) -> list[Alternative]:
        """Friction proportional to the typical load, and damping as strong at half the top speed."""
        found = [Alternative("viscous_damping", {"coefficient": 2 * self.level / at.speed})]
        return found + ([Alternative("load_friction", {"coefficient": self.level / at.load})] if at.load else [])

    @staticmethod
    def law(q: Any, qd: Any, load: Any, memory: Any, level: Any) -> Any:
        return level + 0.0 * qd

    def urdf_dynamics(self) -> dict[str, float]:
        return {"friction": self.level}

    def mjcf_joint(self) -> dict[str, float | tuple[float, ...]]:
        return {"frictionloss": self.level}
