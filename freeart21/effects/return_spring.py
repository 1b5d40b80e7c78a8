"""Return spring: force towards a rest position, proportional to the distance."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

from freeart21.effects.base import Acts, Effect, parameter


@dataclass(frozen=True)
class ReturnSpring(Effect):
    """force = -stiffness * (q - rest). URDF cannot express it."""

    name: ClassVar[str] = "return_spring"
    acts: ClassVar[Acts] = "force"
    label: ClassVar[str] = "a spring"
    joint_word: ClassVar[str | None] = "stiffness"
    basis_of: ClassVar[tuple[str, ...]] = ("position", "direction")
    speed_dependent: ClassVar[bool] = False
    model_error: ClassVar[tuple[float, float]] = (
        0.0,
        0.1,
    )  # a coil's rate is constant in the middle of its travel only

    stiffness: float = parameter("N*m/rad", "N/m", 0.0, 1e6, "force per displacement", scale=1.0)
    rest: float = parameter("rad", "m", -100.0, 100.0, "position without force", scale=0.1)

    @staticmethod
    def law(q: Any, qd: Any, load: Any, memory: Any, stiffness: Any, rest: Any) -> Any:
        return -stiffness * (q - rest)

    def merge(self, other: Effect) -> ReturnSpring:
        """Two parallel springs as one, since MJCF has only one."""
        assert isinstance(other, ReturnSpring)
        stiffness = self.stiffness + other.stiffness
        rest = (self.stiffness * self.rest + other.stiffness * other.rest) / stiffness if stiffness else self.rest
        return ReturnSpring(stiffness, rest)

    def steepness(self) -> float:
        return self.stiffness

    def mjcf_joint(self) -> dict[str, float | tuple[float, ...]]:
        return {"stiffness": self.stiffness, "springref": self.rest}
