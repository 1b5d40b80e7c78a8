"""The pages of `masks` and `look`: the masks' outlines, the most doubtful frames first; what a video shows, graded."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from freeart21.files import atomic
from freeart21.view.document import Markup, Section, data_url, document
from freeart21.view.tables import table_section
from freeart21.view.video import encode_jpeg

SHOWN = 24
"""Frames on the page: half of them the most doubtful, the others evenly spread."""
WIDTH = 480
OUTLINE = (255, 40, 200)


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


def lit_up(picture: NDArray[np.uint8], mask: NDArray[np.uint8], thick: int = 2) -> NDArray[np.uint8]:
    """(h, w, 3) the picture, darker outside of the mask (h, w), and with its outline."""
    lines, _ = cv2.findContours(mask, cv2.RETR_LIST, cv2.CHAIN_APPROX_NONE)
    dark = np.where(mask[..., None] > 0, picture, picture // 2).astype(np.uint8)
    return np.asarray(cv2.drawContours(dark, lines, -1, OUTLINE, thick), np.uint8)


def write_masks_page(views: Sequence[MaskView], out: Path, title: str, notes: Sequence[str], lead: str) -> None:
    """Write the page: `views` in their order, and what to do by `lead`."""
    pictures = []
    for view in views:
        size = WIDTH, round(WIDTH * view.mask.shape[0] / view.mask.shape[1])
        picture = cv2.resize(np.ascontiguousarray(view.rgb), size, interpolation=cv2.INTER_AREA).astype(np.uint8)
        mask = cv2.resize(view.mask.astype(np.uint8), size, interpolation=cv2.INTER_NEAREST).astype(np.uint8)
        text = f"frame {view.frame}: doubt {view.doubt:.2f}" + (f", {view.reason}" if view.reason else "")
        pictures.append((text, lit_up(picture, mask)))
    section = Section("Outlines, the most doubtful frames first", _gallery(pictures), place="full", note=lead)
    atomic.write_bytes(out, document(title, [section], "masks", notices=notes).encode())


def write_look_page(rows: Sequence[tuple[str, str, str, str]], sheet: NDArray[np.uint8], out: Path, title: str) -> None:
    """Write the page of what a video shows.

    Args:
        rows: Property, its value, its grade ('good', 'poor', 'bad'), and what to do.
        sheet: (h, w, 3) RGB contact sheet.
        out: The page.
        title: Of the page.
    """
    note = "Outlined: the mask. Below: depth inside it."
    sections = [
        table_section("What it shows", rows, ["property", "measured", "", "what to do"], "full"),
        Section("Frames, masks and depth", _gallery([("contact sheet", sheet)]), place="full", note=note),
    ]
    notices = [f"{what}: {value}. {advice}" for what, value, grade, advice in rows if grade == "bad"]
    atomic.write_bytes(out, document(title, sections, "video", notices=notices).encode())


def _gallery(pictures: Sequence[tuple[str, NDArray[np.uint8]]]) -> Markup:
    """Pictures with a line of text each, as many beside each other as there is room for."""
    figure = Markup('<figure><img alt="{0}" src="{1}"><figcaption>{0}</figcaption></figure>')
    figures = (figure.format(text, data_url("image/jpeg", encode_jpeg(image, 82))) for text, image in pictures)
    return Markup('<div class="gallery">{}</div>').format(Markup("").join(figures))
