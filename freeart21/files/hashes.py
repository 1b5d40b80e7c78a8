"""SHA-256 of files."""

from __future__ import annotations

import hashlib
from pathlib import Path

from freeart21.files import checked

MAX_HASHED_BYTES = checked.MAX_ARRAY_BYTES
"""The largest file that any reader accepts."""


def file_sha256(path: Path, root: Path | None = None) -> str:
    """Hexadecimal SHA-256 of a file's bytes; raises FreeArtError as `checked.open_file`, `root` as there."""
    with checked.open_file(path, MAX_HASHED_BYTES, root) as file:
        return (
            hashlib.file_digest(file, "sha256").hexdigest()
            if hasattr(hashlib, "file_digest")
            else hashlib.sha256(file.read()).hexdigest()
        )
