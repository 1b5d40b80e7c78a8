"""PARIS: the `save` folder of an experiment.

    it<N>_val_motion.json or it<N>_test_motion.json
        {"type": "rotate", "axis_o": [3], "axis_d": [3], "rot_angle": degrees, "R": 3 x 3}
        {"type": "translate", "axis_o": [3], "axis_d": [3], "dist": length}
    it<N>_static_<res>_thre<t>.ply    the static part
    it<N>_dyn_t0_<res>_thre<t>.ply    the moving part in the first state (t = 0)
    it<N>_dynamic_<res>_thre<t>.ply   the same half way (t = 0.5)

Read in 3dlg-hcvc/paris@fcab60d2e9f65d67134931f45a8592bed9e21fde: systems/base.py (export_motion, export_meshes),
systems/revolute.py and prismatic.py (angle in degrees, or length, of the whole motion from t = 0 to t = 1, by the
right-hand rule or along axis_d), utils/mixins.py (save_trans_part_mesh), models/revolute.py (canonical is t = 0.5),
preprocess.py (the world is the object's, z up: (x, -z, y) of PartNet-Mobility's meshes). The largest N counts. Lengths
are PartNet-Mobility's own. The joint type is that of the configuration.
"""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

from freeart21.errors import FreeArtError
from freeart21.files import checked
from freeart21.joint import Joint, JointType
from leaderboard.adapters.layout import ImportedResult, Layout, Request
from leaderboard.adapters.readers import read_number, read_part, unit_vector
from leaderboard.adapters.two_states import TYPE_GIVEN, two_state_result

_MOTION = re.compile(r"it([0-9]{1,9})_(?:val|test)_motion\.json")
_TYPES: dict[str, tuple[JointType, str]] = {"rotate": ("revolute", "rot_angle"), "translate": ("prismatic", "dist")}


def _list_motions(folder: Path) -> list[tuple[int, Path]]:
    """(N, file) of every motion, by rising N."""
    matches = ((_MOTION.fullmatch(path.name), path) for path in folder.glob("it*_motion.json"))
    return sorted((int(match[1]), path) for match, path in matches if match)


def _read(folder: Path, request: Request) -> ImportedResult:
    step, path = _list_motions(folder)[-1]
    data, scale = checked.read_json(path), request.options.scale
    given = data.get("type")
    if given not in _TYPES:
        raise FreeArtError(f"{path}: type is {given!r}, expected rotate or translate"[:300])
    joint_type, key = _TYPES[given]
    axis = unit_vector(checked.numbers(data, "axis_d", (3,), path), f"{path}: axis_d")
    pivot = scale * checked.numbers(data, "axis_o", (3,), path)
    amount = read_number(data, key, path)
    span = float(np.radians(amount)) if joint_type == "revolute" else scale * amount
    static, moving = _find_surface(folder, step, "static"), _find_surface(folder, step, "dyn_t0")
    meshes = None
    if static is not None and moving is not None:
        meshes = read_part(static, folder, scale)[0], read_part(moving, folder, scale)[0]
    elif static is not None and (half := _find_surface(folder, step, "dynamic")) is not None:
        joint = Joint("joint", joint_type, axis, pivot, -np.inf, np.inf)
        at_start = read_part(half, folder, scale)[0].moved(joint.transform(-span / 2))
        meshes = read_part(static, folder, scale)[0], at_start
    return two_state_result(folder, request, "zup", joint_type, axis, pivot, span, meshes, (TYPE_GIVEN,))


def _find_surface(folder: Path, step: int, part: str) -> Path | None:
    """The mesh of that step; among several resolutions or thresholds, the first by name."""
    return next(iter(sorted(folder.glob(f"it{step}_{part}_*.ply"))), None)


LAYOUT = Layout(
    "paris",
    "PARIS, https://github.com/3dlg-hcvc/paris",
    "3dlg-hcvc/paris@fcab60d2e9f65d67134931f45a8592bed9e21fde:systems/base.py, utils/mixins.py, preprocess.py",
    lambda folder: bool(_list_motions(folder)),
    _read,
    subfolders=("save", "*/save", "*"),
    frame="zup",
)
