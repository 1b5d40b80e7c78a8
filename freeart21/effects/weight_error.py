"""Weight error: gravity pulls more or less than the asset says."""

from dataclasses import dataclass
from typing import ClassVar

from freeart21.effects.base import AssetError, OperatingPoint, parameter


@dataclass(frozen=True)
class WeightError(AssetError):
    """Gravity's torque, or its force on a slider, is `weight` times the asset's."""

    name: ClassVar[str] = "weight_error"
    label: ClassVar[str] = "another weight than the asset's"
    neutral: ClassVar[float] = 1.0
    phrases: ClassVar[dict[str, str]] = {"weight": "its weight pulls {} times as much as the asset says"}

    weight: float = parameter("1", "1", 0.0, 100.0, "gravity's torque or force over the asset's", default=1.0)

    @classmethod
    def uncertainty(cls, name: str, at: OperatingPoint) -> float:
        return at.gravity_relative if any(at.gravity) else 0.0

    def weight_factor(self) -> float:
        return self.weight
