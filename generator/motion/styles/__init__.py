"""The styles of motion, one file each: how object, camera and joint are moved."""

from __future__ import annotations

from freeart21.registry import find_instances
from generator.motion.style import Style

STYLES: dict[str, Style] = dict(sorted(find_instances(__name__, Style).items(), key=lambda item: item[1].stream))
"""By name, in the order of their streams: the modules of this folder, and entry points of others
(`freeart21.registry`)."""
