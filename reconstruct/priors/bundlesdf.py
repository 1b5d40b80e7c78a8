"""BundleSDF's poses (Wen et al., CVPR 2023), from the folder that a run of it leaves.

Read in NVlabs/BundleSDF at cf0610e (BundleTrack/src/Bundler.cpp, run_custom.py, readme.md): `ob_in_cam/ID.txt` holds
the 4 x 4 matrix that maps points of the object to the camera (x right, y down, z forward), metres, a file a frame,
named as the frame's picture; a run with `--stride` leaves frames out.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from freeart21.errors import FreeArtError
from freeart21.files import checked
from freeart21.se3 import Array, check_poses, orthonormalised

MAX_BYTES = 4096
FOLDER = "ob_in_cam"
ROUNDING = 1e-3
"""Departure of R R^T from the identity: single floats, after many compositions."""


def read_poses(folder: Path, names: list[str]) -> Array:
    """(n, 4, 4) camera from object in the frames of these picture names (without ending); NaN where there is none.

    Raises FreeArtError when no frame has a pose, and on a file that holds no pose.
    """
    poses = np.full((len(names), 4, 4), np.nan)
    place = Path(folder) / FOLDER
    for i, name in enumerate(names):
        path = place / f"{name}.txt"
        if checked.is_there(path):
            poses[i] = _read_pose(path, folder)
    if not np.isfinite(poses).any():
        raise FreeArtError(f"{place} has a pose of none of {len(names)} frames, expected {names[0]}.txt and so on")
    return poses


def _read_pose(path: Path, folder: Path) -> Array:
    text = checked.read_text(path, MAX_BYTES, folder)
    try:
        T = np.array([float(word) for word in text.split()]).reshape(4, 4)
    except ValueError:
        raise FreeArtError(f"{path} holds no matrix of 4 rows and 4 columns") from None
    return orthonormalised(check_poses(str(path), T, ROUNDING))
