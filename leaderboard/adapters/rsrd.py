"""RSRD (Robot See Robot Do): keyframes.txt of its tracker, and the Gaussians that it moves.

    keyframes.txt                JSON: part_deltas [T][P][7], T_objreg_objinit [1][7]: quaternion w, x, y, z; position
    part_0.ply ... part_<P-1>.ply  Gaussians (or any points) of each part, as scanned, in nerfstudio's world
    dataparser_transforms.json   "scale": nerfstudio's units per metre (or --scale, metres per unit)

Read in kerrj/rsrd@0c047831a85fd72ee1f76e3ac5cece9acd87e0ce: rsrd/motion/motion_optimizer.py (save_tracks; the object's
frame is at the mean of all Gaussians, a part's at the mean of its own, both without rotation; the camera is at the
world's origin) and rsrd/util/warp_kernels.py (the order of the products). A part's points go to
T_world_obj T_objreg_objinit T_obj_part delta (T_world_obj T_obj_part)^-1 in the camera, which has OpenGL's axes as in
nerfstudio. `dataset_scale` divides lengths to metres in rsrd/robot/graspable_obj.py.

The means are only in the trained model, a pickled checkpoint that is not read, so the parts' Gaussians have to be
exported to the folder of keyframes.txt; without them neither axis nor poses can be computed. RSRD has no joint: it is
fitted here. part_deltas has one entry per frame of the video; P can exceed two.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from freeart21 import se3
from freeart21.errors import FreeArtError
from freeart21.files import checked
from freeart21.formats.third_party import T_GL_CV
from freeart21.se3 import Array
from leaderboard.adapters.layout import ImportedResult, Layout, Request
from leaderboard.adapters.readers import poses_from_wxyz, read_part, scale_mesh, scale_poses
from leaderboard.adapters.tracked_parts import TrackedPart, fit_tracked_parts

MAX_PARTS = 64


def _read(folder: Path, request: Request) -> ImportedResult:
    path = folder / "keyframes.txt"
    data = checked.read_json(path)
    deltas = checked.numbers(data, "part_deltas", (None, None, 7), path)
    start = checked.numbers(data, "T_objreg_objinit", (1, 7), path)
    frames, count = deltas.shape[:2]
    if frames != request.frames or not 2 <= count <= MAX_PARTS:
        raise FreeArtError(
            f"{path} has {frames} frames of {count} parts, expected {request.frames} frames of 2 to {MAX_PARTS} parts"
        )
    files = [folder / f"part_{k}.ply" for k in range(count)]
    for file in files:
        if not file.is_file():
            raise FreeArtError(
                f"{file} is missing: part_deltas turn about the mean of each part's Gaussians, which only the trained "
                f"model has; export the Gaussians of all {count} parts as part_0.ply to part_{count - 1}.ply"
            )
    surfaces = [read_part(file, folder) for file in files]
    clouds = [_centres(mesh.vertices, bool(note)) for mesh, note in surfaces]
    scale, notes = _read_scale(folder, request)
    means = [cloud.mean(0) for cloud in clouds]
    mean = np.concatenate(clouds).mean(0)
    T_world_obj = _translation(mean) @ poses_from_wxyz(start, f"{path}: T_objreg_objinit")[0]
    Ts_delta = poses_from_wxyz(deltas, f"{path}: part_deltas")
    parts = []
    for k, (mesh, _) in enumerate(surfaces):
        Ts = T_world_obj @ _translation(means[k] - mean) @ Ts_delta[:, k]
        Ts = scale_poses(se3.inverse(T_GL_CV) @ Ts, scale)
        own = scale_mesh(mesh.moved(_translation(-means[k])), scale)
        parts.append(TrackedPart(se3.orthonormalised(Ts), own, float(len(clouds[k]))))
    notes += tuple(note for _, note in surfaces if note)
    return fit_tracked_parts(parts, np.arange(frames), frames, notes)


def _centres(vertices: Array, is_cloud: bool) -> Array:
    """Centres of the Gaussians; those of a cloud, read as triangles, are the triangles' centres."""
    return vertices.reshape(-1, 3, 3).mean(1) if is_cloud else vertices


def _translation(position: Array) -> Array:
    return se3.pose(np.eye(3), position)


def _read_scale(folder: Path, request: Request) -> tuple[float, tuple[str, ...]]:
    """Metres per unit of nerfstudio's world, and a note when neither the user nor a file gives it."""
    path = folder / "dataparser_transforms.json"
    if request.options.scale != 1:
        return request.options.scale, ()
    if not path.is_file():
        return 1.0, ("no dataparser_transforms.json: one unit of its world is assumed to be a metre",)
    return 1 / checked.number(checked.read_json(path), "scale", path, 1e-6, 1e6, "units in a metre"), ()


LAYOUT = Layout(
    "rsrd",
    "RSRD (Robot See Robot Do), https://github.com/kerrj/rsrd",
    "kerrj/rsrd@0c047831a85fd72ee1f76e3ac5cece9acd87e0ce:rsrd/motion/motion_optimizer.py, rsrd/util/warp_kernels.py",
    lambda folder: (folder / "keyframes.txt").is_file(),
    _read,
)
