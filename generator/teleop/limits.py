"""Where an object may be before the camera, and where it begins."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial import ConvexHull, QhullError

from freeart21 import se3
from freeart21.camera import Camera
from freeart21.se3 import Array
from generator.motion.body import UPRIGHT, Body
from generator.motion.framing import MARGIN

FILL = 0.6
"""Height of the object in the picture when it begins, as a share of the picture's: about that of the recorder's motions
(0.65 in the mean), with room to move."""
NEAREST_M = 0.25
"""From the camera to the ball round the object, metres, or the ball's radius if that is less: nearer, small things would
not fill the picture, and nearer still they leave it."""
FARTHEST = 6.0
"""Distances of the beginning, up to which the object may go: it is a sixth as large there."""
_DIRECTIONS = 300
"""In which the body's outermost points are looked for: neighbours are 0.2 rad apart, so that of a ball 0.5 % of its
radius is missed, less than the strip along the border (`MARGIN`)."""
_TILT, _YAW = np.radians(22.0), np.radians(-32.0)
"""The object begins seen from above, and from the side: three of its faces are seen."""


@dataclass(frozen=True)
class Room:
    """Where the object may be: wholly in the picture, whatever its joint does, and not too near."""

    points: Array
    """(k, 3) that bound the object at all states, in its own frame."""
    centre: Array
    """(3,) about which it is turned, in its own frame."""
    radius: float
    """Metres from there to the furthest point."""
    nearest: float
    farthest: float
    """Of the centre's depth, metres."""
    T_start: Array
    """(4, 4) where it begins, camera from object."""

    @classmethod
    def of(cls, body: Body, camera: Camera) -> Room:
        """The room of a body before a camera."""
        points = _outermost(body)
        R = se3.exp_so3([_TILT, 0, 0]) @ UPRIGHT @ se3.exp_so3([0, 0, _YAW])
        turned = (points - body.centre) @ R.T
        nearest = body.radius + min(NEAREST_M, body.radius)
        depth = max(_filling(turned, camera), nearest)
        place = np.array([0.0, 0.0, depth])
        v = camera.project(turned + place)[:, 1]
        place[1] = -((v.max() + v.min()) / 2 - camera.K[1, 2]) * depth / camera.K[1, 1]
        T = se3.pose(R, place - R @ body.centre)
        return cls(points, body.centre, body.radius, nearest, FARTHEST * depth, T)

    @property
    def reach(self) -> float:
        """Metres from the camera within which the object's own frame is."""
        return 2 * self.farthest + float(np.linalg.norm(self.centre)) + self.radius


def _outermost(body: Body) -> Array:
    """(k, 3) points that bound the body over its whole range of states."""
    points = body.points(np.linspace(body.lower, body.upper, 25)).reshape(-1, 3)
    try:
        points = points[ConvexHull(points).vertices]
    except QhullError:  # a flat body has no hull of its own
        points = np.unique(points, axis=0)
    k = np.arange(_DIRECTIONS) + 0.5  # a Fibonacci lattice on the sphere
    z, turn = 1 - 2 * k / _DIRECTIONS, np.pi * (1 + np.sqrt(5)) * k
    across = np.sqrt(1 - z**2)
    directions = np.stack([across * np.cos(turn), across * np.sin(turn), z], 1)
    return points[np.unique((points @ directions.T).argmax(0))]


def _filling(turned: Array, camera: Camera) -> float:
    """The depth at which points (k, 3) about the origin are `FILL` of the picture high, or all of its width."""
    near, far = 1.001 * max(-turned[:, 2].min(), 1e-6), 1e3 * float(np.abs(turned).max())
    size = np.array([camera.width * (1 - 4 * MARGIN), FILL * camera.height])
    for _ in range(60):
        depth = float(np.sqrt(near * far))
        fits = (np.ptp(camera.project(turned + np.array([0, 0, depth])), axis=0) <= size).all()
        near, far = (near, depth) if fits else (depth, far)
    return far
