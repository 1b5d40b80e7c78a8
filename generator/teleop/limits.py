"""The region in which the object may be, and its start pose."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from freeart21 import se3
from freeart21.camera import Camera
from freeart21.se3 import Array
from generator.motion.body import UPRIGHT, Body
from generator.motion.framing import MARGIN

FILL = 0.6
"""Height of the object at the start, as a share of the picture's: about that of the recorder's motions (mean 0.65),
with space to move."""
NEAREST_M = 0.25
"""Least distance from the camera to the object's bounding sphere, metres, or a quarter of its radius if that is
less: small objects would not fill the picture from further away."""
FARTHEST = 6.0
"""Largest distance, relative to that of the start: the object is a sixth as large there."""
_DIRECTIONS = 300
"""Directions in which extreme points are searched: neighbours are 0.2 rad apart, so that 0.5 % of a ball's radius is
missed, less than the strip along the border (`MARGIN`)."""
_TILT, _YAW = np.radians(22.0), np.radians(-32.0)
"""The object starts seen from above and from the side, so that three of its faces are visible."""


@dataclass(frozen=True)
class Workspace:
    """Where the object may be: completely in the picture and not too near."""

    points: tuple[Array, Array]
    """(k, 3) bounding points of the fixed and the moving part at joint state zero, object's frame."""
    centre: Array
    """(3,) centre of rotation in the object's frame: of its bounding box at the start."""
    radius: float
    """Metres from the centre to the furthest point at the start."""
    nearest: float
    farthest: float
    """Range of the centre's depth, metres."""
    state: float
    """Joint state at the start: zero, or the nearest limit."""
    T_start: Array
    """(4, 4) start pose, camera from object."""

    @classmethod
    def of(cls, body: Body, camera: Camera) -> Workspace:
        """The workspace of a body in front of a camera."""
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
            fits = _fits(turned + _centring_shift(turned, depth, camera), camera)
            near, far = (near, depth) if fits else (depth, far)
        T = se3.pose(R, _centring_shift(turned, far, camera) - R @ centre)
        bounding = _extreme_points(body.hulls[0]), _extreme_points(body.hulls[1])
        return cls(bounding, centre, radius, nearest, FARTHEST * far, state, T)

    @property
    def reach(self) -> float:
        """Largest distance from the camera to the origin of the object's frame, metres."""
        return 2 * self.farthest + float(np.linalg.norm(self.centre)) + self.radius


def _extreme_points(points: Array) -> Array:
    """The points among (n, 3) that are extreme in one of the sampled directions."""
    k = np.arange(_DIRECTIONS) + 0.5  # a Fibonacci lattice on the sphere
    z, turn = 1 - 2 * k / _DIRECTIONS, np.pi * (1 + np.sqrt(5)) * k
    across = np.sqrt(1 - z**2)
    directions = np.stack([across * np.cos(turn), across * np.sin(turn), z], 1)
    return np.asarray(points[np.unique((points @ directions.T).argmax(0))])


def _centring_shift(points: Array, depth: float, camera: Camera) -> Array:
    """The translation (3,) that moves points (k, 3) about the origin to the picture's middle, at a depth."""
    place = np.array([0.0, 0.0, depth])
    for _ in range(20):  # not exact with perspective, so it is repeated
        uv = camera.project(points + place)
        off = (uv.max(0) + uv.min(0)) / 2 - camera.K[:2, 2]
        place[:2] -= off * depth / camera.K[[0, 1], [0, 1]]
    return place


def _fits(points: Array, camera: Camera) -> bool:
    """Whether points (k, 3) are inside the picture and at most `FILL` of it high."""
    strip, size = MARGIN * camera.height, np.array([camera.width, camera.height])
    uv = camera.project(points)
    inside = (uv.min(0) >= strip).all() and (uv.max(0) <= size - strip).all()
    return bool(inside and np.ptp(uv[:, 1]) <= FILL * camera.height)
