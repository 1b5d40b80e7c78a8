"""BundleSDF and FoundationPose: folders of tracked object poses; one run tracks one rigid body.

    ob_in_cam/<frame>.txt    4 x 4, camera (OpenCV) from object, metres; the name is the picture's
    a mesh                   in the object's frame

Two runs, one per part, make an answer with a joint of `freeart21.joint_fit`, which a note says. One run alone gives the
reference part's poses without a joint. Two runs lie in two subfolders of a sequence's folder: `reference/` and
`moving/`, or any two with an ob_in_cam/, the first by name being the reference part.

BundleSDF, the output folder of run_custom.py, read in NVlabs/BundleSDF@cf0610e3636bc42535c996f129161f44beeadc56:
BundleTrack/src/Bundler.cpp (saveNewframeResult: the object's pose in the camera, ten digits), bundlesdf.py
(textured_mesh.obj is in the object's frame, in metres; mesh_cleaned.obj is in normalised space and is not read),
offscreen_renderer.py (OpenCV camera), run_custom.py (names are those of the pictures).

FoundationPose, the debug folder of run_demo.py, read in
NVlabs/FoundationPose@bf2518348eb2ef8f1fdf786b79ed698db02e8703: run_demo.py (np.savetxt of the pose, camera from the
given mesh; names are those of the pictures), Utils.py (OpenCV camera). Its model_tf.obj is in the camera frame of the
first picture and is not read: copy the mesh that was given to it, in metres, into the folder of ob_in_cam/ as mesh.obj
or mesh.ply. Its results on LINEMOD and YCB-Video (*_res.yml) are not read.
"""

from __future__ import annotations

from functools import partial
from pathlib import Path

import numpy as np

from freeart21 import se3
from freeart21.errors import FreeArtError
from freeart21.joint_fit import fit_joint
from freeart21.mesh import Mesh, box_centre
from freeart21.se3 import Array
from leaderboard.adapters import readers
from leaderboard.adapters.layout import ImportedResult, Layout, Request

MAX_FILES = 100_000
_DEFAULT_SIZE = 0.1
"""Metres; size of a part without a surface, for weighing rotations against translations."""


def _list_runs(folder: Path) -> list[Path]:
    """The runs in a sequence's folder: itself, or its subfolders with poses, in order."""
    if (folder / "ob_in_cam").is_dir():
        return [folder]
    below = sorted(path for path in folder.iterdir() if (path / "ob_in_cam").is_dir()) if folder.is_dir() else []
    named = [folder / "reference", folder / "moving"]
    return named if set(named) <= set(below) else below


def _read(mesh_names: tuple[str, ...], folder: Path, request: Request) -> ImportedResult:
    """The result in `folder`; the mesh of a run is the first existing file of `mesh_names`."""
    runs = _list_runs(folder)
    if len(runs) > 2:
        names = ", ".join(run.name for run in runs)
        raise FreeArtError(f"{folder} holds {len(runs)} runs, expected one or two: {names}")
    tracks = [_read_poses(run / "ob_in_cam", request) for run in runs]
    common = sorted(set.intersection(*(set(poses) for poses, _ in tracks)))
    if not common:
        raise FreeArtError(f"{folder}: its two runs have no frame in common")
    at, n = np.array(common), request.frames
    notes = tuple(note for _, notes in tracks for note in notes)
    Ts = [np.array([poses[i] for i in common]) for poses, _ in tracks]
    seen, absent = readers.frames_with_result(at, n)
    reference = readers.nearest_poses(Ts[0], at, n)
    if len(runs) == 1:
        note = "one run tracks one rigid body: there is no joint"
        return ImportedResult(None, poses=(reference, reference), seen=seen, notes=(note, *absent, *notes))
    base, moving = (_read_mesh(run, mesh_names, request) for run in runs)
    centre = np.zeros(3) if moving is None else box_centre(moving)
    size = _DEFAULT_SIZE if moving is None else float(np.linalg.norm(np.ptp(moving.vertices, axis=0)))
    fit, other = fit_joint(se3.inverse(Ts[0]) @ Ts[1], centre, size / 2)
    note = "the joint is not the method's: it was fitted to the poses of its parts by the import "
    note += f"({fit.type}, {1000 * fit.residual:.2g} mm off in the median frame; the other type "
    note += f"{1000 * other.residual:.2g} mm)"
    carried = readers.nearest_poses(Ts[1] @ se3.inverse(fit.T_zero), at, n)
    meshes = None if base is None or moving is None else (base, moving.moved(fit.T_zero))
    states = readers.interpolate_states(fit.states, at, n)
    notes = (note, *absent, *notes)
    return ImportedResult(fit.joint(), states, (reference, carried), meshes=meshes, seen=seen, notes=notes)


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


BUNDLESDF = Layout(
    "bundlesdf",
    "BundleSDF, https://github.com/NVlabs/BundleSDF",
    "NVlabs/BundleSDF@cf0610e3636bc42535c996f129161f44beeadc56:BundleTrack/src/Bundler.cpp, bundlesdf.py",
    lambda folder: bool(_list_runs(folder)),
    partial(_read, ("textured_mesh.obj",)),
)
FOUNDATIONPOSE = Layout(
    "foundationpose",
    "FoundationPose, https://github.com/NVlabs/FoundationPose",
    "NVlabs/FoundationPose@bf2518348eb2ef8f1fdf786b79ed698db02e8703:run_demo.py",
    lambda folder: bool(_list_runs(folder)),
    partial(_read, ("mesh.obj", "mesh.ply", "textured_mesh.obj")),
)
