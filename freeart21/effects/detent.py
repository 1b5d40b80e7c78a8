"""Detent: a click position that holds the joint weakly, like a ball in a groove."""

from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from freeart21.effects.base import Acts, Alternative, Effect, OperatingPoint, parameter

CATCH = 1.5
"""Travel of a latch of the same force at the same place, in widths of a detent."""


@dataclass(frozen=True)
class Detent(Effect):
    """force = -peak * x * exp(tail * (1 - |x|^(1 / tail))) with x = (q - centre) / width.

    The largest force, `peak`, is one width from the centre on either side for any tail. Near the centre it is a spring
    of stiffness peak * exp(tail) / width. A tail of 1/2 is the slope of a Gaussian well, 1 the long reach of a magnet,
    1/4 the two lobes of a rounded groove, less a spring catch whose force drops on release. Fitted to half sine lobes,
    parabolas, raised cosines, a magnet's 1 / (1 + x^2)^2 and a truncated ramp, each with its own width, it is off by 4
    to 9 % of the force; with a fixed tail by 16 to 42 %. URDF and MJCF cannot express it.
    """

    name: ClassVar[str] = "detent"
    acts: ClassVar[Acts] = "force"
    label: ClassVar[str] = "a notch that it clicks into"
    basis_of: ClassVar[tuple[str, ...]] = ("position",)
    speed_dependent: ClassVar[bool] = False
    model_error: ClassVar[tuple[float, float]] = (0.0, 0.4)  # shapes of grooves and catches vary
    support_widths: ClassVar[float] = 1.9  # a groove ends, a Gaussian does not

    peak: float = parameter("N*m", "N", 0.0, 1e4, "largest holding force", scale=0.1)
    centre: float = parameter("rad", "m", -100.0, 100.0, "position that it holds", scale=0.1)
    width: float = parameter("rad", "m", 1e-5, 10.0, "distance from the centre to the largest force", scale=0.05)
    tail: float = parameter("1", "1", 0.05, 2.0, "how slowly the force ends beyond that", scale=0.1, default=0.5)

    def alternatives(self, at: OperatingPoint) -> list[Alternative]:
        """A spring, for a notch wider than the motion, and a latch of the same force."""
        spring = {"stiffness": self.peak * float(np.exp(self.tail)) / self.width, "rest": self.centre}
        catch = {"hold": self.peak, "position": self.centre, "travel": CATCH * self.width, "capture": 0.5}
        return [Alternative("return_spring", spring), Alternative("latch", catch)]

    @staticmethod
    def law(q: Any, qd: Any, load: Any, memory: Any, peak: Any, centre: Any, width: Any, tail: Any) -> Any:
        x = (q - centre) / width
        return -peak * x * np.exp(tail * (1.0 - np.abs(x) ** (1.0 / tail)))

    def steepness(self) -> float:
        """At the centre, or where the force ends. The slope is peak / width * exp(tail * (1 - y)) * (1 - y) with y =
        |x|^(1 / tail), least at y = 1 + 1 / tail."""
        return float(self.peak / self.width * max(np.exp(self.tail), np.exp(-1.0) / self.tail))
