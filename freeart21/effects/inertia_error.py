"""Inertia error: another inertia than the asset says."""

from dataclasses import dataclass
from typing import ClassVar

from freeart21.effects.base import AssetError, OperatingPoint, parameter


@dataclass(frozen=True)
class InertiaError(AssetError):
    """Inertia about a hinge, or a slider's mass, is `inertia` times the asset's; its weight is not."""

    name: ClassVar[str] = "inertia_error"
    label: ClassVar[str] = "another inertia than the asset's"
    neutral: ClassVar[float] = 1.0
    phrases: ClassVar[dict[str, str]] = {"inertia": "its inertia is {} times what the asset says"}

    inertia: float = parameter("1", "1", 0.0, 100.0, "inertia over the asset's", default=1.0)

    @classmethod
    def uncertainty(cls, name: str, at: OperatingPoint) -> float:
        return at.inertia_relative

    def inertia_factor(self) -> float:
        return self.inertia
