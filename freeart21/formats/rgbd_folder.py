"""A plain folder of pictures from a depth camera.

    rgb/ or color/            NAME.png or .jpg
    depth/                    NAME.png, 16 bits, millimetres by default; aligned to the colours; 0 is no depth, and so
                              is 65535, or the value that the camera writes in its place
    masks/ or mask/           NAME.png or .jpg: the object, with hands cut out; white (or any label) on black
    cam_K.txt                 3x3 intrinsic matrix of the colours, as BundleSDF and FoundationPose have it; or
    camera_intrinsic.json     or intrinsic.json: {width, height, intrinsic_matrix}, nine numbers column by column, as
                              Open3D's recorders write it

NAME is the same in all three folders, or ends in the same number, or is a time stamp: seconds with a fraction (as the
TUM RGB-D sets have them), or Unix time in s, ms, us or ns. Without time stamps, frames are in the
order of the last number in their names, `fps` a second. Pictures must be undistorted. Pixel centres of these matrices
are at whole numbers, as in OpenCV; ours are at +0.5.
"""

from __future__ import annotations

import itertools
import re
from bisect import bisect
from pathlib import Path

import numpy as np

from freeart21.camera import Camera
from freeart21.errors import FreeArtError
from freeart21.files import checked
from freeart21.formats import third_party
from freeart21.formats.third_party import RecordingLayout, ThirdPartyRecording, find_recordings
from freeart21.recording import Frame, Recording
from freeart21.se3 import Array

MILLIMETRE = 0.001
FPS = 30.0
MAX_DIFFERENCE_NS = 20_000_000
"""Largest difference between time stamps of one frame, as in associate.py of the TUM RGB-D sets (0.02 s)."""

_COLOUR, _DEPTH, _MASK = ("rgb", "color", "colour", "images"), ("depth",), ("masks", "mask")
_OPEN3D = ("camera_intrinsic.json", "intrinsic.json")
_UNIX_S = (1_000_000_000, 4_200_000_000)  # 2001 to 2103: excludes dates such as 20240131123000
_TOP_SHARE, _TOP_FRAMES = 0.01, 8  # least share of pixels, over so many frames, of the value for no depth


def is_rgbd_folder(folder: Path) -> bool:
    """Whether `folder` has colours, intrinsics, and depth as pictures (an official example has .npz)."""
    depth = folder / "depth"
    return (
        _place(folder, _COLOUR) is not None
        and _has_intrinsics(folder)
        and depth.is_dir()
        and any(path.suffix and path.suffix != ".npz" for path in depth.iterdir())
    )


def read_rgbd_folder(folder: Path, depth_unit: float = MILLIMETRE, fps: float | None = None) -> ThirdPartyRecording:
    """The recording in `folder`; frames load lazily. `depth_unit` is in metres, `fps` in frames a second.

    With `fps` None, times come from time stamps in the names, else from FPS. Raises FreeArtError when masks are
    missing, frames do not match, or sizes differ.
    """
    folder = Path(folder)
    if not 0 < depth_unit < 1:
        raise FreeArtError(f"depth unit is {depth_unit!r}, expected metres between 0 and 1, such as 0.001")
    if fps is not None and not 0 < fps < np.inf:
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
    rgb, deep, mask = (_pictures(folder, names) for names in (_COLOUR, _DEPTH, _MASK))
    frames, times, notes = _frames(folder, rgb, deep, mask, fps)
    if len(frames) > third_party.MAX_FRAMES:
        raise FreeArtError(f"{folder} has {len(frames)} frames, expected 1 to {third_party.MAX_FRAMES}")
    height, width = checked.read_rgb(frames[0][0]).shape[:2]
    camera = _camera(folder, width, height)
    invalid = _first_invalid_depth([depth for _, depth, _ in frames])
    lost: dict[int, int] = {}

    def load(index: int) -> Frame:
        colours, raw = checked.read_rgb(frames[index][0]), checked.read_uint16(frames[index][1])
        shown = third_party.read_foreground(frames[index][2])
        for path, size in zip(frames[index], (colours.shape, raw.shape, shown.shape), strict=True):
            if size[:2] != (height, width):
                raise FreeArtError(
                    f"{path} is {size[1]} x {size[0]}, expected {width} x {height} as the first colours: "
                    "align depth to the colour camera, and masks with it"
                )
        lost[index] = int(np.count_nonzero(raw >= invalid))
        depth = np.where(raw < invalid, raw, 0).astype(np.float32) * np.float32(depth_unit)
        return Frame(colours, depth, shown)

    def observe() -> tuple[str, ...]:
        pixels, some = sum(lost.values()), sum(map(bool, lost.values()))
        share = pixels / (width * height * len(lost) or 1)
        text = f"depth {invalid} is taken as none: {pixels} pixels ({share:.1%}) of {some} frames"
        return (text,) if pixels else ()

    name = third_party.safe_name(folder.resolve().name)
    recording = Recording(camera, times, load, (), None, name)
    return ThirdPartyRecording(name, name, recording, None, "a video alone has no truth", notes, observe)


def _first_invalid_depth(depth: list[Path]) -> int:
    """The smallest depth value that means no depth.

    That is 65535; or the largest value of the recording, when many pixels have it and no other pixel has half of it or
    more. Cameras write 2047 or 10000, for example, while depths of surfaces have values in between.
    """
    chosen = np.unique(np.linspace(0, len(depth) - 1, _TOP_FRAMES).round().astype(int))
    counts = sum(np.bincount(checked.read_uint16(depth[i]).ravel(), minlength=1 << 16) for i in chosen)
    counts = np.asarray(counts)[:-1]
    values = np.flatnonzero(counts[1:]) + 1
    if len(values) < 2 or 2 * values[-2] > values[-1]:
        return len(counts)
    return int(values[-1]) if counts[values[-1]] >= _TOP_SHARE * counts.sum() else len(counts)


def _place(folder: Path, names: tuple[str, ...]) -> Path | None:
    return next((folder / name for name in names if (folder / name).is_dir()), None)


def _has_intrinsics(folder: Path) -> bool:
    return any((folder / name).is_file() for name in ("cam_K.txt", *_OPEN3D))


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
    colour, deep, masked = stamps
    notes: list[str] = []
    if colour is not None and deep is not None and masked is not None:
        depths, masks = (sorted((t, name) for name, t in stamped.items()) for stamped in (deep, masked))
        found = sorted((t, name, _nearest(depths, t), _nearest(masks, t)) for name, t in colour.items())
        chosen = [(t, (rgb[name], depth[d], mask[m])) for t, name, d, m in found if d and m]
        if len(chosen) < len(found):
            notes.append(
                f"{len(found) - len(chosen)} of {len(found)} colours have no depth and mask within "
                f"{MAX_DIFFERENCE_NS / 1e6:g} ms by their time stamps, and are left out"
            )
        if not chosen:
            raise FreeArtError(
                f"{folder}: no colours have depth and a mask within {MAX_DIFFERENCE_NS / 1e6:g} ms by name"
            )
        for (t, (one, *_)), (later, (other, *_)) in itertools.pairwise(chosen):
            if t == later:
                raise FreeArtError(f"{folder}: {one.name} and {other.name} have one time stamp")
        times = np.array([t - chosen[0][0] for t, _ in chosen]) / 1e9
        frames = [frame for _, frame in chosen]
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


def _nearest(stamps: list[tuple[int, str]], t: int) -> str | None:
    """Name of the nearest of sorted time stamps to `t`, ns; None when it differs by MAX_DIFFERENCE_NS or more."""
    at = bisect(stamps, (t,))
    difference, name = min((abs(stamp - t), name) for stamp, name in stamps[max(at - 1, 0) : at + 1])
    return name if difference < MAX_DIFFERENCE_NS else None


def _describe_times(times: Array) -> str:
    """A note on times from names: duration, median step, and the longest gap."""
    if len(times) < 2:
        return "times are from the names: one frame"
    steps = np.diff(times)
    median, longest = float(np.median(steps)), int(np.argmax(steps))
    text = f"times are from the names: {len(times)} frames in {times[-1]:.6g} s, {1e3 * median:.4g} ms apart"
    gaps = int(np.count_nonzero(steps > 1.5 * median))
    if not gaps:
        return text
    return f"{text}; gaps are kept ({gaps}), the longest {steps[longest]:.4g} s after frame {longest}"


def _camera(folder: Path, width: int, height: int) -> Camera:
    """The camera; its pixel centres are at +0.5."""
    if (folder / "cam_K.txt").is_file():
        path = folder / "cam_K.txt"
        K = third_party.read_matrix(path)
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


LAYOUT = RecordingLayout(
    "rgbd",
    1,
    "rgb/ or color/, depth/*.png, masks/ and cam_K.txt or camera_intrinsic.json",
    lambda source: find_recordings(source, is_rgbd_folder, ("*",)),
    lambda folder, options: read_rgbd_folder(folder, options.depth_unit, options.fps),
)
