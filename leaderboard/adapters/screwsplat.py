"""ScrewSplat: its screws and joint angles as plain arrays, beside clouds of the parts.

    screws.npy                    (S, 6) w, then v: the unit twist of each screw in the world; w is zero for a slider
    theta.npy                     (T, S) rad or m, one row for each articulation that it was shown; or (S,)
    screw_confs.npy               (S,), optional: screws below 0.3 are left out
    point_cloud_static.npy        (N, 3) the points that no screw moves, at all thetas zero
    point_cloud_movable_<k>.npy   (N, 3) the points of screw k, counted from 1

Read in seungyeon-k/ScrewSplat-public@d88d7788645238b55bda5b27b19a9084cede7fa2: scene/gaussian_model.py (v = -w x q;
joint angles, canonical at zero), gaussian_renderer/__init__.py (a part moves by exp(theta * screw)),
articulated_object/articulated_object_renderer.py (the names, which the project uses for its TRUTH, stored there as a
pickled dictionary).

The project writes no such file of its predictions: they are in a torch checkpoint (chkpnt*.pth), which is a pickle
and is not read. So this layout is the project's names and conventions, in arrays that a user saves of it with
get_screws, get_joint_angles, get_screw_confs and the centres by their largest part index. It cannot be proved by a file
of the project, only by its conventions. Where T is the number of frames of the video, theta is the state in each.
"""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

from freeart21.errors import FreeArtError
from freeart21.formats.third_party import read_npy
from freeart21.joint import JointType
from freeart21.mesh import Mesh
from freeart21.se3 import Array
from leaderboard.adapters.points import mesh_of_points
from leaderboard.adapters.toolbox import Found, Layout, Request, chosen, joined
from leaderboard.adapters.two_states import found

LEAST_CONFIDENCE = 0.3
_UNIT = 1e-2  # how far the length of a screw's direction may be from 1
_STILL = 1e-6


def _read(folder: Path, request: Request) -> Found:
    scale = request.options.scale
    screws = read_npy(folder / "screws.npy", (None, 6))
    kept = np.arange(len(screws))
    if (folder / "screw_confs.npy").is_file():
        kept = np.flatnonzero(read_npy(folder / "screw_confs.npy", (len(screws),)) >= LEAST_CONFIDENCE)
    which = int(kept[chosen([str(k + 1) for k in kept], request.options.joint, f"{folder}/screws.npy")])
    w, v = screws[which, :3], screws[which, 3:]
    turns = float(np.linalg.norm(w)) > _STILL
    kind: JointType = "revolute" if turns else "prismatic"
    axis = w if turns else v
    if abs(np.linalg.norm(axis) - 1) > _UNIT:
        raise FreeArtError(
            f"{folder}/screws.npy: screw {which + 1} is {screws[which].tolist()}, expected a unit (w, v)"
        )
    pivot = scale * np.cross(w, v) if turns else np.zeros(3)
    thetas = _thetas(folder / "theta.npy", len(screws))[:, which] * (1.0 if turns else scale)
    limits = float(thetas.min()), float(thetas.max())
    meshes, notes = _meshes(folder, which, scale)
    told = found(folder, request, "camera", kind, axis, pivot, limits, meshes, notes)
    if len(thetas) != request.frames:
        return told
    return Found(**{**vars(told), "states": thetas})


def _thetas(path: Path, count: int) -> Array:
    """(T, S)."""
    try:
        return read_npy(path, (None, count))
    except FreeArtError:
        return read_npy(path, (count,))[None]


def _meshes(folder: Path, which: int, scale: float) -> tuple[tuple[Mesh, Mesh] | None, tuple[str, ...]]:
    named = {
        int(match[1]): path
        for path in folder.glob("point_cloud_movable_*.npy")
        if (match := re.fullmatch(r"point_cloud_movable_([0-9]{1,4})\.npy", path.name))
    }
    static = folder / "point_cloud_static.npy"
    if which + 1 not in named or not static.is_file():
        return None, ("it has no point clouds of its parts: no surface is measured",)
    others = [mesh_of_points(scale * read_npy(path, (None, 3))) for k, path in named.items() if k != which + 1]
    moving = mesh_of_points(scale * read_npy(named[which + 1], (None, 3)))
    rest = joined([mesh_of_points(scale * read_npy(static, (None, 3))), *others])
    return (rest, moving), ("its parts are clouds of points",)


LAYOUT = Layout(
    "screwsplat",
    "ScrewSplat, https://github.com/seungyeon-k/ScrewSplat-public",
    "seungyeon-k/ScrewSplat-public@d88d7788645238b55bda5b27b19a9084cede7fa2:scene/gaussian_model.py",
    lambda folder: (folder / "screws.npy").is_file() and (folder / "theta.npy").is_file(),
    _read,
    frame="camera",
    joint_choice=True,
)
