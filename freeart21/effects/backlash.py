"""Backlash: slack between the actuator's side of the joint and the moving part."""

from dataclasses import dataclass
from typing import Any, ClassVar

from freeart21.effects.base import Acts, Effect, parameter


@dataclass(frozen=True)
class Backlash(Effect):
    """The actuator drives a body of its own, that meets the moving part at either end of a slack of `width`.

    Two inertias with a gap (Nordin and Gutman, "Controlling mechanical systems with backlash - a survey", Automatica 38
    (2002), with stiff, perfectly inelastic contact). With x the drive side's position and J its inertia, its share
    `drive_inertia` and any armature together:
      apart (|x - q| < width / 2): J x'' = actuator's force, and the part moves without it;
      touching (|x - q| = width / 2): (I + J) q'' = all forces, for as long as the drive side pushes, not pulls;
      meeting: both go on at the speed that keeps the momentum.
    When the part stops dead at a limit, a drive side that it was dragging along goes on through the slack; one that was
    pushing it on, or that comes upon the part at rest there, comes back with `throw_back` of its speed.
    An actuator's law sees the drive side's position and speed, as a servo's encoder does; `q` stays the part's.
    Friction and all else act on the part. At the start the drive side is in the middle, as fast as the part. A joint
    without an actuator only carries a loose body along. URDF and MJCF's joint have no word for it.
    """

    name: ClassVar[str] = "backlash"
    acts: ClassVar[Acts] = "slack"
    becomes: ClassVar[str | None] = "armature"

    width: float = parameter("rad", "m", 0.0, 10.0, "free travel from one end of the slack to the other", scale=0.02)
    drive_inertia: float = parameter("kg*m^2", "kg", 1e-9, 1e4, "inertia of the drive side", scale=0.01)
    throw_back: float = parameter("1", "1", 0.0, 1.0, "part of its speed that it comes back with", default=0.0)

    @staticmethod
    def meeting(side: Any, x: Any, v: Any, q: Any, qd: Any, push: Any, width: Any) -> Any:
        """The side on which they touch: 1 drive side ahead, -1 behind, 0 apart.

        Args:
            side: the same, until now.
            x: position of the drive side.
            v: velocity of the drive side.
            q: position of the part.
            qd: velocity of the part.
            push: force that the drive side puts on the part if they touch: actuator's force - J q''.
            width: of the slack.
        """
        if side != 0:
            return side if side * push >= 0 else 0
        if x - q >= 0.5 * width and v > qd:
            return 1
        return -1 if q - x >= 0.5 * width and v < qd else 0
