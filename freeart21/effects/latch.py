"""Latch: a catch that holds the joint at a position until it is pulled hard enough."""

from dataclasses import dataclass
from itertools import product
from typing import Any, ClassVar

import numpy as np

from freeart21.effects.base import Acts, Alternative, Effect, OperatingPoint, parameter
from freeart21.effects.detent import CATCH

_SHIFTS, _STIFFER, _TRAVELS, _CAPTURES = (-0.3, 0.0, 0.3), (0.6, 1.0, 1.6), (0.65, 0.8, 1.0, 1.25), (0.3, 0.5, 0.7)
"""Restarts relative to the travel: shifts of its place, factors of its stiffness, factors of its travel, capture
ratios."""


@dataclass(frozen=True)
class Latch(Effect):
    """While caught, force = -hold * (q - position) / travel. It releases where |q - position| exceeds travel, so at a
    pull of `hold`, and catches again within capture * travel: closing it takes less work than opening it.

    A linear spring with hysteresis, the simplest model with a release force and a closed state. Its memory is 1 while
    caught, else 0; it starts caught within the capture range. URDF and MJCF cannot express it.
    """

    name: ClassVar[str] = "latch"
    acts: ClassVar[Acts] = "force"
    label: ClassVar[str] = "a catch that holds it"
    speed_dependent: ClassVar[bool] = False
    model_error: ClassVar[tuple[float, float]] = (0.0, 0.4)  # shapes of grooves and catches vary
    support_widths: ClassVar[float] = 1.0

    hold: float = parameter("N*m", "N", 0.0, 1e4, "pull at which it lets go", scale=1.0)
    position: float = parameter("rad", "m", -100.0, 100.0, "where it holds the joint", scale=0.1)
    travel: float = parameter("rad", "m", 1e-5, 10.0, "distance from there at which it lets go", scale=0.02)
    capture: float = parameter("1", "1", 0.0, 1.0, "part of the travel within which it catches", scale=0.5)

    def alternatives(self, at: OperatingPoint) -> list[Alternative]:
        """A notch of the same force at the same place."""
        return [
            Alternative(
                "detent", {"peak": self.hold, "centre": self.position, "width": self.travel / CATCH, "tail": 0.5}
            )
        ]

    def restarts(self) -> list[dict[str, float]]:
        return [
            {
                "hold": self.hold * part * stiffer,
                "position": self.position + shift * self.travel,
                "travel": self.travel * part,
                "capture": capture,
            }
            for shift, stiffer, part, capture in product(_SHIFTS, _STIFFER, _TRAVELS, _CAPTURES)
        ]

    @staticmethod
    def law(q: Any, qd: Any, load: Any, memory: Any, hold: Any, position: Any, travel: Any, capture: Any) -> Any:
        return -hold * memory * (q - position) / travel

    @staticmethod
    def remember(q: Any, memory: Any, hold: Any, position: Any, travel: Any, capture: Any) -> Any:
        away = np.abs(q - position)
        return 1.0 * ((away <= capture * travel) | ((memory > 0.5) & (away <= travel)))

    def steepness(self) -> float:
        return self.hold / self.travel
