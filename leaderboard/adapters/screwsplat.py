"""ScrewSplat: its screws and joint angles as plain arrays, with point clouds of the parts.

    screws.npy                    (S, 6) w, then v: the unit twist of each screw in the world; w is zero for a slider
    theta.npy                     (T, S) rad or m, one row per observed articulation; or (S,)
    screw_confs.npy               (S,), optional: screws below 0.3 are left out
    point_cloud_static.npy        (N, 3) points that no screw moves, at all thetas zero
    point_cloud_movable_<k>.npy   (N, 3) points of screw k, counted from 1

Read in seungyeon-k/ScrewSplat-public@d88d7788645238b55bda5b27b19a9084cede7fa2: scene/gaussian_model.py (v = -w x q;
joint angles, canonical at zero), gaussian_renderer/__init__.py (a part moves by exp(theta * screw)),
articulated_object/articulated_object_renderer.py (the names, which the project uses for its truth, stored there as a
pickled dictionary).

The project writes no such files for its predictions: they are in a torch checkpoint (chkpnt*.pth), a pickle that is not
read. This layout has the project's names and conventions, for arrays that a user saves with get_screws,
get_joint_angles, get_screw_confs and the centres by their largest part index. No file of the project can verify it,
only its conventions. Where T is the number of frames of the video, theta is the state in each frame.
"""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import numpy as np

from freeart21.errors import FreeArtError
from freeart21.formats.third_party import read_npy
from freeart21.joint import JointType
from freeart21.mesh import Mesh, join_meshes
from freeart21.se3 import Array
from leaderboard.adapters.layout import ImportedResult, Layout, Request
from leaderboard.adapters.readers import choose_joint, mesh_from_points, two_state_result

LEAST_CONFIDENCE = 0.3
_UNIT_TOLERANCE = 1e-2
_STILL = 1e-6


def _read(folder: Path, request: Request) -> ImportedResult:
    scale = request.options.scale
    screws = read_npy(folder / "screws.npy", (None, 6))
    confident = np.arange(len(screws))
    if (folder / "screw_confs.npy").is_file():
        confident = np.flatnonzero(read_npy(folder / "screw_confs.npy", (len(screws),)) >= LEAST_CONFIDENCE)
    names = [str(k + 1) for k in confident]
    index = int(confident[choose_joint(names, request.options.joint, f"{folder}/screws.npy")])
    w, v = screws[index, :3], screws[index, 3:]
    turns = float(np.linalg.norm(w)) > _STILL
    joint_type: JointType = "revolute" if turns else "prismatic"
    axis = w if turns else v
    if abs(np.linalg.norm(axis) - 1) > _UNIT_TOLERANCE:
        raise FreeArtError(
            f"{folder}/screws.npy: screw {index + 1} is {screws[index].tolist()}, expected a unit (w, v)"
        )
    pivot = scale * np.cross(w, v) if turns else np.zeros(3)
    thetas = _read_thetas(folder / "theta.npy", len(screws))[:, index] * (1.0 if turns else scale)
    limits = float(thetas.min()), float(thetas.max())
    meshes, notes = _read_meshes(folder, index, scale)
    result = two_state_result(folder, request, "camera", joint_type, axis, pivot, limits, meshes, notes)
    return replace(result, states=thetas) if len(thetas) == request.frames else result


def _read_thetas(path: Path, count: int) -> Array:
    """Joint angles (T, S)."""
    try:
        return read_npy(path, (None, count))
    except FreeArtError:
        return read_npy(path, (count,))[None]


def _read_meshes(folder: Path, index: int, scale: float) -> tuple[tuple[Mesh, Mesh] | None, tuple[str, ...]]:
    movable = {
        int(match[1]): path
        for path in folder.glob("point_cloud_movable_*.npy")
        if (match := re.fullmatch(r"point_cloud_movable_([0-9]{1,4})\.npy", path.name))
    }
    static = folder / "point_cloud_static.npy"
    if index + 1 not in movable or not static.is_file():
        return None, ("it has no point clouds of its parts: no surface is measured",)

    def read(path: Path) -> Mesh:
        return mesh_from_points(scale * read_npy(path, (None, 3)))

    others = [read(path) for k, path in movable.items() if k != index + 1]
    return (join_meshes([read(static), *others]), read(movable[index + 1])), ("its parts are clouds of points",)


LAYOUT = Layout(
    "screwsplat",
    "ScrewSplat, https://github.com/seungyeon-k/ScrewSplat-public",
    "seungyeon-k/ScrewSplat-public@d88d7788645238b55bda5b27b19a9084cede7fa2:scene/gaussian_model.py",
    lambda folder: (folder / "screws.npy").is_file() and (folder / "theta.npy").is_file(),
    _read,
    frame="camera",
    has_several_joints=True,
)
