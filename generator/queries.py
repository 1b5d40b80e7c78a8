"""Plans held-out views: pose and joint state from different frames, seen by a camera that moved a little."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from freeart21 import se3
from freeart21.camera import Camera
from freeart21.errors import FreeArtError
from freeart21.joint import Joint
from freeart21.mesh import Mesh
from freeart21.recording import Query
from freeart21.se3 import Array
from generator.motion import hull_points
from generator.motion.framing import MARGIN

TURN_DEGREES = 15.0
"""Largest rotation of the camera of a held-out view about the object."""
SHIFT = 0.04
"""Largest additional translation, as a share of the distance to the object."""


@dataclass(frozen=True)
class PlannedQuery:
    """One held-out view, and how to render it."""

    query: Query
    T_camera_reference: Array
    """(4, 4) the moved camera from the canonical frame, reference part."""
    state: float
    """Joint state, rad or m."""


def plan_queries(
    meshes: tuple[Mesh, Mesh],
    joint: Joint,
    camera: Camera,
    Ts_camera_reference: Array,
    states: Array,
    n: int,
    seed: int,
) -> tuple[PlannedQuery, ...]:
    """Draw `n` views: the reference part as in one random frame, the joint as in another, the camera moved.

    `meshes` are reference and moving part; `joint` moves the second. The whole object is in each picture: a camera
    motion that cuts it off is drawn again, a little smaller each time, and new frames are drawn when none fits. Raises
    FreeArtError when no such view is found.
    """
    rng = np.random.default_rng([seed, 3])
    hulls = hull_points(meshes[0]), hull_points(meshes[1])
    views: list[PlannedQuery] = []
    for _ in range(100 * n):
        if len(views) == n:
            break
        a, b = (int(k) for k in rng.choice(len(states), 2, replace=False))
        T, q = Ts_camera_reference[a], float(states[b])
        points = np.concatenate([se3.transform(T, hulls[0]), se3.transform(T @ joint.transform(q), hulls[1])])
        move = _fitting_move(rng, camera, points)
        if move is not None:
            views.append(PlannedQuery(Query(a, b, move), move @ T, q))
    if len(views) < n:
        raise FreeArtError(f"only {len(views)} of {n} held-out views keep the object in the picture")
    return tuple(views)


def _fitting_move(rng: np.random.Generator, camera: Camera, points: Array) -> Array | None:
    """A camera motion T_newcam_cam (4, 4) that keeps all points (k, 3) in the picture; None when none is found."""
    centre = (points.min(0) + points.max(0)) / 2
    strip, corner = MARGIN * camera.height, np.array([camera.width, camera.height])
    for size in (0.95 ** np.arange(30)).tolist():
        axis = rng.normal(size=3)
        angle = np.radians(TURN_DEGREES) * size * rng.uniform(0.3, 1.0)
        R = se3.exp_so3(angle * axis / np.linalg.norm(axis))
        shift = size * SHIFT * np.linalg.norm(centre) * rng.uniform(-1, 1, 3)
        T_newcam_cam = se3.pose(R, centre + shift - R @ centre)
        uv = camera.project(se3.transform(T_newcam_cam, points))
        if (uv >= strip).all() and (uv <= corner - strip).all():
            return T_newcam_cam
    return None
