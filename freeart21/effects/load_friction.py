"""Load friction: dry friction proportional to the bearing force."""

from dataclasses import dataclass
from typing import Any, ClassVar

from freeart21.effects.base import Acts, Alternative, Effect, OperatingPoint, parameter


@dataclass(frozen=True)
class LoadFriction(Effect):
    """level = coefficient * load, with the bearing force in N as load (`JointMechanics.load`).

    Coulomb's law at the bearing: the coefficient of friction for a slider, times the pin's radius for a hinge (a
    journal bearing's friction radius). SAPIEN's `joint.friction` differs: it adds forces and moments. URDF and MJCF
    cannot express it.
    """

    name: ClassVar[str] = "load_friction"
    acts: ClassVar[Acts] = "drive"
    label: ClassVar[str] = "friction that grows with the load"
    dissipates: ClassVar[bool] = True
    common: ClassVar[bool] = True
    confounded_with: ClassVar[str | None] = "coulomb_friction"
    needs_load: ClassVar[bool] = True
    model_error: ClassVar[tuple[float, float]] = (0.1, 0.1)  # as Coulomb's

    coefficient: float = parameter("m", "1", 0.0, 10.0, "friction force per bearing force", scale=0.01)

    def alternatives(self, at: OperatingPoint) -> list[Alternative]:
        """Coulomb friction at the typical load, and damping as strong at half the top speed."""
        level = self.coefficient * at.load
        found = [Alternative("viscous_damping", {"coefficient": 2 * level / at.speed})]
        return found + ([Alternative("coulomb_friction", {"level": level})] if at.load else [])

    @staticmethod
    def law(q: Any, qd: Any, load: Any, memory: Any, coefficient: Any) -> Any:
        return coefficient * load
