"""Category of a sequence's object, from its truth."""

from __future__ import annotations

from pathlib import Path

from freeart21.catalog import CATALOG
from freeart21.errors import FreeArtError
from freeart21.files import checked
from leaderboard.submission import shorten

UNKNOWN = "unknown"


def read_category(truth_folder: Path) -> str:
    """The `category` in the `source` of truth.json, else that of the catalog object named there, else UNKNOWN."""
    try:
        source = checked.read_json(Path(truth_folder) / "truth.json").get("source")
    except FreeArtError:
        return UNKNOWN
    if not isinstance(source, dict):
        return UNKNOWN
    category = source.get("category")
    if isinstance(category, str) and category.strip():
        return shorten(category)
    return next((entry.category for entry in CATALOG if entry.name == source.get("object")), UNKNOWN)
