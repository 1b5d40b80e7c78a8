"""A plain folder of pictures from a depth camera.

    rgb/ or color/            NAME.png or .jpg
    depth/                    NAME.png, 16 bits, millimetres by default; aligned to the colours; 0 is no depth, and so
                              is 65535, or the value that the camera writes in its place
    masks/ or mask/           NAME.png or .jpg: the object, with hands cut out; white (or any label) on black
    cam_K.txt                 3x3 intrinsic matrix of the colours, as BundleSDF and FoundationPose have it; or
    camera_intrinsic.json     or intrinsic.json: {width, height, intrinsic_matrix}, nine numbers column by column, as
                              Open3D's recorders write it

NAME is the same in all three folders, or ends in the same number, or is a time stamp: seconds with a fraction (as the
TUM RGB-D sets have them), or Unix time in s, ms, us or ns. Without time stamps, frames are in the order of the last
number in their names, `fps` a second. Pictures must be undistorted. Colours that EXIF turns are turned with their
depth, mask and K. Pixel centres of these matrices are at whole numbers, as in OpenCV; ours are at +0.5.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from freeart21.camera import Camera
from freeart21.errors import FreeArtError
from freeart21.files import atomic, checked
from freeart21.files.sequence import encode_depth
from freeart21.formats import third_party
from freeart21.formats.rgbd_video import (
    HALF_PIXEL,
    MAX_DIFFERENCE_S,
    Lens,
    Picture,
    RgbdVideo,
    align_video,
    check_intrinsics,
    pair_times,
    read_intrinsics,
    read_unturned,
    turn_intrinsics,
    turn_pixels,
)
from freeart21.formats.third_party import DEFAULTS, ReadOptions, RecordingLayout, ThirdPartyRecording
from freeart21.recording import Frame
from freeart21.se3 import Array

MILLIMETRE = 0.001
FPS = 30.0

_COLOUR, _DEPTH, _MASK = ("rgb", "color", "colour", "images"), ("depth",), ("masks", "mask")
_OPEN3D = ("camera_intrinsic.json", "intrinsic.json")
_UNIX_S = (1_000_000_000, 4_200_000_000)  # 2001 to 2103: excludes dates such as 20240131123000
_TOP_SHARE, _TOP_FRAMES = 0.01, 8  # least share of pixels, over so many frames, of the value for no depth


def is_rgbd_folder(folder: Path) -> bool:
    """Whether `folder` has colours, intrinsics, and depth as pictures (an official example has .npz)."""
    return has_pictures(folder) and _intrinsics_file(folder) is not None


def has_pictures(folder: Path) -> bool:
    """Whether `folder` has colours, and depth as pictures."""
    depth = folder / "depth"
    return (
        _place(folder, _COLOUR) is not None
        and depth.is_dir()
        and any(path.suffix and path.suffix != ".npz" for path in depth.iterdir())
    )


def read_rgbd_folder(
    folder: Path, options: ReadOptions = DEFAULTS, lens_of: Callable[[Path, int, int], Lens] | None = None
) -> ThirdPartyRecording:
    """The recording in `folder`; frames load lazily.

    With `options.fps` None, times come from time stamps in the names, else from FPS. `lens_of` gives the colour camera
    from the folder, width and height, where no file of the folder has it. Depth of fewer pixels than the colours is
    brought to them, and turned with them where their EXIF says so. Raises FreeArtError when frames do not match, or
    the shapes of colours and depth differ.
    """
    folder, depth_unit, fps = Path(folder), options.depth_unit, options.fps
    if not 0 < depth_unit < 1:
        raise FreeArtError(f"depth unit is {depth_unit!r}, expected metres between 0 and 1, such as 0.001")
    if fps is not None and not 0 < fps < np.inf:
        raise FreeArtError(f"fps is {fps!r}, expected a positive number of frames a second")
    if not has_pictures(folder) or (lens_of is None and _intrinsics_file(folder) is None):
        raise FreeArtError(
            f"{folder} is not a folder of RGB-D pictures: expected rgb/ or color/, depth/ with 16-bit PNG files, and "
            "cam_K.txt or camera_intrinsic.json"
        )
    masked = options.masks is None and _place(folder, _MASK) is not None
    rgb, deep = (_pictures(folder, names) for names in (_COLOUR, _DEPTH))
    frames, times, notes = _frames(folder, rgb, deep, _pictures(folder, _MASK) if masked else rgb, fps)
    if len(frames) > third_party.MAX_FRAMES:
        raise FreeArtError(f"{folder} has {len(frames)} frames, expected 1 to {third_party.MAX_FRAMES}")
    first, turns = read_unturned(frames[0][0])
    height, width = first.shape[:2]
    lens = _lens(folder, width, height, turns) if lens_of is None else lens_of(folder, width, height)
    invalid, occurs = _first_invalid_depth([depth for _, depth, _ in frames])
    notes += (f"depth {invalid} is taken as none",) if occurs else ()
    some = checked.read_uint16(frames[0][1]).shape
    if sorted(some) != sorted((height, width)):
        notes += (
            f"depth of {some[1]} x {some[0]} pixels is taken to have the view of the colours, {width} x {height}",
        )

    def load(index: int) -> Picture:
        path, depth_path, _ = frames[index]
        colours, turned = read_unturned(path)
        if colours.shape[:2] != (height, width) or turned != turns:
            raise FreeArtError(
                f"{path} is {colours.shape[1]} x {colours.shape[0]}, {turned} quarter turns by its EXIF, expected "
                f"{width} x {height}, {turns} as the first colours"
            )
        raw = checked.read_uint16(depth_path)
        if turns % 2 and not _same_shape(raw.shape, height, width) and _same_shape(raw.shape, width, height):
            raw = turn_pixels(raw, -turns)
        if not _same_shape(raw.shape, height, width):
            raise FreeArtError(
                f"{depth_path} is {raw.shape[1]} x {raw.shape[0]}, expected {width} x {height} as the first colours: "
                "align depth to the colour camera"
            )
        return Picture(colours, np.where(raw < invalid, raw, 0).astype(np.float32) * np.float32(depth_unit))

    def mask(index: int) -> NDArray[np.bool_]:
        return third_party.read_foreground(frames[index][2])

    name = third_party.safe_name(folder.resolve().name)
    video = RgbdVideo(name, times, load, lens, turns=turns, mask=mask if masked else None, notes=notes)
    return align_video(video, options)


def write_pictures(folder: Path, time_s: float, frame: Frame, masked: bool) -> None:
    """Write rgb/, depth/ (millimetres) and, when `masked`, masks/ of a frame, named by its time, seconds."""
    name = f"{time_s:013.6f}.png"
    atomic.write_bytes(folder / "rgb" / name, checked.encode_png(frame.rgb))
    atomic.write_bytes(folder / "depth" / name, checked.encode_png(encode_depth(frame.depth, MILLIMETRE)))
    if masked:
        atomic.write_bytes(folder / "masks" / name, checked.encode_png(255 * frame.mask.astype(np.uint8)))


def write_intrinsics(folder: Path, camera: Camera) -> None:
    """Write cam_K.txt, for pixel centres at whole numbers."""
    K = camera.K - HALF_PIXEL
    atomic.write_bytes(folder / "cam_K.txt", "".join(" ".join(f"{x:.9g}" for x in row) + "\n" for row in K).encode())


def _same_shape(shape: tuple[int, ...], height: int, width: int) -> bool:
    """Whether a depth picture can have the view of `width` x `height` colours: its shape, as many pixels or fewer."""
    rows, columns = shape
    return (rows, columns) == (height, width) or (
        rows < height and abs(columns * height - rows * width) <= max(height, width)
    )


def _first_invalid_depth(depth: list[Path]) -> tuple[int, bool]:
    """The smallest depth value that means no depth, and whether it occurs.

    That is 65535; or the largest value of the recording, when many pixels have it and no other pixel has half of it or
    more. Cameras write 2047 or 10000, for example, while depths of surfaces have values in between.
    """
    chosen = np.unique(np.linspace(0, len(depth) - 1, _TOP_FRAMES).round().astype(int))
    counts = np.sum([np.bincount(checked.read_uint16(depth[i]).ravel(), minlength=1 << 16) for i in chosen], axis=0)
    values = np.flatnonzero(counts[1:-1]) + 1
    if len(values) >= 2 and 2 * values[-2] <= values[-1] and counts[values[-1]] >= _TOP_SHARE * counts[:-1].sum():
        return int(values[-1]), True
    return len(counts) - 1, bool(counts[-1])


def _place(folder: Path, names: tuple[str, ...]) -> Path | None:
    return next((folder / name for name in names if (folder / name).is_dir()), None)


def _intrinsics_file(folder: Path) -> Path | None:
    return next((folder / name for name in ("cam_K.txt", *_OPEN3D) if (folder / name).is_file()), None)


def _pictures(folder: Path, names: tuple[str, ...]) -> dict[str, Path]:
    """Stem to file; FreeArtError for links that lead out of the folder."""
    place = _place(folder, names)
    assert place is not None
    suffixes = (".png",) if names == _DEPTH else (".png", ".jpg", ".jpeg")
    found: dict[str, Path] = {}
    for path in sorted(place.iterdir()):
        if path.suffix.lower() in suffixes:
            if path.stem in found:
                raise FreeArtError(f"{place}: {found[path.stem].name} and {path.name} are one frame")
            found[path.stem] = third_party.within(folder, path)
    if not found:
        kinds = sorted({path.suffix if path.is_file() else f"{path.name}/" for path in place.iterdir()})
        form = "16-bit .png" if names == _DEPTH else ".png or .jpg"
        raise FreeArtError(f"{place} holds {', '.join(kinds[:5]) or 'no'} files, expected {form} files in it")
    return found


_Files = dict[str, Path]
_Frame = tuple[Path, Path, Path]


def _frames(
    folder: Path, rgb: _Files, depth: _Files, mask: _Files, fps: float | None
) -> tuple[list[_Frame], Array, tuple[str, ...]]:
    """Colours, depth and mask of every frame, (n,) seconds from the first frame, and notes."""
    stamps = [_stamps(list(files)) for files in (rgb, depth, mask)]
    notes: list[str] = []
    if None not in stamps:
        named = [sorted((t, name) for name, t in (one or {}).items()) for one in stamps]
        first = named[0][0][0]
        colours, depths, masks = (np.array([t - first for t, _ in one]) / 1e9 for one in named)
        for at in np.flatnonzero(np.diff(colours) == 0)[:1]:
            one, other = (rgb[name].name for _, name in named[0][at : at + 2])
            raise FreeArtError(f"{folder}: {one} and {other} have one time stamp")
        with_depth, deep = pair_times(colours, depths)
        with_mask, masked = pair_times(colours[with_depth], masks)
        chosen, deep = with_depth[with_mask], deep[with_mask]
        within = f"within {1e3 * MAX_DIFFERENCE_S:g} ms"
        if not len(chosen):
            raise FreeArtError(f"{folder}: no colours have depth and a mask {within} by name")
        if len(chosen) < len(rgb):
            notes.append(
                f"{len(rgb) - len(chosen)} of {len(rgb)} colours have no depth and mask {within} by their time stamps, "
                "and are left out"
            )
        places = zip(*([named[k][i][1] for i in rows] for k, rows in enumerate((chosen, deep, masked))), strict=True)
        frames = [(rgb[a], depth[b], mask[c]) for a, b, c in places]
        times = np.array([named[0][i][0] - named[0][chosen[0]][0] for i in chosen]) / 1e9
        notes.append(
            _describe_times(times) if fps is None else f"times are by --fps, {fps:g} a second, not by the names"
        )
        return frames, times if fps is None else np.arange(len(frames)) / fps, tuple(notes)
    rows = _same_frames(folder, rgb, depth, mask)
    steps = np.diff([_number(row[0].stem) for row in rows])
    if fps is None and len(steps) and (steps != 1).any() and (steps > 0).all():
        notes.append(
            f"numbers in the names step by {steps.min()} to {steps.max()}; frames are taken to be evenly spaced, "
            f"{FPS:g} a second (--fps for others)"
        )
    return rows, np.arange(len(rows)) / (fps or FPS), tuple(notes)


def _same_frames(folder: Path, rgb: _Files, depth: _Files, mask: _Files) -> list[_Frame]:
    """Frames of files with the same name or, where names differ, the same number; sorted by number."""
    if not set(rgb) == set(depth) == set(mask):
        named = [{_number(name): path for name, path in files.items()} for files in (rgb, depth, mask)]
        if set(named[0]) == set(named[1]) == set(named[2]) and len(named[0]) == len(rgb):
            return [(named[0][k], named[1][k], named[2][k]) for k in sorted(named[0])]
    for sub, files in (("depth", depth), ("masks", mask)):
        unmatched = sorted(set(rgb) ^ set(files), key=_frame_order)
        if unmatched:
            where, lacks = ("the colours", sub) if unmatched[0] in rgb else (sub, "the colours")
            raise FreeArtError(
                f"{folder}: frame '{unmatched[0]}' is among {where}, but not among {lacks}; {len(unmatched)} differ"
            )
    return [(rgb[name], depth[name], mask[name]) for name in sorted(rgb, key=_frame_order)]


def _frame_order(name: str) -> tuple[int, str]:
    """Sort key: the last number in a name, so that frame_9 is before frame_10."""
    return (_number(name), name)


def _number(name: str) -> int:
    """The last number in a name; 0 without one."""
    numbers = re.findall(r"[0-9]+", name)
    return int(numbers[-1]) if numbers else 0


def _stamps(names: list[str]) -> dict[str, int] | None:
    """Name to its time stamp, ns; None unless all names have one.

    Time stamps are Unix times in s, ms, us or ns, or seconds with a fraction. Seconds are whole names, or end in
    numbers with equally many decimals (unlike v1.9 and v1.10).
    """
    found = [re.search(r"([0-9]{1,20})(?:\.([0-9]{1,18}))?$", name) for name in names]
    parts = [(m[1], m[2] or "", m[0] == name) for m, name in zip(found, names, strict=True) if m is not None]
    if len(parts) < len(names):
        return None
    middle = sorted(int(whole) for whole, _, _ in parts)[len(parts) // 2]
    unit = next((k for k in range(4) if _UNIX_S[0] * 1000**k <= middle <= _UNIX_S[1] * 1000**k), None)
    decimals = {len(fraction) for _, fraction, _ in parts}
    alone = all(whole_name for _, _, whole_name in parts)
    if unit is None and (decimals == {0} or not (alone or len(decimals) == 1)):
        return None
    digits = 9 - 3 * (unit or 0)
    return {
        name: int(whole) * 10**digits + int((fraction + digits * "0")[:digits] or 0)
        for name, (whole, fraction, _) in zip(names, parts, strict=True)
    }


def _describe_times(times: Array) -> str:
    """A note on times from names: duration, median step, and the longest gap."""
    steps = np.diff(times) if len(times) > 1 else np.zeros(1)
    median, longest = float(np.median(steps)), int(np.argmax(steps))
    text = f"times are from the names: {len(times)} frames in {times[-1]:.6g} s, {1e3 * median:.4g} ms apart"
    gaps = int(np.count_nonzero(steps > 1.5 * median))
    return f"{text}; gaps are kept ({gaps}), the longest {steps[longest]:.4g} s after frame {longest}" if gaps else text


def _lens(folder: Path, width: int, height: int, turns: int) -> Lens:
    """The camera of `width` x `height` colours as filmed, which stand upright after `turns` clockwise quarter turns.

    A file that names the upright size, or a principal point that fits it better, is turned back.
    """
    path = _intrinsics_file(folder)
    assert path is not None
    upright = (height, width) if turns % 2 else (width, height)
    is_upright = False
    if path.name in _OPEN3D:
        data = checked.read_json(path)
        K = checked.numbers(data, "intrinsic_matrix", (9,), path).reshape(3, 3).T
        K = K + HALF_PIXEL
        size = checked.numbers({"size": [data.get("width"), data.get("height")]}, "size", (2,), path)
        if tuple(size) not in ((width, height), upright):
            raise FreeArtError(
                f"{path} is of pictures {size[0]:g} x {size[1]:g}, but the colours are {width} x {height}"
            )
        is_upright = tuple(size) != (width, height)
    else:
        K = read_intrinsics(path)
        is_upright = np.abs(K[:2, 2] / upright - 0.5).sum() < np.abs(K[:2, 2] / (width, height) - 0.5).sum()
    if is_upright:
        K = turn_intrinsics(K, *upright, -turns)
    check_intrinsics(K, width, height, str(path))
    return Lens(K, width, height)


LAYOUT = RecordingLayout(
    "rgbd",
    1,
    "rgb/ or color/, depth/*.png, masks/ and cam_K.txt or camera_intrinsic.json",
    is_rgbd_folder,
    read_rgbd_folder,
)
