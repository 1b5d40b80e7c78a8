"""Shared by all third-party layouts: camera axes, depth units, numbered files, and what a folder knows of the truth."""

from __future__ import annotations

import io
import re
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path, PurePath
from typing import Any, TypeVar

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray
from PIL import Image as Pillow

from freeart21 import se3
from freeart21.errors import FreeArtError
from freeart21.files import checked
from freeart21.joint import Joint
from freeart21.recording import Recording
from freeart21.se3 import Array

P = TypeVar("P", bound=PurePath)
Image = NDArray[np.uint8]
Progress = Callable[[int, int], None]
"""Called with the number of finished frames and their total."""

T_GL_CV: Array = np.diag([1.0, -1.0, -1.0, 1.0])
"""OpenGL camera (x right, y up, z backward) from ours (x right, y down, z forward)."""

T_SAPIEN_CV: Array = np.array([[0, 0, 1, 0], [-1, 0, 0, 0], [0, -1, 0, 0], [0, 0, 0, 1]], float)
"""SAPIEN camera (x forward, y left, z up) from ours."""

FARTHEST_M = 100.0
"""The far plane of both data sets: larger depths are in millimetres."""
MAX_FRAMES = 100_000
LONGEST_SIDE = 1280
"""Default longest side, pixels: phones film 1920 x 1440 with 256 x 192 depth."""

_LEAST_MM = 20  # integer depth always below this is not in millimetres: no camera films from two centimetres
_UNIT_NORM = 0.05  # largest deviation of a stored quaternion's norm from one
_PNG = b"\x89PNG\r\n\x1a\n"
_MOST_VALUES = 32  # in a label map; black and white enlarged 2, 3, 4 times (bilinear) has 10, 10, 25; soft masks 256
_MOST_LABELS = 16  # two parts, a hand and a few more; a soft mask of low resolution has more flat values


@dataclass(frozen=True)
class KnownTruth:
    """What a third-party folder knows of the truth, for n frames.

    The object's frame is that of its URDF's root link (z up). The sides are those of the scored joint: parent (with the
    root link) and child.
    """

    states: Array
    """(n,) joint state, rad or m."""
    Ts_camera_object: Array
    """(n, 4, 4) poses of the root link."""
    side: Callable[[int], Image]
    """Frame index to (height, width): 0 neither, 1 parent side, 2 child side."""
    joint_name: str | None = None
    """Name of the scored joint in the object's URDF; None when the layout does not have it."""
    joint: Joint | None = None
    """Motion of the child relative to the parent side, object's frame; None when only the URDF has it."""
    held: dict[str, float] = field(default_factory=dict)
    """States of other joints, rad or m, if the layout has them."""
    source: dict[str, Any] = field(default_factory=dict)
    """Its origin."""

    def __post_init__(self) -> None:
        states = np.asarray(self.states, float)
        poses = se3.check_poses("known T_camera_object", self.Ts_camera_object)
        if states.ndim != 1 or len(poses) != len(states) or not np.isfinite(states).all():
            raise FreeArtError(f"known states have shape {states.shape}, expected ({len(poses)},) finite numbers")
        object.__setattr__(self, "states", states)

    def parts(self, joint: Joint) -> Parts:
        """Reference and moving part for the child-against-parent motion `joint`.

        Reads every part mask, see `assign_parts`.
        """
        counts = np.array([np.bincount(self.side(i).ravel(), minlength=3)[1:3] for i in range(len(self.states))])
        return assign_parts(counts, self.Ts_camera_object, self.states, joint, self.side)


@dataclass(frozen=True)
class Parts:
    """Reference and moving part, chosen from the two sides."""

    order: tuple[int, int]
    """Side (0 parent, 1 child) of the reference and of the moving part."""
    joint: Joint
    """Motion of the moving part against the reference part, in the object's frame."""
    Ts_camera: tuple[Array, Array]
    """Poses (n, 4, 4) of reference and moving part."""
    seen: NDArray[np.int64]
    """(n, 2) pixels of reference and moving part."""
    part_mask: Callable[[int], Image]
    """Frame index to (height, width): 0 neither, 1 reference, 2 moving."""


def assign_parts(
    counts: NDArray[np.int64], Ts_camera_object: Array, states: Array, joint: Joint, side: Callable[[int], Image]
) -> Parts:
    """Choose the reference part: the side with more pixels over all frames.

    When that is the child side, the axis is reversed and the states stay.

    Args:
        counts: (n, 2) pixels of parent and child side.
        Ts_camera_object: (n, 4, 4) poses of the parent side.
        states: (n,) joint states, rad or m.
        joint: motion of the child side relative to the parent side, in the object's frame.
        side: frame index to (height, width): 0 no object, 1 parent side, 2 child side.
    """
    order = (1, 0) if counts[:, 1].sum() > counts[:, 0].sum() else (0, 1)
    Ts = Ts_camera_object, Ts_camera_object @ joint.transform(states)
    own = joint if order == (0, 1) else replace(joint, axis=-joint.axis)
    label = np.array([0, 1 + order.index(0), 1 + order.index(1)], np.uint8)
    return Parts(order, own, (Ts[order[0]], Ts[order[1]]), counts[:, list(order)], lambda i: label[side(i)])


@dataclass(frozen=True)
class ThirdPartyRecording:
    """A third-party folder, read."""

    name: str
    """Name for a sequence: letters, digits, '.', '-' and '_'."""
    object_id: str
    """The object's PartNet-Mobility id."""
    recording: Recording
    known: KnownTruth | None
    """None when the truth is incomplete; `lacks` is the reason."""
    lacks: str = ""
    notes: tuple[str, ...] = ()
    """Notes for the user, one line each."""
    has_masks: bool = True
    """False: the mask of every frame is empty, because nobody has segmented the object yet."""


@dataclass(frozen=True)
class ReadOptions:
    """What a user says of the recordings that are read."""

    depth_unit: float = 1e-3
    """Metres per depth unit of picture folders."""
    fps: float | None = None
    """Frames a second of picture folders; None: from time stamps in the names, else 30."""
    partnet_root: Path | None = None
    """Folder of PartNet-Mobility objects."""
    masks: Path | None = None
    """Folder with a mask for each frame of a camera's recording, instead of its own."""
    longest_side: int = LONGEST_SIDE
    """Most pixels of width and height of a camera's pictures; larger ones are made smaller."""


DEFAULTS = ReadOptions()


@dataclass(frozen=True)
class RecordingLayout:
    """A layout of recordings that `convert` reads: one module of `freeart21.formats` each."""

    name: str
    rank: int
    """Layouts are tried in this order; the first one with a recording in the folder is taken."""
    files: str
    """The files that a recording is recognised by, for messages."""
    fits: Callable[[Path], bool]
    """Whether a folder, or a file, is a recording."""
    read: Callable[[Path, ReadOptions], ThirdPartyRecording]
    patterns: tuple[str, ...] = ("*",)
    """Where in a folder its recordings are; the first pattern with any is taken."""
    objects: Callable[[Path], Path | None] = lambda recording: None
    """The folder of PartNet-Mobility objects that belongs to a recording, if it exists."""
    object_folder: Callable[[Path], Path | None] = lambda recording: None
    """The folder of the recorded object itself, where a recording has one."""

    def find(self, source: Path) -> list[Path]:
        """`source` if it is a recording, else the recordings in it."""
        if self.fits(source):
            return [source]
        found = ([path for path in sorted(source.glob(pattern)) if self.fits(path)] for pattern in self.patterns)
        return next((some for some in found if some), [])


def find_object_folder(own: Path | None, object_id: str, partnet_root: Path | None) -> Path | None:
    """The object's PartNet-Mobility folder, if it exists: its `own`, or by its id in `partnet_root`."""
    name = safe_name(object_id)
    candidates = (None, None) if partnet_root is None else (partnet_root / name, partnet_root / "dataset" / name)
    return next((p for p in (own, *candidates) if p is not None and (p / "mobility.urdf").is_file()), None)


def numbered(folder: Path, suffixes: tuple[str, ...]) -> dict[int, Path]:
    """Frame number to file, for files in `folder` whose stem is a number of any length. Links count by their names.

    Raises FreeArtError when the folder is missing, or two files have the same number (0001.png and 00001.png).
    """
    if not folder.is_dir():
        raise FreeArtError(f"{folder} is missing")
    return by_number(folder.iterdir(), suffixes, folder)


def frame_files(folder: Path, sub: str, suffixes: tuple[str, ...], frames: Sequence[int] | None = None) -> list[Path]:
    """The files of `frames` (None: of all, counted from 0) in a folder of `folder`, links resolved.

    Raises FreeArtError as `numbered`, when one is missing, or when a link leads out of `folder`.
    """
    found = numbered(folder / sub, suffixes)
    frames = range(len(found)) if frames is None else frames
    absent = [i for i in frames if i not in found]
    if absent or not 0 < len(frames) <= MAX_FRAMES:
        missing = f"frame {absent[0]} is missing" if absent else "no frame is there" if not frames else "too many"
        raise FreeArtError(f"{folder / sub}: {missing}; {len(frames)} frames, expected 1 to {MAX_FRAMES}")
    return [within(folder, found[i]) for i in frames]


def by_number(paths: Iterable[P], suffixes: tuple[str, ...], where: Path) -> dict[int, P]:
    """As `numbered`, of these paths in `where`."""
    found: dict[int, P] = {}
    for path in sorted(paths):
        if path.suffix.lower() in suffixes and re.fullmatch(r"[0-9]{1,9}", path.stem):
            number = int(path.stem)
            if number in found:
                raise FreeArtError(f"{where}: {found[number].name} and {path.name} are both frame {number}")
            found[number] = path
    return found


def safe_name(name: str) -> str:
    """`name` as a plain folder name."""
    plain = re.sub(r"[^A-Za-z0-9._-]+", "-", name).strip(".-")
    if not plain:
        raise FreeArtError(f"'{name}' gives no folder name")
    return plain


def within(folder: Path, path: Path) -> Path:
    """`path` in `folder` with links resolved; FreeArtError when it is outside."""
    return checked.inside(folder, str(path.relative_to(folder)))


def depth_metres(raw: NDArray[Any], where: Path) -> NDArray[np.float32]:
    """(height, width) z-depth, metres, 0 where there is none, from one file's array.

    Integers are millimetres, floats are metres. Exceptions: floats with a median above the far plane (100) are
    millimetres, and integers that never reach 20 are refused. Not finite and negative values are no depth, and so are
    the largest integer of the type, and floats from the largest of half precision on (Blender writes 1e10). Files of
    one data set differ, so each is judged alone.
    """
    raw = raw[..., 0] if raw.ndim == 3 and raw.shape[2] == 1 else raw
    if raw.ndim != 2 or raw.dtype.kind not in "fiu":
        raise FreeArtError(f"{where}: depth has shape {raw.shape} {raw.dtype}, expected (height, width) of numbers")
    largest = np.finfo(np.float16).max if raw.dtype.kind == "f" else np.iinfo(raw.dtype).max
    depth = np.where(raw < largest, raw, 0).astype(np.float32)
    depth[~np.isfinite(depth) | (depth < 0)] = 0
    some = depth[depth > 0]
    if raw.dtype.kind in "iu":
        if len(some) and some.max() < _LEAST_MM:
            raise FreeArtError(
                f"{where}: depth is {raw.dtype} with no value above {some.max():g}, "
                "expected millimetres in whole numbers"
            )
        return depth / np.float32(1000)
    return depth / np.float32(1000) if len(some) and np.median(some) > FARTHEST_M else depth


def read_npy(path: Path, shape: tuple[int | None, ...]) -> Array:
    """The float64 array of an .npy file, without pickle, of bounded size; None in `shape` is any length."""
    array = checked.read_npy(path)
    fits = array.ndim == len(shape) and all(s in (None, a) for s, a in zip(shape, array.shape, strict=True))
    if not fits or array.dtype.kind not in "fiu" or not np.isfinite(array).all():
        wanted = ", ".join("n" if s is None else str(s) for s in shape)
        raise FreeArtError(f"{path} has shape {array.shape} {array.dtype}, expected ({wanted}) of finite numbers")
    return array.astype(float)


def read_matrix(path: Path) -> Array:
    """The rows of numbers, separated by blanks or commas, of a text file. Raises FreeArtError."""
    text = checked.read_text(path, 1 << 16, errors="replace").replace(",", " ")
    try:
        return np.array([[float(word) for word in line.split()] for line in text.splitlines() if line.strip()])
    except ValueError:
        raise FreeArtError(f"{path} is not a 3 x 3 matrix of numbers") from None


def read_foreground(path: Path) -> NDArray[np.bool_]:
    """(height, width) foreground of a mask picture: values above half of the smallest label.

    Reads black and white of 1, 8 or 16 bits, label maps (all labels), colours (the brightest channel), palettes (the
    index, where index 0 is black), and cut-outs (alpha, where it varies). A label is a value that fills squares of 3 x
    3 pixels, unlike soft edges. In soft masks and JPEG, with many values, the darkest sixteenth is background.
    """
    data = checked.read_bytes(path, checked.MAX_IMAGE_BYTES)
    image = checked.decode_image(data, path, cv2.IMREAD_UNCHANGED)
    is_png = data.startswith(_PNG)
    if is_png and data[25:26] == b"\x03":  # a palette, by the colour type in IHDR (PNG specification, 11.2.1)
        with Pillow.open(io.BytesIO(data)) as opened:
            if (opened.getpalette() or [255])[:3] == [0, 0, 0]:  # two labels can have one colour: palettes are padded
                image = np.asarray(opened)
    if image.dtype not in (np.uint8, np.uint16):
        raise FreeArtError(f"{path} is not a readable mask picture of 8 or 16 bits")
    if image.ndim == 3:
        alpha = image[..., 3] if image.shape[2] == 4 else None
        image = alpha if alpha is not None and alpha.min() < alpha.max() else image[..., :3].max(2)
    if not is_png or len(np.unique(image)) > _MOST_VALUES:
        image = np.where(image < np.iinfo(image.dtype).max / 16, np.zeros_like(image), image)
    flat = cv2.erode(image, np.ones((3, 3))) == cv2.dilate(image, np.ones((3, 3)))
    labels = np.unique(image[flat & (image > 0)])
    least = labels[0] if 0 < len(labels) <= _MOST_LABELS else image.max(initial=0)
    return np.asarray((image > 0) & (image > least / 2))


def poses_from_rows(rows: ArrayLike, where: str) -> Array:
    """(n, 4, 4) poses from rows (n, 7): position, then a quaternion w, x, y, z of about unit length."""
    rows = np.asarray(rows, float)
    norms = np.linalg.norm(rows[:, 3:], axis=1)
    bad = np.flatnonzero(~(np.abs(norms - 1) <= _UNIT_NORM))
    if len(bad) or not np.isfinite(rows).all():
        at = int(bad[0]) if len(bad) else 0
        raise FreeArtError(f"{where}: quaternion {at} has length {norms[at]:.3g}, expected 1 (w, x, y, z)")
    return se3.pose_from_wxyz(rows[:, :3], rows[:, 3:])


def same_count(folder: Path, counts: dict[str, int]) -> None:
    """FreeArtError when `counts` (file name to number of entries) differ."""
    if len(set(counts.values())) > 1:
        text = ", ".join(f"{name} {count}" for name, count in counts.items())
        raise FreeArtError(f"{folder}: the numbers of frames differ: {text}")
