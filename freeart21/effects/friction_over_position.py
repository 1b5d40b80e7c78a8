"""Friction over position: dry friction whose level has a free shape over the joint's position."""

from dataclasses import dataclass
from typing import ClassVar

from freeart21.effects.base import Acts, Effect, FitRange, OperatingPoint, parameter
from freeart21.effects.force_over_position import ForceOverPosition


@dataclass(frozen=True)
class FrictionOverPosition(Effect):
    """level(q) against the motion, and up to level(q) at rest: linear interpolation between eight levels at even
    positions from first to last, constant beyond.

    Rails, seals and bearings whose friction varies with position. URDF and MJCF cannot express it.
    """

    name: ClassVar[str] = "friction_over_position"
    acts: ClassVar[Acts] = "drive"
    label: ClassVar[str] = "dry friction that differs from place to place"
    experiment: ClassVar[str] = "Move it slowly through its whole range, both ways, with a known force."
    complexity: ClassVar[int] = 3
    range_fields: ClassVar[tuple[str, ...]] = ("first", "last")
    dissipates: ClassVar[bool] = True
    reduces_to: ClassVar[str | None] = "coulomb_friction"
    model_error: ClassVar[tuple[float, float]] = (0.1, 0.0)  # a free shape over position

    level_1: float = parameter("N*m", "N", 0.0, 1e4, "level at the first position", scale=0.1)
    level_2: float = parameter("N*m", "N", 0.0, 1e4, "level at 1/7 of the way", scale=0.1)
    level_3: float = parameter("N*m", "N", 0.0, 1e4, "level at 2/7 of the way", scale=0.1)
    level_4: float = parameter("N*m", "N", 0.0, 1e4, "level at 3/7 of the way", scale=0.1)
    level_5: float = parameter("N*m", "N", 0.0, 1e4, "level at 4/7 of the way", scale=0.1)
    level_6: float = parameter("N*m", "N", 0.0, 1e4, "level at 5/7 of the way", scale=0.1)
    level_7: float = parameter("N*m", "N", 0.0, 1e4, "level at 6/7 of the way", scale=0.1)
    level_8: float = parameter("N*m", "N", 0.0, 1e4, "level at the last position", scale=0.1)
    first: float = parameter("rad", "m", -100.0, 100.0, "first position", scale=0.1)
    last: float = parameter("rad", "m", -100.0, 100.0, "last position", scale=0.1)

    @classmethod
    def fit_range(cls, name: str, at: OperatingPoint) -> FitRange:
        # the prior holds it where some runs do not come
        r = super().fit_range(name, at)
        return r._replace(size=0.1 * at.force, prior=0.3 * at.force)

    law = staticmethod(ForceOverPosition.law)
