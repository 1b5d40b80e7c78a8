"""Readers and conversions that adapters share: frames, units, frame numbers, masks, meshes and untrusted files."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial import cKDTree

from freeart21 import se3
from freeart21.errors import FreeArtError
from freeart21.files import checked
from freeart21.files.mesh_file import read_ply
from freeart21.formats.third_party import T_GL_CV, poses_from_rows, read_npy
from freeart21.joint import Joint, JointType
from freeart21.mesh import Mesh, join_meshes
from freeart21.se3 import Array
from freeart21.view.mesh_pieces import read_pieces
from leaderboard.adapters.layout import Axes, Frame, ImportedResult, Request

MASK_THRESHOLD = 0.5
"""Pixels of a soft map above it are the moving part."""
POSE_TOLERANCE = 1e-3
"""Tolerance of rigid poses in files, which are single precision or text of few digits."""
NEIGHBOURS = 8
"""Neighbours that define the plane of a point's triangle."""
SIDE = 2.0
"""Side of the triangles in median distances to the nearest other point."""
LARGEST = 2_000_000
"""Most points of a cloud; the scorer holds 4 million faces."""
_ASPECT = 0.02
"""Largest relative difference between the aspect ratios of a map and its video."""

# ---- frames and units


def cameras_from_world(rows: ArrayLike, where: str, axes: Axes, scale: float) -> Array:
    """T_camera_world (n, 4, 4), OpenCV, of camera poses (n, 4, 4) in the world, whose camera axes are `axes`."""
    Ts = se3.check_poses(where, rows, tolerance=POSE_TOLERANCE)
    Ts = scale_poses(se3.orthonormalised(Ts), scale)
    return np.asarray(se3.inverse(Ts if axes == "opencv" else Ts @ T_GL_CV))


def poses_from_wxyz(rows: ArrayLike, where: str) -> Array:
    """Poses (..., 4, 4) of rows (..., 7): quaternion w, x, y, z of about unit length, then position."""
    rows = np.asarray(rows, float)
    flat = rows.reshape(-1, 7)
    return np.asarray(poses_from_rows(flat[:, [4, 5, 6, 0, 1, 2, 3]], where).reshape(*rows.shape[:-1], 4, 4))


def scale_poses(Ts: Array, scale: float) -> Array:
    """Poses (..., 4, 4) with translations times `scale`."""
    out = np.array(Ts, float)
    out[..., :3, 3] *= scale
    return out


def scale_mesh(mesh: Mesh, scale: float) -> Mesh:
    """`mesh` with vertices times `scale`."""
    return mesh if scale == 1 else replace(mesh, vertices=mesh.vertices * scale)


def unit_vector(axis: ArrayLike, where: str) -> Array:
    """`axis` (3,) scaled to length 1. Raises FreeArtError when it is zero or not three finite numbers."""
    axis = np.asarray(axis, float).reshape(-1)
    length = float(np.linalg.norm(axis)) if axis.shape == (3,) else np.nan
    if not np.isfinite(length) or length < 1e-9:
        raise FreeArtError(f"{where} is {axis.tolist()}, expected three numbers, not all zero")
    return np.asarray(axis / length)


# ---- from the frames of a layout to those of the video


def number_frames(stems: Sequence[str], frames: int, where: str) -> tuple[NDArray[np.int64], bool]:
    """Frame of the video for each file name, and whether the names contain it.

    Names that are numbers from 0 to `frames` - 1 are frame numbers. Other names (time stamps, numbers from 1) are
    counted in their order if there is one per frame. Raises FreeArtError otherwise.
    """
    numbers = [int(stem) for stem in stems if re.fullmatch(r"[0-9]{1,20}", stem)]
    if len(numbers) == len(stems) and len(set(numbers)) < len(numbers):
        raise FreeArtError(f"{where}: two files have the same number, expected one a frame")
    if numbers and len(numbers) == len(stems) and max(numbers) < frames:
        return np.array(numbers, np.int64), True
    if len(stems) == frames:
        keys: Sequence[Any] = numbers if len(numbers) == len(stems) else stems
        return np.argsort(np.argsort(np.array(keys))).astype(np.int64), False
    raise FreeArtError(
        f"{where} has {len(stems)} entries, {min(stems, default='none')} to {max(stems, default='none')}, expected "
        f"numbers from 0 to {frames - 1}, or {frames} entries"
    )


def interpolate_states(states: Array, at: NDArray[np.int64], frames: int) -> Array:
    """(frames,) states, linearly interpolated between those of the frames `at`, constant beyond."""
    order = np.argsort(at)
    return np.asarray(np.interp(np.arange(frames), at[order], states[order]))


def nearest_poses(Ts: Array, at: NDArray[np.int64], frames: int) -> Array:
    """(frames, 4, 4) poses: each frame gets that of the nearest frame in `at`."""
    nearest = np.abs(np.arange(frames)[:, None] - at[None]).argmin(1)
    return np.asarray(Ts[nearest])


def frames_with_result(at: NDArray[np.int64], frames: int) -> tuple[NDArray[np.bool_], tuple[str, ...]]:
    """(frames,) whether each frame is in `at`, and a note when some are not."""
    seen = np.zeros(frames, bool)
    seen[at] = True
    absent = int((~seen).sum())
    note = f"{absent} of {frames} frames have no result: they get the nearest frame's poses"
    return seen, (note,) if absent else ()


def masks_from_maps(moving: NDArray[Any], at: NDArray[np.int64], request: Request, where: str) -> NDArray[np.uint8]:
    """(n, height, width) part masks from soft maps (m, H, W) of the moving part in the frames `at`.

    Values above MASK_THRESHOLD are the moving part, the rest of the video's foreground is the reference part. Maps of
    another size are resized by nearest neighbour. Frames without a map are 0.
    """
    camera = request.recording.camera
    if moving.ndim != 3 or moving.dtype.kind not in "fiub" or len(moving) != len(at):
        raise FreeArtError(f"{where} has shape {moving.shape} {moving.dtype}, expected ({len(at)}, height, width)")
    height, width = moving.shape[1:]
    if min(height, width) < 1 or abs(width * camera.height / (height * camera.width) - 1) > _ASPECT:
        raise FreeArtError(f"{where} is {width} x {height}, expected the shape of {camera.width} x {camera.height}")
    masks = np.zeros((request.frames, camera.height, camera.width), np.uint8)
    for k, i in enumerate(at):
        mask: NDArray[Any] = np.ascontiguousarray(moving[k] > MASK_THRESHOLD, np.uint8)
        if mask.shape != masks.shape[1:]:
            mask = cv2.resize(mask, (camera.width, camera.height), interpolation=cv2.INTER_NEAREST)
        masks[i] = np.where(mask > 0, 2, request.foreground[i])
    return masks


# ---- clouds


def mesh_from_points(points: Array, colours: NDArray[np.uint8] | None = None) -> Mesh:
    """Equilateral triangles of side SIDE median spacings, centred at `points` (n, 3), metres, with `colours` (n, 3).

    A surface that the scorer can measure: no holes are closed and none is fitted. Each triangle lies in the plane of
    the point's neighbours, so that samples of the triangles are samples of the cloud, noise included. Coincident points
    are ignored for the spacing. Raises FreeArtError for too few or too many points.
    """
    points = np.asarray(points, float).reshape(-1, 3)
    if not 4 <= len(points) <= LARGEST:
        raise FreeArtError(f"a cloud has {len(points)} points, expected 4 to {LARGEST}")
    tree = cKDTree(points)
    distances, neighbours = tree.query(points, k=min(NEIGHBOURS + 1, len(points)))
    others = distances[:, 1:]
    nearest = np.where(others > 0, others, np.inf).min(1)
    spacing = float(np.median(nearest[np.isfinite(nearest)])) if np.isfinite(nearest).any() else 0.0
    if spacing <= 0:
        raise FreeArtError("a cloud has all its points in one place")
    centred = points[neighbours] - points[neighbours].mean(1, keepdims=True)
    _, directions = np.linalg.eigh(np.einsum("nki,nkj->nij", centred, centred))
    u, v = directions[:, :, 2], directions[:, :, 1]  # the plane of the two largest spreads
    radius = SIDE * spacing / np.sqrt(3)
    turns = 2 * np.pi * np.arange(3) / 3
    corners = points[:, None] + radius * (
        np.cos(turns)[None, :, None] * u[:, None] + np.sin(turns)[None, :, None] * v[:, None]
    )
    repeated = None if colours is None else np.repeat(colours, 3, 0)
    return Mesh(corners.reshape(-1, 3), np.arange(3 * len(points)).reshape(-1, 3), repeated)


# ---- results without a video


def two_state_result(
    folder: Path,
    request: Request,
    default: Frame,
    joint_type: JointType,
    axis: ArrayLike,
    pivot: Array,
    span: float | tuple[float, float],
    meshes: tuple[Mesh, Mesh] | None,
    notes: tuple[str, ...] = (),
) -> ImportedResult:
    """The result of a method that saw two joint states from many views, not a video: a joint and the parts, no poses.

    It is in a world frame of its own (`default`, unless the user names one), metres, and is placed in one frame of the
    video, the anchor, which must show the first state. Its files do not define the camera's pose in that world.
    `span` is the motion from the first state to the second, rad or m, or the joint's two limits. `meshes` are the parts
    in the first state, which is state zero.
    """
    T_camera_world = request.T_camera_world(folder, default)
    limits = span if isinstance(span, tuple) else (min(0.0, span), max(0.0, span))
    axis = unit_vector(axis, f"{folder}: the joint's axis")
    joint = Joint("joint", joint_type, axis, np.asarray(pivot, float), *limits)
    note = f"it has no poses: it is placed in frame {request.anchor}, assumed to show joint state zero"
    return ImportedResult(joint, anchor=request.anchor, anchor_pose=T_camera_world, meshes=meshes, notes=(note, *notes))


# ---- files


def read_part(path: Path, root: Path, scale: float = 1.0) -> tuple[Mesh, str]:
    """The part in an OBJ or PLY file, and a note if it is a cloud (`mesh_from_points`).

    Materials must lie in the folder `root`. Raises FreeArtError when the file cannot be read or has no point.
    """
    if path.suffix.lower() == ".obj":
        mesh = join_meshes([piece.mesh for piece in read_pieces(path, root)])
    else:
        mesh = read_ply(path, root)[0]
    if mesh.empty and len(mesh.vertices) == 0:
        raise FreeArtError(f"{path} has neither faces nor points")
    mesh = scale_mesh(mesh, scale)
    if mesh.empty:
        return mesh_from_points(mesh.vertices, mesh.colours), f"{path.name} is a cloud of {len(mesh.vertices)} points"
    return mesh, ""


def read_pose_text(path: Path) -> Array:
    """The 4 x 4 pose in a text file of numbers separated by blanks. Raises FreeArtError when it holds none."""
    text = checked.read_text(path, 1 << 16, errors="replace")
    try:
        rows = np.array([[float(word) for word in line.split()] for line in text.splitlines() if line.strip()])
    except ValueError:
        rows = np.zeros(0)
    if rows.shape != (4, 4):
        raise FreeArtError(f"{path} holds no 4 x 4 matrix of numbers")
    return rows


def read_list(path: Path, content: str) -> list[dict[str, Any]]:
    """The JSON list of objects in `path`. Raises FreeArtError when it is not one, or empty; `content` is for that."""
    data = checked.read_any_json(path)
    if not isinstance(data, list) or not data or not all(isinstance(entry, dict) for entry in data):
        raise FreeArtError(f"{path} holds no list of {content}")
    return data


def read_vector(path: Path) -> Array:
    """The vector (3,) in an .npy file of shape (3,) or (1, 3)."""
    try:
        return read_npy(path, (3,))
    except FreeArtError:
        return np.asarray(read_npy(path, (1, 3))[0])


def choose_joint(names: Sequence[str], wanted: str | None, where: str) -> int:
    """Index of the joint: the only one, or the one `wanted` by name or by number from 0."""
    if wanted is None and len(names) == 1:
        return 0
    if wanted is not None and wanted in names:
        return list(names).index(wanted)
    if wanted is not None and wanted.isdigit() and int(wanted) < len(names):
        return int(wanted)
    joints = "no movable joint" if not names else f"the joints {', '.join(names[:20])}"
    raise FreeArtError(f"{where} has {joints}; expected one, or --joint (or 'joint' in the map) to choose one")
