"""A data folder in the scene-wise format of BOP (bop_toolkit, docs/bop_datasets_format.md): 6D poses of both parts.

Facts of the format: millimetres; cam_K for pixel centres at whole numbers (ours are at +0.5); cam_R_m2c row by row;
depth_scale times a depth picture is millimetres; mask/ has the whole silhouette of an object, mask_visib/ what is seen;
names of masks are IMAGE_OBJECT, both of six digits.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from freeart21 import processes, se3
from freeart21.articulation import PARTS
from freeart21.camera import Camera
from freeart21.errors import FreeArtError
from freeart21.files import atomic, checked
from freeart21.files.benchmark import read_benchmark
from freeart21.files.mesh_file import write_ply
from freeart21.files.sequence import read_sequence
from freeart21.files.truth import read_truth
from freeart21.mesh import Mesh, used_vertices
from freeart21.se3 import Array
from freeart21.z_buffer import draw_triangles
from leaderboard.release.shards import Progress

MM = 1000.0
_FARTHEST = 1e6
"""Pixels: a corner beyond that is not drawn."""


def write_bop(data: Path, out: Path, progress: Progress = lambda *_: None) -> int:
    """Write `out`/models and `out`/SPLIT/000001, ...: a scene a sequence, two objects each; gives the number of scenes.

    Object 2 k - 1 is the reference part of scene k, 2 k its moving part. Raises FreeArtError without a truth.
    """
    benchmark = read_benchmark(data)
    with atomic.new_folder(Path(out)) as new:
        models: dict[str, Any] = {}
        (new / "models").mkdir()
        for k, name in enumerate(benchmark.sequences):
            truth = read_truth(benchmark.truth(name))
            for part in range(len(PARTS)):
                id, mesh = 2 * k + part + 1, truth.articulation.part(PARTS[part])
                if mesh.empty:
                    raise FreeArtError(f"{benchmark.truth(name)}: its {PARTS[part]} part has no faces")
                scaled = Mesh(mesh.vertices * MM, mesh.faces, mesh.colours)
                write_ply(new / "models" / f"obj_{id:06d}.ply", scaled)
                models[str(id)] = {**_size(scaled), "sequence": name, "part": PARTS[part]}
            _write_scene(new / "test" / f"{k + 1:06d}", benchmark.sequence(name), benchmark.truth(name), 2 * k + 1)
            progress(f"Wrote {name}", k + 1, len(benchmark.sequences))
        atomic.write_json(new / "models" / "models_info.json", models)
        recording = read_sequence(benchmark.sequence(benchmark.sequences[0]))
        camera = {"width": recording.camera.width, "height": recording.camera.height, "depth_scale": 1.0}
        K = _matrix(recording.camera)
        camera |= {"fx": K[0, 0], "fy": K[1, 1], "cx": K[0, 2], "cy": K[1, 2]}
        atomic.write_json(new / "camera.json", camera)
        targets = [
            {"scene_id": k + 1, "im_id": i, "obj_id": 2 * k + part + 1, "inst_count": 1}
            for k, name in enumerate(benchmark.sequences)
            for i in range(len(read_sequence(benchmark.sequence(name))))
            for part in range(len(PARTS))
        ]
        atomic.write_json(new / "test_targets_bop19.json", targets)
    return len(benchmark.sequences)


def _write_scene(scene: Path, sequence: Path, truth_folder: Path, first: int) -> None:
    recording, truth = read_sequence(sequence), read_truth(truth_folder)
    scale = float(checked.read_json(sequence / "sequence.json")["depth_scale"])
    cameras: dict[str, Any] = {}
    poses: dict[str, Any] = {}
    infos: dict[str, Any] = {}
    for i in range(len(recording)):
        processes.raise_if_stopped()
        for sub in ("rgb", "depth"):
            picture = checked.read_bytes(sequence / sub / f"{i:05d}.png", checked.MAX_IMAGE_BYTES, sequence)
            atomic.write_bytes(scene / sub / f"{i:06d}.png", picture, sync=False)
        frame, labels = recording.frame(i), truth.part_mask(i)
        cameras[str(i)] = {"cam_K": _matrix(recording.camera).ravel(), "depth_scale": scale * MM}
        poses[str(i)], infos[str(i)] = [], []
        for part, name in enumerate(PARTS):
            T = (truth.Ts_camera_reference, truth.Ts_camera_moving)[part][i]
            visible = labels == part + 1
            whole = silhouette(truth.articulation.part(name), T, recording.camera) | visible
            for sub, mask in (("mask", whole), ("mask_visib", visible)):
                content = checked.encode_png(mask.astype(np.uint8) * 255)
                atomic.write_bytes(scene / sub / f"{i:06d}_{part:06d}.png", content, sync=False)
            pose = {"cam_R_m2c": T[:3, :3].ravel(), "cam_t_m2c": T[:3, 3] * MM}
            poses[str(i)].append({**pose, "obj_id": first + part, "state": truth.states[i]})
            share = float(visible.sum() / whole.sum()) if whole.any() else 0.0
            count = {"px_count_all": int(whole.sum()), "px_count_visib": int(visible.sum())}
            valid = {"px_count_valid": int((whole & (frame.depth > 0)).sum()), "visib_fract": share}
            infos[str(i)].append({"bbox_obj": _box(whole), "bbox_visib": _box(visible), **count, **valid})
    for file, table in (("scene_camera", cameras), ("scene_gt", poses), ("scene_gt_info", infos)):
        atomic.write_json(scene / f"{file}.json", table)


def silhouette(mesh: Mesh, T_camera_mesh: Array, camera: Camera) -> NDArray[np.bool_]:
    """(height, width) pixels of a mesh alone, nothing before it."""
    points = se3.transform(T_camera_mesh, mesh.vertices)
    depth = np.full((camera.height, camera.width), np.inf)
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        at = points[:, :2] / points[:, 2:] * np.diag(camera.K)[:2] + camera.K[:2, 2]
    finite = np.asarray((np.abs(at) < _FARTHEST).all(1))  # NaN is not
    faces = np.ascontiguousarray(mesh.faces[finite[mesh.faces].all(1)])
    weights, face = np.empty((*depth.shape, 3)), np.full(depth.shape, -1)
    draw_triangles(np.ascontiguousarray(at), np.ascontiguousarray(points[:, 2]), faces, depth, face, weights)
    return face >= 0


def _matrix(camera: Camera) -> Array:
    """The intrinsic matrix for pixel centres at whole numbers."""
    K = np.array(camera.K, float)
    K[:2, 2] -= 0.5
    return K


def _box(mask: NDArray[np.bool_]) -> list[int]:
    """x, y, width, height; -1 where there is no pixel, as BOP has it."""
    if not mask.any():
        return [-1, -1, -1, -1]
    rows, columns = np.flatnonzero(mask.any(1)), np.flatnonzero(mask.any(0))
    return [int(v) for v in (columns[0], rows[0], columns[-1] - columns[0], rows[-1] - rows[0])]


def _size(mesh: Mesh) -> dict[str, float]:
    """Diameter and box, millimetres."""
    from scipy.spatial import ConvexHull, QhullError, distance

    used = used_vertices(mesh)
    low, high = used.min(0), used.max(0)
    try:
        hull = used[ConvexHull(used).vertices]
    except QhullError:  # flat
        hull = used
    names = [f"{what}_{axis}" for what in ("min", "size") for axis in "xyz"]
    diameter = max(float(distance.cdist(hull[k : k + 500], hull).max()) for k in range(0, len(hull), 500))
    return {"diameter": diameter, **dict(zip(names, [*low, *(high - low)], strict=True))}
