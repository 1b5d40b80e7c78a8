"""A method's trust in its own result as JSON, as in prediction.json and asset.json."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from freeart21.errors import FreeArtError
from freeart21.files import checked
from freeart21.reconstruction import NOT_STATED, VERDICTS, Trust

MAX_REASONS, MAX_REASON = 100, 1000
"""Lines, and characters of each, that are read of why an answer is doubtful."""


def trust_to_json(trust: Trust | None) -> dict[str, Any]:
    """verdict ("not stated" of None) and reasons."""
    if trust is None:
        return {"verdict": NOT_STATED, "reasons": []}
    return {"verdict": trust.verdict, "reasons": list(trust.reasons)}


def trust_from_json(data: Any, path: Path) -> Trust | None:
    """The trust that `trust_to_json` wrote; None when nothing is stated. Raises FreeArtError naming `path`."""
    if data is None or data == trust_to_json(None):
        return None
    if not isinstance(data, dict) or data.get("verdict") not in VERDICTS:
        raise FreeArtError(f"{path}: 'trust' is {checked.shorten(data)}, expected a verdict, {' or '.join(VERDICTS)}")
    reasons = data.get("reasons", [])
    lines = isinstance(reasons, list) and len(reasons) <= MAX_REASONS and all(isinstance(r, str) for r in reasons)
    if not lines or any(len(r) > MAX_REASON or not r.isprintable() for r in reasons):
        raise FreeArtError(
            f"{path}: the reasons of 'trust' are {checked.shorten(reasons)}, expected at most {MAX_REASONS} plain "
            f"lines of at most {MAX_REASON} characters"
        )
    if data["verdict"] == "sound" and reasons:
        raise FreeArtError(f"{path}: 'trust' is sound with {len(reasons)} reasons for doubt, expected none")
    return Trust(data["verdict"], tuple(reasons))
