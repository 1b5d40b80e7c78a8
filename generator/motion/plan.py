"""What every motion of the recorder is: a plan of poses, joint states and the camera's place in the world."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from freeart21.se3 import Array


@dataclass(frozen=True)
class Plan:
    """Where the object is in every frame, and where the world is: its lamps, and gravity along its -z."""

    Ts_camera_object: Array
    """(n, 4, 4) camera from the object's frame (the root link's)."""
    states: Array
    """(n,) joint state, rad or m."""
    Ts_camera_world: Array
    """(n, 4, 4) camera from the world: z up, metres. The same in all frames when the camera stands still."""
    source: dict[str, Any] | None = None
    """Where the motion is from, when it was not planned here: for the truth's source."""


@dataclass(frozen=True)
class Preset:
    """How large the object is and how far it stands from the camera."""

    name: str
    diagonal_m: float | None
    """Bounding-box diagonal, metres, to which the object is to be scaled before it is planned for; None keeps it."""
    distance_m: float | None
    """Mean distance from the camera to the object, metres, or further when it must be to fit; None follows `fill`."""
    fill: float | None
    """Mean height of the object in the picture, as a share of the picture's height; None follows `distance_m`."""
    fov_y_degrees: float
    """Vertical field of view of the camera."""


PRESETS: dict[str, Preset] = {
    "handheld": Preset("handheld", None, None, 0.65, 40.0),
    "paper": Preset("paper", 2.0, 3.0, None, 50.0),
}
"""'handheld': real size, near enough to fill the picture as in a hand; 'paper': of PartNet scale, about 3 m away."""
