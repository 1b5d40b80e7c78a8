"""The region in which the object may be, and its start pose."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from freeart21 import se3
from freeart21.camera import Camera
from freeart21.se3 import Array
from freeart21.sphere import fibonacci_sphere
from generator.motion.body import UPRIGHT, Body
from generator.motion.framing import place_object
from generator.motion.plan import PRESETS

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
        nearest = radius + min(NEAREST_M, radius / 4)
        preset = replace(PRESETS["handheld"], fill=FILL)
        T = place_object(R[None], np.zeros((1, 3)), np.zeros(1), np.array([state]), body, camera, preset, False)[0]
        far = float(se3.transform(T, centre[None])[0, 2])
        bounding = _extreme_points(body.hulls[0]), _extreme_points(body.hulls[1])
        return cls(bounding, centre, radius, nearest, FARTHEST * far, state, T)

    @property
    def reach(self) -> float:
        """Largest distance from the camera to the origin of the object's frame, metres."""
        return 2 * self.farthest + float(np.linalg.norm(self.centre)) + self.radius


def _extreme_points(points: Array) -> Array:
    """The points among (n, 3) that are extreme in one of the sampled directions."""
    return np.asarray(points[np.unique((points @ fibonacci_sphere(_DIRECTIONS).T).argmax(0))])
