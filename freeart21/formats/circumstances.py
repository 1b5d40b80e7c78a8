"""A JSON file with the facts about recordings that `freeart21 measure` has no options for, as in measured.json."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from freeart21.errors import FreeArtError
from freeart21.files import base_json, checked
from freeart21.files.actuator_json import actuator_from_json
from freeart21.files.measured import OTHER_UNITS, UNITS
from freeart21.joint import JointType
from freeart21.measured import BaseAxis
from freeart21.mechanics import Actuator

KEYS = ("actuator", "base", "prescribed", "units", "wrapped")
COLUMNS = ("qd", "voltage", *base_json.COLUMNS)
"""Roles of columns whose units only this file can set."""


@dataclass(frozen=True)
class Circumstances:
    """The contents of the file; None where it says nothing."""

    actuator: Actuator | None = None
    base: Any = None
    """`base` of measured.json: "moving", or an object with axis and point."""
    prescribed: bool | tuple[str, ...] = ()
    """All runs, or the names of runs, whose motion was prescribed by something else than the efforts."""
    units: dict[str, str] = field(default_factory=dict)
    """Role to unit."""
    wrapped: bool | None = None
    """Whether angles are within one turn. With None, jumps of a turn are removed."""
    where: Path = Path("measure")

    def scale(self, role: str, kind: JointType) -> float:
        """Size of a column's unit in SI; FreeArtError when a joint of this kind has no such unit."""
        own = UNITS[kind][role]
        unit = self.units.get(role, own)
        known = {own: 1.0, **OTHER_UNITS.get(own, {})}
        if unit not in known:
            raise FreeArtError(f"{self.where}: '{role}' is in {unit!r}, expected {' or '.join(map(repr, known))}")
        return known[unit]

    def base_axis(self, roles: set[str]) -> BaseAxis | None:
        """The rotation axis of the base; FreeArtError when it does not fit the columns of these roles."""
        moved = bool(roles & set(base_json.COLUMNS))
        base = self.base if self.base is not None else ("moving" if moved else "fixed")
        return base_json.base_axis_of(base, moved, base_json.ANGLE in roles, self.where)

    def is_prescribed(self, run: str) -> bool | None:
        """Whether a run's motion was prescribed; None when unknown."""
        found = self.prescribed if isinstance(self.prescribed, bool) else run in self.prescribed
        return True if found else None


def read_circumstances(path: Path) -> Circumstances:
    """The circumstances in a file; FreeArtError on an unknown key or a wrong value."""
    data = checked.read_json(path, root=checked.ANYWHERE)
    unknown = [key for key in data if key not in KEYS]
    if unknown:
        raise FreeArtError(f"{path}: there is no '{unknown[0]}'; there are {', '.join(KEYS)}")
    for key in ("actuator", "units"):
        if data.get(key) is not None and not isinstance(data[key], dict):
            raise FreeArtError(f"{path}: '{key}' is {data[key]!r}, expected an object")
    if data.get("wrapped") not in (None, True, False):
        raise FreeArtError(f"{path}: 'wrapped' is {data['wrapped']!r}, expected true or false")
    prescribed = data.get("prescribed", ())
    if isinstance(prescribed, list) and all(isinstance(name, str) for name in prescribed):
        prescribed = tuple(prescribed)
    elif not isinstance(prescribed, bool | tuple):
        raise FreeArtError(f"{path}: 'prescribed' is {prescribed!r}, expected true, false or a list of runs")
    units = data.get("units") or {}
    odd = [role for role in units if role not in COLUMNS]
    if odd:
        raise FreeArtError(f"{path}: units of '{odd[0]}', expected of {', '.join(COLUMNS)} (others have options)")
    actuator = None if data.get("actuator") is None else actuator_from_json(data["actuator"], path)
    return Circumstances(actuator, data.get("base"), prescribed, units, data.get("wrapped"), Path(path))
