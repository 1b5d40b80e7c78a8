"""Other projects' files of a made-up truth, typed here as those projects write them.

Frames and units are computed with plain matrices and SciPy, without the adapters' code.
"""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import trimesh
from plyfile_like import write_cloud, write_mesh, write_obj
from scipy.spatial.transform import Rotation
from score_files import truths

from freeart21.files.result import read_method
from leaderboard.adapters.importer import import_results
from leaderboard.adapters.layout import Options
from leaderboard.sequence_score import score_sequence

ANCHOR = 4
"""Frame of the video that shows the first state of methods without a video."""
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
    folder: Path, truth, *, world, stand, sign, axes, soft=False, wxyz_of=wxyz, kind=None, zoom=1, noise=0.0
) -> Path:
    """A hypothesis folder of the truth: the static part stands in `world`, the clouds at the joint state `stand`."""
    joint, n = truth.articulation.joint, len(truth)
    home = folder / (kind or joint.type)
    home.mkdir(parents=True, exist_ok=True)
    cameras = [world @ np.linalg.inv(T) @ (GL if axes == "opengl" else np.eye(4)) for T in truth.Ts_camera_reference]
    np.save(home / "joint_axis.npy", world[:3, :3] @ joint.axis * (1.7 if soft else 1.0))  # iTACO's is not normalised
    np.save(home / "joint_pos.npy", apply(world, joint.pivot))
    np.save(home / "joint_value.npy", sign * (truth.states - stand) + noise)
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
    return score_sequence(out / name, data / "sequences" / name, data / "truth" / name, "strict-2", lacks=lacks(out))


def lacks(out) -> tuple[str, ...]:
    return read_method(out).lacks


def truth_of(name="a"):
    return truths()[name]


ZUP = world_of(R_ZUP_LABEL @ R_LABEL_LINK)
"""PARIS's world from the object's frame."""


def freeartgs(folder, name="a", *, with_training=True, frames=None, wrong=None):
    """`outputs/<id>` as FreeArtGS leaves it, trained with the clouds at joint state 0.2 of the truth's."""
    truth = truth_of(name)
    joint, n, world = truth.articulation.joint, len(truth), rigid(1)
    home = folder / "evaluation_data"
    trained = truth.states - 0.2
    quaternion = (lambda R: Rotation.from_matrix(R).as_quat()) if wrong == "xyzw" else None
    more = {"wxyz_of": quaternion} if quaternion else {}
    kind = evaluation_data(home, truth, world=world, stand=0.2, sign=1, axes="opencv", zoom=2, **more)
    values = trained - trained[0]
    np.save(kind / "joint_value.npy", np.degrees(values) if wrong == "degrees" else values)
    if wrong != "xyzw":
        cameras = [world @ np.linalg.inv(T) for T in truth.Ts_camera_reference]
        named = [{"file_path": f"images/{i:05d}.png", "transform_matrix": T.tolist()} for i, T in enumerate(cameras)]
        write_json(kind / "camera_poses.json", named)
        if frames is not None:
            write_json(kind / "camera_poses.json", [named[i] for i in frames])
            np.save(kind / "joint_value.npy", values[frames])
            maps = np.load(kind / "moving_map.npz")["a"]
            np.savez_compressed(kind / "moving_map.npz", a=maps[frames])
    (kind / "best_loss.txt").write_text("0.001\n")
    manifest = {"joint_type": joint.type, "exported_joint_types": [joint.type], "motion_part": 1}
    write_json(home / "export_manifest.json", manifest | {"weight_threshold": 0.5, "part_weight_margin": 0.3})
    if with_training:
        key = "angle_rad" if joint.type == "revolute" else "distance"
        art = {"joint_type": joint.type, "joint_axis_world": [0, 0, 1], "joint_origin_world": [0, 0, 0]}
        art["frames"] = [
            {key: float(q), "frame_index": i} for i, q in enumerate(trained[range(n) if frames is None else frames])
        ]
        write_json(folder / "splatfacto-art" / "articulation.json", art)
    return folder


def itaco(folder, name="a", *, losses=(0.01, 0.5), sign=-1):
    """Refined joints as iTACO saves them: both hypotheses, the right one of the first loss."""
    truth = truth_of(name)
    right = truth.articulation.joint.type
    other = {"revolute": "prismatic", "prismatic": "revolute"}[right]
    stand = truth.states[0]
    for kind, loss in zip((right, other), losses, strict=True):
        noise = 0 if kind == right else np.linspace(0, 0.5, len(truth))
        home = evaluation_data(
            folder, truth, world=rigid(2), stand=stand, sign=sign, axes="opengl", soft=True, kind=kind, noise=noise
        )
        if loss is not None:
            (home / "best_loss.txt").write_text(str(loss))
    return folder


def parts_at(truth, state, world):
    """Reference and moving part of the truth at a joint state, in `world` (from the object's frame)."""
    joint = truth.articulation.joint
    reference, moving = truth.articulation.reference, truth.articulation.moving
    return (
        (apply(world, reference.vertices), reference.faces),
        (apply(world @ moved(joint, state), moving.vertices), moving.faces),
    )


def artgs(folder, name="a", *, extra=False):
    truth = truth_of(name)
    joint, first = truth.articulation.joint, truth.states[ANCHOR]
    home = folder / "train" / "ours_20000"
    axis, pivot = ZUP[:3, :3] @ joint.axis, apply(ZUP, joint.pivot)
    kind = "hinge" if joint.type == "revolute" else "slider"
    entries = [
        {"id": 0, "parent": -1, "name": "root", "joint": "heavy", "jointData": {}, "visuals": ["meshes/start_0.ply"]}
    ]
    entry = {"id": 1, "parent": 0, "name": "joint_1", "joint": kind, "visuals": ["meshes/start_1.ply"]}
    entry["jointData"] = {"axis": {"origin": pivot.tolist(), "direction": axis.tolist()}, "limit": {}}
    entries.append(entry)
    for k, (vertices, faces) in enumerate(parts_at(truth, first, ZUP)):
        if extra and k == 0:  # half of the body hangs on another joint
            write_mesh(home / "meshes" / "start_2.ply", vertices, faces[::2])
            faces = faces[1::2]
        write_mesh(home / "meshes" / f"start_{k}.ply", vertices, faces)
    if extra:
        entries.append(entry | {"id": 2, "name": "joint_2", "visuals": ["meshes/start_2.ply"]})
    write_json(home / "joint_info.json", entries)
    return home


def articulate_anything(folder, name="a"):
    """The URDF of the truth with its base turned as PartNet-Mobility's: meshes in the label frame."""
    truth = truth_of(name)
    joint, label = truth.articulation.joint, world_of(R_LABEL_LINK)
    axis, pivot = label[:3, :3] @ joint.axis, apply(label, joint.pivot)
    state = truth.states[ANCHOR]  # position zero is what the anchor frame shows
    body, lid = parts_at(truth, state, label)
    write_obj(folder / "textured_objs" / "body.obj", *body)
    write_obj(folder / "textured_objs" / "lid.obj", *lid)
    xyz = "{:.12g} {:.12g} {:.12g}".format
    visual = '<visual><origin xyz="{}"/><geometry><mesh filename="textured_objs/{}.obj"/></geometry></visual>'.format
    (folder / "mobility.urdf").write_text(
        '<?xml version="1.0"?><robot name="made"><link name="base"/>'
        f'<link name="body">{visual("0 0 0", "body")}</link><link name="lid">{visual(xyz(*-pivot), "lid")}</link>'
        '<joint name="base_to_body" type="fixed"><parent link="base"/><child link="body"/>'
        '<origin xyz="0 0 0" rpy="1.570796326794897 0 -1.570796326794897"/></joint>'
        f'<joint name="body_to_lid" type="{joint.type}"><parent link="body"/><child link="lid"/>'
        f'<origin xyz="{xyz(*pivot)}" rpy="0 0 0"/><axis xyz="{xyz(*axis)}"/>'
        '<limit lower="0.0" upper="1.2"/></joint></robot>'
    )
    return folder


def screwsplat(folder, name="a", *, order="wv", shown=2, unit=1.0):
    """Arrays by the conventions of ScrewSplat in the camera's frame of the anchor, lengths in `unit`s, metres.

    The second screw is the joint."""
    truth = truth_of(name)
    joint, first, world = truth.articulation.joint, truth.states[ANCHOR], truth.Ts_camera_reference[ANCHOR]
    axis, pivot = world[:3, :3] @ joint.axis, apply(world, joint.pivot)
    turns = joint.type == "revolute"
    w, v = (axis, -np.cross(axis, pivot) / unit) if turns else (np.zeros(3), axis)
    folder.mkdir(parents=True)
    np.save(folder / "screws.npy", np.array([[0, 0, 1, 0, 0, 0], [*w, *v] if order == "wv" else [*v, *w]]))
    np.save(folder / "screw_confs.npy", np.array([0.05, 0.97]))
    thetas = truth.states - first if shown is None else np.linspace(0, 0.5, shown)
    thetas = thetas / (1.0 if turns else unit)
    np.save(folder / "theta.npy", np.stack([np.zeros(len(thetas)), thetas], 1))
    for label, mesh, T in (
        ("static", truth.articulation.reference, world),
        ("movable_2", truth.articulation.moving, world @ moved(joint, first)),
    ):
        np.save(folder / f"point_cloud_{label}.npy", apply(T, surface_points(mesh, 3000)) / unit)
    return folder


def tracked(run, Ts, mesh, seed, *, names=None, obj="textured_mesh.obj", savetxt=False):
    """One run on one part: its own frame, the poses of that frame in the camera, and the part in it."""
    own = rigid(seed)
    write_obj(run / obj, apply(own, mesh.vertices), mesh.faces)
    (run / "ob_in_cam").mkdir(parents=True)
    for i, T in enumerate(Ts @ np.linalg.inv(own)):
        path = run / "ob_in_cam" / f"{names[i] if names else f'{i:04d}'}.txt"
        if savetxt:
            np.savetxt(path, T)
        else:
            path.write_text("\n".join(" ".join(f"{x: .10g}" for x in row) for row in T) + "\n")
    return run


def runs_of(folder, name="a", of=lambda T: T, **options):
    truth = truth_of(name)
    parts = truth.articulation
    tracked(folder / "reference", of(truth.Ts_camera_reference), parts.reference, 4, **options)
    tracked(folder / "moving", of(truth.Ts_camera_moving), parts.moving, 5, **options)
    return folder


WRITERS = {
    "freeartgs": freeartgs,
    "itaco": itaco,
    "artgs": artgs,
    "articulate-anything": articulate_anything,
    "bundlesdf": runs_of,
    "foundationpose": lambda folder, name="a", **options: runs_of(folder, name, **{"obj": "mesh.obj"} | options),
    "screwsplat": screwsplat,
}
"""Layout to a function of folder and sequence that writes its files."""
