"""File names from names of users."""

from __future__ import annotations

import hashlib
import re
from collections.abc import Iterable

LONGEST = 60
"""Characters kept of a name."""
_RESERVED = {"con", "prn", "aux", "nul", *(f"{port}{k}" for port in ("com", "lpt") for k in range(10))}


def file_names(names: Iterable[str]) -> list[str]:
    """A file name without ending for each name: letters, digits, '-', '_' and '.', unique regardless of case.

    A safe name stays as it is; any other gets a short digest of itself, so that it is independent of the others.
    """
    found: list[str] = []
    for name in names:
        taken = {one.casefold() for one in found}
        plain = re.sub(r"[^A-Za-z0-9_.-]+", "-", name)[:LONGEST].strip("-.")
        choice = plain or "name"
        if plain != name or plain.split(".")[0].casefold() in _RESERVED or plain.casefold() in taken:
            choice += f"-{hashlib.sha256(name.encode('utf-8', 'surrogatepass')).hexdigest()[:16]}"
        found.append(choice if choice.casefold() not in taken else f"{choice}-{len(found)}")
    return found
