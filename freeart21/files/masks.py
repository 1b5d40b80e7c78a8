"""Masks made without hand work, with the doubt about each, and their folder: a picture a frame, and masks.json."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from freeart21.files import atomic, checked
from freeart21.files.places import MASKS

SCHEMA = "freeart21/masks/1"


class Click(NamedTuple):
    """A pixel with what a user calls it."""

    frame: int
    column: float
    row: float
    """Pixels of the recording."""
    on_object: bool


@dataclass(frozen=True)
class Masks:
    """Masks and how far they can be trusted."""

    masks: NDArray[np.bool_]
    """(n, height, width), pixels of the recording."""
    doubt: NDArray[Any]
    """(n,) 0 to 1; more than 0.5 should be looked at."""
    reasons: tuple[str, ...]
    """(n,) the largest cause of each doubt."""
    notes: tuple[str, ...] = ()
    """On the whole video."""


def write_masks(folder: Path, made: Masks, clicks: Sequence[Click] = ()) -> None:
    """Write the masks as 00000.png and so on, and masks.json with the user's clicks. An older `folder` is replaced."""
    with atomic.new_folder(folder, MASKS) as aside:
        for i, mask in enumerate(made.masks):
            atomic.write_bytes(aside / f"{i:05d}.png", checked.encode_png(255 * mask.astype(np.uint8)))
        frames = [{"doubt": round(float(d), 3), "reason": r} for d, r in zip(made.doubt, made.reasons, strict=True)]
        marks = [[c.frame, c.column, c.row, int(c.on_object)] for c in clicks]
        atomic.write_json(
            aside / "masks.json", {"schema": SCHEMA, "notes": list(made.notes), "clicks": marks, "frames": frames}
        )
