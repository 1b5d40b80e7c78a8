"""Networks that carry masks along a video, one file each."""

from __future__ import annotations

from freeart21.errors import FreeArtError
from freeart21.registry import find_classes
from reconstruct.segmenters.base import Prompt, Segmenter

__all__ = ["SEGMENTERS", "Prompt", "Segmenter", "make_segmenter"]

SEGMENTERS: dict[str, type[Segmenter]] = find_classes(__name__, Segmenter)
"""By name: the modules of this folder, and entry points of others (`freeart21.registry`)."""


def make_segmenter(name: str) -> Segmenter:
    """The segmenter `name`, its weights loaded; FreeArtError lists the known ones, or says what is missing."""
    if name not in SEGMENTERS:
        raise FreeArtError(f"unknown segmenter '{name}'; segmenters: {', '.join(SEGMENTERS)}")
    return SEGMENTERS[name]()
