"""Force over position: a force of free shape over the joint's position."""

from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from freeart21.effects.base import Acts, Effect, FitRange, OperatingPoint, parameter


@dataclass(frozen=True)
class ForceOverPosition(Effect):
    """Linear interpolation between eight forces at even positions from first to last, constant beyond.

    Springs, notches, magnets, cams and cables without a formula here. It has eight parameters, so effects with a
    formula come first (`complexity`). URDF and MJCF cannot express it.
    """

    name: ClassVar[str] = "force_over_position"
    acts: ClassVar[Acts] = "force"
    label: ClassVar[str] = "a force that depends on where the joint is"
    experiment: ClassVar[str] = "Move it slowly through its whole range, both ways, with a known force."
    complexity: ClassVar[int] = 3
    range_fields: ClassVar[tuple[str, ...]] = ("first", "last")
    speed_dependent: ClassVar[bool] = False
    model_error: ClassVar[tuple[float, float]] = (0.0, 0.0)  # a free shape

    force_1: float = parameter("N*m", "N", -1e4, 1e4, "force at the first position", scale=0.1)
    force_2: float = parameter("N*m", "N", -1e4, 1e4, "force at 1/7 of the way", scale=0.1)
    force_3: float = parameter("N*m", "N", -1e4, 1e4, "force at 2/7 of the way", scale=0.1)
    force_4: float = parameter("N*m", "N", -1e4, 1e4, "force at 3/7 of the way", scale=0.1)
    force_5: float = parameter("N*m", "N", -1e4, 1e4, "force at 4/7 of the way", scale=0.1)
    force_6: float = parameter("N*m", "N", -1e4, 1e4, "force at 5/7 of the way", scale=0.1)
    force_7: float = parameter("N*m", "N", -1e4, 1e4, "force at 6/7 of the way", scale=0.1)
    force_8: float = parameter("N*m", "N", -1e4, 1e4, "force at the last position", scale=0.1)
    first: float = parameter("rad", "m", -100.0, 100.0, "first position", scale=0.1)
    last: float = parameter("rad", "m", -100.0, 100.0, "last position", scale=0.1)

    @classmethod
    def fit_range(cls, name: str, at: OperatingPoint) -> FitRange:
        # the prior holds it where some runs do not come
        r = super().fit_range(name, at)
        return r._replace(size=0.1 * at.force, prior=0.3 * at.force)

    @staticmethod
    def law(
        q: Any, qd: Any, load: Any, memory: Any, f1: Any, f2: Any, f3: Any, f4: Any, f5: Any, f6: Any, f7: Any,
        f8: Any, first: Any, last: Any,
    ) -> Any:  # fmt: skip
        at = np.minimum(np.maximum(7 * (q - first) / (last - first), 0.0), 7.0)
        return (
            f1 * np.maximum(1.0 - np.abs(at - 0.0), 0.0)
            + f2 * np.maximum(1.0 - np.abs(at - 1.0), 0.0)
            + f3 * np.maximum(1.0 - np.abs(at - 2.0), 0.0)
            + f4 * np.maximum(1.0 - np.abs(at - 3.0), 0.0)
            + f5 * np.maximum(1.0 - np.abs(at - 4.0), 0.0)
            + f6 * np.maximum(1.0 - np.abs(at - 5.0), 0.0)
            + f7 * np.maximum(1.0 - np.abs(at - 6.0), 0.0)
            + f8 * np.maximum(1.0 - np.abs(at - 7.0), 0.0)
        )

    def steepness(self) -> float:
        *forces, first, last = self.values()
        return float(max(-np.diff(forces).min(), 0.0) * 7 / max(last - first, 1e-9))
