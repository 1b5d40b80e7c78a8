"""A sequence of the TUM RGB-D benchmark, or one recorded in its layout.

    rgb.txt, depth.txt     the lists of pictures, by which the folder is recognised
    rgb/, depth/           TIMESTAMP.png; depth has 16 bits, 5000 units a metre
    cam_K.txt              3x3 intrinsic matrix, where the folder's name has no freiburg1, 2 or 3

The cameras are those of the benchmark's page (vision.in.tum.de/data/datasets/rgbd-dataset/file_formats), with their
distortion.
"""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import numpy as np

from freeart21.errors import FreeArtError
from freeart21.files import checked
from freeart21.formats.rgbd_folder import has_pictures, read_rgbd_folder
from freeart21.formats.rgbd_video import Lens, intrinsics, read_intrinsics
from freeart21.formats.third_party import ReadOptions, RecordingLayout, ThirdPartyRecording

DEPTH_UNIT = 1 / 5000
_SIZE = (640, 480)
_CAMERAS = {
    "1": ((517.3, 516.5, 318.6, 255.3), (0.2624, -0.9531, -0.0054, 0.0026, 1.1633)),
    "2": ((520.9, 521.0, 325.1, 249.7), (0.2312, -0.7849, -0.0033, -0.0001, 0.9172)),
    "3": ((535.4, 539.2, 320.1, 247.6), (0.0, 0.0, 0.0, 0.0, 0.0)),
}


def read_tum(folder: Path, options: ReadOptions) -> ThirdPartyRecording:
    """The recording in `folder`. Raises FreeArtError in one line."""
    return read_rgbd_folder(folder, replace(options, depth_unit=DEPTH_UNIT), _find_lens)


def _find_lens(folder: Path, width: int, height: int) -> Lens:
    named = re.search(r"freiburg([123])", folder.resolve().name)
    if checked.is_there(folder / "cam_K.txt"):
        return Lens(read_intrinsics(folder / "cam_K.txt"), width, height)
    if named is None or (width, height) != _SIZE:
        raise FreeArtError(
            f"{folder} has no cam_K.txt, and is no freiburg1, 2 or 3 of 640 x 480: its intrinsic matrix is unknown"
        )
    focus, distortion = _CAMERAS[named[1]]
    return Lens(intrinsics(focus), width, height, np.array(distortion))


LAYOUT = RecordingLayout(
    "tum",
    0,
    "rgb.txt, depth.txt, rgb/, depth/",
    lambda folder: has_pictures(folder) and all(checked.is_there(folder / f"{k}.txt") for k in ("rgb", "depth")),
    read_tum,
)
