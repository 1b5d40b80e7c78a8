"""iTACO (Video2Articulation): the folder of refined joints, `refinement/monst3r/chamfer/<seed>`; see `evaluation_data`.

Read in 3dlg-hcvc/video2articulation@74903b413f3ef3b7f64df166aac4adcd3ac8ebe5: joint_refinement.py (files; a point seen
in frame i is mapped to the scanned surface by the camera, then rotated by the right-hand rule by joint_value[i], so the
part moves the other way from the surface to the frame), extract_mesh.py (meshes and clouds, at the surface's state),
evaluate.py (which type counts, and what is a failure), utils.py (cameras of the simulated data have OpenGL's axes;
those of the real data, data.py RealDataLoader, OpenCV's: `--axes opencv`).

The type is the one of smaller best_loss, but prismatic when the revolute axis is 0.15 m or more from the surface. Here
that is surface_pcd.ply, their reconstruction, while their evaluator has the scan. A missing best_loss is 100; without
any, their evaluator counts a failure, as does the import. N is the number of frames in sample_rgb, as in the sequences
that `freeart21 convert` makes of their data.
"""

from __future__ import annotations

import math
import re
from dataclasses import replace
from pathlib import Path

import numpy as np

from freeart21.errors import FreeArtError
from freeart21.files import checked
from freeart21.files.mesh_file import read_ply
from freeart21.joint import JointType
from freeart21.reconstruction import Failure
from leaderboard.adapters.evaluation_data import list_hypotheses, read_hypothesis
from leaderboard.adapters.layout import ImportedResult, Layout, Request
from leaderboard.adapters.readers import read_vector, unit_vector

NO_LOSS = 100.0
NEAR_M = 0.15
_SEQUENCE = re.compile(r"([A-Za-z]+)-([0-9]+)-(joint_[0-9]+)-(view_[A-Za-z0-9]+)")


def _sequence_folders(sequence: str) -> tuple[str, ...]:
    """The folder in their data set of a sequence that `freeart21 convert` made of it."""
    match = _SEQUENCE.fullmatch(sequence)
    return (f"{match[1]}/{match[2]}/{match[3]}_bg/{match[4]}",) if match else ()


def _matches(folder: Path) -> bool:
    return bool(list_hypotheses(folder)) and not (folder / "export_manifest.json").is_file()


def _read(folder: Path, request: Request) -> ImportedResult | Failure:
    losses = {kind: _read_loss(folder / kind / "best_loss.txt") for kind in list_hypotheses(folder)}
    kinds = [kind for kind, loss in losses.items() if loss < NO_LOSS]
    if not kinds:
        return Failure("refinement", "neither the revolute nor the prismatic hypothesis has a best_loss")
    joint_type: JointType = "revolute" if min(kinds, key=lambda k: losses[k]) == "revolute" else "prismatic"
    note = f"{joint_type} by best_loss {losses[joint_type]:.3g}"
    surface = folder / "surface_pcd.ply"
    if joint_type == "revolute" and "prismatic" in losses and surface.is_file():
        axis_file = folder / joint_type / "joint_axis.npy"
        axis = unit_vector(read_vector(axis_file), str(axis_file))
        points = read_ply(surface)[0].vertices - read_vector(folder / joint_type / "joint_pos.npy")
        distance = float(np.linalg.norm(np.cross(points, axis), axis=1).min()) * request.options.scale
        if distance >= NEAR_M:
            joint_type = "prismatic"
            note = f"prismatic, as the revolute axis is {distance:.3g} m from the surface"
    result = read_hypothesis(folder, joint_type, request, request.options.axes or LAYOUT.axes or "opengl", -1.0)
    return replace(result, notes=(*result.notes, note))


def _read_loss(path: Path) -> float:
    if not path.is_file():
        return NO_LOSS
    text = checked.read_text(path, 1 << 10, errors="replace").strip()
    try:
        value = float(text)
    except ValueError:
        raise FreeArtError(f"{path} holds {text[:40]!r}, expected a number") from None
    return NO_LOSS if math.isnan(value) else value


LAYOUT = Layout(
    "itaco",
    "iTACO (Video2Articulation), https://github.com/3dlg-hcvc/video2articulation",
    "3dlg-hcvc/video2articulation@74903b413f3ef3b7f64df166aac4adcd3ac8ebe5:joint_refinement.py, extract_mesh.py",
    _matches,
    _read,
    subfolders=("refinement/*/*/*", "chamfer/*", "*"),
    axes="opengl",
    sequence_folders=_sequence_folders,
)
