"""iTACO (Video2Articulation): the folder of refined joints, `refinement/monst3r/chamfer/<seed>`.

    surface_pcd.ply                    10,000 points of the whole object
    revolute/ and, or, prismatic/
      joint_axis.npy (3,)   joint_pos.npy (3,)   joint_value.npy (N,) rad or m   best_loss.txt
      camera_poses.npy (N, 7) quaternion w, x, y, z, then position: world from camera
      moving_map.npz        'a' (N, H, W) soft map of the moving part, in [0, 1]
      moving_pcd.ply, static_pcd.ply (or *_mesh.ply)

FreeArtGS adopted these files, with a partly different meaning, and reads them by `read_hypothesis`. The world is the
frame of the static part. Camera axes and the sign of the states differ between the two projects; their
evaluators ignore both, as they compare states whatever their sign.

Read in 3dlg-hcvc/video2articulation@74903b413f3ef3b7f64df166aac4adcd3ac8ebe5: joint_refinement.py (files; a point seen
in frame i is mapped to the scanned surface by the camera, then rotated by the right-hand rule by joint_value[i], so the
part moves the other way from the surface to the frame), extract_mesh.py (meshes and clouds, at the surface's state),
evaluate.py (which type counts, and what is a failure), utils.py (cameras of the simulated data have OpenGL's axes;
those of the real data, data.py RealDataLoader, OpenCV's: `--axes opencv`).

The type is the one of smaller best_loss, but prismatic when the revolute axis is 0.15 m or more from the surface. Here
that is surface_pcd.ply, their reconstruction, while their evaluator has the scan. A missing best_loss is 100; without
any, their evaluator counts a failure, as does the import. N is the number of frames in sample_rgb, as in the sequences
that `freeart21 convert` makes of their data.
"""

from __future__ import annotations

import math
import re
from dataclasses import replace
from pathlib import Path

import numpy as np

from freeart21.errors import FreeArtError
from freeart21.files import checked
from freeart21.files.mesh_file import read_ply
from freeart21.formats.third_party import read_npy
from freeart21.joint import JOINT_TYPES, Joint, JointType
from freeart21.mesh import Mesh
from freeart21.reconstruction import Failure
from freeart21.se3 import Array
from leaderboard.adapters import readers
from leaderboard.adapters.layout import Axes, ImportedResult, Layout, Request

NO_LOSS = 100.0
NEAR_M = 0.15
_SEQUENCE = re.compile(r"([A-Za-z]+)-([0-9]+)-(joint_[0-9]+)-(view_[A-Za-z0-9]+)")


def _sequence_folders(sequence: str) -> tuple[str, ...]:
    """The folder in their data set of a sequence that `freeart21 convert` made of it."""
    match = _SEQUENCE.fullmatch(sequence)
    return (f"{match[1]}/{match[2]}/{match[3]}_bg/{match[4]}",) if match else ()


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


def _matches(folder: Path) -> bool:
    return bool(list_hypotheses(folder)) and not (folder / "export_manifest.json").is_file()


def _read(folder: Path, request: Request) -> ImportedResult | Failure:
    losses = {kind: _read_loss(folder / kind / "best_loss.txt") for kind in list_hypotheses(folder)}
    kinds = [kind for kind, loss in losses.items() if loss < NO_LOSS]
    if not kinds:
        return Failure("refinement", "neither the revolute nor the prismatic hypothesis has a best_loss")
    joint_type: JointType = "revolute" if min(kinds, key=lambda k: losses[k]) == "revolute" else "prismatic"
    note = f"{joint_type} by best_loss {losses[joint_type]:.3g}"
    surface = folder / "surface_pcd.ply"
    if joint_type == "revolute" and "prismatic" in losses and surface.is_file():
        axis_file = folder / joint_type / "joint_axis.npy"
        axis = readers.unit_vector(readers.read_vector(axis_file), str(axis_file))
        points = read_ply(surface)[0].vertices - readers.read_vector(folder / joint_type / "joint_pos.npy")
        distance = float(np.linalg.norm(np.cross(points, axis), axis=1).min()) * request.options.scale
        if distance >= NEAR_M:
            joint_type = "prismatic"
            note = f"prismatic, as the revolute axis is {distance:.3g} m from the surface"
    result = read_hypothesis(folder, joint_type, request, request.options.axes or LAYOUT.axes or "opengl", -1.0)
    return replace(result, notes=(*result.notes, note))


def _read_loss(path: Path) -> float:
    if not path.is_file():
        return NO_LOSS
    text = checked.read_text(path, 1 << 10, errors="replace").strip()
    try:
        value = float(text)
    except ValueError:
        raise FreeArtError(f"{path} holds {text[:40]!r}, expected a number") from None
    return NO_LOSS if math.isnan(value) else value


LAYOUT = Layout(
    "itaco",
    "iTACO (Video2Articulation), https://github.com/3dlg-hcvc/video2articulation",
    "3dlg-hcvc/video2articulation@74903b413f3ef3b7f64df166aac4adcd3ac8ebe5:joint_refinement.py, extract_mesh.py",
    _matches,
    _read,
    subfolders=("refinement/*/*/*", "chamfer/*", "*"),
    axes="opengl",
    sequence_folders=_sequence_folders,
)
