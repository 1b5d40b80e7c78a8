"""Members of a registry whose packages or weights are not here."""

from typing import Any

import pytest

from freeart21.errors import FreeArtError


def make_or_skip(kind: Any, *arguments: Any) -> Any:
    """`kind(*arguments)`; the test is skipped, with its own line, where a package or weights are missing."""
    try:
        return kind(*arguments)
    except FreeArtError as error:
        if not any(text in str(error) for text in ("is not installed", "FREEART21_WEIGHTS")):
            raise
        pytest.skip(f"outside data are not here: {error}")
