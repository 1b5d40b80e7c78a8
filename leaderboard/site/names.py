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
    taken: set[str] = set()
    found: list[str] = []
    for name in names:
        plain = re.sub(r"[^A-Za-z0-9_.-]+", "-", name)[:LONGEST].strip("-.")
        digest = hashlib.sha256(name.encode("utf-8", "surrogatepass")).hexdigest()
        safe = (
            bool(plain)
            and plain == name
            and plain.split(".")[0].casefold() not in _RESERVED
            and plain.casefold() not in taken
        )
        for length in range(8, len(digest) + 1, 8):
            choice = plain if safe else f"{plain or 'name'}-{digest[:length]}"
            if choice.casefold() not in taken:
                break
        else:
            choice = f"{plain or 'name'}-{digest}-{len(found)}"  # the very same name again
        taken.add(choice.casefold())
        found.append(choice)
    return found
