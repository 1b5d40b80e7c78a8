"""Armature: the inertia of a rotor or gear train that turns with the joint, and that gravity does not feel."""

from dataclasses import dataclass
from typing import Any, ClassVar

from freeart21.effects.base import Acts, Effect, parameter


@dataclass(frozen=True)
class Armature(Effect):
    """Inertia of the joint = inertia of the links + value; of a geared rotor it is its own times the ratio squared."""

    name: ClassVar[str] = "armature"
    acts: ClassVar[Acts] = "inertia"

    value: float = parameter("kg*m^2", "kg", 0.0, 1e4, "added inertia", scale=0.01)

    @staticmethod
    def law(q: Any, qd: Any, load: Any, memory: Any, value: Any) -> Any:
        return value + 0.0 * qd

    def mjcf_joint(self) -> dict[str, float | tuple[float, ...]]:
        return {"armature": self.value}
