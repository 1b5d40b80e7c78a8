"""Other projects' files of a made-up truth, typed here as those projects write them.

Frames and units are worked out with plain matrices and SciPy, by no code of the adapters, so that a known point (the
truth) proves the adapter's own.
"""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import trimesh
from plyfile_like import write_cloud
from scipy.spatial.transform import Rotation
from score_files import few_samples, truths, write_data

from freeart21.files.result import read_method
from leaderboard.adapters.importer import import_results
from leaderboard.adapters.layout import Options
from leaderboard.sequence_score import score_sequence

__all__ = ["few_samples", "write_data"]
GL = np.diag([1.0, -1.0, -1.0, 1.0])
"""OpenGL's camera from OpenCV's, and back."""


def rigid(seed: int) -> np.ndarray:
    rng = np.random.default_rng(seed)
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = Rotation.random(random_state=seed).as_matrix(), rng.normal(size=3)
    return T


def turned(axis, pivot, angle) -> np.ndarray:
    """The right-hand turn by `angle` rad about the line, as 4 x 4."""
    T = np.eye(4)
    T[:3, :3] = Rotation.from_rotvec(np.asarray(axis) * angle).as_matrix()
    T[:3, 3] = pivot - T[:3, :3] @ pivot
    return T


def moved(joint, state) -> np.ndarray:
    """What a truth's joint does to its moving part's points at state zero."""
    if joint.type == "revolute":
        return turned(joint.axis, joint.pivot, state)
    T = np.eye(4)
    T[:3, 3] = joint.axis * state
    return T


def apply(T, points) -> np.ndarray:
    return np.asarray(points) @ T[:3, :3].T + T[:3, 3]


def wxyz(R) -> np.ndarray:
    x, y, z, w = Rotation.from_matrix(R).as_quat()
    return np.array([w, x, y, z])


def surface_points(mesh, count, seed=0) -> np.ndarray:
    made = trimesh.Trimesh(mesh.vertices, mesh.faces, process=False)
    return np.asarray(trimesh.sample.sample_surface(made, count, seed=seed)[0])


def write_json(path: Path, data) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps(data))


R_LABEL_LINK = Rotation.from_euler("zyx", [90, 0, -90], degrees=True).as_matrix()
"""PartNet-Mobility's mesh frame (y up) from the URDF's root link (z up), as iTACO's utils.py turns it."""
R_ZUP_LABEL = np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]])
"""PARIS's world from that, as its preprocess.py turns it."""


def world_of(R) -> np.ndarray:
    T = np.eye(4)
    T[:3, :3] = R
    return T


def official_example(folder: Path, truth, world_seed=6) -> Path:
    """What an official FreeArt-21 example says of the object's and the camera's poses in the world."""
    T_world_camera = rigid(world_seed)
    poses = []
    for T in truth.Ts_camera_reference:
        here = T_world_camera @ T
        poses.append({"position": here[:3, 3].tolist(), "quaternion": wxyz(here[:3, :3]).tolist()})
    write_json(folder / "object_poses.json", poses)
    write_json(folder / "camera_params.json", [{"model_matrix": (T_world_camera @ GL).tolist()}] * len(poses))
    return folder


def evaluation_data(
    folder: Path, truth, *, world, stand, sign, axes, soft=False, wxyz_of=wxyz, unit=1.0, kind=None, zoom=1, noise=0.0
) -> Path:
    """A hypothesis folder of the truth: the static part stands in `world`, the clouds at the joint state `stand`."""
    joint, n = truth.articulation.joint, len(truth)
    home = folder / (kind or joint.type)
    home.mkdir(parents=True, exist_ok=True)
    cameras = [world @ np.linalg.inv(T) @ (GL if axes == "opengl" else np.eye(4)) for T in truth.Ts_camera_reference]
    np.save(home / "joint_axis.npy", world[:3, :3] @ joint.axis * (1.7 if soft else 1.0))  # iTACO's is not normalised
    np.save(home / "joint_pos.npy", apply(world, joint.pivot))
    np.save(home / "joint_value.npy", sign * (truth.states - stand) * unit + noise)
    np.save(home / "camera_poses.npy", np.array([[*wxyz_of(T[:3, :3]), *T[:3, 3]] for T in cameras]))
    maps = np.stack([truth.part_mask(i) == 2 for i in range(n)]).astype(float)
    maps = np.where(maps > 0, 0.8, 0.3) if soft else maps
    np.savez_compressed(home / "moving_map.npz", a=maps.repeat(zoom, 1).repeat(zoom, 2))
    static = apply(world, surface_points(truth.articulation.reference, 4000))
    moving = apply(world @ moved(joint, stand), surface_points(truth.articulation.moving, 3000, 1))
    write_cloud(home / "static_pcd.ply", static, (0, 0, 255))
    write_cloud(home / "moving_pcd.ply", moving, (255, 0, 0))
    write_cloud(folder / "surface_pcd.ply", np.concatenate([static, moving]), (255, 255, 255))
    return home


def imported(data, source, out, layout, **options):
    """The row of sequence `a` (or another) after an import."""
    name = options.pop("name", "a")
    report = import_results(layout, source, data, out, Options(**options))
    assert name in report.sequences
    return score_sequence(out / name, data / "sequences" / name, data / "truth" / name, lacks=lacks(out))


def lacks(out) -> tuple[str, ...]:
    return read_method(out).lacks


def truth_of(name="a"):
    return truths()[name]
