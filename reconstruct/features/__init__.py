"""Features of pixels, one file each."""

from __future__ import annotations

from freeart21.errors import FreeArtError
from freeart21.registry import find_classes
from reconstruct.features.base import Descriptors, Features
from reconstruct.scene import Scene
from reconstruct.settings import FeatureSettings

__all__ = ["FEATURES", "Descriptors", "Features", "make_features"]

FEATURES: dict[str, type[Features]] = find_classes(__name__, Features)
"""By name: the modules of this folder, and entry points of others (`freeart21.registry`)."""


def make_features(scene: Scene, settings: FeatureSettings) -> Features:
    """The features that `settings.model` names; FreeArtError lists the known ones."""
    if settings.model not in FEATURES:
        raise FreeArtError(f"unknown features '{settings.model}'; features: {', '.join(FEATURES)}")
    return FEATURES[settings.model](scene, settings)
