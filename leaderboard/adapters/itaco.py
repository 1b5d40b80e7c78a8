"""iTACO (Video2Articulation): the folder of refined joints, `refinement/monst3r/chamfer/<seed>`; see `evaluation_data`.

Read in 3dlg-hcvc/video2articulation@74903b413f3ef3b7f64df166aac4adcd3ac8ebe5: joint_refinement.py (files; a point seen
in frame i is carried to the scanned surface by the camera, then turned by the right-hand rule by joint_value[i]: from
the surface to the frame the part turns the other way), extract_mesh.py (meshes and clouds, at the surface's state),
evaluate.py (which type counts, and what no result is), utils.py (cameras of the simulated data have OpenGL's axes;
those of the real data, data.py RealDataLoader, OpenCV's: `--axes opencv`).

The type is the one of smaller best_loss, but prismatic where the revolute axis stays 0.15 m and more away from the
surface: measured here to surface_pcd.ply, their reconstruction, while their evaluator has the scan. A missing best_loss
is 100; without any, their evaluator counts a failure, and so do we. N is the number of frames that sample_rgb names, as
in our sequences that `freeart21 convert` makes of their data.
"""

from __future__ import annotations

import math
import re
from pathlib import Path

import numpy as np

from freeart21.errors import FreeArtError
from freeart21.files import checked
from freeart21.files.mesh_file import read_ply
from freeart21.joint import JointType
from freeart21.reconstruction import Failure
from leaderboard.adapters.evaluation_data import found, hypotheses
from leaderboard.adapters.toolbox import Found, Layout, Request, read_vector, unit

NO_LOSS = 100.0
NEAR_M = 0.15


_SEQUENCE = re.compile(r"([A-Za-z]+)-([0-9]+)-(joint_[0-9]+)-(view_[A-Za-z0-9]+)")


def _folders(sequence: str) -> tuple[str, ...]:
    """As their data set has it, of a sequence that `freeart21 convert` made of it."""
    match = _SEQUENCE.fullmatch(sequence)
    return (f"{match[1]}/{match[2]}/{match[3]}_bg/{match[4]}",) if match else ()


def _fits(folder: Path) -> bool:
    return bool(hypotheses(folder)) and not (folder / "export_manifest.json").is_file()


def _read(folder: Path, request: Request) -> Found | Failure:
    losses = {kind: _loss(folder / kind / "best_loss.txt") for kind in hypotheses(folder)}
    kinds = [kind for kind, loss in losses.items() if loss < NO_LOSS]
    if not kinds:
        return Failure("refinement", "neither the revolute nor the prismatic hypothesis has a best_loss")
    kind: JointType = "revolute" if min(kinds, key=lambda k: losses[k]) == "revolute" else "prismatic"
    notes = [f"{kind} by best_loss {losses[kind]:.3g}"]
    surface = folder / "surface_pcd.ply"
    if kind == "revolute" and "prismatic" in losses and surface.is_file():
        axis = unit(read_vector(folder / kind / "joint_axis.npy"), str(folder / kind / "joint_axis.npy"))
        points = read_ply(surface)[0].vertices - read_vector(folder / kind / "joint_pos.npy")
        away = float(np.linalg.norm(np.cross(points, axis), axis=1).min()) * request.options.scale
        if away >= NEAR_M:
            kind = "prismatic"
            notes = [f"prismatic, as the revolute axis is {away:.3g} m from the surface"]
    told = found(folder, kind, request, request.options.axes or LAYOUT.axes or "opengl", -1.0)
    return Found(**{**vars(told), "notes": (*told.notes, *notes)})


def _loss(path: Path) -> float:
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
    _fits,
    _read,
    inside=("refinement/*/*/*", "chamfer/*", "*"),
    axes="opengl",
    folders=_folders,
)
