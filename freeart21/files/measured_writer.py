"""Writes a measured set: measured.json and one CSV file or poses.npz per run, as `read_measured` reads them."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from freeart21.errors import FreeArtError
from freeart21.files import atomic
from freeart21.files.actuator_json import actuator_to_json
from freeart21.files.base_json import base_columns
from freeart21.files.measured import DRIVES, MARKS, UNITS, VERSION
from freeart21.measured import Measured, Run
from freeart21.mechanics import Actuator
from freeart21.se3 import Array


def write_measured(folder: Path, measured: Measured) -> None:
    """Write a set into `folder`, which is made. Poses are relative to the reference part: its own are the identity."""
    folder.mkdir(parents=True, exist_ok=True)
    units = UNITS[measured.joint_type]
    columns = {"t_s", "q"} | {c for c in DRIVES for r in measured.runs if getattr(r, c) is not None}
    columns |= {"qd" for run in measured.runs if run.qd is not None}
    columns |= {column for run in measured.runs for column in base_columns(run.base)}
    actuator = measured.actuator
    atomic.write_json(
        folder / "measured.json",
        {
            "version": VERSION,
            "joint": measured.joint,
            "joint_type": measured.joint_type,
            "units": {column: unit for column, unit in units.items() if column in columns},
            "gravity": measured.gravity,
            "base": _base(measured),
            "sampling": {"rate_hz": measured.rate_hz, "timestamps": measured.timestamps},
            "runs": [_write_run(folder, run) for run in measured.runs],
            **({"interpolation": measured.interpolation} if columns & set(DRIVES) else {}),
            **({} if measured.effort_kind is None else {"effort": measured.effort_kind}),
            **({} if actuator is None else {"actuator": actuator_to_json(actuator, _follows(actuator, columns))}),
            "asset_uncertainty": {
                "inertia_relative": measured.inertia_relative,
                "gravity_relative": measured.gravity_relative,
            },
        },
    )


def _base(measured: Measured) -> str | dict[str, Array]:
    """`base` of measured.json."""
    if measured.base_axis is not None:
        return {"axis": measured.base_axis.axis, "point": measured.base_axis.point}
    return "moving" if any(run.base is not None for run in measured.runs) else "fixed"


def _follows(actuator: Actuator, columns: set[str]) -> bool:
    return "q_command" in columns or actuator.stiffness > 0


def _write_run(folder: Path, run: Run) -> dict[str, str | bool]:
    """Write the file or folder of a run; gives its entry in measured.json."""
    marked = {word: getattr(run, word) for word in MARKS if getattr(run, word) is not None}
    if run.poses is None:
        _write_csv(folder / f"{run.name}.csv", run)
        return {"file": f"{run.name}.csv", **marked}
    if run.base is not None or any(getattr(run, column) is not None for column in DRIVES):
        raise FreeArtError(
            f"run '{run.name}' has poses and a drive or a moving base, which no file of a measured set can hold"
        )
    place = folder / run.name
    place.mkdir()
    seen = np.ones(len(run.times_s), bool) if run.seen is None else run.seen
    np.savez_compressed(
        place / "poses.npz",
        T_camera_reference=np.tile(np.eye(4), (len(run.times_s), 1, 1)),
        T_camera_moving=run.poses,
        times_s=run.times_s,
        seen=seen,
    )
    return {"file": run.name, "kind": "poses", **marked}


def _write_csv(path: Path, run: Run) -> None:
    """Write all digits of every number; a missing reading is an empty cell."""
    series = {"t_s": run.times_s, "q": run.q, "qd": run.qd, **{column: getattr(run, column) for column in DRIVES}}
    series |= base_columns(run.base)
    table = {name: values.tolist() for name, values in series.items() if values is not None}
    rows = (
        ",".join("" if value != value else repr(value) for value in row) for row in zip(*table.values(), strict=True)
    )
    atomic.write_bytes(path, "\n".join([",".join(table), *rows, ""]).encode())
