"""Gear friction: dry friction proportional to the load of the drive's gears."""

from dataclasses import dataclass
from typing import Any, ClassVar

from freeart21.effects.base import Acts, Effect, parameter


@dataclass(frozen=True)
class GearFriction(Effect):
    """level = coefficient * load, with load = |force of the actuator - all other forces but friction|, N*m or N.

    The loss of a geared drive grows with the torque through its teeth, from the motor and from the part (Duclusaud et
    al., Extended friction models for the physics simulation of servo actuators, 2025, model M3). A part at rest on its
    drive loads the teeth from both sides, so the load is twice its weight, and the coefficient is half the gearbox's
    loss of torque. From 1 on nothing would move. URDF and MJCF cannot express it.
    """

    name: ClassVar[str] = "gear_friction"
    acts: ClassVar[Acts] = "drive"
    label: ClassVar[str] = "friction in the gears that grows with what they carry"
    drivetrain: ClassVar[bool] = True
    dissipates: ClassVar[bool] = True
    common: ClassVar[bool] = True
    geared: ClassVar[bool] = True
    model_error: ClassVar[tuple[float, float]] = (0.1, 0.1)  # as Coulomb's

    coefficient: float = parameter("1", "1", 0.0, 0.95, "friction force per force that gears carry", scale=0.1)

    @staticmethod
    def law(q: Any, qd: Any, load: Any, memory: Any, coefficient: Any) -> Any:
        return coefficient * load
