"""Parses the messages of pages and checks all their values against bounds."""

from __future__ import annotations

import json
import math
import re
import struct
from dataclasses import dataclass
from typing import Any, Literal, get_args

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
MAX_VIEW = 16384
"""Largest side of a page, pixels; no screen has more."""
_ROUNDING = 1e-3
"""Largest deviation of a quaternion's length from 1, as in `freeart21.files.take`."""

Device = Literal["mouse", "keys", "touch", "gamepad", "headset"]
CommandName = Literal["record", "pause", "undo", "save", "reset", "drive"]
_DEVICES, _COMMANDS = frozenset(get_args(Device)), frozenset(get_args(CommandName))
_PICTURE = struct.Struct("<Id")


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
    device: Device


@dataclass(frozen=True)
class Ping:
    """A request for an answer, with the latency that the page measured."""

    time_ms: float
    latency_ms: tuple[float, float] | None
    """Median and 95th percentile from a move to the picture that shows it."""


@dataclass(frozen=True)
class Command:
    """A command: a button or its key."""

    what: CommandName


@dataclass(frozen=True)
class ViewSize:
    """The size of the page's picture, in pixels of the screen."""

    width: int
    height: int


@dataclass(frozen=True)
class Acknowledgement:
    """Number of pictures that the page has shown."""

    count: int


Message = Move | Ping | Command | ViewSize | Acknowledgement


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
    if kind == "ping":
        return Ping(_number(data, "time", 0, MAX_TIME_MS), _latency(data))
    if kind == "do":
        if not isinstance(data.get("what"), str) or data["what"] not in _COMMANDS:
            raise BadMessage("an unknown command")
        return Command(data["what"])
    if kind == "view":
        return ViewSize(_count(data, "width", 1, MAX_VIEW), _count(data, "height", 1, MAX_VIEW))
    if kind == "seen":
        return Acknowledgement(_count(data, "n", 0, MAX_COUNT))
    raise BadMessage("an unknown type")


def pack_picture(n: int, time_ms: float, jpeg: bytes) -> bytes:
    """The binary frame of a picture: number and page time of the newest move that it shows, and the JPEG."""
    return _PICTURE.pack(n & 0xFFFFFFFF, time_ms) + jpeg


def unpack_picture(frame: bytes) -> tuple[int, float, bytes]:
    """Number, page time in ms and JPEG of a frame made by `pack_picture`."""
    n, time_ms = _PICTURE.unpack_from(frame)
    return n, time_ms, frame[_PICTURE.size :]


def printable(text: str) -> str:
    """`text` without control characters and shortened, for a log."""
    return re.sub(r"[^\x20-\x7e]", "?", text)[:60]


def _move(data: dict[str, Any], bounds: Bounds) -> Move:
    position = _numbers(data, "position", 3, bounds.reach)
    q = _numbers(data, "quaternion", 4, 2.0)
    length = math.sqrt(sum(v * v for v in q))
    if abs(length - 1) > _ROUNDING:
        raise BadMessage("a quaternion that is no turn")
    if math.sqrt(sum(v * v for v in position)) > bounds.reach:
        raise BadMessage("a place out of reach")
    device = data.get("device")
    if not isinstance(device, str) or device not in _DEVICES:
        raise BadMessage("an unknown device")
    state = _number(data, "state", -1e6, 1e6)
    return Move(
        _count(data, "n", 0, MAX_COUNT),
        _number(data, "time", 0, MAX_TIME_MS),
        _count({"epoch": 0} | data, "epoch", 0, MAX_COUNT),
        se3.pose_from_wxyz(position, q),
        min(max(state, bounds.lower), bounds.upper),
        device,  # type: ignore[arg-type]
    )


def _latency(data: dict[str, Any]) -> tuple[float, float] | None:
    if data.get("latency") is None:
        return None
    median, high = _numbers(data, "latency", 2, 1e6)
    return median, high


def _numbers(data: dict[str, Any], key: str, count: int, most: float) -> list[float]:
    values = data.get(key)
    if not isinstance(values, list) or len(values) != count:
        raise BadMessage(f"'{key}' is not {count} numbers")
    return [_real(value, key, -most, most) for value in values]


def _number(data: dict[str, Any], key: str, low: float, high: float) -> float:
    return _real(data.get(key), key, low, high)


def _count(data: dict[str, Any], key: str, low: int, high: int) -> int:
    value = data.get(key)
    if not isinstance(value, int) or isinstance(value, bool) or not low <= value <= high:
        raise BadMessage(f"'{key}' is not a whole number from {low} to {high}")
    return value


def _real(value: object, key: str, low: float, high: float) -> float:
    # compared before it becomes a float: an integer of a thousand digits would not fit, and NaN compares false
    if not isinstance(value, int | float) or isinstance(value, bool) or not low <= value <= high:
        raise BadMessage(f"'{key}' is not a number from {low:g} to {high:g}")
    return float(value)


def _no_constant(name: str) -> float:
    raise ValueError(f"{name} is no JSON")
