"""Armature: inertia of a rotor or gear train that turns with the joint and has no weight."""

from dataclasses import dataclass
from typing import Any, ClassVar

from freeart21.effects.base import Acts, Alternative, Effect, FitRange, OperatingPoint, parameter

_SLACKS = (0.003, 0.01, 0.03)
"""Initial widths of a slack, as shares of the range of motion."""


@dataclass(frozen=True)
class Armature(Effect):
    """Inertia of the joint = inertia of the links + value. For a geared rotor that is its own inertia times the ratio
    squared.

    When the links stop dead at a limit, the rotor twists its shaft, presses them into the limit, and takes them back
    with it; see `freeart21.events.drive_rebound`. `throw_back` is the speed ratio of the rotor's own rebound, exp(-2 z
    acos(z) / sqrt(1 - z^2)) for a damping ratio z of the rotor on its shaft (a spring and a dashpot that cannot pull).
    `swing` is the time of one radian of its oscillation, period / (2 pi). With swing 0 the links leave at once, at
    throw_back times the rotor's share of all inertia. URDF cannot express it, MJCF only the inertia.
    """

    name: ClassVar[str] = "armature"
    acts: ClassVar[Acts] = "inertia"
    label: ClassVar[str] = "inertia of the drive itself"
    drivetrain: ClassVar[bool] = True
    joint_word: ClassVar[str | None] = "armature"
    rotor_fields: ClassVar[tuple[str, ...]] = ("value", "throw_back", "swing")
    common: ClassVar[bool] = True

    value: float = parameter("kg*m^2", "kg", 0.0, 1e4, "added inertia", scale=0.01)
    throw_back: float = parameter("1", "1", 0.0, 1.0, "part of its speed that it comes back with", default=0.0)
    swing: float = parameter("s", "s", 0.0, 1.0, "seconds in which it swings by a radian on its shaft", default=0.0)

    @classmethod
    def fit_range(cls, name: str, at: OperatingPoint) -> FitRange:
        size = 0.1 * at.inertia
        return FitRange(1e-3 * size, 1e3 * size, size) if name == "value" else super().fit_range(name, at)

    def alternatives(self, at: OperatingPoint) -> list[Alternative]:
        """Weaker gravity: the same motion where no other force is known. And a drive of this inertia behind a slack so
        narrow that it hardly matters; with a wide one all impacts are displaced."""
        less = dict(
            zip(("cosine", "sine", "constant"), (-self.value / at.inertia * g for g in at.gravity), strict=True)
        )
        slacks = [{"width": part * at.span, "drive_inertia": self.value} for part in _SLACKS]
        return [Alternative("gravity_offset", less), *(Alternative("backlash", point) for point in slacks)]

    @staticmethod
    def law(q: Any, qd: Any, load: Any, memory: Any, value: Any, throw_back: Any, swing: Any) -> Any:
        return value + 0.0 * qd

    def mjcf_joint(self) -> dict[str, float | tuple[float, ...]]:
        return {"armature": self.value}
