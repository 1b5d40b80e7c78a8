"""A JSON file with the facts about recordings that `freeart21 measure` has no options for, as in measured.json."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from freeart21.errors import FreeArtError
from freeart21.files import base_json, checked
from freeart21.files.actuator_json import actuator_from_json
from freeart21.files.json_record import read_record
from freeart21.files.measured import OTHER_UNITS, UNITS
from freeart21.joint import JointType
from freeart21.measured import BaseAxis, Run
from freeart21.mechanics import Actuator

COLUMNS = ("qd", "voltage", *base_json.COLUMNS)
"""Roles of columns whose units only this file can set."""


@dataclass(frozen=True)
class Circumstances:
    """The contents of the file; None where it says nothing."""

    actuator: Any = None
    """An `Actuator`; in the file, that of measured.json."""
    base: Any = None
    """`base` of measured.json: "moving", or an object with axis and point."""
    prescribed: Any = ()
    """True for all runs, or the names of runs, whose motion was prescribed by something else than the efforts."""
    units: dict[str, str] = field(default_factory=dict)
    """Role to unit."""
    wrapped: bool | None = None
    """Whether angles are within one turn. With None, jumps of a turn are removed."""
    where: str = "measure"

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
        return base_json.base_axis_of(base, moved, base_json.ANGLE in roles, Path(self.where))

    def mark_prescribed(self, runs: Iterable[Run]) -> tuple[Run, ...]:
        """The runs with `prescribed` set, unknown where the file does not say so; FreeArtError for an unknown name."""
        names = [run.name for run in runs]
        chosen = self.prescribed if isinstance(self.prescribed, list | tuple) else names if self.prescribed else ()
        for name in chosen:
            if name not in names:
                raise FreeArtError(
                    f"{self.where}: there is no run {name!r} to be prescribed; runs: {', '.join(names)[:300]}"
                )
        return tuple(replace(run, prescribed=True if run.name in chosen else None) for run in runs)


def read_circumstances(path: Path) -> Circumstances:
    """The circumstances in a file; FreeArtError on an unknown key or a wrong value."""
    data = checked.read_json(path, root=checked.ANYWHERE)
    found = read_record(Circumstances, {**data, "where": str(path)}, str(path))
    if not isinstance(found.prescribed, bool | list | tuple):
        raise FreeArtError(f"{path}: 'prescribed' is {found.prescribed!r}, expected true, false or a list of runs")
    odd = [role for role in found.units if role not in COLUMNS]
    if odd:
        raise FreeArtError(f"{path}: units of '{odd[0]}', expected of {', '.join(COLUMNS)} (others have options)")
    if found.actuator is None:
        return found
    actuator: Actuator = actuator_from_json(checked.json_object(data, "actuator", path), path)
    return replace(found, actuator=actuator)
