"""What an import said of a result, kept with it, for the row of its score."""

from __future__ import annotations

from pathlib import Path

from freeart21.errors import FreeArtError
from freeart21.files import checked
from leaderboard.submission import shorten

MOST = 8
"""Lines that a row shows: a result may come from anywhere."""


def import_notes(folder: Path) -> tuple[str, ...]:
    """The notes that `freeart21 import` left in the result `folder`; none in a result that was not imported."""
    try:
        settings = checked.read_json(folder / "prediction.json").get("settings")
    except FreeArtError:
        return ()
    told = settings.get("import") if isinstance(settings, dict) else None
    notes = told.get("notes") if isinstance(told, dict) else None
    lines = [note for note in notes if isinstance(note, str)] if isinstance(notes, list) else []
    return tuple(f"import: {shorten(note)}" for note in lines[:MOST])
