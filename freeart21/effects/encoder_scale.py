"""Encoder scale: scale error of the position sensor."""

from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from numpy.typing import ArrayLike

from freeart21.effects.base import Acts, Effect, Kind, parameter


@dataclass(frozen=True)
class EncoderScale(Effect):
    """reading = factor * q."""

    name: ClassVar[str] = "encoder_scale"
    kind: ClassVar[Kind] = "sensing"
    acts: ClassVar[Acts] = "reading"
    label: ClassVar[str] = "a sensor whose scale is off"
    neutral: ClassVar[float] = 1.0
    model_error: ClassVar[tuple[float, float]] = (0.05, 0.05)  # slightly nonlinear scales

    factor: float = parameter("1", "1", 0.1, 10.0, "reading per position", scale=0.1)

    def reading_error(self, q: ArrayLike) -> Any:
        return (self.factor - 1.0) * np.asarray(q, float)
