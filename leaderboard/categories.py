"""Which category a sequence's object is of, as its truth says; nothing is guessed from names."""

from __future__ import annotations

from pathlib import Path

from freeart21.catalog import CATALOG
from freeart21.errors import FreeArtError
from freeart21.files import checked
from leaderboard.submission import shorten

UNKNOWN = "unknown"


def read_category(truth_folder: Path) -> str:
    """The category that truth.json names in its `source`, or that of the catalog's object that it names, or UNKNOWN."""
    try:
        source = checked.read_json(Path(truth_folder) / "truth.json").get("source")
    except FreeArtError:
        return UNKNOWN
    if not isinstance(source, dict):
        return UNKNOWN
    said = source.get("category")
    if isinstance(said, str) and said.strip():
        return shorten(said)
    return next((entry.category for entry in CATALOG if entry.name == source.get("object")), UNKNOWN)
