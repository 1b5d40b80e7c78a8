"""Reads takes, ours or third-party motion capture; the layout is recognised by content.

ARCTIC's object tracks (Fan et al., CVPR 2023) are arrays (n, 7) at 30 Hz: the joint state (rad), the object's
rotation vector in the world (rad), its position (mm). The world's z points up; a level camera is assumed.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from freeart21 import se3
from freeart21.errors import FreeArtError
from freeart21.files import checked
from freeart21.files.hashes import file_sha256
from freeart21.files.take import MAX_SAMPLES, MAX_TAKE_BYTES, Take, read_take

ARCTIC_HZ = 30.0
ARCTIC_FORM = "ARCTIC object track"
ARCTIC_SIZES_M = (0.24, 0.39)
"""Range of bounding box diagonals of the objects: ketchup bottle .24, mixer .32, laptop .39; the other eight are
unknown. A track does not name its object."""
_NUMPY = b"\x93NUMPY"
_LEVEL = np.array([[0.0, -1, 0], [0, 0, -1], [1, 0, 0]])
"""Rotation from the world to a level camera that looks along the world's x."""


def read_track(path: Path) -> Take:
    """The take in `path`: ours (`freeart21.files.take`), or a track of ARCTIC. Raises FreeArtError in one line."""
    head = checked.read_head(path, 1 << 10, checked.ANYWHERE)
    if head.startswith(_NUMPY):
        return _arctic(path)
    if head.lstrip()[:1] != b"{":
        raise FreeArtError(f"{path} is no take: expected lines of JSON (freeart21/take/1) or a NumPy array of ARCTIC")
    return read_take(path)


def _arctic(path: Path) -> Take:
    given = checked.read_npy(path, checked.ANYWHERE, MAX_TAKE_BYTES)
    if given.ndim != 2 or given.shape[1] != 7 or given.dtype.kind != "f" or not 2 <= len(given) <= MAX_SAMPLES:
        raise FreeArtError(
            f"{path} has shape {given.shape} {given.dtype}, expected (2 to {MAX_SAMPLES}, 7) of floating point"
        )
    rows = np.array(given, float)
    if not np.isfinite(rows).all():
        raise FreeArtError(f"{path} has entries that are not finite, the first in row {_first_odd(rows)}")
    Ts_world = se3.pose(se3.exp_so3(rows[:, 1:4]), 1e-3 * rows[:, 4:])
    return Take(
        path.name,
        file_sha256(path, checked.ANYWHERE),
        ARCTIC_FORM,
        "motion capture",
        "first",
        "revolute",
        np.arange(len(rows)) / ARCTIC_HZ,
        se3.pose(_LEVEL, np.zeros(3)) @ Ts_world,
        rows[:, 0],
    )


def _first_odd(rows: np.ndarray) -> int:
    return int(np.flatnonzero(~np.isfinite(rows).all(1))[0])
