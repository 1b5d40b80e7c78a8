"""Video2Articulation-S (iTACO): a static object, a moving camera, one moving joint.

    partnet_mobility/<Category>/<id>/joint_<k>_bg/
      actor_pose.pkl         {"actor_<n>": [T x 7]} position, quaternion wxyz, in the world; a pickle, read as untrusted
      gt_joint_value.npy     (T,) rad or m     qpos.npy (T, joints), columns named by joint_id_list.txt     meta.json
      view_<n>/
        rgb/%06d.jpg   depth/%06d.npz ('a', float metres or uint16 millimetres, mixed)   segment/%06d.npz ('a', actor)
        camera_pose.npy (T, 7)  position, quaternion wxyz of the SAPIEN camera: x forward, y left, z up
        intrinsics.npy 3x3      sample_rgb/ names the frames that count, when it is there

Seen in 3dlg-hcvc/video2articulation@74903b4: all names, keys and orders (data.py, render_interaction_sim.py), the
camera's axes (utils.py, precompute_camera2label), uint16 is millimetres (utils.py, depth2xyz), the foreground is what
the actors of actor_pose.pkl cover (data.py, load_obj_mask), the root link is actor_6 (data.py), frames are those that
sample_rgb names (data.py). Room and floor are other actors, not foreground; their depth stays in the picture.
15 frames a second are assumed, as in its video.mp4.

Differences: the joint's number can have several digits; a part counts as moving by its angle and shift, not by the
difference of stored numbers (q and -q are the same rotation); links that move with the moving part belong to it.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from freeart21 import se3
from freeart21.camera import Camera
from freeart21.errors import FreeArtError
from freeart21.files import checked
from freeart21.formats import third_party
from freeart21.formats.third_party import Image, KnownTruth, RecordingLayout, ThirdPartyRecording
from freeart21.formats.untrusted_pickle import read_pickle
from freeart21.joint import Joint, JointType
from freeart21.recording import Frame, Recording
from freeart21.se3 import Array

FPS = 15.0
LICENCE = (
    "CC-BY-NC-4.0 (Video2Articulation-S); objects under the PartNet-Mobility terms of use; not to be redistributed"
)
R_OBJECT_LABEL: Array = np.array([[0.0, 0.0, -1.0], [-1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
"""The object's frame (z up) from the mesh or label frame (y up) of the data set's other files."""
ROOT_ACTOR = 6
"""Actor of the root link, after floor and four walls."""

_LABELS = 256  # segment is uint8: higher actor ids wrap around
_MOVED = 1e-3  # rad plus m: smallest motion
_AGREES = 0.02  # rad or m: tolerance between the stated joint value and the actors' poses


def is_view(folder: Path) -> bool:
    """Whether `folder` looks like a view folder."""
    return (folder / "camera_pose.npy").is_file() and (folder / "intrinsics.npy").is_file()


def read_view(folder: Path) -> ThirdPartyRecording:
    """The recording of one view folder, with the poses of both parts; frames load lazily.

    Raises FreeArtError when a file is missing or invalid, numbers of frames differ, or the pickle holds more than
    numbers.
    """
    folder = Path(folder)
    if not is_view(folder):
        raise FreeArtError(
            f"{folder} is not a Video2Articulation-S view: expected camera_pose.npy and intrinsics.npy next to rgb/"
        )
    home = folder.resolve().parent
    named = re.fullmatch(r"joint_([0-9]{1,4})(?:_bg)?", home.name)
    if named is None:
        raise FreeArtError(f"{folder} is in {home.name}, expected a folder named like joint_0_bg")
    number, object_id, category = int(named[1]), home.parent.name, home.parent.parent.name
    cameras = third_party.poses_from_rows(
        third_party.read_npy(folder / "camera_pose.npy", (None, 7)), f"{folder}/camera_pose.npy"
    )
    T = len(cameras)
    frames = _frames(folder, T)
    rgb = third_party.frame_files(folder, "rgb", (".jpg", ".jpeg", ".png"), frames)
    depth, segment = (third_party.frame_files(folder, sub, (".npz",), frames) for sub in ("depth", "segment"))
    height, width = checked.read_rgb(rgb[0]).shape[:2]
    camera = Camera(third_party.read_npy(folder / "intrinsics.npy", (3, 3)), width, height)
    actors = _actors(home / "actor_pose.pkl", T)
    cast = _cast(actors, home)
    notes: list[str] = []
    states, held = _states(home, number, T, notes)
    sides = _side_labels(cast, home)

    def side(i: int) -> Image:
        labels = checked.read_npz(segment[i], ("a",))["a"]
        if labels.shape != (height, width) or labels.dtype.kind not in "iu":
            raise FreeArtError(
                f"{segment[i]}: segment has shape {labels.shape} {labels.dtype}, expected {(height, width)} ids"
            )
        return sides[labels.astype(np.int64) % _LABELS]

    def load(index: int) -> Frame:
        metres = third_party.depth_metres(checked.read_npz(depth[index], ("a",))["a"], depth[index])
        return Frame(checked.read_rgb(rgb[index]), metres, side(index) > 0)

    joint, lacks = _joint(actors, cast, states, number, home)
    T_camera_world = se3.inverse(cameras @ third_party.T_SAPIEN_CV)
    source = {
        "layout": "Video2Articulation-S",
        "category": category,
        "object": object_id,
        "view": folder.resolve().name,
        "frames": frames,
    }
    known = KnownTruth(
        states[frames],
        (T_camera_world @ actors[cast.root])[frames],
        side,
        f"joint_{number}",
        joint,
        held,
        source,
    )
    name = f"{category}-{object_id}-joint_{number}-{folder.resolve().name}"
    recording = Recording(camera, np.array(frames) / FPS, load, (), LICENCE, name)
    return ThirdPartyRecording(third_party.safe_name(name), object_id, recording, known, lacks, tuple(notes))


@dataclass(frozen=True)
class _Cast:
    """Roles of the actors."""

    root: int
    moving: int
    child: frozenset[int]
    """The moving actor and those that move with it."""
    parent: frozenset[int]


def _frames(folder: Path, T: int) -> list[int]:
    """Frames of the recording: the names in sample_rgb, whose files can be broken links, or all."""
    sample = folder / "sample_rgb"
    if not sample.is_dir():
        return list(range(T))
    frames = sorted(third_party.numbered(sample, (".jpg", ".jpeg", ".png")))
    if not frames or frames[-1] >= T:
        raise FreeArtError(f"{sample} names frames {frames[-1:] or 'none'}, but camera_pose.npy has {T} poses")
    return frames


def _actors(path: Path, T: int) -> dict[int, Array]:
    """Actor id to poses (T, 4, 4) in the world."""
    data = read_pickle(path)
    actors = {}
    for key, rows in data.items() if isinstance(data, dict) else ():
        named = re.fullmatch(r"actor_([0-9]{1,9})", key) if isinstance(key, str) else None
        if named is None:
            raise FreeArtError(f"{path} has the key {key!r}, expected actor_0, actor_1, ...")
        try:
            table = np.array(rows, float)
        except (TypeError, ValueError):
            table = np.zeros(0)
        if table.shape != (T, 7):
            raise FreeArtError(
                f"{path}: {key} has shape {table.shape}, expected ({T}, 7) as camera_pose.npy has {T} poses"
            )
        actors[int(named[1])] = third_party.poses_from_rows(table, f"{path}: {key}")
    if len(actors) < 2:
        raise FreeArtError(f"{path} has {len(actors)} actors, expected the object's links, two or more")
    return actors


def _cast(actors: dict[int, Array], home: Path) -> _Cast:
    root = ROOT_ACTOR if ROOT_ACTOR in actors else min(actors)
    change = {a: float(_difference(Ts, Ts[0]).max()) for a, Ts in actors.items()}
    if change[root] > _MOVED:
        raise FreeArtError(f"{home}: the root link (actor_{root}) moves by {change[root]:.3g}, expected it at rest")
    moving = max(change, key=lambda a: change[a])
    if change[moving] <= _MOVED:
        raise FreeArtError(f"{home}: no actor moves, expected one that does")
    child = {a for a, Ts in actors.items() if _slip(Ts, actors[moving]) < _slip(Ts, actors[root])}
    return _Cast(root, moving, frozenset(child), frozenset(set(actors) - child))


def _difference(Ts: Array, U: Array) -> Array:
    """(...) angle, rad, plus shift, m, between poses (..., 4, 4) and U."""
    turn = se3.rotation_angle(np.swapaxes(U[..., :3, :3], -1, -2) @ Ts[..., :3, :3])
    return np.asarray(turn + np.linalg.norm(Ts[..., :3, 3] - U[..., :3, 3], axis=-1))


def _slip(Ts: Array, carriers: Array) -> float:
    """Largest motion relative to a carrier, rad plus m."""
    relative = se3.inverse(carriers) @ Ts
    return float(_difference(relative, relative[0]).max())


def _side_labels(cast: _Cast, home: Path) -> NDArray[np.uint8]:
    """(256,) actor id in a segment picture to 0 room, 1 parent side, 2 child side."""
    sides = np.zeros(_LABELS, np.uint8)
    for ids, side in ((cast.parent, 1), (cast.child, 2)):
        for actor in ids:
            if sides[actor % _LABELS] not in (0, side) or (actor >= _LABELS and actor % _LABELS < ROOT_ACTOR):
                raise FreeArtError(
                    f"{home}: actor_{actor} shares its number in the 8-bit segment pictures with another"
                )
            sides[actor % _LABELS] = side
    return sides


def _states(home: Path, number: int, T: int, notes: list[str]) -> tuple[Array, dict[str, float]]:
    """(T,) joint values, and the other joints' states if qpos.npy and joint_id_list.txt have them."""
    names = _joint_names(home / "joint_id_list.txt")
    columns: dict[str, Array] = {}
    if (home / "qpos.npy").is_file() and names:
        columns = dict(zip(names, third_party.read_npy(home / "qpos.npy", (T, len(names))).T, strict=True))
    own = columns.pop(f"joint_{number}", None)
    held = {name: float(column[0]) for name, column in columns.items()}
    path = home / "gt_joint_value.npy"
    if not path.is_file():
        if own is None:
            raise FreeArtError(f"{path} is missing, and there is no qpos.npy with joint_{number} in joint_id_list.txt")
        return own, held
    try:
        states = third_party.read_npy(path, (T,))
    except FreeArtError:
        states = third_party.read_npy(path, (T, 1))[:, 0]
    if own is not None and np.abs(own - states).max() > _AGREES:
        notes.append(f"{path.name} and qpos.npy differ by up to {np.abs(own - states).max():.3g}; qpos.npy is taken")
        states = own
    return states, held


def _joint_names(path: Path) -> list[str]:
    if not path.is_file():
        return []
    words = checked.read_text(path, 1 << 20, errors="replace").split()
    return [f"joint_{word}" if word.isdigit() else word for word in words]


def _joint(actors: dict[int, Array], cast: _Cast, states: Array, number: int, home: Path) -> tuple[Joint | None, str]:
    """The joint that maps the stated joint values to the moving actor's poses in the root link's frame.

    Its limits are those of the states, and of the folder's meta.json.
    """
    moved = se3.inverse(actors[cast.root]) @ actors[cast.moving]
    steps, q = moved @ se3.inverse(moved[0]), states - states[0]
    span = float(np.abs(q).max())
    usable = np.flatnonzero((np.abs(q) > 0.3 * span) & (se3.rotation_angle(steps[:, :3, :3]) < 3.0))
    if span <= _MOVED or not len(usable):
        return None, f"{home.name}: the joint value does not change, so the motion does not show the joint"
    twist = np.mean(se3.log_se3(steps[usable]) / q[usable, None], axis=0)
    v, w = twist[:3], twist[3:]
    kind: JointType = "revolute" if np.linalg.norm(w) * span > _MOVED else "prismatic"
    direction = w if kind == "revolute" else v
    axis = direction / np.linalg.norm(direction)
    pivot = np.cross(axis, v) / np.linalg.norm(direction) if kind == "revolute" else np.zeros(3)
    path = home / "meta.json"
    data = checked.read_json(path) if path.is_file() else {}
    ends = [*states, *(data[key] for key in ("init", "target") if checked.is_number(data.get(key)))]
    joint = Joint(f"joint_{number}", kind, axis, pivot, float(min(ends)), float(max(ends)))
    off = float(_difference(steps, joint.transform(q)).max())
    if off > _AGREES * max(1.0, span):
        return None, f"{home.name}: the joint value and the poses of actor_{cast.moving} disagree by up to {off:.3g}"
    return joint, ""


LAYOUT = RecordingLayout(
    "video2articulation",
    3,
    "camera_pose.npy and intrinsics.npy",
    is_view,
    lambda folder, options: read_view(folder),
    ("view_*", "joint_*/view_*", "*/joint_*/view_*", "*/*/joint_*/view_*", "*/*/*/joint_*/view_*"),
)
