"""The plan of a motion: poses, joint states and the camera's pose in the world."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from freeart21.se3 import Array


@dataclass(frozen=True)
class Plan:
    """Poses of object and world in every frame; lamps are fixed in the world, gravity is its -z."""

    Ts_camera_object: Array
    """(n, 4, 4) camera from the object's frame (the root link's)."""
    states: Array
    """(n,) joint state, rad or m."""
    Ts_camera_world: Array
    """(n, 4, 4) camera from the world (z up), metres; constant when the camera is at rest."""
    source: dict[str, Any] | None = None
    """Origin of a motion that was not planned here, for the truth's `source`; None for a planned one."""


@dataclass(frozen=True)
class Preset:
    """Size of the object and distance from the camera."""

    name: str
    diagonal_m: float | None
    """Bounding-box diagonal, metres, to which the object is scaled; None keeps its size."""
    distance_m: float | None
    """Mean distance from camera to object, metres, or more where the object would not fit; None uses `fill`."""
    fill: float | None
    """Mean height of the object in the picture, as a share of the picture's height; None uses `distance_m`."""
    fov_y_degrees: float
    """Vertical field of view of the camera."""


PRESETS: dict[str, Preset] = {
    "handheld": Preset("handheld", None, None, 0.65, 40.0),
    "paper": Preset("paper", 2.0, 3.0, None, 50.0),
}
"""'handheld': real size, filling the picture; 'paper': PartNet's scale, about 3 m away."""
