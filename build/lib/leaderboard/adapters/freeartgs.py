"""FreeArtGS: `outputs/<id>/evaluation_data`, as its export writes it for its own evaluator.

    export_manifest.json               joint_type, which of the two folders counts
    revolute/ or prismatic/            as in `evaluation_data`, and camera_poses.json:
                                       [{"file_path": ".../00012.png", "transform_matrix": 4 x 4}], each frame answered
    ../splatfacto-art/articulation.json  beside it: "frames" with angle_rad or distance, as trained

Read in FreeArtGS/FreeArtGS@061c6c8be42aa7dfd090dfd7c4137d6c2dcccd6a: evaluate/export_evaluation_data.py (files, the
first joint value is taken off all, uncertain Gaussians are in neither cloud), evaluate/eval_data.py (the manifest
decides the type), evaluate/eval_utils.py (file_path names the frame), evaluate/evaluate_freeartgs.py (cameras have
OpenCV's axes, as it turns them to compare with OpenGL's), evaluate/psnr_utils.py (the moving Gaussians turn by the
right-hand rule by the trained value, from where the cloud has them; moving_map.npz holds thresholded weights).

So the clouds stand where the trained value is zero, while joint_value.npy is zero in the first frame: the difference
is in articulation.json. Without it the two are taken for the same, and that is noted.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from freeart21.errors import FreeArtError
from freeart21.files import checked
from freeart21.joint import JOINT_TYPES, JointType
from leaderboard.adapters.evaluation_data import found, hypotheses
from leaderboard.adapters.toolbox import Found, Layout, Request, read_list

_VALUES = {"revolute": "angle_rad", "prismatic": "distance"}


def _fits(folder: Path) -> bool:
    return (folder / "export_manifest.json").is_file() and bool(hypotheses(folder))


def _read(folder: Path, request: Request) -> Found:
    manifest = folder / "export_manifest.json"
    kind = checked.read_json(manifest).get("joint_type")
    if kind not in JOINT_TYPES or kind not in hypotheses(folder):
        raise FreeArtError(f"{manifest} has joint_type {kind!r}, expected one of {', '.join(hypotheses(folder))}"[:300])
    chosen: JointType = "revolute" if kind == "revolute" else "prismatic"
    names, cameras = None, None
    path = folder / chosen / "camera_poses.json"
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
    first, notes = _first_value(trained, chosen)
    axes = request.options.axes or LAYOUT.axes or "opencv"
    told = found(folder, chosen, request, axes, 1.0, first, names, cameras)
    return Found(**{**vars(told), "notes": (*told.notes, *notes)})


def _first_value(path: Path, kind: JointType) -> tuple[float, tuple[str, ...]]:
    """The trained joint value of the first frame, rad or m."""
    if not path.is_file():
        return 0.0, (
            "no splatfacto-art/articulation.json beside it: the clouds are taken to stand as in the first frame",
        )
    frames = checked.read_json(path).get("frames")
    value = (
        frames[0].get(_VALUES[kind], 0.0)
        if isinstance(frames, list) and frames and isinstance(frames[0], dict)
        else None
    )
    if isinstance(value, bool) or not isinstance(value, int | float) or not abs(value) < 1e6:
        raise FreeArtError(f"{path}: the first of 'frames' has {_VALUES[kind]} {value!r}, expected a number"[:300])
    return float(value), ()


LAYOUT = Layout(
    "freeartgs",
    "FreeArtGS, https://github.com/FreeArtGS/FreeArtGS",
    "FreeArtGS/FreeArtGS@061c6c8be42aa7dfd090dfd7c4137d6c2dcccd6a:evaluate/export_evaluation_data.py",
    _fits,
    _read,
    inside=("evaluation_data",),
    axes="opencv",
)
