"""Weight turn: the base is not level, or the centre of mass not where the asset says."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from freeart21.effects.base import AssetError, OperatingPoint, parameter


@dataclass(frozen=True)
class WeightTurn(AssetError):
    """Gravity comes from a direction turned by `lean` in the plane of motion (along a slider) and by `lean_across`
    across it. An offset centre of mass turns a hinge's weight in the plane of motion, too."""

    name: ClassVar[str] = "weight_turn"
    label: ClassVar[str] = "a weight that pulls another way than the asset's"
    phrases: ClassVar[dict[str, str]] = {
        "lean": "its weight pulls {} from where the asset says",
        "lean_across": "its weight pulls {} from across where the asset says",
    }

    lean: float = parameter("rad", "rad", -np.pi, np.pi, "tilt in the plane of motion", default=0.0)
    lean_across: float = parameter("rad", "rad", -np.pi, np.pi, "tilt across the plane of motion", default=0.0)

    @classmethod
    def uncertainty(cls, name: str, at: OperatingPoint) -> float:
        change = float(np.linalg.norm(at.tilted_gravity[name == "lean_across"]))
        doubt = at.tilt
        if name == "lean" and at.joint_type == "revolute" and change > 0:  # of the centre of mass
            doubt += at.gravity_relative * float(np.linalg.norm(at.gravity)) / change
        return doubt if change > 1e-6 * np.linalg.norm((at.gravity, *at.tilted_gravity)) else 0.0

    def tilt(self) -> tuple[float, float]:
        return self.lean, self.lean_across
