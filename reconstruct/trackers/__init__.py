"""Trackers, one file each."""

from __future__ import annotations

from freeart21.errors import FreeArtError
from freeart21.registry import find_classes
from reconstruct.scene import Scene
from reconstruct.settings import TrackSettings
from reconstruct.tracks import Tracker

TRACKERS: dict[str, type[Tracker]] = find_classes(__name__, Tracker)
"""By name: the modules of this folder, and entry points of others (`freeart21.registry`)."""


def make_tracker(scene: Scene, settings: TrackSettings) -> Tracker:
    """The tracker that `settings.tracker` names; FreeArtError lists the known ones."""
    if settings.tracker not in TRACKERS:
        raise FreeArtError(f"unknown tracker '{settings.tracker}'; trackers: {', '.join(TRACKERS)}")
    return TRACKERS[settings.tracker](scene, settings)
