"""Matchers, one file each."""

from __future__ import annotations

from freeart21.errors import FreeArtError
from freeart21.registry import find_classes
from reconstruct.matchers.base import Matcher, Matches
from reconstruct.scene import Scene

__all__ = ["MATCHERS", "Matcher", "Matches", "make_matcher"]

MATCHERS: dict[str, type[Matcher]] = find_classes(__name__, Matcher)
"""By name: the modules of this folder, and entry points of others (`freeart21.registry`)."""


def make_matcher(scene: Scene, name: str) -> Matcher:
    """The matcher `name`; FreeArtError lists the known ones."""
    if name not in MATCHERS:
        raise FreeArtError(f"unknown matcher '{name}'; matchers: {', '.join(MATCHERS)}")
    return MATCHERS[name](scene)
