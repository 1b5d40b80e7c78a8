"""The actuator of a measured set, from JSON and to JSON."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np

from freeart21.errors import FreeArtError
from freeart21.mechanics import Actuator, DcMotor

_LIMITS = ("max_effort", "torque_constant", "max_current")
_LAW = ("stiffness", "damping", "dead_band")
FIELDS: dict[str, tuple[str, ...]] = {
    "position": (*_LAW, *_LIMITS),
    "effort": _LIMITS,
    "dc_motor": ("resistance", "max_voltage", *_LAW, *_LIMITS),
}
"""Type of actuator to its numbers in JSON."""
REQUIRED: dict[str, tuple[str, ...]] = {
    "effort": (),
    "position": ("stiffness", "damping"),
    "dc_motor": ("torque_constant", "resistance"),
}
"""Type of actuator to the required ones."""
_ABOVE_ZERO = (*_LIMITS, "resistance", "max_voltage")


def actuator_from_json(given: dict[str, Any], where: Path | str) -> Actuator:
    """The actuator in the JSON object `given`; null is an unknown number.

    Raises FreeArtError, which begins with `where`, on another type, or a missing, unknown or impossible number.
    """
    kind = given.get("type")
    if not isinstance(kind, str) or kind not in FIELDS:
        raise FreeArtError(f"{where}: the actuator's type is {kind!r}, expected {' or '.join(map(repr, FIELDS))}")
    unknown = [key for key in given if key not in ("type", *FIELDS[kind])]
    if unknown:
        raise FreeArtError(
            f"{where}: an actuator of type '{kind}' has no '{unknown[0]}'; expected {', '.join(FIELDS[kind])}"
        )
    numbers = {key: _number(given[key], key, kind, where) for key in FIELDS[kind] if given.get(key) is not None}
    for key in REQUIRED[kind]:
        if key not in numbers:
            raise FreeArtError(f"{where}: an actuator of type '{kind}' needs '{key}', expected a finite number")
    if kind != "dc_motor" and ("max_current" in numbers) != ("torque_constant" in numbers):
        raise FreeArtError(f"{where}: an actuator's limit of current needs both 'max_current' and 'torque_constant'")
    law = [numbers.get(key, 0.0) for key in _LAW]
    most, current = numbers.get("max_effort", math.inf), numbers.get("max_current", math.inf)
    if kind == "dc_motor":
        volts = numbers.get("max_voltage", math.inf)
        motor = DcMotor(numbers["torque_constant"], numbers["resistance"], volts, current)
        return Actuator(None, law[0], law[1], dead_band=law[2], max_effort=most, motor=motor)
    if "torque_constant" in numbers:
        most = min(most, numbers["torque_constant"] * current)
    return Actuator(None, law[0], law[1], dead_band=law[2], max_effort=most)


def _number(value: Any, key: str, kind: str, where: Path | str) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float) or not np.isfinite(value):
        raise FreeArtError(f"{where}: the actuator's '{key}' is {value!r}, expected a finite number")
    least = "above 0" if key in _ABOVE_ZERO else "0 or more"
    if value < 0 or (value == 0 and key in _ABOVE_ZERO):
        raise FreeArtError(f"{where}: the actuator's '{key}' is {value:g}, expected {least}")
    return float(value)


def actuator_to_json(actuator: Actuator, follows: bool = True) -> dict[str, Any]:
    """The JSON object of `actuator`, without unknown limits. `follows`: whether it follows commanded positions."""
    law = {"stiffness": actuator.stiffness, "damping": actuator.damping, "dead_band": actuator.dead_band}
    if not follows or not actuator.dead_band:
        del law["dead_band"]
    limits = {} if math.isinf(actuator.max_effort) else {"max_effort": actuator.max_effort}
    motor = actuator.motor
    if motor is None:
        return {"type": "position", **law, **limits} if follows else {"type": "effort", **limits}
    numbers = {"max_voltage": motor.max_voltage, "max_current": motor.max_current}
    limits |= {key: value for key, value in numbers.items() if math.isfinite(value)}
    own = {"torque_constant": motor.torque_constant, "resistance": motor.resistance}
    return {"type": "dc_motor", **own, **(law if follows else {}), **limits}
