"""RSRD (Robot See Robot Do): keyframes.txt of its tracker, and the Gaussians that it moved.

    keyframes.txt                JSON: part_deltas [T][P][7], T_objreg_objinit [1][7]: quaternion w, x, y, z; position
    part_0.ply ... part_<P-1>.ply  Gaussians (or any points) of each part, as scanned, in nerfstudio's world
    dataparser_transforms.json   "scale": nerfstudio's units in a metre (or --scale, metres in one unit)

Read in kerrj/rsrd@0c047831a85fd72ee1f76e3ac5cece9acd87e0ce: rsrd/motion/motion_optimizer.py (save_tracks; the object's
frame is at the mean of all Gaussians, a part's at the mean of its own, neither turned; the camera is at the world's
origin) and rsrd/util/warp_kernels.py (the order of the products). A part's points go to
T_world_obj T_objreg_objinit T_obj_part delta (T_world_obj T_obj_part)^-1 in the camera, whose axes are OpenGL's as
nerfstudio has them. `dataset_scale` divides lengths to metres in rsrd/robot/graspable_obj.py.

The means are in the trained model only (a pickled checkpoint, which is not read), so the parts' Gaussians must be
exported beside keyframes.txt; without them neither the axis's place nor any pose can be known. RSRD has no joint: it is
fitted here. Its part_deltas are one a frame of the video; P may be more than two.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from freeart21 import se3
from freeart21.errors import FreeArtError
from freeart21.files import checked
from freeart21.formats.third_party import T_GL_CV
from freeart21.se3 import Array
from leaderboard.adapters.followed import Followed, found_of
from leaderboard.adapters.toolbox import Found, Layout, Request, read_part, scaled, scaled_mesh, wxyz_first

MAX_PARTS = 64


def _fits(folder: Path) -> bool:
    return (folder / "keyframes.txt").is_file()


def _read(folder: Path, request: Request) -> Found:
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
                f"model knows; export the Gaussians of all {count} parts as part_0.ply to part_{count - 1}.ply"
            )
    read = [read_part(file, folder) for file in files]
    clouds = [_points(mesh.vertices, bool(note)) for mesh, note in read]
    scale, notes = _scale(folder, request)
    means = [cloud.mean(0) for cloud in clouds]
    middle = np.concatenate(clouds).mean(0)
    T_world_obj = _at(middle) @ wxyz_first(start, f"{path}: T_objreg_objinit")[0]
    Ts_delta = wxyz_first(deltas, f"{path}: part_deltas")
    parts = []
    for k, (mesh, _) in enumerate(read):
        Ts = T_world_obj @ _at(means[k] - middle) @ Ts_delta[:, k]
        Ts = scaled(se3.inverse(T_GL_CV) @ Ts, scale)
        own = scaled_mesh(mesh.moved(_at(-means[k])), scale)
        parts.append(Followed(se3.orthonormalised(Ts), own, float(len(clouds[k]))))
    said = tuple(note for _, note in read if note)
    return found_of(parts, np.arange(frames), frames, (*notes, *said))


def _points(vertices: Array, cloud: bool) -> Array:
    """The Gaussians' centres: of a cloud that became triangles, the middle of each."""
    return vertices.reshape(-1, 3, 3).mean(1) if cloud else vertices


def _at(position: Array) -> Array:
    return se3.pose(np.eye(3), position)


def _scale(folder: Path, request: Request) -> tuple[float, tuple[str, ...]]:
    """Metres in one unit of nerfstudio's world."""
    path = folder / "dataparser_transforms.json"
    if request.options.scale != 1 or not path.is_file():
        said = "no dataparser_transforms.json: one unit of its world is taken for a metre"
        return request.options.scale, () if request.options.scale != 1 else (said,)
    value = checked.read_json(path).get("scale")
    if isinstance(value, bool) or not isinstance(value, int | float) or not 1e-6 < value < 1e6:
        raise FreeArtError(f"{path}: 'scale' is {value!r}, expected units in a metre"[:300])
    return 1 / float(value), ()


LAYOUT = Layout(
    "rsrd",
    "RSRD (Robot See Robot Do), https://github.com/kerrj/rsrd",
    "kerrj/rsrd@0c047831a85fd72ee1f76e3ac5cece9acd87e0ce:rsrd/motion/motion_optimizer.py, rsrd/util/warp_kernels.py",
    _fits,
    _read,
)
