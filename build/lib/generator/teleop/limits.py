"""Where an object may be before the camera, and where it begins."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from freeart21 import se3
from freeart21.camera import Camera
from freeart21.se3 import Array
from generator.motion.body import UPRIGHT, Body
from generator.motion.framing import MARGIN

FILL = 0.6
"""Height of the object in the picture when it begins, as a share of the picture's: about that of the recorder's motions
(0.65 in the mean), with room to move."""
NEAREST_M = 0.25
"""From the camera to the ball round the object, metres, or a quarter of the ball's radius if that is less: small things
would not fill the picture from further away."""
FARTHEST = 6.0
"""Distances of the beginning, up to which the object may go: it is a sixth as large there."""
_DIRECTIONS = 300
"""In which the body's outermost points are looked for: neighbours are 0.2 rad apart, so that of a ball 0.5 % of its
radius is missed, less than the strip along the border (`MARGIN`)."""
_TILT, _YAW = np.radians(22.0), np.radians(-32.0)
"""The object begins seen from above, and from the side: three of its faces are seen."""


@dataclass(frozen=True)
class Room:
    """Where the object may be: wholly in the picture, and not too near."""

    points: tuple[Array, Array]
    """(k, 3) that bound the still and the moving part at joint state zero, in the object's frame."""
    centre: Array
    """(3,) about which it is turned, in its own frame: of the box round it as it begins."""
    radius: float
    """Metres from there to the furthest point then."""
    nearest: float
    farthest: float
    """Of the centre's depth, metres."""
    state: float
    """The joint's, when the object begins: zero, or the limit next to it."""
    T_start: Array
    """(4, 4) where it begins, camera from object."""

    @classmethod
    def of(cls, body: Body, camera: Camera) -> Room:
        """The room of a body before a camera."""
        state = min(max(0.0, body.lower), body.upper)
        R = se3.exp_so3([_TILT, 0, 0]) @ UPRIGHT @ se3.exp_so3([0, 0, _YAW])
        points = body.points(np.array([state]))[0]
        centre = (points.min(0) + points.max(0)) / 2
        radius = float(np.linalg.norm(points - centre, axis=1).max())
        turned = (points - centre) @ R.T
        near = nearest = radius + min(NEAREST_M, radius / 4)
        far = 1e3 * radius
        for _ in range(60):
            depth = float(np.sqrt(near * far))
            fits = _fits(turned + _centred(turned, depth, camera), camera)
            near, far = (near, depth) if fits else (depth, far)
        T = se3.pose(R, _centred(turned, far, camera) - R @ centre)
        bounding = _outermost(body.hulls[0]), _outermost(body.hulls[1])
        return cls(bounding, centre, radius, nearest, FARTHEST * far, state, T)

    @property
    def reach(self) -> float:
        """Metres from the camera within which the object's own frame is; its centre may be in a corner."""
        return 2 * self.farthest + float(np.linalg.norm(self.centre)) + self.radius


def _outermost(points: Array) -> Array:
    """Those of points (n, 3) that are the furthest ones in some direction."""
    k = np.arange(_DIRECTIONS) + 0.5  # a Fibonacci lattice on the sphere
    z, turn = 1 - 2 * k / _DIRECTIONS, np.pi * (1 + np.sqrt(5)) * k
    across = np.sqrt(1 - z**2)
    directions = np.stack([across * np.cos(turn), across * np.sin(turn), z], 1)
    return points[np.unique((points @ directions.T).argmax(0))]


def _centred(points: Array, depth: float, camera: Camera) -> Array:
    """The shift (3,) that brings points (k, 3) about the origin into the picture's middle, to a depth."""
    place = np.array([0.0, 0.0, depth])
    for _ in range(20):  # the nearer a point, the more a shift moves it: each step leaves a share
        uv = camera.project(points + place)
        off = (uv.max(0) + uv.min(0)) / 2 - camera.K[:2, 2]
        place[:2] -= off * depth / camera.K[[0, 1], [0, 1]]
    return place


def _fits(points: Array, camera: Camera) -> bool:
    """Whether points (k, 3) are at most `FILL` of the picture high, and inside it."""
    strip, size = MARGIN * camera.height, np.array([camera.width, camera.height])
    uv = camera.project(points)
    inside = (uv.min(0) >= strip).all() and (uv.max(0) <= size - strip).all()
    return bool(inside and np.ptp(uv[:, 1]) <= FILL * camera.height)
