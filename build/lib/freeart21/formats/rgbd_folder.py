"""A plain folder of pictures from a depth camera, as one's own recordings come.

    rgb/ or color/            NAME.png or .jpg
    depth/                    NAME.png, 16 bits, millimetres unless told otherwise; 0 is none; aligned to the colours
    masks/ or mask/           NAME.png: the object, with hands cut out; white on black
    cam_K.txt                 3x3 intrinsic matrix of the colours, as BundleSDF and FoundationPose have it; or
    camera_intrinsic.json     or intrinsic.json: {width, height, intrinsic_matrix}, nine numbers column by column, as
                              Open3D's recorders write it

NAME is the same in all three folders; frames come in the order of the last number in it. The lens's distortion is taken
to be gone. These matrices put pixel centres at whole numbers, as OpenCV does; ours stand at +0.5.
"""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

from freeart21.camera import Camera
from freeart21.errors import FreeArtError
from freeart21.files import checked
from freeart21.formats import foreign
from freeart21.formats.foreign import Foreign
from freeart21.recording import Frame, Recording
from freeart21.se3 import Array

MILLIMETRE = 0.001
FPS = 30.0

_COLOUR, _DEPTH, _MASK = ("rgb", "color", "colour", "images"), ("depth",), ("masks", "mask")
_OPEN3D = ("camera_intrinsic.json", "intrinsic.json")


def is_rgbd_folder(folder: Path) -> bool:
    """Whether `folder` looks like one: colours, intrinsics, and depth in 16-bit pictures."""
    places = _place(folder, _COLOUR), _place(folder, _DEPTH)
    return None not in places and _has_intrinsics(folder) and any((folder / "depth").glob("*.png"))


def read_rgbd_folder(folder: Path, depth_unit: float = MILLIMETRE, fps: float = FPS) -> Foreign:
    """The recording in `folder`; frames load lazily. `depth_unit` is in metres, `fps` in frames a second.

    Raises FreeArtError, in one line, when masks are missing, frames do not go together, or sizes differ.
    """
    folder = Path(folder)
    if not 0 < depth_unit < 1:
        raise FreeArtError(f"depth unit is {depth_unit!r}, expected metres between 0 and 1, such as 0.001")
    if not 0 < fps < np.inf:
        raise FreeArtError(f"fps is {fps!r}, expected a positive number of frames a second")
    if not is_rgbd_folder(folder):
        raise FreeArtError(
            f"{folder} is not a folder of RGB-D pictures: expected rgb/ or color/, depth/ with 16-bit PNG files, and "
            "cam_K.txt or camera_intrinsic.json"
        )
    if _place(folder, _MASK) is None:
        raise FreeArtError(
            f"{folder} has no masks/: a picture of every frame is expected that is white where the object is, with "
            "hands cut out"
        )
    rgb, depth, mask = (_pictures(folder, names) for names in (_COLOUR, _DEPTH, _MASK))
    for sub, files in (("depth", depth), ("masks", mask)):
        odd = sorted(set(rgb) ^ set(files), key=_in_time)
        if odd:
            where, lacks = ("the colours", sub) if odd[0] in rgb else (sub, "the colours")
            raise FreeArtError(f"{folder}: frame '{odd[0]}' is among {where}, but not among {lacks}; {len(odd)} differ")
    names = sorted(rgb, key=_in_time)
    if not 0 < len(names) <= foreign.MAX_FRAMES:
        raise FreeArtError(f"{folder} has {len(names)} frames, expected 1 to {foreign.MAX_FRAMES}")
    height, width = checked.read_rgb(rgb[names[0]]).shape[:2]
    camera = _camera(folder, width, height)

    def load(index: int) -> Frame:
        name = names[index]
        colours, raw = checked.read_rgb(rgb[name]), checked.read_uint16(depth[name])
        shown = foreign.read_foreground(mask[name])
        for path, image in ((rgb[name], colours), (depth[name], raw), (mask[name], shown)):
            if image.shape[:2] != (height, width):
                raise FreeArtError(
                    f"{path} is {image.shape[1]} x {image.shape[0]}, expected {width} x {height} as the first colours: "
                    "align depth to the colour camera, and masks with it"
                )
        return Frame(colours, raw.astype(np.float32) * np.float32(depth_unit), shown)

    name = foreign.safe_name(folder.resolve().name)
    recording = Recording(camera, np.arange(len(names)) / fps, load, (), None, name)
    return Foreign(name, name, recording, None, "a video alone has none")


def _place(folder: Path, names: tuple[str, ...]) -> Path | None:
    return next((folder / name for name in names if (folder / name).is_dir()), None)


def _has_intrinsics(folder: Path) -> bool:
    return any((folder / name).is_file() for name in ("cam_K.txt", *_OPEN3D))


def _pictures(folder: Path, names: tuple[str, ...]) -> dict[str, Path]:
    """Name without suffix to file; links may not lead out of the folder."""
    place = _place(folder, names)
    assert place is not None
    suffixes = (".png", ".jpg", ".jpeg") if names == _COLOUR else (".png",)
    found: dict[str, Path] = {}
    for path in sorted(place.iterdir()):
        if path.suffix.lower() in suffixes:
            if path.stem in found:
                raise FreeArtError(f"{place}: {found[path.stem].name} and {path.name} are one frame")
            found[path.stem] = foreign.within(folder, path)
    return found


def _in_time(name: str) -> tuple[int, str]:
    """Sorts frames by the last number in their names, as frame_9 before frame_10."""
    numbers = re.findall(r"[0-9]+", name)
    return (int(numbers[-1]) if numbers else 0, name)


def _camera(folder: Path, width: int, height: int) -> Camera:
    """The camera, with pixel centres at +0.5."""
    if (folder / "cam_K.txt").is_file():
        path = folder / "cam_K.txt"
        K = foreign.read_matrix(path)
    else:
        path = next(folder / name for name in _OPEN3D if (folder / name).is_file())
        data = checked.read_json(path)
        K = checked.numbers(data, "intrinsic_matrix", (9,), path).reshape(3, 3).T
        size = checked.numbers({"size": [data.get("width"), data.get("height")]}, "size", (2,), path)
        if size.tolist() != [width, height]:
            raise FreeArtError(
                f"{path} is of pictures {size[0]:g} x {size[1]:g}, but the colours are {width} x {height}"
            )
    return Camera(_centred(K, path), width, height)


def _centred(K: Array, path: Path) -> Array:
    if K.shape != (3, 3):
        raise FreeArtError(f"{path} has shape {K.shape}, expected a 3 x 3 matrix")
    K = K.copy()
    K[:2, 2] += 0.5
    return K
