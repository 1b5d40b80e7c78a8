"""FreeArtGS: `outputs/<id>/evaluation_data`, as exported for its own evaluator.

    export_manifest.json               joint_type: which of the two folders counts
    revolute/ or prismatic/            as in `itaco`, and camera_poses.json:
                                       [{"file_path": ".../00012.png", "transform_matrix": 4 x 4}], each exported frame
    ../splatfacto-art/articulation.json  "frames" with the trained angle_rad or distance

Read in FreeArtGS/FreeArtGS@061c6c8be42aa7dfd090dfd7c4137d6c2dcccd6a: evaluate/export_evaluation_data.py (files; the
first joint value is subtracted from all; uncertain Gaussians are in neither cloud), evaluate/eval_data.py (the manifest
decides the type), evaluate/eval_utils.py (file_path names the frame), evaluate/evaluate_freeartgs.py (OpenCV cameras,
which it turns to compare with OpenGL's), evaluate/psnr_utils.py (the moving Gaussians rotate by the right-hand rule by
the trained value from where the cloud has them; moving_map.npz has thresholded weights).

So the clouds are at the trained value zero, but joint_value.npy is zero in the first frame. articulation.json has the
difference; without it, both are assumed equal, with a note.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from freeart21.errors import FreeArtError
from freeart21.files import checked
from freeart21.joint import JOINT_TYPES, JointType
from leaderboard.adapters.itaco import list_hypotheses, read_hypothesis
from leaderboard.adapters.layout import ImportedResult, Layout, Request
from leaderboard.adapters.readers import read_list

_VALUE_KEYS = {"revolute": "angle_rad", "prismatic": "distance"}


def _matches(folder: Path) -> bool:
    return (folder / "export_manifest.json").is_file() and bool(list_hypotheses(folder))


def _read(folder: Path, request: Request) -> ImportedResult:
    manifest = folder / "export_manifest.json"
    given = checked.read_json(manifest).get("joint_type")
    hypotheses = list_hypotheses(folder)
    if given not in JOINT_TYPES or given not in hypotheses:
        raise FreeArtError(f"{manifest} has joint_type {given!r}, expected one of {', '.join(hypotheses)}"[:300])
    joint_type: JointType = "revolute" if given == "revolute" else "prismatic"
    names, cameras = None, None
    path = folder / joint_type / "camera_poses.json"
    if path.is_file():
        frames = read_list(path, "cameras")
        try:
            names = [Path(str(frame["file_path"])).stem for frame in frames]
            cameras = np.array([frame["transform_matrix"] for frame in frames], float)
        except (KeyError, TypeError, ValueError):
            raise FreeArtError(f"{path}: every camera needs a file_path and a transform_matrix of numbers") from None
        if cameras.shape[1:] != (4, 4):
            raise FreeArtError(f"{path}: transform_matrix has shape {cameras.shape[1:]}, expected (4, 4)")
    trained = checked.inside(folder.parent, "splatfacto-art/articulation.json")
    first, notes = _read_first_value(trained, joint_type)
    axes = request.options.axes or LAYOUT.axes or "opencv"
    result = read_hypothesis(folder, joint_type, request, axes, 1.0, first, names, cameras)
    return replace(result, notes=(*result.notes, *notes))


def _read_first_value(path: Path, joint_type: JointType) -> tuple[float, tuple[str, ...]]:
    """The trained joint value of the first frame, rad or m, and a note when the file is missing."""
    if not path.is_file():
        return 0.0, ("no splatfacto-art/articulation.json: the clouds are assumed to be at the first frame's state",)
    frames, key = checked.read_json(path).get("frames"), _VALUE_KEYS[joint_type]
    first = frames[0] if isinstance(frames, list) and frames else None
    if not isinstance(first, dict):
        raise FreeArtError(f"{path}: 'frames' is {checked.shorten(frames)}, expected a list that begins with an object")
    return checked.number({key: 0.0, **first}, key, f"{path}: the first of 'frames'", -1e6, 1e6, "a number"), ()


LAYOUT = Layout(
    "freeartgs",
    "FreeArtGS, https://github.com/FreeArtGS/FreeArtGS",
    "FreeArtGS/FreeArtGS@061c6c8be42aa7dfd090dfd7c4137d6c2dcccd6a:evaluate/export_evaluation_data.py",
    _matches,
    _read,
    subfolders=("evaluation_data",),
    axes="opencv",
)
