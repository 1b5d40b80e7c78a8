"""A folder of masks made without hand work: a picture a frame, and masks.json with the doubt about each."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from freeart21.files import atomic, checked
from freeart21.files.places import MASKS

SCHEMA = "freeart21/masks/1"


def write_masks(
    folder: Path,
    masks: NDArray[np.bool_],
    doubt: NDArray[np.floating],
    reasons: Sequence[str],
    notes: Sequence[str],
    clicks: Sequence[Sequence[float]] = (),
) -> None:
    """Write masks (n, h, w) as 00000.png and so on, and masks.json.

    Args:
        folder: An older one is replaced.
        masks: True on the object.
        doubt: (n,) 0 to 1.
        reasons: (n,) causes of the doubts.
        notes: On the whole video.
        clicks: Frame, column, row, and 1 for the object or 0, of every click of the user.
    """
    with atomic.new_folder(folder, MASKS) as aside:
        for i, mask in enumerate(masks):
            atomic.write_bytes(aside / f"{i:05d}.png", checked.encode_png(255 * mask.astype(np.uint8)))
        frames = [{"doubt": round(float(d), 3), "reason": r} for d, r in zip(doubt, reasons, strict=True)]
        body = {"schema": SCHEMA, "notes": list(notes), "clicks": [list(click) for click in clicks], "frames": frames}
        atomic.write_json(aside / "masks.json", body)
