"""DigitalTwinArt: `runs/<exp>/results/step_<N>`.

    init_motion.json       a list of {axis_direction [3], axis_position [3], theta, rotation 3 x 3, translation [3]},
                           one a joint; with several joints init_p<order>_motion.json, of which the first is in order
    init_revolute_motion.json and init_prismatic_motion.json   instead of it, where no truth was at hand
    init_part_0.obj        the base, in the first state
    init_part_<i>.obj      the part of joint i - 1, in the first state

Read in NVlabs/DigitalTwinArt@1a48b402e4bf4bb7731296e8e230f0db3d86fe4f: model.py (export_canonical: names, and lengths
turned back to the input's), utils/articulation_utils.py (interpret_transforms: rotation and translation take points of
the first state to the second; theta is in degrees, or the length of the translation, with axis_position zero). The
world is that of its PARIS data (z up). Of several steps the last counts; all that is no part of the chosen joint is the
reference part.

Where a truth was at hand, the type in init_motion.json is the truth's. Where none was, the project writes both joints
and does not choose: the import does, by the same motion: a slider where it turns by less than 5 degrees.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from freeart21 import se3
from freeart21.files import checked
from freeart21.joint import JointType
from leaderboard.adapters.toolbox import Found, Layout, Request, chosen, joined, one_number, read_list, read_part
from leaderboard.adapters.two_states import TOLD, found

LEAST_TURN = np.radians(5)
_OURS = "the type is not the method's, which writes both: the import took the one that its motion of the part shows"


def _known(folder: Path) -> Path | None:
    """The joints of a run that knew the truth's types."""
    one = folder / "init_motion.json"
    return one if one.is_file() else next(iter(sorted(folder.glob("init_p[0-9]*_motion.json"))), None)


def _fits(folder: Path) -> bool:
    both = (folder / f"init_{kind}_motion.json" for kind in ("revolute", "prismatic"))
    return _known(folder) is not None or all(path.is_file() for path in both)


def _read(folder: Path, request: Request) -> Found:
    known = _known(folder)
    path, note = known or folder / "init_revolute_motion.json", TOLD if known else _OURS
    entries = read_list(path, "joints")
    which = chosen([str(k) for k in range(len(entries))], request.options.joint, str(path))
    entry = entries[which]
    motion = se3.pose(
        checked.numbers(entry, "rotation", (3, 3), path), checked.numbers(entry, "translation", (3,), path)
    )
    motion = se3.orthonormalised(se3.check_poses(f"{path}: rotation of joint {which}", motion, tolerance=1e-3))
    angle = float(se3.rotation_angle(motion[:3, :3]))
    kind: JointType
    if known is not None:
        kind = "prismatic" if _is_slide(entry, path) else "revolute"
    else:
        kind = "revolute" if angle >= LEAST_TURN else "prismatic"
        if kind == "prismatic":
            path = folder / "init_prismatic_motion.json"
            entries = read_list(path, "joints")
            entry = entries[chosen([str(k) for k in range(len(entries))], str(which), str(path))]
    scale = request.options.scale
    axis = checked.numbers(entry, "axis_direction", (3,), path)
    pivot = scale * checked.numbers(entry, "axis_position", (3,), path)
    theta = one_number(entry, "theta", path)
    span = float(np.radians(theta)) if kind == "revolute" else scale * theta
    parts = [folder / f"init_part_{k}.obj" for k in range(len(entries) + 1)]
    meshes = None
    if all(part.is_file() for part in parts):
        surfaces = [read_part(part, folder, scale)[0] for part in parts]
        meshes = joined([m for k, m in enumerate(surfaces) if k != which + 1]), surfaces[which + 1]
    return found(folder, request, "zup", kind, axis, pivot, span, meshes, (note,))


def _is_slide(entry: dict[str, Any], path: Path) -> bool:
    """Whether the numbers are those that a prismatic joint gets: no position, and theta the translation's length."""
    length = float(np.linalg.norm(checked.numbers(entry, "translation", (3,), path)))
    still = not checked.numbers(entry, "axis_position", (3,), path).any()
    return bool(still and abs(one_number(entry, "theta", path) - length) <= 1e-5 * max(1.0, length))


LAYOUT = Layout(
    "digitaltwinart",
    "DigitalTwinArt, https://github.com/NVlabs/DigitalTwinArt",
    "NVlabs/DigitalTwinArt@1a48b402e4bf4bb7731296e8e230f0db3d86fe4f:model.py, utils/articulation_utils.py",
    _fits,
    _read,
    inside=("results/step_*", "step_*"),
    frame="zup",
    joint_choice=True,
)
