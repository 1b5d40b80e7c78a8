"""ManiSkill trajectories of the FreeArt21 environments: NAME.h5 with NAME.json, as `RecordEpisode` writes them.

    env_info.env_kwargs     asset, scale, sim_config.control_freq (JSON)
    traj_K/obs/sensor_data/CAMERA/rgb, depth (int16, millimetres), segmentation        (T + 1, h, w, 1 or 3)
    traj_K/obs/sensor_param/CAMERA/intrinsic_cv, extrinsic_cv                            (T + 1, 3, 3 or 4)
    traj_K/obs/extra/part_ids                                                            (T + 1, n, 2) see `_sides`
    traj_K/env_states/articulations/object     position, quaternion wxyz, velocities, q, qd of the joint: (T + 1, 15)

The first camera becomes the video. ManiSkill's depth is in whole millimetres, and so is the video's.
"""

from __future__ import annotations

import json
import os
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from freeart21 import se3
from freeart21.camera import Camera
from freeart21.errors import FreeArtError
from freeart21.files import atomic, checked
from freeart21.formats import third_party
from freeart21.formats.third_party import Image, KnownTruth, RecordingLayout, ThirdPartyRecording
from freeart21.recording import Frame, Recording
from freeart21.se3 import Array

FREE_MOVING = "export.maniskill:FreeArt21-FreeMoving-v1"
"""Environment id that makes gymnasium import the module."""
CONTROL_HZ = 20
"""Default of the environments."""
MAX_FILE_BYTES = 1 << 40
"""Size limit of an HDF5 file, which is read by rows."""
_MILLIMETRE = np.float32(0.001)
_SIM_HZ = 500


def objects_place() -> Path:
    """Cache folder of procedural objects: $XDG_CACHE_HOME/freeart21/objects, or ~/.cache/freeart21/objects."""
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "freeart21" / "objects"


def object_folder_of(env_kwargs: dict[str, Any]) -> Path:
    """The object folder of an environment made with `env_kwargs`; it need not exist."""
    asset = Path(str(env_kwargs.get("asset", "drawer_unit")))
    return asset if asset.exists() else objects_place() / f"{asset}-s{env_kwargs.get('object_seed', 0)}"


def episodes(folder: Path) -> Iterator[Path]:
    """FOLDER/NAME.h5/traj_K for every episode of the FreeArt21 environments in `folder`."""
    for file in sorted(folder.glob("*.h5")):
        if file.with_suffix(".json").is_file():
            data = checked.read_any_json(file.with_suffix(".json"))
            if "FreeArt21-" in str(_env_info(data).get("env_id")):
                for episode in data.get("episodes") or ():
                    number = episode.get("episode_id") if isinstance(episode, dict) else None
                    if not isinstance(number, int):
                        raise FreeArtError(f"{file.with_suffix('.json')}: an episode's episode_id is {number!r}")
                    yield file / f"traj_{number}"


def _env_info(data: Any) -> dict[str, Any]:
    """env_info of a trajectory's JSON, with env_kwargs as a dictionary; empty when missing."""
    info = data.get("env_info") if isinstance(data, dict) else None
    info = info if isinstance(info, dict) else {}
    kwargs = info.get("env_kwargs")
    return {**info, "env_kwargs": kwargs if isinstance(kwargs, dict) else {}}


def read_episode(episode: Path) -> ThirdPartyRecording:
    """The recording of an episode as `episodes` names it; pictures load lazily.

    Raises FreeArtError when h5py is missing, or the episode lacks colours, depth or segmentation.
    """
    file, traj = episode.parent, episode.name
    info = _env_info(checked.read_any_json(file.with_suffix(".json")))
    kwargs = info["env_kwargs"]
    cameras = _names(file, f"{traj}/obs/sensor_data")
    if not cameras:
        raise FreeArtError(f"{file} {traj} has no pictures: record with obs_mode='rgb+depth+segmentation'")
    at = f"{traj}/obs/sensor_data/{cameras[0]}"
    colours = _read(file, f"{at}/rgb", 0)
    param = f"{traj}/obs/sensor_param/{cameras[0]}"
    K, E = _read(file, f"{param}/intrinsic_cv").astype(float), _read(file, f"{param}/extrinsic_cv").astype(float)
    rows = _read(file, f"{traj}/env_states/articulations/object").astype(float)
    sides = _sides(_read(file, f"{traj}/obs/extra/part_ids", 0))
    n = len(rows)
    if not 0 < n <= third_party.MAX_FRAMES or rows.shape[1] != 15 or len(K) != n or len(E) != n:
        raise FreeArtError(
            f"{file} {traj}: states have shape {rows.shape}, expected (n, 15), of as many frames as pictures"
        )

    def side(i: int) -> Image:
        ids = _read(file, f"{at}/segmentation", i)[..., 0]
        return np.asarray(sides[np.clip(ids, 0, len(sides) - 1)])

    def load(index: int) -> Frame:
        depth = _read(file, f"{at}/depth", index)[..., 0].astype(np.float32) * _MILLIMETRE
        return Frame(_read(file, f"{at}/rgb", index), depth, side(index) > 0)

    hz = (kwargs.get("sim_config") or {}).get("control_freq", CONTROL_HZ)
    camera = Camera(K[0], colours.shape[1], colours.shape[0])
    Ts_camera_world = np.tile(np.eye(4), (n, 1, 1))
    Ts_camera_world[:, :3] = E
    known = KnownTruth(
        rows[:, 13],
        Ts_camera_world @ se3.pose_from_wxyz(rows[:, :3], rows[:, 3:7]),
        side,
        kwargs.get("joint"),
        source={"format": "ManiSkill", "environment": str(info.get("env_id")), "episode": traj},
    )
    folder = object_folder_of(kwargs)
    lacks = ""
    if isinstance(kwargs.get("asset"), list):
        lacks = "its environment had several objects"
    elif kwargs.get("scale", 1.0) != 1.0:
        lacks = f"the object was simulated at {kwargs['scale']:g} times the size of its files"
    elif not (folder / "mobility.urdf").is_file():
        lacks = f"{folder} is no PartNet-Mobility folder, whose meshes a truth needs"
    notes = (f"of {len(cameras)} cameras the first is taken: {cameras[0]}",) if len(cameras) > 1 else ()
    name = third_party.safe_name(f"{file.stem}-{traj}")
    recording = Recording(camera, np.arange(n) / hz, load, (), None, name)
    return ThirdPartyRecording(name, folder.resolve().name, recording, None if lacks else known, lacks, notes)


def objects_of(episode: Path) -> Path | None:
    """The folder with the object folder of an episode, if it exists."""
    info = _env_info(checked.read_any_json(episode.parent.with_suffix(".json")))
    folder = object_folder_of(info["env_kwargs"]).resolve()
    return folder.parent if folder.is_dir() else None


def write_trajectory(
    folder: Path,
    name: str,
    asset: Path | str,
    times_s: Array,
    states: Array,
    Ts_world_root: Array,
    camera: Camera | None,
) -> Path:
    """Write a motion as the trajectory FOLDER/NAME.h5 of FreeArt21-FreeMoving-v1, with its NAME.json; gives NAME.h5.

    ManiSkill replays it: the hand follows the poses, the joint's motor the states. The camera looks along x from the
    world's origin, z up.

    Args:
        folder: output folder.
        name: stem of both files.
        asset: `asset` of the environment.
        times_s: (n,) s, taken as evenly spaced.
        states: (n,) positions of the URDF's joint, rad or m.
        Ts_world_root: (n, 4, 4) poses of the URDF's root link.
        camera: camera of the replay; None for the environment's.
    """
    h5py = _h5py()
    times, states = np.asarray(times_s, float), np.asarray(states, float)
    poses = se3.check_poses("motion poses", Ts_world_root)
    if not 2 <= len(times) == len(states) == len(poses):
        raise FreeArtError(
            f"{name}: {len(times)} times, {len(states)} states, {len(poses)} poses: expected as many, 2 at least"
        )
    hz = max(1, round((len(times) - 1) / (times[-1] - times[0])))
    kwargs: dict[str, Any] = {
        "asset": str(asset),
        "obs_mode": "rgb+depth+segmentation",
        "control_mode": "pd_joint_pos",
        "robot_uids": "freeart21_object",
        "sim_backend": "cpu",
        "render_backend": "cpu",
        "sim_config": {"sim_freq": hz * -(-_SIM_HZ // hz), "control_freq": hz},
    }
    if camera is not None:
        seen = {"width": camera.width, "height": camera.height, "intrinsic": camera.K.tolist(), "fov": None}
        kwargs["sensor_configs"] = {"base_camera": {"pose": [0, 0, 0, 1, 0, 0, 0], "near": 0.01, "far": 100.0, **seen}}
    rows = np.concatenate([poses[:, :3, 3], se3.wxyz(poses)], 1)
    n = len(times)
    velocity = np.zeros((n, 6))
    twists = se3.log_se3(se3.inverse(poses[:-1]) @ poses[1:]) * hz
    velocity[1:] = np.einsum("nij,nkj->nki", poses[1:, :3, :3], twists.reshape(-1, 2, 3)).reshape(-1, 6)
    speed = np.gradient(states) * hz
    object_states = np.concatenate([rows, velocity, states[:, None], speed[:, None]], 1)
    options = {
        "base_times": ((times - times[0]) * (n - 1) / hz / (times[-1] - times[0])).tolist(),
        "base_poses": rows.tolist(),
        "start": float(states[0]),
        "target": float(states[-1]),
    }
    folder = Path(folder)
    with atomic.new_folder(folder / f".{name}") as aside:
        with h5py.File(aside / f"{name}.h5", "w") as file:
            group = file.create_group("traj_0", track_order=True)
            group["actions"] = states[1:, None].astype(np.float32)
            group["env_states/articulations/object"] = object_states.astype(np.float32)
            group["env_states/target"] = np.full((n, 1), states[-1], np.float32)
            for what in ("terminated", "truncated", "success"):
                group[what] = np.zeros(n - 1, bool)
        episode = {
            "episode_id": 0,
            "episode_seed": 0,
            "control_mode": "pd_joint_pos",
            "elapsed_steps": n - 1,
            "reset_kwargs": {"seed": 0, "options": options},
            "success": False,
        }
        info = {"env_id": FREE_MOVING, "env_kwargs": kwargs, "max_episode_steps": n}
        header = {"env_info": info, "commit_info": None, "source_type": "freeart21", "episodes": [episode]}
        (aside / f"{name}.json").write_text(json.dumps(header))
    for end in (".json", ".h5"):
        (folder / f".{name}" / f"{name}{end}").replace(folder / f"{name}{end}")
    (folder / f".{name}").rmdir()
    return folder / f"{name}.h5"


def _sides(part_ids: Array) -> Image:
    """Segmentation id to 0 no part, 1 parent side, 2 child side; the last entry is for all larger ids."""
    pairs = np.asarray(part_ids, int).reshape(-1, 2)
    if not len(pairs) or pairs.min() < 0 or pairs[:, 1].max() > 2 or pairs.max() > 1 << 15:
        raise FreeArtError(f"part_ids are {pairs.tolist()}, expected pairs of an id and 1 or 2")
    sides = np.zeros(pairs[:, 0].max() + 2, np.uint8)
    sides[pairs[:, 0]] = pairs[:, 1]
    return sides


def _h5py() -> Any:
    try:
        import h5py
    except ImportError as error:
        raise FreeArtError("h5py is not installed: pip install 'freeart21[maniskill]'") from error
    return h5py


def _names(file: Path, place: str) -> list[str]:
    with _h5py().File(checked.require_file(file, MAX_FILE_BYTES), "r") as opened:
        return list(opened[place]) if place in opened else []


def _read(file: Path, place: str, index: int | None = None) -> Any:
    """A data set of an HDF5 file, or one row of it. Links and storage in other files are refused."""
    h5py = _h5py()
    try:
        with h5py.File(checked.require_file(file, MAX_FILE_BYTES), "r") as opened:
            here = opened
            for word in place.split("/"):
                if word not in here:
                    raise FreeArtError(f"{file} has no {place}: record with obs_mode='rgb+depth+segmentation'")
                if not isinstance(here.get(word, getlink=True), h5py.HardLink):
                    raise FreeArtError(f"{file}: {place} is a link, expected the data itself")
                here = here[word]
            if not isinstance(here, h5py.Dataset) or here.external or here.is_virtual:
                raise FreeArtError(f"{file}: {place} holds no data of its own")
            size = here.nbytes if index is None else here.nbytes // max(1, here.shape[0] if here.shape else 1)
            if size > 1 << 28:
                raise FreeArtError(f"{file}: {place} has {size} bytes, expected at most {1 << 28}")
            return np.asarray(here[...] if index is None else here[index])
    except OSError as error:
        raise FreeArtError(f"{file} is not a readable HDF5 file: {error}") from error


LAYOUT = RecordingLayout(
    "maniskill",
    4,
    "NAME.h5 and NAME.json, trajectories of FreeArt21 environments",
    episodes,
    lambda episode, options: read_episode(episode),
    objects_of,
)
