"""Encoder offset: zero error of the position sensor."""

from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from numpy.typing import ArrayLike

from freeart21.effects.base import Acts, Alternative, Effect, FitRange, Kind, OperatingPoint, parameter


@dataclass(frozen=True)
class EncoderOffset(Effect):
    """reading = q + offset."""

    name: ClassVar[str] = "encoder_offset"
    kind: ClassVar[Kind] = "sensing"
    acts: ClassVar[Acts] = "reading"
    label: ClassVar[str] = "a sensor whose zero is off"
    common: ClassVar[bool] = True

    offset: float = parameter("rad", "m", -100.0, 100.0, "reading at q = 0", scale=0.05)

    @classmethod
    def fit_range(cls, name: str, at: OperatingPoint) -> FitRange:
        return FitRange(-0.6 * at.span, 0.6 * at.span, 0.1 * at.span)

    def alternatives(self, at: OperatingPoint) -> list[Alternative]:
        """For a hinge, gravity of another direction: the same motion where nothing else depends on position."""
        cosine, sine, _ = at.gravity
        change = complex(cosine, sine) * complex(np.expm1(1j * self.offset))
        if at.joint_type != "revolute":
            return []
        return [Alternative("gravity_offset", {"cosine": change.real, "sine": change.imag}, self.offset)]

    def reading_error(self, q: ArrayLike) -> Any:
        return self.offset + 0.0 * np.asarray(q, float)
