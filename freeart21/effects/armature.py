"""Armature: the inertia of a rotor or gear train that turns with the joint, and that gravity does not feel."""

from dataclasses import dataclass
from typing import Any, ClassVar

from freeart21.effects.base import Acts, Effect, parameter


@dataclass(frozen=True)
class Armature(Effect):
    """Inertia of the joint = inertia of the links + value; of a geared rotor it is its own times the ratio squared.

    When the links stop dead at a limit the rotor goes on, twists its shaft, and takes them back with it: an impact that
    came in with qd leaves -throw_back * qd. That is the rotor's share of all inertia times what its shaft gives back,
    exp(-2 z acos(z) / sqrt(1 - z^2)) when z is the damping ratio of the rotor on it (a spring and a dashpot that let go
    when they push no more). URDF has no word for it, MJCF for the inertia only.
    """

    name: ClassVar[str] = "armature"
    acts: ClassVar[Acts] = "inertia"

    value: float = parameter("kg*m^2", "kg", 0.0, 1e4, "added inertia", scale=0.01)
    throw_back: float = parameter("1", "1", 0.0, 1.0, "part of the speed that comes back at a limit", default=0.0)

    @staticmethod
    def law(q: Any, qd: Any, load: Any, memory: Any, value: Any, throw_back: Any) -> Any:
        return value + 0.0 * qd

    def rebound(self, qd: Any) -> Any:
        return -self.throw_back * qd

    def mjcf_joint(self) -> dict[str, float | tuple[float, ...]]:
        return {"armature": self.value}
