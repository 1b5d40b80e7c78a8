"""ArtGS: `<model>/train/ours_<iteration>`.

    joint_info.json    [{"id": 0, "parent": -1, "joint": "heavy", "visuals": ["meshes/start_0.ply"]},
                        {"id": 1, "parent": 0, "name": "joint_1", "joint": "hinge" or "slider",
                         "jointData": {"axis": {"origin": [3], "direction": [3]}, "limit": {}},
                         "visuals": ["meshes/start_1.ply"]}, ...]
    meshes/start_<id>.ply   each part in the first state

Read in YuLiu-LY/ArtGS@b11a0e1e7bbfe0dfdfdfe473a21713950b284e16: render.py (export_joint_info_json, render_set), scene/
artgs.py (get_joint_param: axis and position in the world of its Gaussians), utils/metrics.py (compared with PARIS's
truth, z up). The files lack limits. The last iteration counts; all parts but the chosen joint's are the reference part.
The joint type is the method's own estimate (train_predict.py), unless a user gave it.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from freeart21.errors import FreeArtError
from freeart21.files import checked
from freeart21.joint import JointType
from freeart21.mesh import Mesh, join_meshes
from leaderboard.adapters.layout import ImportedResult, Layout, Request
from leaderboard.adapters.readers import choose_joint, read_list, read_part, two_state_result

_TYPES: dict[str, JointType] = {"hinge": "revolute", "slider": "prismatic"}


def _read(folder: Path, request: Request) -> ImportedResult:
    path, scale = folder / "joint_info.json", request.options.scale
    entries = read_list(path, "parts")
    joints = [entry for entry in entries if entry.get("joint") in _TYPES]
    joint = joints[choose_joint([str(j.get("name")) for j in joints], request.options.joint, str(path))]
    axis = joint.get("jointData", {}).get("axis") if isinstance(joint.get("jointData"), dict) else None
    if not isinstance(axis, dict):
        raise FreeArtError(f"{path}: '{joint.get('name')}' has no jointData with an axis"[:300])
    pivot = scale * checked.numbers(axis, "origin", (3,), path)
    direction = checked.numbers(axis, "direction", (3,), path)
    surfaces = {id(entry): _read_surface(entry, folder, path, scale) for entry in entries}
    moving = surfaces[id(joint)]
    rest = [mesh for key, mesh in surfaces.items() if key != id(joint) and mesh is not None]
    meshes = (join_meshes(rest), moving) if moving is not None and rest else None
    limits = (-np.inf, np.inf)
    return two_state_result(folder, request, "zup", _TYPES[joint["joint"]], direction, pivot, limits, meshes)


def _read_surface(entry: dict[str, Any], folder: Path, path: Path, scale: float) -> Mesh | None:
    """The meshes of one part as one; None when one of them is missing."""
    names = entry.get("visuals")
    if not isinstance(names, list) or not names or not all(isinstance(name, str) for name in names):
        raise FreeArtError(f"{path}: 'visuals' is {names!r}, expected a list of files"[:300])
    files = [checked.inside(folder, name) for name in names]
    if not all(file.is_file() for file in files):
        return None
    return join_meshes([read_part(file, folder, scale)[0] for file in files])


LAYOUT = Layout(
    "artgs",
    "ArtGS, https://github.com/YuLiu-LY/ArtGS",
    "YuLiu-LY/ArtGS@b11a0e1e7bbfe0dfdfdfe473a21713950b284e16:render.py, scene/artgs.py",
    lambda folder: (folder / "joint_info.json").is_file(),
    _read,
    subfolders=("train/ours_*", "*/train/ours_*", "*"),
    frame="zup",
    has_several_joints=True,
)
