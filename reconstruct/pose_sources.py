"""Poses of the parts that another program found: initial guesses beside our own; the video's cost decides.

`bundlesdf:FOLDER` has those that BundleSDF (Wen et al., CVPR 2023) left, a run a part:

    FOLDER/ob_in_cam/ID.txt           of one part
    FOLDER/RUN/ob_in_cam/ID.txt       of one or two parts: every subfolder that has an ob_in_cam

Read in NVlabs/BundleSDF at cf0610e (BundleTrack/src/Bundler.cpp, run_custom.py, readme.md): a file holds the 4 x 4
matrix that maps points of the object to the camera (x right, y down, z forward), metres, a file a frame, named as the
frame's picture. ID is the number of the frame, from 0, as in the pictures of our sequences. A run with `--stride`
leaves frames out.
"""

from __future__ import annotations

import hashlib
from pathlib import Path

import numpy as np

from freeart21.errors import FreeArtError
from freeart21.files import checked
from freeart21.se3 import Array, check_poses, orthonormalised
from reconstruct.scene import Scene

SOURCE = "bundlesdf"
MAX_BYTES = 4096
FOLDER = "ob_in_cam"
ROUNDING = 1e-3
"""Departure of R R^T from the identity: single floats, after many compositions."""
MOST_RUNS, LEAST_FRAMES = 2, 2
FARTHEST = 1.0
"""Object diagonals between the body's origin and the middle of the object's points, in the median frame: BundleSDF puts
the origin into the middle of its first points. Millimetres, or object from camera, lie farther."""


def find_poses(scene: Scene, given: str) -> Array:
    """(b, n, 4, 4) camera from body, metres, of b bodies in n frames, `given` as SOURCE:FOLDER; NaN where unknown. None
    of an empty `given`.

    Each body is one of the parts, which one need not be known. Its own frame is any. Raises FreeArtError.
    """
    runs = _find_runs(given)
    return np.stack([_read_run(run, scene) for run in runs]) if runs else np.zeros((0, len(scene), 4, 4))


def digest_poses(given: str) -> str:
    """SHA-256, hexadecimal, of the files that the poses come from; empty without such."""
    runs, digest = _find_runs(given), hashlib.sha256()
    for run in runs:
        for path in _pose_files(run):
            digest.update(f"{run.name} {path.name} ".encode())
            digest.update(checked.read_bytes(path, MAX_BYTES, run))
    return digest.hexdigest() if runs else ""


def _find_runs(given: str) -> list[Path]:
    """The folders of the source's runs; FreeArtError names the known source."""
    source, _, name = given.partition(":")
    if not given:
        return []
    if source != SOURCE:
        raise FreeArtError(f"unknown source of poses '{source}'; sources: {SOURCE}")
    folder = Path(name)
    below = sorted(path for path in folder.iterdir()) if name and folder.is_dir() else []
    runs = [run for run in (folder, *below) if (run / FOLDER).is_dir()] if below else []
    if not 1 <= len(runs) <= MOST_RUNS:
        raise FreeArtError(f"'{name}' holds {len(runs)} runs of BundleSDF, expected 1 or 2: {folder}/{FOLDER}")
    return runs


def _pose_files(run: Path) -> list[Path]:
    return sorted((run / FOLDER).glob("*.txt"))


def _read_run(run: Path, scene: Scene) -> Array:
    """(n, 4, 4) camera from body, NaN where there is none; FreeArtError when the poses are not of this video."""
    n, found = len(scene), {}
    for path in _pose_files(run):
        if not path.stem.isdecimal() or int(path.stem) >= n:
            raise FreeArtError(f"{path} is of no frame of the video, expected numbers from 0 to {n - 1}")
        found[int(path.stem)] = _read_pose(path, run)
    if len(found) < LEAST_FRAMES:
        raise FreeArtError(f"{run / FOLDER} has {len(found)} poses, expected at least {LEAST_FRAMES}")
    Ts = np.full((n, 4, 4), np.nan)
    Ts[list(found)] = list(found.values())
    off = [
        np.linalg.norm(Ts[i, :3, 3] - scene.points[i][scene.valid[i]].mean(0)) for i in found if scene.valid[i].any()
    ]
    if off and np.median(off) > FARTHEST * scene.diagonal:
        raise FreeArtError(
            f"{run}: the body lies {np.median(off):.3g} m off the object, which measures {scene.diagonal:.3g} m: "
            "expected metres, and matrices that map points of the object to the camera"
        )
    return Ts


def _read_pose(path: Path, folder: Path) -> Array:
    text = checked.read_text(path, MAX_BYTES, folder)
    try:
        T = np.array([float(word) for word in text.split()]).reshape(4, 4)
    except ValueError:
        raise FreeArtError(f"{path} holds no matrix of 4 rows and 4 columns") from None
    return orthonormalised(check_poses(str(path), T, ROUNDING))
