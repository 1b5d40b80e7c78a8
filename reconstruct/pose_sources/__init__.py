"""Sources of poses that another program found, one file each."""

from __future__ import annotations

from freeart21.errors import FreeArtError
from freeart21.registry import find_classes
from freeart21.se3 import Array
from reconstruct.pose_sources.base import PoseSource
from reconstruct.scene import Scene
from reconstruct.settings import GivenPosesSettings

__all__ = ["POSE_SOURCES", "PoseSource", "digest_poses", "find_poses"]

POSE_SOURCES: dict[str, type[PoseSource]] = find_classes(__name__, PoseSource)
"""By name: the modules of this folder, and entry points of others (`freeart21.registry`)."""


def find_poses(scene: Scene, settings: GivenPosesSettings) -> Array:
    """See `PoseSource.poses`, of the source that the settings name; FreeArtError lists the known ones."""
    return _make_source(settings).poses(scene)


def digest_poses(settings: GivenPosesSettings) -> str:
    """See `PoseSource.digest`."""
    return _make_source(settings).digest()


def _make_source(settings: GivenPosesSettings) -> PoseSource:
    if settings.source not in POSE_SOURCES:
        raise FreeArtError(f"unknown source of poses '{settings.source}'; sources: {', '.join(POSE_SOURCES)}")
    return POSE_SOURCES[settings.source](settings)
