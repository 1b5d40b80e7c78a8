"""Held-out views: poses and states of different frames, seen by a camera that moved a little."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from freeart21 import se3
from freeart21.camera import Camera
from freeart21.joint import Joint
from freeart21.mesh import Mesh
from freeart21.recording import Query
from freeart21.se3 import Array
from generator.motion import Plan, hull_points


@dataclass(frozen=True)
class QuerySettings:
    """How far the camera of a held-out view stands from the recording one."""

    turn_degrees: float = 15.0
    """Largest turn of the camera about the object."""
    shift: float = 0.04
    """Largest translation besides, as a share of the distance to the object."""
    margin: float = 0.02
    """Strip along the picture's border, as a share of its height, that the object never enters."""


@dataclass(frozen=True)
class PlannedQuery:
    """One held-out view, and how to render it."""

    query: Query
    T_camera_object: Array
    """(4, 4) the moved camera from the object's frame."""
    state: float
    """Joint state, rad or m."""


def plan_queries(
    meshes: tuple[Mesh, Mesh],
    joint: Joint,
    camera: Camera,
    plan: Plan,
    n: int,
    seed: int,
    settings: QuerySettings | None = None,
) -> tuple[PlannedQuery, ...]:
    """`n` views of random pose frame and another state frame; the whole object is in each picture.

    A camera move that would cut the object off is drawn again, and shrunk a little each time.
    """
    settings = settings or QuerySettings()
    rng = np.random.default_rng([seed, 3])
    hulls = hull_points(meshes[0]), hull_points(meshes[1])
    views = []
    for _ in range(n):
        a, b = (int(k) for k in rng.choice(len(plan.states), 2, replace=False))
        T_camera_object, q = plan.Ts_camera_object[a], float(plan.states[b])
        points = np.concatenate(
            [se3.transform(T_camera_object, hulls[0]), se3.transform(T_camera_object @ joint.transform(q), hulls[1])]
        )
        centre = se3.transform(T_camera_object, plan.centre)
        size = 1.0
        while True:
            T_newcam_cam = _camera_move(rng, centre, size, settings)
            if size < 1e-3 or _inside(camera, se3.transform(T_newcam_cam, points), settings.margin):
                break
            size *= 0.93
        views.append(PlannedQuery(Query(a, b, T_newcam_cam), T_newcam_cam @ T_camera_object, q))
    return tuple(views)


def _camera_move(rng: np.random.Generator, centre: Array, size: float, settings: QuerySettings) -> Array:
    """A turn about the object's centre and a small translation: up to the settings' amounts times `size`."""
    axis = rng.normal(size=3)
    angle = np.radians(settings.turn_degrees) * size * rng.uniform(0.3, 1.0)
    R = se3.exp_so3(angle * axis / np.linalg.norm(axis))
    shift = size * settings.shift * np.linalg.norm(centre) * rng.uniform(-1, 1, 3)
    return se3.pose(R, centre + shift - R @ centre)


def _inside(camera: Camera, points_camera: Array, margin: float) -> bool:
    uv, strip = camera.project(points_camera), margin * camera.height
    return bool((uv >= strip).all() and (uv <= np.array([camera.width, camera.height]) - strip).all())
