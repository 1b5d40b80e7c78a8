"""A folder of the Stray Scanner app (iPhone or iPad with LiDAR).

    rgb.mp4                 colours as the sensor lies: landscape, however the phone was held
    depth/000000.png        or .npy: 16 bits, millimetres, the same view in fewer pixels
    confidence/000000.png   or .npy: 0 low, 1 medium, 2 high
    camera_matrix.csv       3x3 intrinsic matrix of the video
    odometry.csv            timestamp, frame, x, y, z, qx, qy, qz, qw; newer ones also fx, fy, cx, cy, ... per frame

Poses map OpenCV's camera axes to a world whose y points up (StrayVisualizer, stray_visualize.py): by them the pictures
are turned upright. Frame numbers name the files and count the video's frames.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from freeart21 import se3
from freeart21.errors import FreeArtError
from freeart21.files import checked
from freeart21.formats import third_party
from freeart21.formats.rgbd_video import (
    Lens,
    Picture,
    RgbdVideo,
    align_video,
    drop_low_confidence,
    intrinsics,
    read_intrinsics,
)
from freeart21.formats.third_party import (
    MAX_FRAMES,
    ReadOptions,
    RecordingLayout,
    ThirdPartyRecording,
)
from freeart21.formats.video_file import VideoFile, VideoTrack
from freeart21.se3 import Array

_MAX_TABLE_BYTES = 64 << 20
_MAPS = (".png", ".npy")
_POSE, _FOCUS = ("qw", "qx", "qy", "qz"), ("fx", "fy", "cx", "cy")
_LEVEL = 0.5
"""Least share of the upward direction within the picture: above 60 degrees down or up no side of it is above."""


def read_stray_scanner(folder: Path, options: ReadOptions) -> ThirdPartyRecording:
    """The recording in `folder`. Raises FreeArtError in one line."""
    folder = Path(folder)
    table = _read_table(folder / "odometry.csv")
    file = VideoFile(folder / "rgb.mp4", "mp4", folder)
    if not file.titles:
        raise FreeArtError(f"{file.path} has no video track")
    track = VideoTrack(file, next(iter(file.titles.values())))
    depth = third_party.numbered(folder / "depth", _MAPS)
    confidence = third_party.numbered(folder / "confidence", _MAPS) if (folder / "confidence").is_dir() else {}
    number = table["frame"].astype(int)
    rows = [row for row, i in enumerate(number) if i in depth and 0 <= i < len(track)]
    if not rows:
        raise FreeArtError(f"{folder}: no row of odometry.csv has a picture in depth/ and a frame in rgb.mp4")
    focus = np.stack([table.get(name, np.full(len(number), np.nan)) for name in _FOCUS], 1)
    focused = np.isfinite(focus).all(1)

    def load(index: int) -> Picture:
        row, i = rows[index], int(number[rows[index]])
        metres = third_party.depth_metres(_read_map(folder, depth[i]), depth[i])
        if i in confidence:
            metres = drop_low_confidence(metres, _read_map(folder, confidence[i]), str(confidence[i]))
        return Picture(track.read(i, "rgb24"), metres, intrinsics(focus[row]) if focused[row] else None)

    some = focus[rows][focused[rows]]
    K = intrinsics(np.median(some, 0)) if len(some) else read_intrinsics(folder / "camera_matrix.csv")
    left_out = f"{len(number) - len(rows)} of {len(number)} frames have no depth or no colours, and are left out"
    times = table["timestamp"][rows]
    ups = _find_ups(np.stack([table[name] for name in _POSE], 1)[rows])
    video = RgbdVideo(
        third_party.safe_name(folder.resolve().name),
        times - times[0],
        load,
        Lens(K, track.width, track.height),
        turns=_find_turns(ups),
        gravity=-ups,
        folder=folder,
        notes=(left_out,) if len(rows) < len(number) else (),
    )
    return align_video(video, options)


def _read_table(path: Path) -> dict[str, Array]:
    """Column name to (n,) numbers of odometry.csv; empty fields are NaN. Raises FreeArtError."""
    lines = checked.read_text(path, _MAX_TABLE_BYTES).strip().split("\n")
    names = [name.strip() for name in lines[0].split(",")]
    lacking = [name for name in ("timestamp", "frame", *_POSE) if name not in names]
    if lacking:
        raise FreeArtError(f"{path} has no column {', '.join(lacking)}; it has {', '.join(names)[:200]}")
    if not 2 <= len(lines) <= MAX_FRAMES + 1:
        raise FreeArtError(f"{path} has {len(lines) - 1} rows, expected 1 to {MAX_FRAMES}")
    rows = np.full((len(lines) - 1, len(names)), np.nan)
    for i, line in enumerate(lines[1:]):
        words = [word.strip() for word in line.split(",")]
        try:
            rows[i, : len(words)] = [float(word or "nan") for word in words]
        except ValueError:
            raise FreeArtError(f"{path}: row {i + 1} is no row of {len(names)} numbers") from None
    table = dict(zip(names, rows.T, strict=True))
    if not all(np.isfinite(table[name]).all() for name in ("timestamp", "frame", *_POSE)):
        raise FreeArtError(f"{path}: time stamps, frames and rotations are not all finite numbers")
    return table


def _read_map(folder: Path, path: Path) -> NDArray[Any]:
    if path.suffix.lower() == ".npy":
        return checked.read_npy(path, folder)
    return checked.read_image(path, cv2.IMREAD_UNCHANGED, folder)


def _find_ups(wxyz: Array) -> Array:
    """(n, 3) up in camera axes, by (n, 4) rotations from the camera to a world whose y is up."""
    return np.array([se3.rotation_from_wxyz(one / np.linalg.norm(one))[1] for one in wxyz])


def _find_turns(ups: Array) -> int:
    """Clockwise quarter turns that make the pictures upright, by (n, 3) up in camera axes."""
    up = np.median(ups, 0)
    if not np.hypot(up[0], up[1]) >= _LEVEL:
        return 0
    return int(np.rint(np.arctan2(-up[0], -up[1]) / (np.pi / 2))) % 4


LAYOUT = RecordingLayout(
    "stray",
    1,
    "rgb.mp4, depth/, odometry.csv, camera_matrix.csv",
    lambda folder: all(checked.is_there(folder / name) for name in ("rgb.mp4", "depth", "odometry.csv")),
    read_stray_scanner,
)
