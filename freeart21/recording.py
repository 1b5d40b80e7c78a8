"""The input of a method: an RGB-D video with foreground masks, and the held-out views to render."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from freeart21.camera import Camera
from freeart21.errors import FreeArtError
from freeart21.se3 import Array, check_poses


@dataclass(frozen=True)
class Frame:
    """One picture of an RGB-D video."""

    rgb: NDArray[np.uint8]
    """(height, width, 3)."""
    depth: NDArray[np.float32]
    """(height, width) z-depth, metres; 0 where there is none."""
    mask: NDArray[np.bool_]
    """(height, width) foreground: any pixel of the object."""


@dataclass(frozen=True)
class Query:
    """A held-out view: the object's pose of one frame, the joint state of another, and a moved camera."""

    pose_of_frame: int
    """Frame whose pose of the reference part is taken."""
    state_of_frame: int
    """Frame whose joint state is taken."""
    T_newcam_cam: Array
    """(4, 4) maps points of the recording camera to the camera of this view; same intrinsics."""

    def __post_init__(self) -> None:
        object.__setattr__(self, "T_newcam_cam", check_poses("query T_newcam_cam", self.T_newcam_cam))


class FrameSource(Protocol):
    """Loads frames one at a time, from a folder or from memory."""

    def __call__(self, index: int) -> Frame:
        """The frame `index`."""
        ...


@dataclass(frozen=True)
class Recording:
    """An RGB-D video of one object from a camera with known intrinsics. Frames load on demand."""

    camera: Camera
    times_s: NDArray[np.float64]
    """(n,) seconds, increasing."""
    load: FrameSource
    queries: tuple[Query, ...] = ()
    licence: str | None = None
    name: str = "sequence"
    gravity: NDArray[np.float64] | None = None
    """(n, 3) unit direction of gravity in each frame's camera axes (right, down, forward); None when not known."""

    def __post_init__(self) -> None:
        times = np.array(self.times_s, float).reshape(-1)
        if len(times) == 0:
            raise FreeArtError(f"{self.name} has no frames")
        if not np.isfinite(times).all() or (np.diff(times) <= 0).any():
            raise FreeArtError(f"{self.name}: times_s must be finite and increasing")
        for i, query in enumerate(self.queries):
            for which in (query.pose_of_frame, query.state_of_frame):
                if not 0 <= which < len(times):
                    raise FreeArtError(f"{self.name}: query {i} names frame {which}, expected 0 to {len(times) - 1}")
        if self.gravity is not None:
            lengths = np.linalg.norm(self.gravity, axis=-1)
            if self.gravity.shape != (len(times), 3) or not np.allclose(lengths, 1, rtol=0, atol=1e-3):
                raise FreeArtError(f"{self.name}: gravity is {self.gravity.shape}, expected a unit vector a frame")
        times.flags.writeable = False
        object.__setattr__(self, "times_s", times)

    def __len__(self) -> int:
        return len(self.times_s)

    def frame(self, index: int) -> Frame:
        """Frame `index`; raises FreeArtError when it is missing or of another size than the camera's."""
        if not 0 <= index < len(self):
            raise FreeArtError(f"{self.name} has no frame {index}, it has 0 to {len(self) - 1}")
        frame = self.load(index)
        size = (self.camera.height, self.camera.width)
        for what, image in (("rgb", frame.rgb), ("depth", frame.depth), ("mask", frame.mask)):
            if image.shape[:2] != size:
                raise FreeArtError(
                    f"{self.name} frame {index}: {what} is {image.shape[1]} x {image.shape[0]}, "
                    f"expected {size[1]} x {size[0]}"
                )
        return frame

    def frames(self) -> Iterator[Frame]:
        """All frames in order."""
        return (self.frame(i) for i in range(len(self)))
