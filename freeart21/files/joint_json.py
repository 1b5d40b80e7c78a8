"""A joint as JSON, as in truth.json, prediction.json and pages."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from freeart21.errors import FreeArtError
from freeart21.files import checked
from freeart21.joint import Joint


def joint_to_json(joint: Joint) -> dict[str, Any]:
    """name, type, axis, pivot, lower, upper (null where there is no limit)."""
    return {
        "name": joint.name,
        "type": joint.type,
        "axis": joint.axis.tolist(),
        "pivot": joint.pivot.tolist(),
        "lower": joint.lower if np.isfinite(joint.lower) else None,
        "upper": joint.upper if np.isfinite(joint.upper) else None,
    }


def joint_from_json(data: Any, path: Path) -> Joint:
    """The joint that `joint_to_json` wrote; raises FreeArtError naming `path`."""
    if not isinstance(data, dict):
        raise FreeArtError(f"{path}: 'joint' is {data!r}, expected an object")
    lower, upper = data.get("lower"), data.get("upper")
    if not all(value is None or isinstance(value, int | float) for value in (lower, upper)):
        raise FreeArtError(f"{path}: joint limits are {lower!r}, {upper!r}, expected numbers or null")
    with checked.naming(path):
        return Joint(
            checked.text(data, "name", path),
            data.get("type"),  # type: ignore[arg-type]
            checked.numbers(data, "axis", (3,), path),
            checked.numbers(data, "pivot", (3,), path),
            -np.inf if lower is None else float(lower),
            np.inf if upper is None else float(upper),
        )
