"""Folders of tracked object poses, as BundleSDF writes them and FoundationPose, too: one run follows one rigid body.

    ob_in_cam/<frame>.txt    4 x 4, camera (OpenCV) from object, metres; the name is the picture's
    a mesh                   in the object's frame

Two runs, one a part, make an answer; the joint is fitted to them and marked so. One run alone is the reference part's
poses, without joint. Two runs lie in two subfolders of a sequence's folder: `reference/` and `moving/`, or any two with
an ob_in_cam/, of which the first by name is the reference part.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np

from freeart21 import se3
from freeart21.errors import FreeArtError
from freeart21.mesh import Mesh
from freeart21.se3 import Array
from leaderboard.adapters.followed import Followed, found_of
from leaderboard.adapters.toolbox import (
    STRAIGHT,
    Found,
    Request,
    answered,
    frame_numbers,
    read_part,
    read_poses_text,
    scaled,
    spread_poses,
)

MAX_FILES = 100_000


def runs(folder: Path) -> list[Path]:
    """The runs in a sequence's folder: itself, or its subfolders that hold poses, in order."""
    if (folder / "ob_in_cam").is_dir():
        return [folder]
    below = sorted(path for path in folder.iterdir() if (path / "ob_in_cam").is_dir()) if folder.is_dir() else []
    named = [folder / "reference", folder / "moving"]
    return named if set(named) <= set(below) else below


def reader(meshes: tuple[str, ...]) -> Callable[[Path, Request], Found]:
    """A reader of such folders, whose mesh is the first of the names `meshes` that exists."""

    def read(folder: Path, request: Request) -> Found:
        given = runs(folder)
        if len(given) > 2:
            raise FreeArtError(
                f"{folder} holds {len(given)} runs, expected one or two: {', '.join(p.name for p in given)}"
            )
        tracked = [_poses(run / "ob_in_cam", request) for run in given]
        both = sorted(set.intersection(*(set(poses) for poses, _ in tracked)))
        if not both:
            raise FreeArtError(f"{folder}: its two runs have no frame in common")
        at, n = np.array(both), request.frames
        notes = tuple(note for _, said in tracked for note in said)
        surfaces = [_mesh(run, meshes, request) for run in given]
        parts = [
            Followed(np.array([poses[i] for i in both]), mesh, 1.0)
            for (poses, _), mesh in zip(tracked, surfaces, strict=True)
        ]
        if len(parts) == 2:
            return found_of(parts, at, n, notes, first_is_reference=True)
        seen, more = answered(at, n)
        Ts = spread_poses(parts[0].Ts, at, n)
        one = "one run follows one rigid body: there is no joint"
        return Found(None, None, (Ts, Ts), 0, None, None, None, seen, (one, *more, *notes))

    return read


def _poses(folder: Path, request: Request) -> tuple[dict[int, Array], tuple[str, ...]]:
    """Frame of the video to pose, and a note when names do not say the frame."""
    files = sorted(folder.glob("*.txt"))
    if not files or len(files) > MAX_FILES:
        raise FreeArtError(f"{folder} has {len(files)} poses, expected 1 to {MAX_FILES}")
    at, by_name = frame_numbers([path.stem for path in files], request.frames, str(folder))
    Ts = np.array([read_poses_text(path) for path in files])
    Ts = se3.orthonormalised(se3.check_poses(str(folder), Ts, tolerance=STRAIGHT))
    poses = dict(zip(at.tolist(), scaled(Ts, request.options.scale), strict=True))
    note = f"{folder.parent.name}/ob_in_cam: its {len(files)} names are no frame numbers, and count in their order"
    return poses, () if by_name else (note,)


def _mesh(run: Path, names: tuple[str, ...], request: Request) -> Mesh | None:
    paths = [run / name for name in names if (run / name).is_file()]
    return read_part(paths[0], run, request.options.scale)[0] if paths else None
