"""Every layout by its name."""

from __future__ import annotations

from freeart21.errors import FreeArtError
from leaderboard.adapters import (
    artgs,
    articulate_anything,
    bundlesdf,
    digitaltwinart,
    foundationpose,
    freeartgs,
    itaco,
    paris,
    rsrd,
    screwsplat,
)
from leaderboard.adapters.toolbox import Layout

LAYOUTS: dict[str, Layout] = {
    module.LAYOUT.name: module.LAYOUT
    for module in (
        freeartgs,
        itaco,
        rsrd,
        paris,
        digitaltwinart,
        artgs,
        articulate_anything,
        bundlesdf,
        foundationpose,
        screwsplat,
    )
}


def layout_named(name: str) -> Layout:
    """The layout `name`; FreeArtError names those that exist."""
    if name not in LAYOUTS:
        raise FreeArtError(f"unknown layout '{name}'; known: {', '.join(LAYOUTS)}")
    return LAYOUTS[name]
