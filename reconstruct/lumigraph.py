"""Choice and weights of video frames for a place in a new view: the more similarly a frame saw it, the higher.

Lamps stand in the world while the object turns: the look of a place depends on its orientation to the lamps and to the
camera (unstructured lumigraph: Buehler et al. 2001, with the normal as a further coordinate).
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

from freeart21 import se3
from freeart21.reconstruction import Reconstruction
from freeart21.recording import Query
from freeart21.se3 import Array

SAME_NORMAL, SAME_VIEW, SHARPNESS = 0.01, 0.02, 2.0
"""1 - cosine between normals, and between views, that halves the base of a frame's weight; power of the base."""
FACING = 0.1
"""Cosine between normal and view up to which a frame does not see a place."""


def query_poses(result: Reconstruction, query: Query, by_moving_part: bool) -> tuple[Array, Array]:
    """Poses (4, 4) of both parts in the new camera: the state of one frame, the pose of one part in another.

    That part is the result's reference part, or its moving part with `by_moving_part`.
    """
    J = result.articulation.joint.transform(float(result.states[query.state_of_frame]))
    if by_moving_part:
        T = query.T_newcam_cam @ result.Ts_camera_moving[query.pose_of_frame]
        return T @ se3.inverse(J), T
    T = query.T_newcam_cam @ result.Ts_camera_reference[query.pose_of_frame]
    return T, T @ J


def object_box(result: Reconstruction) -> tuple[slice, slice]:
    """Rows and columns of the image where the object is in any frame; the first pixel when it is nowhere."""
    anywhere: NDArray[np.bool_] = result.part_masks.max(0) > 0
    rows, columns = np.flatnonzero(anywhere.any(1)), np.flatnonzero(anywhere.any(0))
    if not len(rows):
        return slice(0, 1), slice(0, 1)
    return slice(int(rows[0]), int(rows[-1]) + 1), slice(int(columns[0]), int(columns[-1]) + 1)


def choose_frames(
    Ts: Array, seen: NDArray[np.bool_], T_camera_part: Array, similar: int, evenly: int
) -> NDArray[np.int64]:
    """Of the frames `seen` (n,) some with the most similar orientation `Ts` (n, 4, 4), and some evenly spaced."""
    frames = np.flatnonzero(seen)
    if len(frames) <= similar + evenly:
        return frames
    turn = se3.rotation_angle(Ts[frames, :3, :3] @ T_camera_part[:3, :3].T)
    nearest = frames[np.argsort(turn, kind="stable")[:similar]]
    return np.union1d(nearest, frames[np.linspace(0, len(frames) - 1, evenly).round().astype(int)])


@njit(nogil=True, cache=True)
def view_similarity_weight(
    T: Array, point: Array, normal: Array, lit: Array, view: Array, fx: float, fy: float, cx: float, cy: float,
) -> tuple[float, float, float, float, float]:  # pragma: no cover  # fmt: skip
    """Weight, column, row and depth, metres, of a place in a frame, and the change of depth from pixel to pixel.

    T (4, 4) is the camera from its part. The weight is 0 where the place faces away or lies behind the camera. `point`,
    `normal` and `view`, the direction to the new camera, are in the part's frame; `lit` is the normal in the recording
    camera's frame, in which the lamps stand.
    """
    x, y, z = point[0], point[1], point[2]
    px = T[0, 0] * x + T[0, 1] * y + T[0, 2] * z + T[0, 3]
    py = T[1, 0] * x + T[1, 1] * y + T[1, 2] * z + T[1, 3]
    pz = T[2, 0] * x + T[2, 1] * y + T[2, 2] * z + T[2, 3]
    if pz <= 0:
        return 0.0, 0.0, 0.0, 0.0, 0.0
    x, y, z = normal[0], normal[1], normal[2]
    nx = T[0, 0] * x + T[0, 1] * y + T[0, 2] * z
    ny = T[1, 0] * x + T[1, 1] * y + T[1, 2] * z
    nz = T[2, 0] * x + T[2, 1] * y + T[2, 2] * z
    length = math.sqrt(px * px + py * py + pz * pz)
    facing = -(nx * px + ny * py + nz * pz) / length
    if facing < FACING:
        return 0.0, 0.0, 0.0, 0.0, 0.0
    shade = 1 - (nx * lit[0] + ny * lit[1] + nz * lit[2])
    away = 1.0
    for d in range(3):
        away += (T[0, d] * px + T[1, d] * py + T[2, d] * pz) / length * view[d]
    weight = facing * facing / (1 + shade / SAME_NORMAL + away / SAME_VIEW) ** SHARPNESS
    slope = (pz / fx) * math.sqrt(max(0.0, 1 - facing * facing)) / facing
    return weight, fx * px / pz + cx, fy * py / pz + cy, pz, slope
