"""A recording of the Record3D app (iPhone or iPad): an .r3d file, it unzipped, or its export of EXR pictures.

    metadata           or metadata.json: w, h, dw, dh (colours and depth), K (nine numbers column by column), fps,
                       perFrameIntrinsicCoeffs (fx, fy, cx, cy), frameTimestamps (s)
    rgbd/0.jpg         colours, or rgb/0.jpg (.png) of the export
    rgbd/0.depth       dh x dw float32 metres, compressed by LZFSE, or depth/0.exr
    rgbd/0.conf        dh x dw bytes, compressed by LZFSE: 0 low, 1 medium, 2 high; LiDAR only

The number in a name is the frame's place in the lists of metadata, which can name more frames than there are files.
"""

from __future__ import annotations

import re
import struct
import zipfile
import zlib
from collections.abc import Callable
from pathlib import Path, PurePosixPath
from typing import Any

import numpy as np

from freeart21.errors import FreeArtError
from freeart21.files import checked
from freeart21.formats import third_party
from freeart21.formats.rgbd_video import (
    HALF_PIXEL,
    Depth,
    Lens,
    Picture,
    RgbdVideo,
    align_video,
    drop_low_confidence,
    import_extra,
    intrinsics,
    read_unturned,
)
from freeart21.formats.third_party import (
    MAX_FRAMES,
    ReadOptions,
    RecordingLayout,
    ThirdPartyRecording,
)
from freeart21.se3 import Array

_MAX_ZIP_BYTES = 64 << 30
_MAX_DIRECTORY_BYTES = 32 << 20
"""Of the list of entries, some 60 bytes each."""
_METADATA = ("metadata", "metadata.json")
_COLOURS, _DEPTH, _CONFIDENCE = (".jpg", ".jpeg", ".png"), (".depth", ".exr"), (".conf",)
_MAX_SIDE = 4096


def read_record3d(source: Path, options: ReadOptions) -> ThirdPartyRecording:
    """The recording in the folder or file `source`. Raises FreeArtError in one line."""
    source = Path(source)
    names = _list_names(source)
    named = next((name for name in _METADATA if name in names), None)
    if named is None:
        raise FreeArtError(f"{source} has no metadata")
    where = source / named
    about = checked.parse_json(_read_entry(source, named).decode("utf-8", "replace"), where)
    if not isinstance(about, dict):
        raise FreeArtError(f"{where} holds a {type(about).__name__}, expected an object")
    colours, depth, confidence = (_number_names(names, kinds, where) for kinds in (_COLOURS, _DEPTH, _CONFIDENCE))
    frames = sorted(set(colours) & set(depth))
    if not 0 < len(frames) <= MAX_FRAMES:
        raise FreeArtError(f"{source} has {len(frames)} frames with colours and depth, expected 1 to {MAX_FRAMES}")
    lens, focus = _read_lens(about, where)
    times = _read_times(about, where, frames)
    first, turns = read_unturned(source / colours[frames[0]], _read_entry(source, colours[frames[0]]))
    height, width = first.shape[:2]
    if abs(width * lens.height - height * lens.width) > max(lens.width, lens.height):
        raise FreeArtError(
            f"{where} is of pictures {lens.width} x {lens.height}, but {colours[frames[0]]} is {width} x {height}: "
            "turn both, or neither"
        )

    def load(index: int) -> Picture:
        i = frames[index]
        name = colours[i]
        rgb, turned = read_unturned(source / name, _read_entry(source, name))
        if turned != turns:
            raise FreeArtError(f"{source / name} is turned by its EXIF, unlike {colours[frames[0]]}")
        metres = _read_depth(source, depth[i], about)
        if i in confidence:
            raw = _unpack(_read_entry(source, confidence[i]), metres.size, source / confidence[i])
            certain = np.frombuffer(raw, np.uint8).reshape(metres.shape)
            metres = drop_low_confidence(metres, certain, str(source / confidence[i]))
        own = Lens(intrinsics(focus[i]), lens.width, lens.height).scaled(width, height) if i < len(focus) else None
        return Picture(rgb, metres, own)

    lacking = len(set(colours) ^ set(depth))
    note = f"{lacking} pictures have colours without depth, or depth without colours, and are left out"
    video = RgbdVideo(
        third_party.safe_name(source.resolve().stem if source.is_file() else source.resolve().name),
        times - times[0],
        load,
        Lens(lens.scaled(width, height), width, height),
        turns=turns,
        folder=source if source.is_dir() else None,
        notes=(note,) if lacking else (),
    )
    return align_video(video, options)


def _list_names(source: Path) -> list[str]:
    """Files of the recording, by their names in it."""
    if source.is_dir():
        return [name for name in _METADATA if checked.is_there(source / name)] + [
            f"{sub}/{path.name}" for sub in ("rgbd", "rgb", "depth") for path in sorted((source / sub).glob("*"))
        ]
    return [info.filename for info in _with_zip(source, lambda archive: archive.infolist())]


def _with_zip(source: Path, use: Callable[[zipfile.ZipFile], Any]) -> Any:
    try:
        with (
            checked.open_file(source, _MAX_ZIP_BYTES, checked.ANYWHERE) as file,
            checked.open_zip(file, source, _MAX_DIRECTORY_BYTES) as archive,
        ):
            return use(archive)
    except (zipfile.BadZipFile, zlib.error, OSError, EOFError, NotImplementedError, RuntimeError, ValueError) as error:
        raise FreeArtError(f"{source} is not a readable .r3d file: {str(error)[:120]}") from error


def _read_entry(source: Path, name: str) -> bytes:
    """The bytes of one file of the recording, at most those of the largest picture."""
    if source.is_dir():
        return checked.read_bytes(source / name, checked.MAX_IMAGE_BYTES, source)

    def read(archive: zipfile.ZipFile) -> bytes:
        with archive.open(name) as entry:
            data = entry.read(checked.MAX_IMAGE_BYTES + 1)
        if len(data) > checked.MAX_IMAGE_BYTES:
            raise FreeArtError(f"{source / name} unpacks to more than {checked.MAX_IMAGE_BYTES} bytes")
        return data

    return _with_zip(source, read)


def _number_names(names: list[str], kinds: tuple[str, ...], where: Path) -> dict[int, str]:
    found: dict[int, str] = {}
    for name in names:
        path = PurePosixPath(name)
        if path.suffix.lower() in kinds and re.fullmatch(r"[0-9]{1,9}", path.stem) and len(path.parts) == 2:
            if int(path.stem) in found:
                raise FreeArtError(f"{where.parent}: {found[int(path.stem)]} and {name} are both frame {path.stem}")
            found[int(path.stem)] = name
    return found


def _read_lens(about: dict[str, Any], where: Path) -> tuple[Lens, Array]:
    """The camera in pictures of w x h, and (n, 4) fx, fy, cx, cy of each frame (n 0 without)."""
    width, height = (int(checked.number(about, key, where, 1, checked.MAX_PIXELS)) for key in ("w", "h"))
    if about.get("perFrameIntrinsicCoeffs"):
        focus = checked.numbers(about, "perFrameIntrinsicCoeffs", (None, 4), where)
        return Lens(intrinsics(np.median(focus, 0)), width, height), focus
    K = checked.numbers(about, "K", (9,), where).reshape(3, 3).T
    if not np.allclose(K[2], [0, 0, 1]):
        K = K.T  # some writers go row by row
    return Lens(K + HALF_PIXEL, width, height), np.zeros((0, 4))


def _read_times(about: dict[str, Any], where: Path, frames: list[int]) -> Array:
    """(n,) seconds of `frames`."""
    if about.get("frameTimestamps"):
        times = checked.numbers(about, "frameTimestamps", (None,), where)
        if frames[-1] >= len(times):
            raise FreeArtError(
                f"{where}: 'frameTimestamps' has {len(times)} entries, but there is a frame {frames[-1]}"
            )
        return times[frames]
    return np.array(frames) / checked.number(about, "fps", where, checked.ABOVE_ZERO, expected="frames a second")


def _read_depth(source: Path, name: str, about: dict[str, Any]) -> Depth:
    """(rows, columns) metres; not a number where there is none."""
    if name.endswith(".exr"):
        return _read_exr(source, name)
    where = source / name
    data = _read_entry(source, name)
    size = _lzfse_size(data, where) if data[:3] == b"bvx" else len(data)
    if "dw" in about and "dh" in about:
        columns, rows = (int(checked.number(about, key, where, 1, _MAX_SIDE)) for key in ("dw", "dh"))
    else:  # early versions: the shape of the colours
        columns = round(float(np.sqrt(size / 4 * about["w"] / about["h"])))
        rows = size // 4 // max(columns, 1)
    return np.frombuffer(_unpack(data, 4 * rows * columns, where), "<f4").reshape(rows, columns).astype(np.float32)


def _read_exr(source: Path, name: str) -> Depth:
    """The only channel, or Z or R, of an OpenEXR picture."""
    path = source / name
    exr = import_extra("OpenEXR", str(path))
    checked.require_file(path, checked.MAX_IMAGE_BYTES, source)
    try:
        low, high = exr.File(str(path), header_only=True).header()["dataWindow"]
        width, height = (int(b) - int(a) + 1 for a, b in zip(low, high, strict=True))
        if not (0 < width <= _MAX_SIDE and 0 < height <= _MAX_SIDE):
            raise FreeArtError(f"{path} claims {width} x {height} pixels, at most {_MAX_SIDE} x {_MAX_SIDE} are read")
        channels = exr.File(str(path), separate_channels=True).channels()
    except (RuntimeError, ValueError, KeyError, TypeError) as error:
        raise FreeArtError(f"{path} is not a readable EXR picture: {str(error)[:120]}") from error
    chosen = next((channels[key] for key in ("Z", "R", *channels) if key in channels), None)
    if chosen is None or chosen.pixels.shape != (height, width):
        raise FreeArtError(f"{path} has channels {', '.join(channels) or 'none'}, expected one of {width} x {height}")
    return np.asarray(chosen.pixels, np.float32)


def _unpack(data: bytes, size: int, where: Path) -> bytes:
    """`size` bytes, packed by LZFSE or as they are. Raises FreeArtError on any other number, before unpacking."""
    packed = data[:3] == b"bvx"
    claimed = _lzfse_size(data, where) if packed else len(data)
    if claimed != size:
        raise FreeArtError(f"{where} has {claimed} bytes unpacked, expected {size}")
    if not packed:
        return data
    lzfse = import_extra("liblzfse", str(where))
    try:
        raw: bytes = lzfse.decompress(data)
    except (lzfse.error, ValueError, MemoryError) as error:
        raise FreeArtError(f"{where} is not readable LZFSE: {str(error)[:120]}") from error
    if len(raw) != size:
        raise FreeArtError(f"{where} has {len(raw)} bytes unpacked, expected {size}")
    return raw


def _lzfse_size(data: bytes, where: Path) -> int:
    """Bytes that LZFSE blocks say they unpack to (lzfse_internal.h: block headers). Raises FreeArtError."""
    at, size = 0, 0
    try:
        while data[at : at + 4] != b"bvx$":
            kind, raw = struct.unpack_from("<4sI", data, at)
            size += raw
            if kind == b"bvx-":
                at += 8 + raw
            elif kind == b"bvxn":
                at += 12 + struct.unpack_from("<I", data, at + 8)[0]
            elif kind == b"bvx2":
                literals, matches, header = struct.unpack_from("<3Q", data, at + 8)
                at += (header & 0xFFFFFFFF) + (literals >> 20 & 0xFFFFF) + (matches >> 40 & 0xFFFFF)
            else:
                raise FreeArtError(f"{where} is not readable LZFSE: a block of the kind {kind!r}")
            if at + 4 > len(data):
                break
        else:
            return size
    except struct.error:
        pass
    raise FreeArtError(f"{where} is not readable LZFSE: it is cut off")


def _is_record3d(path: Path) -> bool:
    if path.is_file():
        return path.suffix.lower() == ".r3d"
    if not any(checked.is_there(path / name) for name in _METADATA):
        return False
    return (path / "rgbd").is_dir() or ((path / "rgb").is_dir() and any((path / "depth").glob("*.exr")))


LAYOUT = RecordingLayout(
    "record3d", 1, "an .r3d file, or metadata and rgbd/ (or rgb/ and depth/*.exr)", _is_record3d, read_record3d
)
