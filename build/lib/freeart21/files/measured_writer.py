"""A measured set to disk: measured.json and one CSV file or poses.npz a run, as `read_measured` reads them."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from freeart21.errors import FreeArtError
from freeart21.files import atomic
from freeart21.files.measured import UNITS, VERSION
from freeart21.measured import Measured, Run


def write_measured(folder: Path, measured: Measured) -> None:
    """Write a set into `folder`, which is made; of poses, the reference part's frame stands in for the camera's."""
    folder.mkdir(parents=True, exist_ok=True)
    units = UNITS[measured.joint_type]
    columns = {"t_s", "q"} | {c for c in ("effort", "q_command") for r in measured.runs if getattr(r, c) is not None}
    actuator = measured.actuator
    atomic.write_json(
        folder / "measured.json",
        {
            "version": VERSION,
            "joint": measured.joint,
            "joint_type": measured.joint_type,
            "units": {column: unit for column, unit in units.items() if column in columns},
            "gravity": measured.gravity,
            "base": "fixed",
            "sampling": {"rate_hz": measured.rate_hz, "timestamps": measured.timestamps},
            "runs": [_write_run(folder, run) for run in measured.runs],
            **({"interpolation": measured.interpolation} if columns & {"effort", "q_command"} else {}),
            **({} if measured.effort_kind is None else {"effort": measured.effort_kind}),
            **(
                {}
                if actuator is None
                else {
                    "actuator": {"type": "position", "stiffness": actuator.stiffness, "damping": actuator.damping},
                }
            ),
            "asset_uncertainty": {
                "inertia_relative": measured.inertia_relative,
                "gravity_relative": measured.gravity_relative,
            },
        },
    )


def _write_run(folder: Path, run: Run) -> dict[str, str | bool]:
    """The file or folder of a run, and what measured.json says of it."""
    marked = {} if run.held_out is None else {"held_out": run.held_out}
    if run.poses is None:
        _write_csv(folder / f"{run.name}.csv", run)
        return {"file": f"{run.name}.csv", **marked}
    if run.effort is not None or run.q_command is not None:
        raise FreeArtError(f"run '{run.name}' has poses and is driven, which no file of a measured set can say")
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
    """Every number to its last digit; a reading that is missing is an empty cell."""
    series = {"t_s": run.times_s, "q": run.q, "effort": run.effort, "q_command": run.q_command}
    table = {name: values.tolist() for name, values in series.items() if values is not None}
    rows = (
        ",".join("" if value != value else repr(value) for value in row) for row in zip(*table.values(), strict=True)
    )
    atomic.write_bytes(path, "\n".join([",".join(table), *rows, ""]).encode())
