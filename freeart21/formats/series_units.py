"""Units as recordings write them: one table of names, spellings and sizes."""

from __future__ import annotations

import re

import numpy as np

from freeart21.files.measured import OTHER_UNITS, UNITS
from freeart21.joint import JointType

_TABLE: dict[str, tuple[float, str]] = {
    "s": (1.0, "sec secs second seconds"),
    "ms": (1e-3, "msec"),
    "us": (1e-6, "usec"),
    "ns": (1e-9, "nsec nsecs"),
    "rad": (1.0, "radian radians"),
    "deg": (np.pi / 180, "degs degree degrees °"),
    "turns": (2 * np.pi, "rev"),
    "m": (1.0, "meters metres"),
    "cm": (1e-2, ""),
    "mm": (1e-3, ""),
    "N*m": (1.0, "nm n.m"),
    "N*cm": (1e-2, "ncm"),
    "mN*m": (1e-3, "mnm"),
    "N": (1.0, ""),
    "mN": (1e-3, ""),
    "rad/s": (1.0, ""),
    "deg/s": (np.pi / 180, "°/s"),
    "counts": (np.nan, "count tick ticks pulses steps raw adc lsb"),
    **dict.fromkeys(("V", "A", "mA", "m/s", "mm/s", "m/s^2", "rpm", "-"), (1.0, "")),
}
"""Unit to its size in SI and its other spellings."""
_SPELLINGS = {word.casefold(): unit for unit, (_, more) in _TABLE.items() for word in (unit, *more.split())}
TIMES = ("s", "ms", "us", "ns")
POSITIONS = {"revolute": ("rad", "deg", "turns"), "prismatic": ("m", "cm", "mm")}
EFFORTS = {"revolute": ("N*m", "N*cm", "mN*m"), "prismatic": ("N", "mN")}


def parse_unit(text: str) -> str | None:
    """Our name of the unit in a text such as '[Deg]'; None when it is no unit."""
    return _SPELLINGS.get(text.strip("[]() ").casefold())


def split_unit(name: str) -> tuple[str, str | None]:
    """A column's name in lower case without its unit, and the unit: ('angle', 'deg') for 'Angle_deg'."""
    low = re.sub(r"[^a-z0-9°*.]+", "_", name.casefold()).strip("_")
    head, _, tail = low.rpartition("_")
    if any(parse_unit(word) == "counts" for word in low.split("_")):
        return low, "counts"
    unit = parse_unit(tail) if len(tail) > 1 or head else None
    return (head or low, unit) if unit else (low, None)


def unit_sizes(role: str, kind: JointType) -> dict[str, float]:
    """Unit to its size in SI, of the columns of a role at a joint of this kind."""
    if role == "t":
        units: tuple[str, ...] = TIMES
    elif role in ("q", "q_command"):
        units = POSITIONS[kind]
    elif role == "effort":
        units = EFFORTS[kind]
    else:
        own = UNITS[kind][role]
        return {own: 1.0, **OTHER_UNITS.get(own, {})}
    return {unit: _TABLE[unit][0] for unit in units}
