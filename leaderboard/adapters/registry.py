"""Every layout by its name."""

from __future__ import annotations

import functools

from freeart21.errors import FreeArtError
from freeart21.registry import find_instances
from leaderboard.adapters.layout import Layout


@functools.cache
def layouts() -> dict[str, Layout]:
    """Name to layout: modules of this folder, and entry points `leaderboard.adapters` of other packages."""
    return find_instances("leaderboard.adapters", Layout)


def layout_named(name: str) -> Layout:
    """The layout `name`; FreeArtError lists the known ones."""
    if name not in layouts():
        raise FreeArtError(f"unknown layout '{name}'; known: {', '.join(layouts())}")
    return layouts()[name]
