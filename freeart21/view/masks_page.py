"""The page of `freeart21 masks`: the masks' outlines, the most doubtful frames first."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from freeart21.files import atomic
from freeart21.view.document import Section, data_url, document, escape
from freeart21.view.video import encode_jpeg

SHOWN = 24
"""Frames on the page: half of them the most doubtful, the others evenly spread."""
_WIDTH = 480
_OUTLINE = (255, 40, 200)


@dataclass(frozen=True)
class MaskView:
    """One frame on the page."""

    frame: int
    rgb: NDArray[np.uint8]
    """(h, w, 3)."""
    mask: NDArray[np.bool_]
    doubt: float
    reason: str


def choose_frames(doubt: NDArray[np.floating]) -> list[int]:
    """Frames to show: the most doubtful first, then evenly spread ones."""
    worst = [int(i) for i in np.argsort(-doubt, kind="stable")[: SHOWN // 2]]
    rest = [int(i) for i in np.unique(np.linspace(0, len(doubt) - 1, SHOWN // 2).astype(int)) if i not in worst]
    return worst + rest


def write_masks_page(views: Sequence[MaskView], out: Path, title: str, notes: Sequence[str], lead: str) -> None:
    """Write one file that needs no network: `views` in their order, and what to do by `lead`."""
    tiles = []
    for view in views:
        height = round(_WIDTH * view.mask.shape[0] / view.mask.shape[1])
        picture = cv2.resize(np.ascontiguousarray(view.rgb), (_WIDTH, height), interpolation=cv2.INTER_AREA)
        mask = cv2.resize(view.mask.astype(np.uint8), (_WIDTH, height), interpolation=cv2.INTER_NEAREST)
        lines, _ = cv2.findContours(mask, cv2.RETR_LIST, cv2.CHAIN_APPROX_NONE)
        dark = np.where(mask[..., None] > 0, picture, picture // 2).astype(np.uint8)
        cv2.drawContours(dark, lines, -1, _OUTLINE, 2)
        text = f"frame {view.frame}: doubt {view.doubt:.2f}" + (f", {view.reason}" if view.reason else "")
        source = data_url("image/jpeg", encode_jpeg(dark, 80))
        tiles.append(
            f'<figure style="margin:0"><img alt="{escape(text)}" style="width:100%" src="{source}">'
            f"<figcaption>{escape(text)}</figcaption></figure>"
        )
    style = "display:grid;gap:12px;grid-template-columns:repeat(auto-fill,minmax(230px,1fr))"
    grid = f'<div style="{style}">{"".join(tiles)}</div>'
    section = Section("Outlines, the most doubtful frames first", grid, place="full", note=lead)
    atomic.write_bytes(out, document(title, [section], "masks", notices=notes).encode())
