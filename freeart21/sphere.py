"""Evenly spread directions on the sphere, and how much of it a set of views covers."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from freeart21.se3 import Array

CELLS = 48
"""Number of equal cells of the viewing sphere."""
REACH_DEGREES = 30.0
"""A cell is covered by any view within this angle of its centre."""


def fibonacci_sphere(n: int) -> Array:
    """n evenly spread unit vectors (n, 3): a Fibonacci lattice of equal areas (Swinbank and Purser 2006)."""
    z = 1 - 2 * (np.arange(n) + 0.5) / n
    angle = np.pi * (1 + 5**0.5) * np.arange(n)
    r = np.sqrt(1 - z**2)
    return np.stack([r * np.cos(angle), r * np.sin(angle), z], -1)


def covered_cells(views: Array) -> NDArray[np.bool_]:
    """(..., CELLS) which cells each of the unit vectors `views` (..., 3) covers."""
    return np.asarray(views @ fibonacci_sphere(CELLS).T >= np.cos(np.radians(REACH_DEGREES)))


def coverage(views: Array) -> float:
    """Share of the sphere's cells that `views` (n, 3), unit vectors from the object to the camera, cover."""
    return float(covered_cells(np.asarray(views, float)).any(0).mean())


def view_directions(Ts_camera_object: Array, centre: Array) -> Array:
    """(n, 3) unit vectors, object frame, from its point `centre` (3,) to the camera, in poses (n, 4, 4)."""
    R, t = Ts_camera_object[:, :3, :3], Ts_camera_object[:, :3, 3]
    towards = -np.einsum("nji,nj->ni", R, t) - centre
    return np.asarray(towards / np.linalg.norm(towards, axis=1, keepdims=True))
