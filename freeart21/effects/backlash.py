"""Backlash: slack between the actuator's side of the joint and the moving part."""

from dataclasses import dataclass
from typing import ClassVar

from freeart21.effects.base import Acts, Effect, parameter
from freeart21.errors import FreeArtError


@dataclass(frozen=True)
class Backlash(Effect):
    """The actuator drives a body of its own, that meets the moving part at either end of a slack of `width`.

    Two inertias with a gap (Nordin and Gutman, "Controlling mechanical systems with backlash - a survey", Automatica 38
    (2002), with stiff, perfectly inelastic contact). With x the drive side's position and J its inertia, its share
    `drive_inertia` and any armature together:
      apart (|x - q| < width / 2): J x'' = actuator's force, and the part moves without it;
      touching (|x - q| = width / 2): (I + J) q'' = all forces, for as long as the drive side pushes, not pulls;
      meeting: both go on at the speed that keeps the momentum.
    At limits (`freeart21.events`): when the part stops dead there, a drive side that it was dragging along goes on
    through the slack; one that was pushing it on, or that comes upon the part at rest there, comes back with
    `throw_back` of its speed.
    An actuator's law sees the drive side's position and speed, as a servo's encoder does; `q` stays the part's.
    Friction and all else act on the part. At the start the drive side is in the middle, as fast as the part. A joint
    without an actuator only carries a loose body along. URDF and MJCF's joint have no word for it.
    """

    name: ClassVar[str] = "backlash"
    acts: ClassVar[Acts] = "slack"
    label: ClassVar[str] = "play in the drive"
    rotor_fields: ClassVar[tuple[str, ...]] = ("drive_inertia", "throw_back")
    reduces_to: ClassVar[str | None] = "armature"

    width: float = parameter("rad", "m", 0.0, 10.0, "free travel from one end of the slack to the other", scale=0.02)
    drive_inertia: float = parameter("kg*m^2", "kg", 1e-9, 1e4, "inertia of the drive side", scale=0.01)
    throw_back: float = parameter("1", "1", 0.0, 1.0, "part of its speed that it comes back with", default=0.0)

    def slack(self) -> float:
        return self.width

    def merge(self, other: Effect) -> Effect:
        raise FreeArtError(f"the asset's joint has an effect '{self.name}' already, expected at most one")
