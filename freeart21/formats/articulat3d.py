"""A sequence in the layout of Articulat3D (ECCV 2026).

images/            the colours
depth/             16 bits, 6553.5 units a metre: ten metres are the largest value
masks/             the object
intrinsics.json    3x3 intrinsic matrix, a list of rows
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from freeart21.files import checked
from freeart21.formats.rgbd_folder import has_pictures, read_rgbd_folder
from freeart21.formats.rgbd_video import HALF_PIXEL, Lens
from freeart21.formats.third_party import ReadOptions, RecordingLayout, ThirdPartyRecording

DEPTH_UNIT = 1 / 6553.5


def read_articulat3d(folder: Path, options: ReadOptions) -> ThirdPartyRecording:
    """The recording in `folder`. Raises FreeArtError in one line."""
    return read_rgbd_folder(folder, replace(options, depth_unit=DEPTH_UNIT), _read_lens)


def _read_lens(folder: Path, width: int, height: int) -> Lens:
    path = folder / "intrinsics.json"
    K = checked.numbers({"matrix": checked.read_any_json(path)}, "matrix", (3, 3), path)
    return Lens(K + HALF_PIXEL, width, height)


LAYOUT = RecordingLayout(
    "articulat3d",
    1,
    "images/, depth/, intrinsics.json",
    lambda folder: checked.is_there(folder / "intrinsics.json") and has_pictures(folder),
    read_articulat3d,
)
