"""The motion of the base in a measured set: columns of its runs, and `base` in measured.json."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from freeart21.errors import FreeArtError
from freeart21.files import checked
from freeart21.measured import BaseAxis, BaseSeries
from freeart21.se3 import Array

POSITIONS, ACCELERATIONS = (tuple(f"base_{k}{x}" for x in "xyz") for k in ("", "a"))
ANGLE = "base_angle"
COLUMNS: dict[str, str] = {**dict.fromkeys(POSITIONS, "m"), **dict.fromkeys(ACCELERATIONS, "m/s^2"), ANGLE: "rad"}
"""Column to its unit, whatever the joint."""


def base_of(table: Mapping[str, Array], where: Path) -> BaseSeries | None:
    """The motion of the base in the columns of a run; None without such columns. Directions without a column are at
    rest.

    Raises FreeArtError when there are both positions and accelerations.
    """
    given = [[table[c] for c in columns if c in table] for columns in (POSITIONS, ACCELERATIONS)]
    if all(given):
        raise FreeArtError(f"{where} has positions and accelerations of its base, expected one of both")
    n = len(table["t_s"])
    position, acceleration = (
        np.stack([table.get(c, np.zeros(n)) for c in columns], 1) if some else None
        for columns, some in zip((POSITIONS, ACCELERATIONS), given, strict=True)
    )
    for column in COLUMNS:
        if column in table and not (np.isfinite(table[column][0]) and not np.isinf(table[column]).any()):
            raise FreeArtError(f"{where}: '{column}' is not a number in the first row, or infinite in another")
    found = BaseSeries(position, acceleration, table.get(ANGLE))
    return None if position is None and acceleration is None and found.angle is None else found


def base_axis_of(value: Any, moved: bool, turned: bool, where: Path) -> BaseAxis | None:
    """The rotation axis of the base, from `base` in measured.json: "fixed", "moving", or an object with axis and point.

    `moved` and `turned`: whether any run has a column of the base's motion, and of its angle. Raises FreeArtError when
    the value does not fit the columns.
    """
    if isinstance(value, dict):
        axis = checked.numbers(value, "axis", (3,), where)
        point = checked.numbers(value, "point", (3,), where) if "point" in value else np.zeros(3)
        length = float(np.linalg.norm(axis))
        if not abs(length - 1) < 1e-3:
            raise FreeArtError(f"{where}: the base's axis is {length:g} long, expected a unit vector")
        if not turned:
            raise FreeArtError(f"{where}: the base has an axis, but no run has a column '{ANGLE}'")
        return BaseAxis(axis / length, point)
    if value not in ("fixed", "moving"):
        raise FreeArtError(f"{where}: base is {value!r}, expected 'fixed', 'moving' or an object with its axis")
    if turned:
        raise FreeArtError(f"{where}: a run has '{ANGLE}', but base is {value!r}, expected an object with its axis")
    if moved != (value == "moving"):
        has = "a run has columns of its motion" if moved else "no run has a column of its motion"
        raise FreeArtError(f"{where}: base is {value!r}, but {has}")
    return None


def base_columns(base: BaseSeries | None) -> dict[str, Array]:
    """Column to (n,) values, for the columns that `base` has."""
    if base is None:
        return {}
    found: dict[str, Array] = {}
    for columns, values in ((POSITIONS, base.position), (ACCELERATIONS, base.acceleration)):
        if values is not None:
            found |= dict(zip(columns, values.T, strict=True))
    return found | ({} if base.angle is None else {ANGLE: base.angle})
