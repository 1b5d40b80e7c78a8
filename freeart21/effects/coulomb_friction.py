"""Coulomb friction: a force of constant size against the motion, that holds the joint at rest up to the same size."""

from dataclasses import dataclass
from typing import Any, ClassVar

from freeart21.effects.base import Acts, Alternative, Effect, OperatingPoint, parameter


@dataclass(frozen=True)
class CoulombFriction(Effect):
    """force = -level * sign(qd) when moving, any force up to level when at rest.

    In SAPIEN it owns the joint's drive, as a saturated damper: exact, with real sticking, and no chatter.
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
    model_error: ClassVar[tuple[float, float]] = (0.1, 0.1)  # a level is what it is

    level: float = parameter("N*m", "N", 0.0, 1e4, "size of the friction force", scale=0.1)

    def alternatives(self, at: OperatingPoint) -> list[Alternative]:
        """Friction of the usual load, and damping that is as strong at half the top speed."""
        found = [Alternative("viscous_damping", {"coefficient": 2 * self.level / at.speed})]
        return found + ([Alternative("load_friction", {"coefficient": self.level / at.load})] if at.load else [])

    @staticmethod
    def law(q: Any, qd: Any, load: Any, memory: Any, level: Any) -> Any:
        return level + 0.0 * qd

    def urdf_dynamics(self) -> dict[str, float]:
        return {"friction": self.level}

    def mjcf_joint(self) -> dict[str, float | tuple[float, ...]]:
        return {"frictionloss": self.level}
