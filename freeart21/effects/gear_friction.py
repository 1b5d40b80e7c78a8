"""Gear friction: dry friction in proportion to what the drive's gears carry."""

from dataclasses import dataclass
from typing import Any, ClassVar

from freeart21.effects.base import Acts, Effect, parameter


@dataclass(frozen=True)
class GearFriction(Effect):
    """level = coefficient * load, the load being |force of the actuator - all other forces but friction|, N*m or N.

    Teeth that press on each other rub: what a geared drive loses grows with the torque that passes through it, from
    the motor's side and from the part's (Duclusaud et al., Extended friction models for the physics simulation of servo
    actuators, 2025, model M3). A part that hangs still on its drive weighs on the teeth from both sides, so the load is
    twice its weight, and half a gearbox's loss of torque is the coefficient. From 1 on nothing would move. URDF and
    MJCF have no word for it.
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
