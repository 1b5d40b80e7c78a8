"""Two surfaces seen from cameras around the object, at several joint states: first hits of the pixels' rays."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from freeart21 import se3
from freeart21.mesh import Mesh
from freeart21.se3 import Array
from freeart21.sphere import fibonacci_sphere
from freeart21.z_buffer import draw_triangles

VIEWS = 24
"""Cameras, evenly spread on a sphere about the object."""
SIDE = 256
"""Pixels along each side of a picture."""
DISTANCE = 3.0
"""Of the cameras from the object's centre, in diagonals."""
FILL = 1.5
"""Width of the picture at that distance, in diagonals: an open object fits, too."""


@dataclass(frozen=True)
class DepthView:
    """What one camera sees of two parts."""

    depth: Array
    """(h, w) z-depth, metres; inf where nothing is hit."""
    part: NDArray[np.int64]
    """(h, w) 0 reference, 1 moving, -1 nothing."""
    face: NDArray[np.int64]
    """(h, w) number of the face within its part, -1 nothing."""


def draw(parts: tuple[Mesh, Mesh], poses: tuple[Array, Array]) -> DepthView:
    """The parts under `poses`, (4, 4) camera from part each, seen by one of `cameras`."""
    depth = np.full((SIDE, SIDE), np.inf)
    part, face = np.full((SIDE, SIDE), -1), np.full((SIDE, SIDE), -1)
    weights = np.empty((SIDE, SIDE, 3))
    focal = SIDE * DISTANCE / FILL
    for k, (mesh, pose) in enumerate(zip(parts, poses, strict=True)):
        points = se3.transform(pose, mesh.vertices)
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
            at = focal * points[:, :2] / points[:, 2:] + SIDE / 2
        before, hit = depth.copy(), np.full((SIDE, SIDE), -1)
        faces = _drawable(mesh, points[:, 2], at)
        draw_triangles(
            at, np.ascontiguousarray(points[:, 2]), np.ascontiguousarray(mesh.faces[faces]), depth, hit, weights
        )
        nearer = depth < before
        part[nearer], face[nearer] = k, faces[hit[nearer]]
    return DepthView(depth, part, face)


def _drawable(mesh: Mesh, depth: Array, at: Array) -> NDArray[np.int64]:
    """Numbers of the faces in front of the camera whose corners have finite pixels."""
    fine = (depth > 0) & np.isfinite(at).all(1) & (np.abs(at).max(1, initial=0.0) < 1e6)
    return np.flatnonzero(fine[mesh.faces].all(1))


def cameras(centre: Array, diagonal: float) -> Array:
    """(VIEWS, 4, 4) camera from object, for cameras that look at the object's point `centre` (3,)."""
    found = []
    for towards in fibonacci_sphere(VIEWS):
        forward = -towards
        side = np.cross(forward, np.eye(3)[int(np.argmin(np.abs(forward)))])
        right = side / np.linalg.norm(side)
        R = np.stack([right, np.cross(forward, right), forward])
        eye = centre + DISTANCE * diagonal * towards
        found.append(se3.pose(R, -R @ eye))
    return np.stack(found)


def frames_of_views(frames: Sequence[int]) -> list[int]:
    """The frame of each view: the `frames` in turn."""
    return [frames[i % len(frames)] for i in range(VIEWS)]
