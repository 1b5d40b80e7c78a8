"""Parses the messages of pages and checks all their values against bounds."""

from __future__ import annotations

import json
import math
from dataclasses import dataclass
from typing import Any

from freeart21 import se3
from freeart21.se3 import Array

VERSION = "1"
"""Version of the messages, part of the websocket's address."""
MAX_BYTES = 2048
"""Largest message; the page's longest, a move, has about 300 bytes."""
MAX_COUNT = 2**53
"""Largest integer that JavaScript numbers represent exactly."""
MAX_TIME_MS = 1e11
"""Largest time since a page was opened: three years."""
_ROUNDING = 1e-3
"""Largest deviation of a quaternion's length from 1, as in `freeart21.files.take`."""
DEVICES = ("mouse", "keys", "touch", "headset")
COMMANDS = ("record", "pause", "undo", "save", "reset", "drive")


class BadMessage(Exception):
    """The fault of a message, in a few words that quote nothing of it."""


@dataclass(frozen=True)
class Move:
    """The object's pose and joint state in the page."""

    n: int
    """Number of the message, increasing by one."""
    time_ms: float
    """Time of the page's clock."""
    epoch: int
    """Number of times that the server had placed the object when the page sent this; older moves are dropped."""
    T: Array
    """(4, 4) the object's frame in the camera's axes."""
    state: float
    """Within the joint's limits, rad or m."""
    device: str


@dataclass(frozen=True)
class Command:
    """A command: a button or its key."""

    what: str


@dataclass(frozen=True)
class Acknowledgement:
    """Number of pictures that the page has shown."""

    count: int


Message = Move | Command | Acknowledgement


@dataclass(frozen=True)
class Bounds:
    """Bounds on joint state and position."""

    lower: float
    upper: float
    """The joint's limits, rad or m."""
    reach: float
    """Metres from the camera."""


def read(text: str, bounds: Bounds) -> Message:
    """Parse a text frame; BadMessage for a fault."""
    if len(text) > MAX_BYTES or len(text.encode("utf-8", "replace")) > MAX_BYTES:
        raise BadMessage(f"more than {MAX_BYTES} bytes")
    try:
        data = json.loads(text, parse_constant=_no_constant)
    except (ValueError, RecursionError) as error:
        raise BadMessage("no JSON") from error
    if not isinstance(data, dict):
        raise BadMessage("no object")
    kind = data.get("type")
    if kind == "move":
        return _move(data, bounds)
    if kind == "do":
        return Command(_one_of(data, "what", COMMANDS))
    if kind == "seen":
        return Acknowledgement(_count(data, "n", 0, MAX_COUNT))
    raise BadMessage("an unknown type")


def _move(data: dict[str, Any], bounds: Bounds) -> Move:
    position = _numbers(data, "position", 3, bounds.reach)
    q = _numbers(data, "quaternion", 4, 2.0)
    if abs(math.hypot(*q) - 1) > _ROUNDING:
        raise BadMessage("a quaternion that is no turn")
    if math.hypot(*position) > bounds.reach:
        raise BadMessage("a place out of reach")
    return Move(
        _count(data, "n", 0, MAX_COUNT),
        _number(data, "time", 0, MAX_TIME_MS),
        _count({"epoch": 0} | data, "epoch", 0, MAX_COUNT),
        se3.pose_from_wxyz(position, q),
        min(max(_number(data, "state", -1e6, 1e6), bounds.lower), bounds.upper),
        _one_of(data, "device", DEVICES),
    )


def _one_of(data: dict[str, Any], key: str, known: tuple[str, ...]) -> str:
    value = data.get(key)
    if not isinstance(value, str) or value not in known:
        raise BadMessage(f"an unknown '{key}'")
    return value


def _numbers(data: dict[str, Any], key: str, count: int, most: float) -> list[float]:
    values = data.get(key)
    if not isinstance(values, list) or len(values) != count:
        raise BadMessage(f"'{key}' is not {count} numbers")
    return [_number({key: value}, key, -most, most) for value in values]


def _number(data: dict[str, Any], key: str, low: float, high: float) -> float:
    value = data.get(key)
    # compared before it becomes a float: an integer of a thousand digits would not fit, and NaN compares false
    if not isinstance(value, int | float) or isinstance(value, bool) or not low <= value <= high:
        raise BadMessage(f"'{key}' is not a number from {low:g} to {high:g}")
    return float(value)


def _count(data: dict[str, Any], key: str, low: int, high: int) -> int:
    value = data.get(key)
    if not isinstance(value, int):
        raise BadMessage(f"'{key}' is not a whole number")
    return int(_number(data, key, low, high))


def _no_constant(name: str) -> float:
    raise ValueError(f"{name} is no JSON")
