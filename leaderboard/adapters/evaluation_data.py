"""The folder of joint hypotheses that iTACO writes and FreeArtGS adopted: same names, partly different meaning.

    surface_pcd.ply                    10,000 points of the whole object
    revolute/ and, or, prismatic/
      joint_axis.npy (3,)   joint_pos.npy (3,)   joint_value.npy (N,) rad or m   best_loss.txt
      camera_poses.npy (N, 7) quaternion w, x, y, z, then position: world from camera
      moving_map.npz        'a' (N, H, W) soft map of the moving part, in [0, 1]
      moving_pcd.ply, static_pcd.ply (or *_mesh.ply)

The world is the frame of the static part. Camera axes and the sign of the states differ between the two projects; their
evaluators ignore both, as they compare states whatever their sign.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from freeart21.errors import FreeArtError
from freeart21.files import checked
from freeart21.formats.third_party import read_npy
from freeart21.joint import JOINT_TYPES, Joint, JointType
from freeart21.mesh import Mesh
from freeart21.se3 import Array
from leaderboard.adapters import readers
from leaderboard.adapters.layout import Axes, ImportedResult, Request


def list_hypotheses(folder: Path) -> tuple[str, ...]:
    """The joint types with a hypothesis in `folder`."""
    return tuple(kind for kind in JOINT_TYPES if (folder / kind / "joint_axis.npy").is_file())


def read_hypothesis(
    home: Path,
    joint_type: JointType,
    request: Request,
    axes: Axes,
    sign: float,
    first: float = 0.0,
    names: list[str] | None = None,
    cameras: Array | None = None,
) -> ImportedResult:
    """The hypothesis of `joint_type` in the folder `home`.

    State i of the moving part is `sign` * joint_value[i]; the clouds are at the state -`first`. `cameras` (N, 4, 4)
    replace camera_poses.npy. `names` are the file names of the N frames with a result; None means all of the video's.
    """
    folder, n, scale = home / joint_type, request.frames, request.options.scale
    values = read_npy(folder / "joint_value.npy", (None,))
    if cameras is None:
        path = folder / "camera_poses.npy"
        cameras = readers.poses_from_wxyz(read_npy(path, (None, 7)), str(path))
    if len(cameras) != len(values) or not len(values):
        raise FreeArtError(f"{folder} has {len(values)} joint values and {len(cameras)} camera poses, expected as many")
    stems = names if names is not None else [str(i) for i in range(len(values))]
    if names is None and len(values) != n:
        raise FreeArtError(f"{folder} has {len(values)} joint values, the video has {n} frames")
    if len(stems) != len(values):
        raise FreeArtError(f"{folder} has {len(values)} joint values for {len(stems)} named frames")
    at, _ = readers.number_frames(stems, n, str(folder))
    metres = scale if joint_type == "prismatic" else 1.0
    states = readers.interpolate_states(sign * values * metres, at, n)
    axis = readers.unit_vector(readers.read_vector(folder / "joint_axis.npy"), str(folder / "joint_axis.npy"))
    pivot = readers.read_vector(folder / "joint_pos.npy") * scale
    joint = Joint("joint", joint_type, axis, pivot, -np.inf, np.inf)
    cameras = readers.cameras_from_world(cameras, f"{folder} camera poses", axes, scale)
    reference = readers.nearest_poses(cameras, at, n)
    seen, notes = readers.frames_with_result(at, n)
    masks, path = None, folder / "moving_map.npz"
    if path.is_file():
        masks = readers.masks_from_maps(checked.read_npz(path, ("a",))["a"], at, request, str(path))
    meshes, mesh_notes = _read_meshes(folder, home, scale)
    if meshes is not None and first:
        meshes = meshes[0], meshes[1].moved(joint.transform(first * metres))
    notes += (*mesh_notes, "poses of the moving part are those of its joint and states, as the layout has no others")
    poses = reference, reference @ joint.transform(states)
    return ImportedResult(joint, states, poses, masks=masks, meshes=meshes, seen=seen, notes=notes)


def _read_meshes(folder: Path, home: Path, scale: float) -> tuple[tuple[Mesh, Mesh] | None, tuple[str, ...]]:
    parts, notes = [], []
    for side in ("static", "moving"):
        paths = [path for kind in ("mesh", "pcd") if (path := folder / f"{side}_{kind}.ply").is_file()]
        if not paths:
            return None, (f"it has no {side}_mesh.ply and no {side}_pcd.ply: no surface is measured",)
        mesh, note = readers.read_part(paths[0], home)
        parts.append(readers.scale_mesh(mesh, scale))
        notes += [note] if note else []
    return (parts[0], parts[1]), tuple(notes)
