"""Interface of a source of poses."""

from __future__ import annotations

from typing import ClassVar

from freeart21.se3 import Array
from reconstruct.scene import Scene
from reconstruct.settings import GivenPosesSettings


class PoseSource:
    """Poses of rigid bodies, found by another program. They are initial guesses: the video's cost decides."""

    name: ClassVar[str]

    def __init__(self, settings: GivenPosesSettings) -> None:
        self.settings = settings

    def poses(self, scene: Scene) -> Array:
        """(b, n, 4, 4) camera from body, metres, of b bodies in n frames; NaN where unknown.

        Each body is one of the parts, which one need not be known. Its own frame is any. Raises FreeArtError.
        """
        raise NotImplementedError

    def digest(self) -> str:
        """SHA-256, hexadecimal, of the files that the poses come from; empty without such."""
        return ""
