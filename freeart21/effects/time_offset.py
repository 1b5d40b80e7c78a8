"""Time offset: the position sensor's clock is off, or its readings are late."""

from dataclasses import dataclass
from typing import ClassVar

from freeart21.effects.base import Acts, Effect, Kind, parameter


@dataclass(frozen=True)
class TimeOffset(Effect):
    """reading(t) = q(t - seconds)."""

    name: ClassVar[str] = "time_offset"
    kind: ClassVar[Kind] = "sensing"
    acts: ClassVar[Acts] = "reading"
    label: ClassVar[str] = "a sensor whose clock is off"
    model_error: ClassVar[tuple[float, float]] = (0.05, 0.05)  # readings are averages

    seconds: float = parameter("s", "s", -10.0, 10.0, "how late a reading is", scale=0.01)

    def delay(self) -> float:
        return self.seconds
