"""What a recording's files do not say and `freeart21 measure` has no option for: a JSON file of it, in the words of
measured.json."""

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

WORDS = ("actuator", "base", "prescribed", "units", "wrapped")
COLUMNS = ("qd", "voltage", *base_json.COLUMNS)
"""Roles of columns that only such a file gives other units."""


@dataclass(frozen=True)
class Circumstances:
    """What is told; None is not."""

    actuator: Actuator | None = None
    base: Any = None
    """As measured.json has it: "moving", or an object with axis and point."""
    prescribed: bool | tuple[str, ...] = ()
    """All runs, or those of these names, of which something else than the efforts prescribed the motion."""
    units: dict[str, str] = field(default_factory=dict)
    """Role of a column to its unit."""
    wrapped: bool | None = None
    """Whether angles are within one turn; leaps of one are undone when None."""
    where: Path = Path("measure")

    def scale(self, role: str, kind: JointType) -> float:
        """What one of a column's unit is in SI; FreeArtError when a joint of this kind has no such unit."""
        own = UNITS[kind][role]
        said = self.units.get(role, own)
        known = {own: 1.0, **OTHER_UNITS.get(own, {})}
        if said not in known:
            raise FreeArtError(f"{self.where}: '{role}' is in {said!r}, expected {' or '.join(map(repr, known))}")
        return known[said]

    def base_axis(self, roles: set[str]) -> BaseAxis | None:
        """What the base turns about, with columns of these roles; FreeArtError when it does not go with them."""
        moved = bool(roles & set(base_json.COLUMNS))
        said = self.base if self.base is not None else ("moving" if moved else "fixed")
        return base_json.base_axis_of(said, moved, base_json.ANGLE in roles, self.where)

    def marks(self, run: str) -> bool | None:
        """What is told of a run's motion."""
        told = self.prescribed
        return (True if told else None) if isinstance(told, bool) else (True if run in told else None)


def read_circumstances(path: Path) -> Circumstances:
    """The file; FreeArtError, in one line, when it says what nobody knows."""
    data = checked.read_json(path, root=checked.ANYWHERE)
    unknown = [word for word in data if word not in WORDS]
    if unknown:
        raise FreeArtError(f"{path}: there is no '{unknown[0]}'; there are {', '.join(WORDS)}")
    for word in ("actuator", "units"):
        if data.get(word) is not None and not isinstance(data[word], dict):
            raise FreeArtError(f"{path}: '{word}' is {data[word]!r}, expected an object")
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
