"""The sensors, one file each: what a camera adds to a rendered video. Several are joined by '+'."""

from __future__ import annotations

from freeart21.errors import FreeArtError
from freeart21.registry import find_classes
from generator.sensors.base import SensorModel

SENSORS: dict[str, type[SensorModel]] = find_classes(__name__, SensorModel)
"""By name: the modules of this folder, and entry points of others (`freeart21.registry`)."""


def check_sensor(name: str) -> tuple[type[SensorModel], ...]:
    """The sensors that `name` joins by '+'; FreeArtError when one is unknown or they can't be joined."""
    parts = name.split("+")
    for part in parts:
        if part not in SENSORS:
            raise FreeArtError(f"unknown sensor '{part}'; sensors: {', '.join(SENSORS)}, or several joined by '+'")
    found = tuple(SENSORS[part] for part in parts)
    replaced = [cls.replaces for cls in found if cls.replaces is not None]
    if len({*parts}) < len(parts) or len({*replaced}) < len(replaced) or (len(parts) > 1 and "all" in replaced):
        raise FreeArtError(
            f"sensor '{name}' joins what does not go together: each name once, clean alone, one source of depth"
        )
    return found
