"""A measured set of part poses to disk: measured.json and one poses.npz a run, as `read_measured` reads them."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from freeart21.errors import FreeArtError
from freeart21.files import atomic
from freeart21.files.measured import UNITS, VERSION
from freeart21.measured import Measured


def write_measured(folder: Path, measured: Measured) -> None:
    """Write runs of poses into `folder`, which is made; the reference part's frame stands in for the camera's."""
    folder.mkdir(parents=True, exist_ok=True)
    listed = []
    for run in measured.runs:
        if run.poses is None or run.effort is not None or run.q_command is not None:
            raise FreeArtError(f"run '{run.name}' is of another kind than poses, which are all that is written here")
        place = folder / run.name
        place.mkdir()
        seen = np.ones(len(run.times_s), bool) if run.seen is None else run.seen
        reference = np.tile(np.eye(4), (len(run.times_s), 1, 1))
        np.savez_compressed(
            place / "poses.npz",
            T_camera_reference=reference,
            T_camera_moving=run.poses,
            times_s=run.times_s,
            seen=seen,
        )
        marked = {} if run.held_out is None else {"held_out": run.held_out}
        listed.append({"file": run.name, "kind": "poses", **marked})
    units = UNITS[measured.joint_type]
    atomic.write_json(
        folder / "measured.json",
        {
            "version": VERSION,
            "joint": measured.joint,
            "joint_type": measured.joint_type,
            "units": {"t_s": units["t_s"], "q": units["q"]},
            "gravity": measured.gravity,
            "base": "fixed",
            "sampling": {"rate_hz": measured.rate_hz, "timestamps": measured.timestamps},
            "runs": listed,
            "asset_uncertainty": {
                "inertia_relative": measured.inertia_relative,
                "gravity_relative": measured.gravity_relative,
            },
        },
    )
