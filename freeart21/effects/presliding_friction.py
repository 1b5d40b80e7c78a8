"""Presliding friction: dry friction that is elastic before it slides."""

from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from freeart21.effects.base import BEARING_TRAVEL, Acts, Effect, FitRange, OperatingPoint, parameter


@dataclass(frozen=True)
class PreslidingFriction(Effect):
    """force = -level * (q - anchor) / travel; the anchor is dragged along when it is further away than travel.

    Its memory is the anchor. After a reversal friction builds up over 2 * travel, so small swings feel a lossy spring.
    This is the elastoplastic bristle that Dahl's and the LuGre model smooth (Dupont, Hayward, Armstrong and Altpeter,
    "Single state elastoplastic friction models", IEEE Transactions on Automatic Control 47, 2002). URDF and MJCF cannot
    express it.
    """

    name: ClassVar[str] = "presliding_friction"
    acts: ClassVar[Acts] = "force"
    label: ClassVar[str] = "dry friction that gives like a spring before it slides"
    experiment: ClassVar[str] = "Push it to and fro by less and less, down to where it hardly moves."
    dissipates: ClassVar[bool] = True
    common: ClassVar[bool] = True
    reduces_to: ClassVar[str | None] = "coulomb_friction"
    speed_dependent: ClassVar[bool] = False
    model_error: ClassVar[tuple[float, float]] = (0.1, 0.1)  # as Coulomb's

    level: float = parameter("N*m", "N", 0.0, 1e4, "size of the friction force once it slides", scale=0.1)
    travel: float = parameter("rad", "m", 1e-5, 10.0, "way over which it gives before it slides", scale=0.02)

    @classmethod
    def fit_range(cls, name: str, at: OperatingPoint) -> FitRange:
        r = super().fit_range(name, at)
        # less travel has every bearing: it is part of all dry friction
        return r._replace(lower=max(BEARING_TRAVEL * at.span, 1e-5)) if name == "travel" else r

    @staticmethod
    def law(q: Any, qd: Any, load: Any, memory: Any, level: Any, travel: Any) -> Any:
        return -level * np.minimum(np.maximum((q - memory) / travel, -1.0), 1.0)

    @staticmethod
    def remember(q: Any, memory: Any, level: Any, travel: Any) -> Any:
        return np.minimum(np.maximum(memory, q - travel), q + travel)

    def steepness(self) -> float:
        return self.level / self.travel
