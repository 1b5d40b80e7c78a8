"""Coulomb friction: a force of constant size against the motion, that holds the joint at rest up to the same size."""

from dataclasses import dataclass
from typing import ClassVar, Literal

from freeart21.effects.base import Effect, parameter


@dataclass(frozen=True)
class CoulombFriction(Effect):
    """force = -level * sign(qd) when moving, any force up to level when at rest.

    In SAPIEN it owns the joint's drive, as a saturated damper: exact, with real sticking, and no chatter.
    """

    name: ClassVar[str] = "coulomb_friction"
    acts: ClassVar[Literal["force", "drive"]] = "drive"

    level: float = parameter("N*m", "N", 0.0, 1e4, "size of the friction force")

    def drive_limit(self, q: float, qd: float) -> float:
        return self.level

    def urdf_dynamics(self) -> dict[str, float]:
        return {"friction": self.level}

    def mjcf_joint(self) -> dict[str, float]:
        return {"frictionloss": self.level}
