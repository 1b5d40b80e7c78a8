"""DigitalTwinArt: `runs/<exp>/results/step_<N>`.

    init_motion.json       list of {axis_direction [3], axis_position [3], theta, rotation 3 x 3, translation [3]}, one
                           per joint; with several joints init_p<order>_motion.json, the first one is in order
    init_revolute_motion.json and init_prismatic_motion.json   instead of it, when no truth was available
    init_part_0.obj        the base, in the first state
    init_part_<i>.obj      the part of joint i - 1, in the first state

Read in NVlabs/DigitalTwinArt@1a48b402e4bf4bb7731296e8e230f0db3d86fe4f: model.py (export_canonical: names, and lengths
in the input's unit), utils/articulation_utils.py (interpret_transforms: rotation and translation map points of the
first state to the second; theta is in degrees, or the length of the translation, with axis_position zero). The world is
that of its PARIS data (z up). The last step counts; all parts but the chosen joint's are the reference part.

With a truth, the type in init_motion.json is the truth's. Without one, the project writes both joints; the import
chooses a slider when the motion rotates by less than 5 degrees.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from freeart21 import se3
from freeart21.files import checked
from freeart21.joint import JointType
from freeart21.mesh import join_meshes
from leaderboard.adapters.layout import ImportedResult, Layout, Request
from leaderboard.adapters.readers import POSE_TOLERANCE, choose_joint, read_list, read_number, read_part
from leaderboard.adapters.two_states import TYPE_GIVEN, two_state_result

LEAST_TURN = np.radians(5)
_TYPE_CHOSEN = "the type is not the method's, which writes both: the import chose it by the motion of the part"


def _find_typed_motion(folder: Path) -> Path | None:
    """The joints of a run that knew the true types."""
    path = folder / "init_motion.json"
    return path if path.is_file() else next(iter(sorted(folder.glob("init_p[0-9]*_motion.json"))), None)


def _matches(folder: Path) -> bool:
    both = (folder / f"init_{kind}_motion.json" for kind in ("revolute", "prismatic"))
    return _find_typed_motion(folder) is not None or all(path.is_file() for path in both)


def _read(folder: Path, request: Request) -> ImportedResult:
    typed = _find_typed_motion(folder)
    path, note = typed or folder / "init_revolute_motion.json", TYPE_GIVEN if typed else _TYPE_CHOSEN
    entries = read_list(path, "joints")
    index = choose_joint([str(k) for k in range(len(entries))], request.options.joint, str(path))
    entry = entries[index]
    motion = se3.pose(
        checked.numbers(entry, "rotation", (3, 3), path), checked.numbers(entry, "translation", (3,), path)
    )
    motion = se3.check_poses(f"{path}: rotation of joint {index}", motion, tolerance=POSE_TOLERANCE)
    angle = float(se3.rotation_angle(se3.orthonormalised(motion)[:3, :3]))
    joint_type: JointType
    if typed is not None:
        joint_type = "prismatic" if _is_slide(entry, path) else "revolute"
    else:
        joint_type = "revolute" if angle >= LEAST_TURN else "prismatic"
        if joint_type == "prismatic":
            path = folder / "init_prismatic_motion.json"
            entries = read_list(path, "joints")
            entry = entries[choose_joint([str(k) for k in range(len(entries))], str(index), str(path))]
    scale = request.options.scale
    axis = checked.numbers(entry, "axis_direction", (3,), path)
    pivot = scale * checked.numbers(entry, "axis_position", (3,), path)
    theta = read_number(entry, "theta", path)
    span = float(np.radians(theta)) if joint_type == "revolute" else scale * theta
    files = [folder / f"init_part_{k}.obj" for k in range(len(entries) + 1)]
    meshes = None
    if all(file.is_file() for file in files):
        surfaces = [read_part(file, folder, scale)[0] for file in files]
        meshes = join_meshes([m for k, m in enumerate(surfaces) if k != index + 1]), surfaces[index + 1]
    return two_state_result(folder, request, "zup", joint_type, axis, pivot, span, meshes, (note,))


def _is_slide(entry: dict[str, Any], path: Path) -> bool:
    """Whether the entry is a prismatic joint's: axis_position is zero, and theta is the translation's length."""
    length = float(np.linalg.norm(checked.numbers(entry, "translation", (3,), path)))
    is_at_origin = not checked.numbers(entry, "axis_position", (3,), path).any()
    return bool(is_at_origin and abs(read_number(entry, "theta", path) - length) <= 1e-5 * max(1.0, length))


LAYOUT = Layout(
    "digitaltwinart",
    "DigitalTwinArt, https://github.com/NVlabs/DigitalTwinArt",
    "NVlabs/DigitalTwinArt@1a48b402e4bf4bb7731296e8e230f0db3d86fe4f:model.py, utils/articulation_utils.py",
    _matches,
    _read,
    subfolders=("results/step_*", "step_*"),
    frame="zup",
    has_several_joints=True,
)
