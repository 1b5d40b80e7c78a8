"""Detent: a click position that holds the joint weakly, as a ball that snaps into a groove."""

from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from freeart21.effects.base import Acts, Alternative, Effect, Surroundings, parameter

CATCH = 1.5
"""Widths of a notch that a catch of the same force at the same place lets its part travel, about."""


@dataclass(frozen=True)
class Detent(Effect):
    """force = -peak * x * exp((1 - x^2) / 2) with x = (q - centre) / width: largest, `peak`, one width from the centre
    on either side, gone three widths away; small swings about the centre feel a spring of peak * sqrt(e) / width.

    The slope of a Gaussian well: the smoothest form with a place, a strength and a width. URDF and MJCF have no word
    for it.
    """

    name: ClassVar[str] = "detent"
    acts: ClassVar[Acts] = "force"
    plain: ClassVar[str] = "a notch that it clicks into"
    spans: ClassVar[tuple[str, ...]] = ("position",)
    knows_speed: ClassVar[bool] = False
    departs: ClassVar[tuple[float, float]] = (0.0, 0.4)  # grooves and catches have all shapes
    widths: ClassVar[float] = 1.9  # a groove ends somewhere, which a Gaussian does not

    peak: float = parameter("N*m", "N", 0.0, 1e4, "largest holding force", scale=0.1)
    centre: float = parameter("rad", "m", -100.0, 100.0, "position that it holds", scale=0.1)
    width: float = parameter("rad", "m", 1e-5, 10.0, "distance from the centre to the largest force", scale=0.05)

    def alternatives(self, among: Surroundings) -> list[Alternative]:
        """A spring, for a notch so wide that nothing of it but its slope is seen, and a catch of the same force."""
        spring = {"stiffness": self.steepness(), "rest": self.centre}
        catch = {"hold": self.peak, "position": self.centre, "travel": CATCH * self.width, "capture": 0.5}
        return [Alternative("return_spring", spring), Alternative("latch", catch)]

    @staticmethod
    def law(q: Any, qd: Any, load: Any, memory: Any, peak: Any, centre: Any, width: Any) -> Any:
        x = (q - centre) / width
        return -peak * x * np.exp(0.5 - 0.5 * x * x)

    def steepness(self) -> float:
        return float(self.peak * np.exp(0.5) / self.width)
