"""Stribeck friction: dry friction that is larger at rest than in motion."""

from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from freeart21.effects.base import Acts, Effect, parameter


@dataclass(frozen=True)
class StribeckFriction(Effect):
    """level(qd) = level + rise * exp(-(qd / speed)^2) against the motion, and up to level + rise at rest.

    The Gaussian form of Armstrong-Helouvry, Dupont and Canudas de Wit, "A survey of models, analysis tools and
    compensation methods for the control of machines with friction", Automatica 30 (1994), with exponent 2. URDF and
    MJCF cannot express it.
    """

    name: ClassVar[str] = "stribeck_friction"
    acts: ClassVar[Acts] = "drive"
    label: ClassVar[str] = "friction that sticks before it slides"
    dissipates: ClassVar[bool] = True
    common: ClassVar[bool] = True
    reduces_to: ClassVar[str | None] = "coulomb_friction"
    basis_of: ClassVar[tuple[str, ...]] = ("velocity",)
    model_error: ClassVar[tuple[float, float]] = (0.2, 0.1)  # measured exponents vary

    level: float = parameter("N*m", "N", 0.0, 1e4, "size of the friction force in fast motion", scale=0.1)
    rise: float = parameter("N*m", "N", 0.0, 1e4, "how much larger it is at rest", scale=0.1)
    speed: float = parameter("rad/s", "m/s", 1e-4, 100.0, "speed at which the rise has fallen to 1/e", scale=0.1)

    @staticmethod
    def law(q: Any, qd: Any, load: Any, memory: Any, level: Any, rise: Any, speed: Any) -> Any:
        return level + rise * np.exp(-((qd / speed) ** 2))
