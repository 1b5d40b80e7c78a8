"""Load friction: dry friction in proportion to the force that the bearing carries."""

from dataclasses import dataclass
from typing import Any, ClassVar

from freeart21.effects.base import Acts, Alternative, Effect, OperatingPoint, parameter


@dataclass(frozen=True)
class LoadFriction(Effect):
    """level = coefficient * load, the load being the bearing's force in N (`JointMechanics.load`).

    Coulomb's law at the bearing: the coefficient is that of friction for a slider, and times the pin's radius for a
    hinge; a journal bearing's friction radius. Not SAPIEN's `joint.friction`, which weighs forces and moments alike.
    URDF and MJCF have no word for it.
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
        """Friction of the usual load's size, and damping that is as strong at half the top speed."""
        level = self.coefficient * at.load
        found = [Alternative("viscous_damping", {"coefficient": 2 * level / at.speed})]
        return found + ([Alternative("coulomb_friction", {"level": level})] if at.load else [])

    @staticmethod
    def law(q: Any, qd: Any, load: Any, memory: Any, coefficient: Any) -> Any:
        return coefficient * load
