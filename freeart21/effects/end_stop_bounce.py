"""End-stop bounce: the limits throw the joint back instead of stopping it dead."""

from dataclasses import dataclass
from typing import Any, ClassVar

from freeart21.effects.base import Acts, Effect, parameter


@dataclass(frozen=True)
class EndStopBounce(Effect):
    """Speed after an impact at a limit = -restitution * speed before it (Newton's law of restitution).

    Without it limits are perfectly inelastic. Of several, the largest counts. URDF and MJCF have no word for it
    (MuJoCo's `solreflimit` is a soft limit).
    """

    name: ClassVar[str] = "end_stop_bounce"
    acts: ClassVar[Acts] = "stop"

    restitution: float = parameter("1", "1", 0.0, 1.0, "speed after the impact per speed before it", scale=0.3)

    @staticmethod
    def law(q: Any, qd: Any, load: Any, memory: Any, restitution: Any) -> Any:
        return -restitution * qd
