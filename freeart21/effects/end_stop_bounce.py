"""End-stop bounce: the limits bounce the joint back instead of stopping it dead."""

from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from freeart21.effects.base import Acts, Effect, FitRange, OperatingPoint, parameter


@dataclass(frozen=True)
class EndStopBounce(Effect):
    """Speed after an impact at a limit = -restitution * speed before it / (1 + fading * |speed before it|).

    Without fading this is Newton's law of restitution. Real stops bounce fast parts back less than slow ones (Goldsmith
    1960; Hunt and Crossley 1975): at a speed of 1 / fading half of the restitution is left. Without the effect limits
    are perfectly inelastic. Of several, the largest applies. URDF and MJCF cannot express it (MuJoCo's `solreflimit` is
    a soft limit).
    """

    name: ClassVar[str] = "end_stop_bounce"
    acts: ClassVar[Acts] = "stop"
    label: ClassVar[str] = "a stop that bounces it back"
    trial_sizes: ClassVar[tuple[float, ...]] = (0.15, 0.5)  # a small rebound is swallowed

    restitution: float = parameter("1", "1", 0.0, 1.0, "speed after a slow impact per speed before it", scale=0.3)
    fading: float = parameter("s/rad", "s/m", 0.0, 1e6, "how fast that falls with speed", scale=0.1, default=0.0)

    @classmethod
    def fit_range(cls, name: str, at: OperatingPoint) -> FitRange:
        usual = 1 / at.speed  # impacts of one speed do not determine the fading, so its prior is at 0
        return FitRange(0.0, 50 * usual, 0.5 * usual, usual) if name == "fading" else super().fit_range(name, at)

    @classmethod
    def trial_values(cls, name: str, at: OperatingPoint) -> list[float]:
        return [0.0] if name == "fading" else super().trial_values(name, at)

    @staticmethod
    def law(q: Any, qd: Any, load: Any, memory: Any, restitution: Any, fading: Any) -> Any:
        return -restitution * qd / (1.0 + fading * np.abs(qd))
