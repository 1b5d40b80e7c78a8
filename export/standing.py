"""Which way an upright object faces, and what its parts are called."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from freeart21.joint import Joint
from freeart21.mesh import Mesh, bounding_diagonal, box_centre

STEEP = np.radians(30.0)
"""An axis within this angle of vertical is vertical, within it of horizontal is horizontal; else it is neither."""
SMALL = 0.4
"""Diagonal over the other part's below which a part is a handle, not a door or a drawer. A choice, not measured."""
FLAT = 0.35
"""Thickness over the next larger extent of a door: a board with a handle on it. A choice."""
INSIDE = 0.3
"""Least share of a drawer's box that is in its carcass's when closed. A choice: a front board stands outside."""
PART, BASE = "part", "base"
ROLES = (BASE, "lid", "door", "drawer", "slider", "handle", PART)


def find_front(
    up: NDArray[np.float64], joint: Joint, standing: Mesh, moving: Mesh, opening: float
) -> NDArray[np.float64]:
    """(3,) the horizontal unit vector that becomes x, in the frame of the arguments.

    A slide opens towards x. A hinge whose axis is not vertical gets it along y, and x points from the axis to the
    moving part or, where that is above or below it, from the standing part to the moving one. A vertical hinge's part
    faces x with its thinnest side, away from the standing part. Else x is the shorter side of the standing part's
    footprint.

    Args:
        up: (3,) unit vector.
        joint: of the moving part against the standing one.
        standing: the part that stands on the ground.
        moving: the other part, at joint position zero.
        opening: sign of the joint's motion from zero, 1 or -1.
    """
    away = box_centre(moving) - box_centre(standing)
    level = joint.axis - up * (up @ joint.axis)
    upright_axis = np.linalg.norm(level) < np.sin(STEEP)
    if not upright_axis and joint.type == "prismatic":
        return normalise(opening * level)
    if not upright_axis:
        across, out = normalise(np.cross(up, level)), box_centre(moving) - joint.pivot
        out = out if abs(across @ out) > abs(up @ out) else away
        return across if across @ out >= 0 else -across
    thin = _thinnest_side(moving if joint.type == "revolute" else standing, up)
    return thin if thin @ away >= -1e-9 else -thin


def _thinnest_side(mesh: Mesh, up: NDArray[np.float64]) -> NDArray[np.float64]:
    """(3,) the horizontal direction in which a mesh is thinnest, to a degree."""
    first = np.eye(3)[int(np.argmin(np.abs(up)))]
    first = normalise(first - up * (up @ first))
    angles = np.radians(np.arange(180.0))
    ways = np.cos(angles)[:, None] * first + np.sin(angles)[:, None] * np.cross(up, first)
    points = mesh.vertices[np.unique(mesh.faces)] @ ways.T
    return np.asarray(ways[int(np.argmin(np.ptp(points, axis=0)))])


@dataclass(frozen=True)
class _Box:
    """Axis-aligned bounding box of a mesh, corners (3,)."""

    low: NDArray[np.float64]
    high: NDArray[np.float64]

    @staticmethod
    def of(mesh: Mesh) -> _Box:
        points = mesh.vertices[np.unique(mesh.faces)]
        return _Box(points.min(0), points.max(0))

    @property
    def extent(self) -> NDArray[np.float64]:
        return self.high - self.low


def name_role(joint: Joint, standing: Mesh, moving: Mesh) -> str:
    """The role of the moving part, one of `ROLES`; the standing part is the `BASE`.

    - A slide with a horizontal axis whose part is mostly inside the base's box is a drawer, any other slide a slider.
    - A hinge with a horizontal axis: a lid where the part's middle is above the base's box or in its upper quarter and
      the part is not flat towards the front.
    - A hinge with an axis of either kind: a door where the part is lower, and flat towards the front.
    - Of a hinge, a part much smaller than the base that is none of these is a handle. All else is a part.

    Args:
        joint: in the root link's frame, z up, x to the front (`find_front`).
        standing: the root's mesh, in its frame.
        moving: the other part there, at joint position zero.
    """
    base, own = _Box.of(standing), _Box.of(moving)
    vertical = abs(joint.axis[2]) > np.cos(STEEP)
    horizontal = abs(joint.axis[2]) < np.sin(STEEP)
    small = bounding_diagonal(moving) < SMALL * bounding_diagonal(standing)
    if joint.type == "prismatic":
        common = np.clip(np.minimum(base.high, own.high) - np.maximum(base.low, own.low), 0, None)
        within = common.prod() > INSIDE * own.extent.prod()
        return "drawer" if horizontal and within and not small else "slider"
    middle = 0.5 * (own.low + own.high)
    thin = own.extent[0] < FLAT * np.delete(own.extent, 0).min()
    high = middle[2] > base.high[2] - 0.25 * base.extent[2]
    if horizontal and high and not thin:
        return "lid"
    if (horizontal or vertical) and thin and not high and not small:
        return "door"
    return "handle" if small else PART


def normalise(vector: NDArray[np.float64]) -> NDArray[np.float64]:
    """(3,) of length one."""
    return np.asarray(vector / np.linalg.norm(vector))
