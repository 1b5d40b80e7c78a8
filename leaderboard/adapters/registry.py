"""Every layout by its name."""

from __future__ import annotations

from freeart21.errors import FreeArtError
from leaderboard.adapters import (
    bundlesdf,
    foundationpose,
    freeartgs,
    itaco,
    rsrd,
)
from leaderboard.adapters.toolbox import Layout

LAYOUTS: dict[str, Layout] = {
    module.LAYOUT.name: module.LAYOUT
    for module in (
        freeartgs,
        itaco,
        rsrd,
        bundlesdf,
        foundationpose,
    )
}


def layout_named(name: str) -> Layout:
    """The layout `name`; FreeArtError names those that exist."""
    if name not in LAYOUTS:
        raise FreeArtError(f"unknown layout '{name}'; known: {', '.join(LAYOUTS)}")
    return LAYOUTS[name]
