"""Backlash: slack between the drive side of the joint and the moving part."""

from dataclasses import dataclass
from typing import ClassVar

from freeart21.effects.base import Acts, Effect, FitRange, OperatingPoint, parameter
from freeart21.errors import FreeArtError


@dataclass(frozen=True)
class Backlash(Effect):
    """The actuator drives a body of its own, which meets the moving part at either end of a slack of `width`.

    Two inertias with a gap and stiff, perfectly inelastic contact (Nordin and Gutman, "Controlling mechanical systems
    with backlash - a survey", Automatica 38, 2002). x is the drive side's position, J its inertia, `drive_inertia` plus
    any armature:

      free (|x - q| < width / 2): J x'' = actuator's force, and the part moves without it;
      in contact (|x - q| = width / 2): (I + J) q'' = all forces, while the drive side pushes;
      impact: both continue at the speed that conserves momentum.

    At limits (`freeart21.events`): when the part stops dead, a drive side that it was pulling continues through the
    slack. One that was pushing it, or that meets the part at rest there, rebounds with `throw_back` of its speed.

    The actuator's law sees position and speed of the drive side, as a servo's encoder does; `q` is the part's. Friction
    and all else act on the part. At the start the drive side is in the middle, as fast as the part. Without an actuator
    it is a loose body. URDF and MJCF's joint cannot express it.
    """

    name: ClassVar[str] = "backlash"
    acts: ClassVar[Acts] = "slack"
    label: ClassVar[str] = "play in the drive"
    rotor_fields: ClassVar[tuple[str, ...]] = ("drive_inertia", "throw_back")
    reduces_to: ClassVar[str | None] = "armature"

    width: float = parameter("rad", "m", 0.0, 10.0, "free travel from one end of the slack to the other", scale=0.02)
    drive_inertia: float = parameter("kg*m^2", "kg", 1e-9, 1e4, "inertia of the drive side", scale=0.01)
    throw_back: float = parameter("1", "1", 0.0, 1.0, "part of its speed that it comes back with", default=0.0)

    @classmethod
    def fit_range(cls, name: str, at: OperatingPoint) -> FitRange:
        size = 0.1 * at.inertia  # a drive side lighter than a fifth of it makes no difference
        return (
            FitRange(max(0.2 * size, 1e-9), 1e3 * size, size)
            if name == "drive_inertia"
            else super().fit_range(name, at)
        )

    @classmethod
    def trial_values(cls, name: str, at: OperatingPoint) -> list[float]:
        return [0.2 * at.inertia] if name == "drive_inertia" else super().trial_values(name, at)

    def slack(self) -> float:
        return self.width

    def merge(self, other: Effect) -> Effect:
        raise FreeArtError(f"the asset's joint has an effect '{self.name}' already, expected at most one")
