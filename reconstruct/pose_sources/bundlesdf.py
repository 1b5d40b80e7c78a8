"""The source `bundlesdf`: the poses that BundleSDF left, a run a part (see `reconstruct.priors.bundlesdf`).

    FOLDER/ob_in_cam/ID.txt           of one part
    FOLDER/RUN/ob_in_cam/ID.txt       of one or two parts: every subfolder that has an ob_in_cam

ID is the number of the frame, from 0, as in the pictures of our sequences.
"""

from __future__ import annotations

import hashlib
from pathlib import Path

import numpy as np

from freeart21.errors import FreeArtError
from freeart21.files import checked
from freeart21.se3 import Array
from reconstruct.pose_sources.base import PoseSource
from reconstruct.priors import bundlesdf
from reconstruct.scene import Scene

MOST_RUNS, LEAST_FRAMES = 2, 2
FARTHEST = 1.0
"""Object diagonals between the body's origin and the middle of the object's points, in the median frame: BundleSDF puts
the origin into the middle of its first points. Millimetres, or object from camera, lie farther."""


class BundleSdf(PoseSource):
    """Results of one run, or of one for each part."""

    name = "bundlesdf"

    def poses(self, scene: Scene) -> Array:
        """See `PoseSource`."""
        return np.stack([_read_run(run, scene) for run in self._runs()])

    def digest(self) -> str:
        """See `PoseSource`."""
        digest = hashlib.sha256()
        for run in self._runs():
            for path in _pose_files(run):
                digest.update(f"{run.name} {path.name} ".encode())
                digest.update(checked.read_bytes(path, bundlesdf.MAX_BYTES, run))
        return digest.hexdigest()

    def _runs(self) -> list[Path]:
        folder = Path(self.settings.folder)
        below = sorted(path for path in folder.iterdir()) if self.settings.folder and folder.is_dir() else []
        runs = [run for run in (folder, *below) if (run / bundlesdf.FOLDER).is_dir()] if below else []
        if not 1 <= len(runs) <= MOST_RUNS:
            place = f"{folder}/{bundlesdf.FOLDER}"
            raise FreeArtError(
                f"'{self.settings.folder}' holds {len(runs)} runs of BundleSDF, expected 1 or 2: {place}"
            )
        return runs


def _pose_files(run: Path) -> list[Path]:
    return sorted((run / bundlesdf.FOLDER).glob("*.txt"))


def _read_run(run: Path, scene: Scene) -> Array:
    """(n, 4, 4) camera from body, NaN where there is none; FreeArtError when the poses are not of this video."""
    n, names = len(scene), {}
    for path in _pose_files(run):
        if not path.stem.isdecimal() or int(path.stem) >= n:
            raise FreeArtError(f"{path} is of no frame of the video, expected numbers from 0 to {n - 1}")
        names[int(path.stem)] = path.stem
    if len(names) < LEAST_FRAMES:
        raise FreeArtError(f"{run / bundlesdf.FOLDER} has {len(names)} poses, expected at least {LEAST_FRAMES}")
    Ts = bundlesdf.read_poses(run, [names.get(i, "none") for i in range(n)])
    off = [
        np.linalg.norm(Ts[i, :3, 3] - scene.points[i][scene.valid[i]].mean(0)) for i in names if scene.valid[i].any()
    ]
    if off and np.median(off) > FARTHEST * scene.diagonal:
        raise FreeArtError(
            f"{run}: the body lies {np.median(off):.3g} m off the object, which measures {scene.diagonal:.3g} m: "
            "expected metres, and matrices that map points of the object to the camera"
        )
    return Ts
