"""The folder of joint hypotheses that iTACO writes and FreeArtGS took over: the same names, but not the same meaning.

    surface_pcd.ply                    10,000 points of the whole
    revolute/ and, or, prismatic/
      joint_axis.npy (3,)   joint_pos.npy (3,)   joint_value.npy (N,) rad or m   best_loss.txt
      camera_poses.npy (N, 7) quaternion w, x, y, z, then position: world from camera
      moving_map.npz        'a' (N, H, W) soft map of the moving part, in [0, 1]
      moving_pcd.ply, static_pcd.ply (or *_mesh.ply)

The world is the frame of the static part. Which axes the cameras have and which way the states count differs between
the two projects, and their evaluators do not see it: both compare states whatever their sign.
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
from leaderboard.adapters.toolbox import (
    Axes,
    Found,
    Request,
    answered,
    camera_from_world,
    frame_numbers,
    part_masks,
    read_part,
    read_vector,
    scaled_mesh,
    spread_poses,
    spread_states,
    unit,
    wxyz_first,
)


def hypotheses(folder: Path) -> tuple[str, ...]:
    """The joint types of which `folder` holds a whole hypothesis."""
    return tuple(kind for kind in JOINT_TYPES if (folder / kind / "joint_axis.npy").is_file())


def found(
    home: Path,
    kind: JointType,
    request: Request,
    axes: Axes,
    sign: float,
    first: float = 0.0,
    names: list[str] | None = None,
    cameras: Array | None = None,
) -> Found:
    """The hypothesis `kind` in the folder `home`.

    State i of the moving part is `sign` * joint_value[i], and the clouds stand at the state -`first`. `cameras`
    (N, 4, 4) stand for camera_poses.npy; `names` are the file names of the N frames that are answered, all of the
    video's, in order, when not given.
    """
    folder, n, scale = home / kind, request.frames, request.options.scale
    values = read_npy(folder / "joint_value.npy", (None,))
    if cameras is None:
        cameras = wxyz_first(read_npy(folder / "camera_poses.npy", (None, 7)), str(folder / "camera_poses.npy"))
    if len(cameras) != len(values) or not len(values):
        raise FreeArtError(f"{folder} has {len(values)} joint values and {len(cameras)} camera poses, expected as many")
    stems = names if names is not None else [str(i) for i in range(len(values))]
    if names is None and len(values) != n:
        raise FreeArtError(f"{folder} has {len(values)} joint values, the video has {n} frames")
    if len(stems) != len(values):
        raise FreeArtError(f"{folder} has {len(values)} joint values for {len(stems)} named frames")
    at, _ = frame_numbers(stems, n, str(folder))
    metres = scale if kind == "prismatic" else 1.0
    states = spread_states(sign * values * metres, at, n)
    axis = unit(read_vector(folder / "joint_axis.npy"), str(folder / "joint_axis.npy"))
    pivot = read_vector(folder / "joint_pos.npy") * scale
    joint = Joint("joint", kind, axis, pivot, -np.inf, np.inf)
    reference = spread_poses(camera_from_world(cameras, f"{folder} camera poses", axes, scale), at, n)
    seen, notes = answered(at, n)
    masks, path = None, folder / "moving_map.npz"
    if path.is_file():
        masks = part_masks(checked.read_npz(path, ("a",))["a"], at, request, str(path))
    meshes, said = _meshes(folder, home, scale)
    if meshes is not None and first:
        meshes = meshes[0], meshes[1].moved(joint.transform(first * metres))
    notes += (*said, "poses of the moving part are those of its joint and states, as the layout has no others")
    return Found(joint, states, (reference, reference @ joint.transform(states)), 0, None, masks, meshes, seen, notes)


def _meshes(folder: Path, home: Path, scale: float) -> tuple[tuple[Mesh, Mesh] | None, tuple[str, ...]]:
    parts, notes = [], []
    for side in ("static", "moving"):
        paths = [path for end in ("mesh", "pcd") if (path := folder / f"{side}_{end}.ply").is_file()]
        if not paths:
            return None, (f"it has no {side}_mesh.ply and no {side}_pcd.ply: no surface is measured",)
        mesh, note = read_part(paths[0], home)
        parts.append(scaled_mesh(mesh, scale))
        notes += [note] if note else []
    return (parts[0], parts[1]), tuple(notes)
