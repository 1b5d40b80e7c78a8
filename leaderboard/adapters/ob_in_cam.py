"""Folders of tracked object poses, as written by BundleSDF and FoundationPose: one run tracks one rigid body.

    ob_in_cam/<frame>.txt    4 x 4, camera (OpenCV) from object, metres; the name is the picture's
    a mesh                   in the object's frame

Two runs, one per part, make an answer with a fitted joint. One run alone gives the reference part's poses without a
joint. Two runs lie in two subfolders of a sequence's folder: `reference/` and `moving/`, or any two with an ob_in_cam/,
the first by name being the reference part.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np

from freeart21 import se3
from freeart21.errors import FreeArtError
from freeart21.mesh import Mesh
from freeart21.se3 import Array
from leaderboard.adapters import readers
from leaderboard.adapters.layout import ImportedResult, Request
from leaderboard.adapters.tracked_parts import TrackedPart, fit_tracked_parts

MAX_FILES = 100_000


def list_runs(folder: Path) -> list[Path]:
    """The runs in a sequence's folder: itself, or its subfolders with poses, in order."""
    if (folder / "ob_in_cam").is_dir():
        return [folder]
    below = sorted(path for path in folder.iterdir() if (path / "ob_in_cam").is_dir()) if folder.is_dir() else []
    named = [folder / "reference", folder / "moving"]
    return named if set(named) <= set(below) else below


def make_reader(meshes: tuple[str, ...]) -> Callable[[Path, Request], ImportedResult]:
    """A reader of such folders; the mesh is the first existing file of `meshes`."""

    def read(folder: Path, request: Request) -> ImportedResult:
        runs = list_runs(folder)
        if len(runs) > 2:
            names = ", ".join(run.name for run in runs)
            raise FreeArtError(f"{folder} holds {len(runs)} runs, expected one or two: {names}")
        tracks = [_read_poses(run / "ob_in_cam", request) for run in runs]
        common = sorted(set.intersection(*(set(poses) for poses, _ in tracks)))
        if not common:
            raise FreeArtError(f"{folder}: its two runs have no frame in common")
        at, n = np.array(common), request.frames
        notes = tuple(note for _, notes in tracks for note in notes)
        surfaces = [_read_mesh(run, meshes, request) for run in runs]
        parts = [
            TrackedPart(np.array([poses[i] for i in common]), mesh, 1.0)
            for (poses, _), mesh in zip(tracks, surfaces, strict=True)
        ]
        if len(parts) == 2:
            return fit_tracked_parts(parts, at, n, notes, first_is_reference=True)
        seen, more = readers.frames_with_result(at, n)
        Ts = readers.nearest_poses(parts[0].Ts, at, n)
        note = "one run tracks one rigid body: there is no joint"
        return ImportedResult(None, poses=(Ts, Ts), seen=seen, notes=(note, *more, *notes))

    return read


def _read_poses(folder: Path, request: Request) -> tuple[dict[int, Array], tuple[str, ...]]:
    """Frame of the video to pose, and a note when the file names are not frame numbers."""
    files = sorted(folder.glob("*.txt"))
    if not files or len(files) > MAX_FILES:
        raise FreeArtError(f"{folder} has {len(files)} poses, expected 1 to {MAX_FILES}")
    at, by_name = readers.number_frames([path.stem for path in files], request.frames, str(folder))
    Ts = np.array([readers.read_pose_text(path) for path in files])
    Ts = se3.orthonormalised(se3.check_poses(str(folder), Ts, tolerance=readers.POSE_TOLERANCE))
    poses = dict(zip(at.tolist(), readers.scale_poses(Ts, request.options.scale), strict=True))
    note = f"{folder.parent.name}/ob_in_cam: its {len(files)} names are not frame numbers and count in their order"
    return poses, () if by_name else (note,)


def _read_mesh(run: Path, names: tuple[str, ...], request: Request) -> Mesh | None:
    paths = [run / name for name in names if (run / name).is_file()]
    return readers.read_part(paths[0], run, request.options.scale)[0] if paths else None
