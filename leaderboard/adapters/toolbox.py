"""What every adapter needs: what it found of a sequence, in our frames and units, and readers that trust nothing.

No adapter sees a truth. What a layout does not give stays None in `Found`; `reconstruction` puts fillers of the right
shapes in its place, and `lacking` names it, so that it is left out of the score and never priced.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any, Literal, get_args

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from freeart21 import se3
from freeart21.articulation import Articulation
from freeart21.errors import FreeArtError
from freeart21.files import checked
from freeart21.files.mesh_file import read_ply
from freeart21.formats import freeart21_official
from freeart21.formats.third_party import T_GL_CV, poses_from_rows, read_npy
from freeart21.formats.video2articulation import R_OBJECT_LABEL
from freeart21.joint import Joint
from freeart21.mesh import Mesh
from freeart21.reconstruction import PIECES, Failure, Piece, Reconstruction
from freeart21.recording import Recording
from freeart21.se3 import Array
from freeart21.view.obj import read_obj
from leaderboard.adapters.points import mesh_of_points

Axes = Literal["opencv", "opengl"]
Frame = Literal["camera", "opengl", "link", "label", "zup"]
FRAMES: tuple[str, ...] = get_args(Frame)
"""Where a layout's world stands, when its files do not say: as the camera of the anchor frame (ours, or OpenGL's axes);
as the object's root link in its URDF (z up); as the mesh files of PartNet-Mobility, the label frame (y up); or as PARIS
turns these up for Blender, (x, -z, y)."""

IN_OBJECT: dict[str, Array] = {
    "link": np.eye(4),
    "label": se3.pose(R_OBJECT_LABEL, np.zeros(3)),
    "zup": se3.pose([[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]], np.zeros(3)),
}
"""T_link_world of the frames that hang on the object."""

MASK_THRESHOLD = 0.5
"""A pixel is moving where a layout's soft map says more."""
STRAIGHT = 1e-3
"""How far a pose in a file may be from a rigid one: they are printed with few digits, or stored in single precision."""
_ASPECT = 0.02  # relative difference of a map's shape from the video's beyond which it is of another video


@dataclass(frozen=True)
class Options:
    """What the files of a layout do not say, and the user does."""

    frame: Frame | None = None
    """Where the layout's world stands; None: as the layout's own evaluator has it."""
    axes: Axes | None = None
    """Axes of its cameras; None: as the layout's own evaluator has it."""
    anchor: int = 0
    """The frame of the video at which a layout without poses stands, and at which its joint state is zero."""
    scale: float = 1.0
    """Metres in one unit of length of the layout."""
    joint: str | None = None
    """Which joint, by name or number, where a layout holds several."""
    object_poses: Path | None = None
    """Official FreeArt-21 examples, whose object_poses.json says where the object stood."""


@dataclass(frozen=True)
class Request:
    """One sequence that is looked for in one folder of a layout."""

    recording: Recording
    """Its video; frames load when asked for."""
    options: Options = field(default_factory=Options)

    @property
    def frames(self) -> int:
        """Of the video."""
        return len(self.recording)

    @property
    def anchor(self) -> int:
        """`options.anchor`, which must be a frame of the video."""
        if not 0 <= self.options.anchor < self.frames:
            raise FreeArtError(
                f"{self.recording.name}: the anchor is frame {self.options.anchor}, expected 0 to {self.frames - 1}"
            )
        return self.options.anchor

    @cached_property
    def foreground(self) -> NDArray[np.bool_]:
        """(n, height, width) of the video: what its masks call the object."""
        return np.stack([self.recording.frame(i).mask for i in range(self.frames)])

    def T_camera_world(self, folder: Path, default: Frame) -> Array:
        """(4, 4) the camera of the anchor frame from the layout's world, by `options.frame` or else `default`.

        Raises FreeArtError when that frame hangs on the object and nothing says where the object stood: neither
        `options.object_poses` nor an object_poses.json in `folder`.
        """
        frame = self.options.frame or default
        if frame == "camera":
            return np.eye(4)
        if frame == "opengl":
            return se3.inverse(T_GL_CV)
        example = self._example(folder)
        if example is None:
            raise FreeArtError(
                f"{folder} stands in the object's frame ({frame}), and nothing says where the object was in the video: "
                "give --object-poses EXAMPLES (official FreeArt-21 examples, with object_poses.json and "
                "camera_params.json), or --frame camera if the method was run in the camera's frame"
            )
        Ts = freeart21_official.read_object_poses(example)
        if len(Ts) != self.frames:
            raise FreeArtError(f"{example} has {len(Ts)} object poses, the video has {self.frames} frames")
        return np.asarray(Ts[self.anchor] @ IN_OBJECT[frame])

    def _example(self, folder: Path) -> Path | None:
        given, name = self.options.object_poses, self.recording.name
        places = (
            [folder] if given is None else [given, *_named_below(given, name), *_named_below(given / "examples", name)]
        )
        found = [place for place in places if (place / "object_poses.json").is_file()]
        if given is not None and not found:
            raise FreeArtError(f"{given} has no object_poses.json of {name}: looked for {given}/{name} and examples/")
        return found[-1] if found else None


def _named_below(folder: Path, name: str) -> list[Path]:
    """Where in `folder` the sequence `name` may lie; official examples have no '_' in their names."""
    return [folder / name, folder / name.replace("_", "-")]


@dataclass(frozen=True)
class Found:
    """What one folder says of one sequence: metres and radians, camera OpenCV; None is what it does not give.

    The canonical frame is the reference part's, and may be any: `poses` and `anchor_pose` say where it stands.
    """

    joint: Joint | None
    """In the canonical frame; None when the folder follows one rigid body only."""
    states: Array | None = None
    """(n,) from the state in which the meshes stand."""
    poses: tuple[Array, Array] | None = None
    """T_camera_reference and T_camera_moving, (n, 4, 4) each."""
    anchor: int = 0
    anchor_pose: Array | None = None
    """(4, 4) T_camera_reference in the frame `anchor`, of a layout without poses; without states, at state zero."""
    masks: NDArray[np.uint8] | None = None
    """(n, height, width): 0 neither, 1 reference, 2 moving."""
    meshes: tuple[Mesh, Mesh] | None = None
    """Reference and moving part, canonical frame, at state zero."""
    seen: NDArray[np.bool_] | None = None
    """(n,) frames that the layout answers; None is all."""
    notes: tuple[str, ...] = ()
    """What the reader of the score should know, a line each."""

    def lacks(self) -> set[Piece]:
        """What is None; nobody's layout holds our held-out views."""
        absent: dict[Piece, object] = {
            "joint": self.joint,
            "states": self.states,
            "poses": self.poses,
            "masks": self.masks,
            "meshes": self.meshes,
            "renders": None,
        }
        return {piece for piece, value in absent.items() if value is None}


@dataclass(frozen=True)
class Layout:
    """One layout of another project's results."""

    name: str
    """As the command line has it."""
    project: str
    """Its name and address."""
    source: str
    """repository@commit:paths in which its files, frames and units were read."""
    fits: Callable[[Path], bool]
    """Whether a folder holds the result of one sequence."""
    read: Callable[[Path, Request], Found | Failure]
    """What that folder says; FreeArtError, one line, when it cannot be read."""
    inside: tuple[str, ...] = ()
    """Patterns below a sequence's folder under which the project puts its results; of several that fit, the last one
    in the order of the numbers in their names counts (the longest trained)."""
    frame: Frame | None = None
    """Where its world stands by its own evaluator; None when its files say."""
    axes: Axes | None = None
    """Axes of its cameras by its own evaluator; None when it has none."""
    joint_choice: bool = False
    """Whether it may hold several joints."""
    folders: Callable[[str], tuple[str, ...]] = lambda sequence: ()
    """Where below the source the project itself would put the results of a sequence of that name."""


def reconstruction(found: Found, recording: Recording) -> Reconstruction:
    """`found` as an answer to `recording`, with fillers in place of what is None."""
    n, camera = len(recording), recording.camera
    joint = found.joint or Joint("unknown", "revolute", np.array([0.0, 0.0, 1.0]), np.zeros(3), -np.inf, np.inf)
    states = np.zeros(n) if found.states is None else found.states
    joint = joint.spanning(states) if found.states is not None else joint
    if found.poses is None:
        pose = np.eye(4) if found.anchor_pose is None else found.anchor_pose
        poses = np.repeat(pose[None], n, 0), np.repeat((pose @ joint.transform(states[found.anchor]))[None], n, 0)
    else:
        poses = found.poses
    masks = found.masks
    if masks is None:
        masks = np.zeros((n, camera.height, camera.width), np.uint8)
    meshes = found.meshes or (_FILLER, _FILLER)
    seen = np.ones(n, bool) if found.seen is None else found.seen
    Ts = tuple(se3.orthonormalised(T) for T in poses)
    return Reconstruction(
        Articulation(joint, *meshes), states, Ts[0], Ts[1], masks, np.column_stack([seen, seen]), anchor=found.anchor
    )


_FILLER = Mesh(
    0.001 * np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1.0]]),
    np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]]),
)
"""A tetrahedron of a millimetre, where there is no mesh."""


def lacking(each: Sequence[set[Piece]]) -> tuple[Piece, ...]:
    """What is lacking in each of them (`Found.lacks`): what the method does not make at all."""
    absent = set.intersection(*each) if each else {"renders"}
    return tuple(piece for piece in PIECES if piece in absent)


# Frames and units


def camera_from_world(rows: ArrayLike, where: str, axes: Axes, scale: float) -> Array:
    """T_camera_world (n, 4, 4), our camera, of cameras (n, 4, 4) in the world whose own axes are `axes`."""
    Ts = se3.check_poses(where, rows, tolerance=STRAIGHT)
    Ts = scaled(se3.orthonormalised(Ts), scale)
    return np.asarray(se3.inverse(Ts if axes == "opencv" else Ts @ T_GL_CV))


def wxyz_first(rows: ArrayLike, where: str) -> Array:
    """(..., 4, 4) poses of rows (..., 7): quaternion w, x, y, z of about unit length, then position."""
    rows = np.asarray(rows, float)
    flat = rows.reshape(-1, 7)
    return np.asarray(poses_from_rows(flat[:, [4, 5, 6, 0, 1, 2, 3]], where).reshape(*rows.shape[:-1], 4, 4))


def scaled(Ts: Array, scale: float) -> Array:
    """Poses (..., 4, 4) with translations times `scale`."""
    out = np.array(Ts, float)
    out[..., :3, 3] *= scale
    return out


def scaled_mesh(mesh: Mesh, scale: float) -> Mesh:
    """`mesh` with its vertices times `scale`."""
    return mesh if scale == 1 else replace(mesh, vertices=mesh.vertices * scale)


def unit(axis: ArrayLike, where: str) -> Array:
    """`axis` (3,) of length 1; FreeArtError when it has none."""
    axis = np.asarray(axis, float).reshape(-1)
    length = float(np.linalg.norm(axis)) if axis.shape == (3,) else np.nan
    if not np.isfinite(length) or length < 1e-9:
        raise FreeArtError(f"{where} is {axis.tolist()}, expected three numbers, not all zero")
    return np.asarray(axis / length)


# From the frames that a layout answers to those of the video


def frame_numbers(stems: Sequence[str], frames: int, where: str) -> tuple[NDArray[np.int64], bool]:
    """Frame of the video for each file name, and whether it is what the names say.

    Names that are numbers from 0 to `frames` - 1, of any count of digits, are frame numbers. Others (time stamps,
    numbers from 1) are counted in their order when there are exactly as many; FreeArtError when there are not.
    """
    numbers = [int(stem) for stem in stems if re.fullmatch(r"[0-9]{1,20}", stem)]
    if len(numbers) == len(stems) and len(set(numbers)) < len(numbers):
        raise FreeArtError(f"{where}: two files have the same number, expected one a frame")
    if numbers and len(numbers) == len(stems) and max(numbers) < frames:
        return np.array(numbers, np.int64), True
    if len(stems) == frames:
        keys: Sequence[Any] = numbers if len(numbers) == len(stems) else stems
        return np.argsort(np.argsort(np.array(keys))).astype(np.int64), False
    raise FreeArtError(
        f"{where} has {len(stems)} entries, {min(stems, default='none')} to {max(stems, default='none')}, expected "
        f"numbers from 0 to {frames - 1}, or {frames} entries"
    )


def spread_states(states: Array, at: NDArray[np.int64], frames: int) -> Array:
    """(frames,) states of the frames `at`, linear between them and constant beyond."""
    order = np.argsort(at)
    return np.asarray(np.interp(np.arange(frames), at[order], states[order]))


def spread_poses(Ts: Array, at: NDArray[np.int64], frames: int) -> Array:
    """(frames, 4, 4) poses of the frames `at`; the nearest one's where there is none."""
    nearest = np.abs(np.arange(frames)[:, None] - at[None]).argmin(1)
    return np.asarray(Ts[nearest])


def answered(at: NDArray[np.int64], frames: int) -> tuple[NDArray[np.bool_], tuple[str, ...]]:
    """(frames,) which are answered, and a note when it is not all of them."""
    seen = np.zeros(frames, bool)
    seen[at] = True
    absent = int((~seen).sum())
    said = f"{absent} of {frames} frames are not answered: they get the nearest answered frame's poses"
    return seen, (said,) if absent else ()


def part_masks(moving: NDArray[Any], at: NDArray[np.int64], request: Request, where: str) -> NDArray[np.uint8]:
    """(n, height, width) part masks of soft maps (m, H, W) of the moving part in the frames `at`.

    Above MASK_THRESHOLD is moving; the rest of the video's own foreground is the reference part. Maps of another size
    are stretched to the video's by the nearest pixel. Frames without a map are 0.
    """
    camera = request.recording.camera
    if moving.ndim != 3 or moving.dtype.kind not in "fiub" or len(moving) != len(at):
        raise FreeArtError(f"{where} has shape {moving.shape} {moving.dtype}, expected ({len(at)}, height, width)")
    height, width = moving.shape[1:]
    if min(height, width) < 1 or abs(width * camera.height / (height * camera.width) - 1) > _ASPECT:
        raise FreeArtError(f"{where} is {width} x {height}, expected the shape of {camera.width} x {camera.height}")
    masks = np.zeros((request.frames, camera.height, camera.width), np.uint8)
    for k, i in enumerate(at):
        mask: NDArray[Any] = np.ascontiguousarray(moving[k] > MASK_THRESHOLD, np.uint8)
        if mask.shape != masks.shape[1:]:
            mask = cv2.resize(mask, (camera.width, camera.height), interpolation=cv2.INTER_NEAREST)
        masks[i] = np.where(mask > 0, 2, request.foreground[i])
    return masks


# Readers


def read_part(path: Path, root: Path, scale: float = 1.0) -> tuple[Mesh, str]:
    """The part in an OBJ or PLY file, and a note: a cloud of points becomes a triangle at each (`points`).

    `root` is the folder that materials may not leave. Raises FreeArtError when it cannot be read or has no point.
    """
    if path.suffix.lower() == ".obj":
        mesh = joined([piece.mesh for piece in read_obj(path, root)])
    else:
        mesh = read_ply(path, root)[0]
    if mesh.empty and len(mesh.vertices) == 0:
        raise FreeArtError(f"{path} has neither faces nor points")
    mesh = scaled_mesh(mesh, scale)
    if mesh.empty:
        return mesh_of_points(mesh.vertices, mesh.colours), f"{path.name} is a cloud of {len(mesh.vertices)} points"
    return mesh, ""


def joined(meshes: Sequence[Mesh]) -> Mesh:
    """All meshes as one; colours stay when all have some."""
    if len(meshes) == 1:
        return meshes[0]
    starts = np.cumsum([0, *(len(mesh.vertices) for mesh in meshes)])
    vertices = np.concatenate([np.zeros((0, 3)), *(mesh.vertices for mesh in meshes)])
    faces = np.concatenate([np.zeros((0, 3), np.int64), *(m.faces + at for m, at in zip(meshes, starts, strict=False))])
    painted = [mesh.colours for mesh in meshes if mesh.colours is not None]
    return Mesh(vertices, faces, np.concatenate(painted) if painted and len(painted) == len(meshes) else None)


def read_poses_text(path: Path) -> Array:
    """The 4 x 4 pose in a text file of numbers parted by blanks; FreeArtError when it is none."""
    text = checked.read_text(path, 1 << 16, errors="replace")
    try:
        rows = np.array([[float(word) for word in line.split()] for line in text.splitlines() if line.strip()])
    except ValueError:
        rows = np.zeros(0)
    if rows.shape != (4, 4):
        raise FreeArtError(f"{path} holds no 4 x 4 matrix of numbers")
    return rows


def read_list(path: Path, of: str) -> list[dict[str, Any]]:
    """The JSON list of objects in `path`; FreeArtError when it is none (`of` says of what) or empty."""
    data = checked.read_any_json(path)
    if not isinstance(data, list) or not data or not all(isinstance(entry, dict) for entry in data):
        raise FreeArtError(f"{path} holds no list of {of}")
    return data


def one_number(data: dict[str, Any], key: str, path: Path) -> float:
    """The finite number `data[key]`, which may be stored as a list of one."""
    value = data.get(key)
    listed = value if isinstance(value, list) else [value]
    return float(checked.numbers({key: np.ravel(np.array(listed, object)).tolist()}, key, (1,), path)[0])


def read_vector(path: Path) -> Array:
    """The (3,) of an .npy file, which may also be stored as (1, 3)."""
    try:
        return read_npy(path, (3,))
    except FreeArtError:
        return read_npy(path, (1, 3))[0]


def chosen(names: Sequence[str], wanted: str | None, where: str) -> int:
    """Which of the joints `names`: the only one, or the one `wanted` by name or, counted from 0, by number."""
    if wanted is None and len(names) == 1:
        return 0
    if wanted is not None and wanted in names:
        return list(names).index(wanted)
    if wanted is not None and wanted.isdigit() and int(wanted) < len(names):
        return int(wanted)
    what = "no joint that moves" if not names else f"the joints {', '.join(names[:20])}"
    raise FreeArtError(f"{where} has {what}; expected one, or --joint (or 'joint' in the map) to say which")
