"""The moved object: two sides, the joint between them, and their bounds."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial import ConvexHull, QhullError

from freeart21 import se3
from freeart21.joint import Joint
from freeart21.mesh import Mesh
from freeart21.se3 import Array

UPRIGHT: Array = np.array([[0.0, -1, 0], [0, 0, -1], [1, 0, 0]])
"""Rotation camera from object for a level view along +x with z up: the front of a PartNet-Mobility object."""

_STATES = 9


@dataclass(frozen=True)
class Body:
    """An object in its own frame, z up. Made by `Body.of`."""

    meshes: tuple[Mesh, Mesh]
    """Parent and child side at joint state zero."""
    joint: Joint
    """Moves the child side."""
    lower: float
    upper: float
    """Range of the states, rad or m."""
    hulls: tuple[Array, Array]
    """Points (k, 3) that bound each side."""
    centre: Array
    """(3,) centre of the box round the object at all states."""
    radius: float
    """Metres from the centre to the furthest point at any state."""

    @classmethod
    def of(cls, meshes: tuple[Mesh, Mesh], joint: Joint) -> Body:
        """The body of two sides and their joint."""
        lower, upper = motion_range(joint)
        hulls = hull_points(meshes[0]), hull_points(meshes[1])
        swept = [hulls[0], *(se3.transform(joint.transform(q), hulls[1]) for q in np.linspace(lower, upper, _STATES))]
        points = np.concatenate(swept)
        centre = (points.min(0) + points.max(0)) / 2
        return cls(
            meshes, joint, lower, upper, hulls, centre, float(np.linalg.norm(points - centre, axis=1).max() * 1.001)
        )

    def points(self, states: Array) -> Array:
        """(n, k, 3) bounding points of both sides at `states` (n,)."""
        moved = se3.transform(self.joint.transform(states), self.hulls[1])
        still = np.broadcast_to(self.hulls[0], (len(states), *self.hulls[0].shape))
        return np.concatenate([still, moved], axis=1)

    def centres(self, states: Array) -> Array:
        """(n, 3) centre of the box round the object at `states` (n,)."""
        points = self.points(states)
        return np.asarray((points.min(1) + points.max(1)) / 2)

    def state(self, share: Array | float) -> Array:
        """The state at a share, 0 to 1, of the range."""
        return self.lower + (self.upper - self.lower) * np.asarray(share, float)


def motion_range(joint: Joint) -> tuple[float, float]:
    """Range of the states: the limits, or half a turn (one metre) to either side where there is none."""
    free = np.pi if joint.type == "revolute" else 1.0
    return (
        joint.lower if np.isfinite(joint.lower) else min(-free, joint.upper - 2 * free),
        joint.upper if np.isfinite(joint.upper) else max(free, joint.lower + 2 * free),
    )


def hull_points(mesh: Mesh) -> Array:
    """Vertices of the convex hull of a mesh; they bound it in every view."""
    points = mesh.vertices[np.unique(mesh.faces)]
    try:
        return np.asarray(points[ConvexHull(points).vertices])
    except QhullError:  # a flat part has no hull of its own
        return points
