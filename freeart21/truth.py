"""The ground truth of a recording. It is in other files than the recording, and methods cannot import it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from freeart21.articulation import PARTS, Articulation
from freeart21.errors import FreeArtError
from freeart21.mesh import bounding_diagonal
from freeart21.se3 import Array, check_poses

Image = NDArray[np.uint8]


@dataclass(frozen=True)
class Truth:
    """The ground truth of n frames. The canonical frame is the object's own; states are the simulator's joint
    values."""

    articulation: Articulation
    states: NDArray[np.float64]
    """(n,) joint state in every frame, rad or m."""
    Ts_camera_reference: Array
    """(n, 4, 4) camera from canonical, reference part."""
    Ts_camera_moving: Array
    """(n, 4, 4) camera from canonical, moving part: Ts_camera_reference @ joint.transform(states)."""
    seen: NDArray[np.int64]
    """(n, 2) visible pixels of the reference and the moving part."""
    outer: tuple[NDArray[np.bool_], NDArray[np.bool_]]
    """Per part (F,) faces that are visible from outside the object at some joint state."""
    visible: tuple[NDArray[np.bool_], NDArray[np.bool_]]
    """Per part (F,) faces that the video shows in at least one frame."""
    part_mask: Callable[[int], Image]
    """Frame index to (height, width): 0 neither, 1 reference, 2 moving."""
    query_rgb: Callable[[int], Image]
    """Query index to (height, width, 3) RGB."""
    query_mask: Callable[[int], NDArray[np.bool_]]
    """Query index to (height, width) foreground."""
    source: dict[str, Any] = field(default_factory=dict)
    """Its origin: simulator and version, driver, seed, object, motion, sensor."""

    def __post_init__(self) -> None:
        n = len(self.states)
        for name in ("Ts_camera_reference", "Ts_camera_moving"):
            poses = check_poses(f"truth {name}", getattr(self, name))
            if len(poses) != n:
                raise FreeArtError(f"truth {name} has {len(poses)} poses for {n} states")
        for k, name in enumerate(PARTS):
            faces = len(self.articulation.part(name).faces)
            for which, flags in (("outer", self.outer[k]), ("visible", self.visible[k])):
                if len(flags) != faces:
                    raise FreeArtError(f"truth has {len(flags)} {which} flags for {faces} faces of the {name} part")

    def __len__(self) -> int:
        return len(self.states)

    @property
    def diagonal(self) -> float:
        """Metres: the diagonal of the object's axis-aligned bounding box, canonical frame, posed as in frame 0."""
        moving = self.articulation.moving.moved(self.articulation.joint.transform(self.states[0]))
        return bounding_diagonal(self.articulation.reference, moving)

    @property
    def range_of_motion(self) -> float:
        """Largest minus smallest state of the recording, rad or m."""
        return float(np.ptp(self.states))
