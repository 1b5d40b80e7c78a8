"""Weights of networks that torch saved: read without running anything that they hold."""

from __future__ import annotations

import io
from pathlib import Path
from typing import Any

from freeart21.errors import FreeArtError


def first_line(error: Exception) -> str:
    """What `error` says, on one line."""
    return next(iter(str(error).splitlines()), "") or type(error).__name__


def parse_weights(data: bytes, where: Path) -> dict[str, Any]:
    """What torch saved in `data`: tensors and plain values, nothing executable. FreeArtError for anything else."""
    import torch

    try:
        found = torch.load(io.BytesIO(data), map_location="cpu", weights_only=True)
    except Exception as error:  # of many classes, by what is wrong with the file
        raise FreeArtError(f"{where} holds no weights: {first_line(error)}") from None
    if not isinstance(found, dict):
        raise FreeArtError(f"{where} holds {type(found).__name__}, expected weights by name")
    return found
