"""The official FreeArt-21 release: one folder per object, `examples/<id>/`.

    rgb/NNNNN.png   depth/NNNNN.npz ('depth', float32 z-depth, metres, 0 is none)   masks/NNNNN.png   vis/NNNNN.png
    rendered_masks/mask_0|mask_1/NNNN.png   parent and child side of the scored joint; 4 or 5 digits
    object_poses.json    [{position, quaternion wxyz}]   the URDF's root link in the world
    joint_states.json    [[q, ...]]                      or dicts with one of several keys
    camera_params.json   [{model_matrix}]                world from OpenGL camera, 4x4; the camera is fixed
    cam_K.txt            3x3
    eval/                after the split: the held-out frames in the same layout, and split_info.json

Seen in FreeArtGS@061c6c8: file names, keys and digits (preprocessing/split_eval_subset.py, utils/utils.py,
evaluate/compute_mask_miou.py), states (evaluate/eval_data.py), quaternion order, model_matrix of the first frame only
(evaluate/convert_objposes_to_camposes.py), poses are the root link's (evaluate/evaluate_freeartgs.py: its three turns
undo its mesh-frame turn exactly), mask_1 is the moving part (evaluate/mask_utils.py); and how such folders were made in
Zarad0X/sapien_video_gen@88b1497:teleop_obj.py. The pictures are rasterised, so pixel centres are at +0.5 as ours.
Frames carry no times: 30 a second are assumed.
"""

from __future__ import annotations

import random
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from freeart21 import se3
from freeart21.camera import Camera
from freeart21.errors import FreeArtError
from freeart21.files import atomic, checked
from freeart21.files.places import require_replaceable
from freeart21.files.urdf import read_urdf_joints
from freeart21.formats import third_party
from freeart21.formats.third_party import (
    Image,
    KnownTruth,
    Progress,
    RecordingLayout,
    ThirdPartyRecording,
)
from freeart21.recording import Frame, Recording
from freeart21.se3 import Array
from freeart21.truth import Truth

FPS = 30.0
LICENCE = (
    "FreeArt-21 as released by its authors; objects under the PartNet-Mobility terms of use; not to be redistributed"
)
SIDECAR = "freeart21.json"
"""Our file for times, licence and the joint's name; their code ignores it."""
SIDECAR_SCHEMA = "freeart21/official/1"
EVAL_SHARE = 0.05
EVAL_SEED = 0
OBJECTS = Path("data/partnet-mobility-v0/dataset")
"""Where their evaluator finds <id>/mobility.urdf, next to examples/."""

_LARGEST_STATE = 1e6
_STATE_KEYS = ("angle_rad", "angle", "value", "qpos", "state", "theta", "translation")


def is_example(folder: Path) -> bool:
    """Whether `folder` looks like an official example."""
    return (folder / "cam_K.txt").is_file() and (folder / "rgb").is_dir() and (folder / "depth").is_dir()


def read_example(folder: Path) -> ThirdPartyRecording:
    """The official example in `folder`; frames load lazily.

    After the official split the video has only the training frames, with gaps in its times. Raises FreeArtError when a
    frame is missing, numbers of frames differ, or a file is invalid.
    """
    folder = Path(folder)
    if not is_example(folder):
        raise FreeArtError(f"{folder} is not an official FreeArt-21 example: expected rgb/, depth/ and cam_K.txt")
    rgb = third_party.frame_files(folder, "rgb", (".png", ".jpg", ".jpeg"))
    depth = third_party.frame_files(folder, "depth", (".npz",))
    masks = third_party.frame_files(folder, "masks", (".png",))
    n = len(rgb)
    third_party.same_count(folder, {"rgb": n, "depth": len(depth), "masks": len(masks)})
    extra = checked.read_json(folder / SIDECAR, SIDECAR_SCHEMA) if (folder / SIDECAR).is_file() else {}
    train = _train_indices(folder, n)
    times = checked.numbers(extra, "times_s", (None,), folder / SIDECAR) if extra else np.arange(max(train) + 1) / FPS
    if len(times) <= max(train):
        raise FreeArtError(
            f"{folder / SIDECAR} has {len(times)} times, expected one for each of {max(train) + 1} frames"
        )
    height, width = checked.read_rgb(rgb[0]).shape[:2]
    camera = Camera(third_party.read_matrix(folder / "cam_K.txt"), width, height)

    def load(index: int) -> Frame:
        metres = third_party.depth_metres(checked.read_npz(depth[index], ("depth",))["depth"], depth[index])
        return Frame(checked.read_rgb(rgb[index]), metres, third_party.read_foreground(masks[index]))

    name = folder.resolve().name
    recording = Recording(camera, times[train], load, (), extra.get("licence") or LICENCE, name)
    known, lacks = _known(folder, n, train, (camera.height, camera.width), extra)
    return ThirdPartyRecording(third_party.safe_name(name), name, recording, known, lacks)


def read_states(path: Path) -> Array:
    """(n,) joint states, rad or m, from joint_states.json: a list with an entry a frame.

    An entry is a number, an object with one, or a list (qpos of several joints), whose first is used, as in the
    official evaluator; but when the first never moves and exactly one other does, that one. Unlike there, an entry
    without a known number is an error, not zero.
    """
    data = checked.read_any_json(path)
    if not isinstance(data, list) or not data:
        raise FreeArtError(f"{path} holds no list of joint states")
    if all(isinstance(entry, list) and entry for entry in data):
        rows = [[_state(value, path, i) for value in entry] for i, entry in enumerate(data)]
        if len({len(row) for row in rows}) > 1:
            raise FreeArtError(f"{path}: entries name different numbers of joints")
        spans = np.ptp(np.array(rows), axis=0)
        moving = np.flatnonzero(spans > 1e-9)
        return np.array(rows)[:, moving[0] if spans[0] <= 1e-9 and len(moving) == 1 else 0]
    return np.array([_state(entry, path, i) for i, entry in enumerate(data)])


def read_object_poses(folder: Path) -> Array:
    """(n, 4, 4) camera from the object's root link, from object_poses.json and camera_params.json in `folder`."""
    poses, cameras = folder / "object_poses.json", folder / "camera_params.json"
    rows = [
        np.concatenate([checked.numbers(entry, key, (n,), poses) for key, n in (("position", 3), ("quaternion", 4))])
        for entry in _entries(poses)
    ]
    Ts_world_gl = np.array([checked.numbers(entry, "model_matrix", (4, 4), cameras) for entry in _entries(cameras)])
    if len(Ts_world_gl) > 1:
        third_party.same_count(folder, {poses.name: len(rows), cameras.name: len(Ts_world_gl)})
    Ts_world_gl = se3.check_poses(f"{cameras} model_matrix", Ts_world_gl, tolerance=1e-3)
    return np.asarray(
        se3.inverse(Ts_world_gl @ third_party.T_GL_CV) @ third_party.poses_from_rows(np.array(rows), str(poses))
    )


def _entries(path: Path) -> list[dict[str, Any]]:
    """The JSON objects in a list, or one alone."""
    data = checked.read_any_json(path)
    entries = [data] if isinstance(data, dict) else data
    if not isinstance(entries, list) or not entries or not all(isinstance(entry, dict) for entry in entries):
        raise FreeArtError(f"{path} holds no list of objects")
    return entries


def eval_indices(frames: int) -> list[int]:
    """Frames that the official split holds out: `random.Random(seed).sample`, sorted."""
    count = max(1, round(frames * EVAL_SHARE))
    return list(range(frames)) if count >= frames else sorted(random.Random(EVAL_SEED).sample(range(frames), count))


def write_example(
    root: Path,
    name: str,
    recording: Recording,
    known: KnownTruth | None,
    object_folder: Path | None = None,
    hold_out: bool = False,
    progress: Progress = lambda done, total: None,
) -> Path:
    """Write `root/examples/name`, and the object to `root/data/partnet-mobility-v0/dataset/name` when it is given.

    Both or neither. Their scripts cut an object's id at the first '_' of the name, so '_' becomes '-'. The camera is
    fixed at the world's origin, and the object has all motion. Without `known`, only pictures and cam_K.txt are
    written. `hold_out` splits like their split_eval_subset.py, into the folder and its eval/.
    """
    name = third_party.safe_name(name).replace("_", "-")
    folder, copied = root / "examples" / name, root / OBJECTS / name
    for place in (folder, copied):
        require_replaceable(place, None)
    n = len(recording)
    if known is not None:
        third_party.same_count(folder, {"video": n, "truth": len(known.states)})
    held_out = eval_indices(n) if hold_out else []
    if hold_out and len(held_out) == n:
        raise FreeArtError(f"cannot hold frames out of {n}")
    groups = {"": [i for i in range(n) if i not in set(held_out)], "eval": held_out}
    with ExitStack() as stack:
        aside = stack.enter_context(atomic.new_folder(folder))
        if object_folder is not None:
            object_aside = stack.enter_context(atomic.new_folder(copied))
            checked.copy_folder(object_folder, object_aside)
        done = 0
        for sub, frames in groups.items():
            if not frames:
                continue
            for new, i in enumerate(frames):
                _write_frame(aside / sub, new, recording.frame(i), None if known is None else known.side(i))
                done += 1
                progress(done, n)
            _write_K(aside / sub / "cam_K.txt", recording.camera.K)
            if known is not None:
                _write_lists(aside / sub, known.Ts_camera_object[frames], known.states[frames])
        if held_out:
            info = {"eval_original_indices": held_out, "train_original_indices": groups[""]}
            atomic.write_json(aside / "eval" / "split_info.json", info)
        facts = {"times_s": recording.times_s, "licence": recording.licence}
        joint = None if known is None else known.joint_name
        atomic.write_json(aside / SIDECAR, {"schema": SIDECAR_SCHEMA, **facts, "joint": joint})
    return folder


def known_of_truth(truth: Truth, object_folder: Path | None) -> KnownTruth:
    """A native truth as an official example states it: the root link's poses, and the sides of the joint.

    The URDF in `object_folder` and the links in the truth's source show which side is the reference part; without them
    the reference part is taken as the parent side.
    """
    turned = _child_is_reference(truth, object_folder)
    label = np.array([0, 2, 1] if turned else [0, 1, 2], np.uint8)
    joint = truth.articulation.joint
    return KnownTruth(
        truth.states,
        truth.Ts_camera_moving if turned else truth.Ts_camera_reference,
        lambda i: label[np.minimum(truth.part_mask(i), 2)],
        str(truth.source.get("joint") or joint.name),
        replace(joint, axis=-joint.axis) if turned else joint,
        source=truth.source,
    )


def _child_is_reference(truth: Truth, object_folder: Path | None) -> bool:
    links = truth.source.get("reference_links")
    urdf = None if object_folder is None else object_folder / "mobility.urdf"
    if not isinstance(links, list | tuple) or urdf is None or not urdf.is_file():
        return False
    joint = read_urdf_joints(urdf).get(str(truth.source.get("joint") or truth.articulation.joint.name))
    return joint is not None and joint.child in links


def _known(
    folder: Path, n: int, train: list[int], size: tuple[int, int], extra: dict[str, Any]
) -> tuple[KnownTruth | None, str]:
    for name in ("object_poses.json", "joint_states.json", "camera_params.json"):
        if not (folder / name).is_file():
            return None, f"it has no {name}"
    if not (folder / "rendered_masks" / "mask_0").is_dir():
        return None, "it has no rendered_masks/mask_0"
    Ts_camera_object = read_object_poses(folder)
    states = read_states(folder / "joint_states.json")
    third_party.same_count(
        folder, {"rgb": n, "object_poses.json": len(Ts_camera_object), "joint_states.json": len(states)}
    )
    joint = extra.get("joint")
    known = KnownTruth(
        states,
        Ts_camera_object,
        _side_reader(folder, n, train, size),
        joint if isinstance(joint, str) else None,
        source={"layout": "FreeArt-21 official", "example": folder.resolve().name, "frames": train},
    )
    return known, ""


def _side_reader(folder: Path, n: int, train: list[int], size: tuple[int, int]) -> Callable[[int], Image]:
    """Frame index to sides. The official split does not renumber 4-digit part masks, so they can have old numbers."""
    places = [f"rendered_masks/mask_{k}" for k in (0, 1)]
    counts = {place: len(third_party.numbered(folder / place, (".png",))) for place in places}
    third_party.same_count(folder, counts)
    numbers = range(n) if counts[places[0]] == n else train
    sides = [third_party.frame_files(folder, place, (".png",), numbers) for place in places]

    def side(i: int) -> Image:
        parent, child = (third_party.read_foreground(files[i]) for files in sides)
        if parent.shape != size or child.shape != size:
            raise FreeArtError(
                f"{folder}: part masks of frame {i} are {parent.shape[1]} x {parent.shape[0]} and "
                f"{child.shape[1]} x {child.shape[0]}, expected {size[1]} x {size[0]}"
            )
        return np.where(child, 2, parent).astype(np.uint8)

    return side


def _train_indices(folder: Path, n: int) -> list[int]:
    """Original number of each frame, after the official split from split_info.json."""
    path = folder / "eval" / "split_info.json"
    if not path.is_file():
        return list(range(n))
    train = checked.numbers(checked.read_json(path), "train_original_indices", (None,), path).astype(int).tolist()
    if train != sorted(set(train)) or not 0 <= min(train, default=0) <= max(train, default=0) < third_party.MAX_FRAMES:
        raise FreeArtError(f"{path}: train_original_indices is not a rising list of frame numbers")
    if len(train) != n:
        raise FreeArtError(f"{path} names {len(train)} frames of the video, but {folder}/rgb has {n}")
    return train


def _state(entry: Any, path: Path, i: int) -> float:
    """The number of one entry: itself, or by the first known key of it; of a list its first."""
    value = entry
    if isinstance(entry, dict):
        value = next((entry[key] for key in _STATE_KEYS if key in entry), None)
    value = value[0] if isinstance(value, list) and value else value
    if not checked.is_number(value) or not abs(value) < _LARGEST_STATE:
        raise FreeArtError(
            f"{path}: state {i} is {checked.shorten(entry)}, expected a number or one of {', '.join(_STATE_KEYS)}"
        )
    return float(value)


def _write_frame(folder: Path, index: int, frame: Frame, side: Image | None) -> None:
    name = f"{index:05d}.png"
    grey = frame.depth * (255.0 / max(float(frame.depth.max(initial=0)), 1e-9))
    pictures = {"rgb": frame.rgb, "masks": frame.mask.astype(np.uint8) * 255, "vis": grey.astype(np.uint8)}
    if side is not None:
        pictures |= {f"rendered_masks/mask_{k}": (side == k + 1).astype(np.uint8) * 255 for k in (0, 1)}
    for sub, picture in pictures.items():
        atomic.write_bytes(folder / sub / name, checked.encode_png(picture))
    (folder / "depth").mkdir(exist_ok=True)
    np.savez_compressed(folder / "depth" / f"{index:05d}.npz", depth=frame.depth.astype(np.float32))


def _write_K(path: Path, K: Array) -> None:
    atomic.write_bytes(path, "".join(" ".join(f"{v:.17g}" for v in row) + "\n" for row in K).encode())


def _write_lists(folder: Path, Ts_camera_object: Array, states: Array) -> None:
    Ts_world_object = third_party.T_SAPIEN_CV @ Ts_camera_object
    T_world_gl = third_party.T_SAPIEN_CV @ se3.inverse(third_party.T_GL_CV)
    camera = {
        "model_matrix": T_world_gl,
        "camera_pose": {"position": [0.0, 0.0, 0.0], "quaternion": [1.0, 0.0, 0.0, 0.0]},
    }
    poses = zip(Ts_world_object[:, :3, 3], se3.wxyz(Ts_world_object), strict=True)
    atomic.write_json(folder / "object_poses.json", [{"position": p, "quaternion": q} for p, q in poses])
    atomic.write_json(folder / "joint_states.json", [[float(q)] for q in states])
    atomic.write_json(folder / "camera_params.json", [camera] * len(states))


def _objects(example: Path) -> Path | None:
    root = example.resolve().parent.parent / OBJECTS
    return root if root.is_dir() else None


LAYOUT = RecordingLayout(
    "official",
    2,
    "rgb/, depth/*.npz and cam_K.txt",
    is_example,
    lambda folder, options: read_example(folder),
    ("examples/*", "*"),
    _objects,
)
