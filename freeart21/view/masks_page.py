"""The pages of `masks` and `look`: the masks' outlines, the most doubtful frames first; what a video shows, graded."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from freeart21.files import atomic
from freeart21.files.masks import Masks
from freeart21.recording import Recording
from freeart21.view.document import Markup, Section, document
from freeart21.view.tables import table_section
from freeart21.view.video import jpeg_url

SHOWN = 24
"""Frames on the page: half of them the most doubtful, the others evenly spread."""
WIDTH = 480
OUTLINE = (255, 40, 200)


def lit_up(picture: NDArray[np.uint8], mask: NDArray[np.uint8], thick: int = 2) -> NDArray[np.uint8]:
    """(h, w, 3) the picture, darker outside of the mask (h, w), and with its outline."""
    lines, _ = cv2.findContours(mask, cv2.RETR_LIST, cv2.CHAIN_APPROX_NONE)
    dark = np.where(mask[..., None] > 0, picture, picture // 2).astype(np.uint8)
    return np.asarray(cv2.drawContours(dark, lines, -1, OUTLINE, thick), np.uint8)


def write_masks_page(recording: Recording, made: Masks, out: Path, notes: Sequence[str], lead: str) -> None:
    """Write the page: the most doubtful frames first, then evenly spread ones, and what to do by `lead`."""
    worst = [int(i) for i in np.argsort(-made.doubt, kind="stable")[: SHOWN // 2]]
    rest = [int(i) for i in np.unique(np.linspace(0, len(made.doubt) - 1, SHOWN // 2).astype(int)) if i not in worst]
    pictures = []
    for i in worst + rest:
        size = WIDTH, round(WIDTH * made.masks.shape[1] / made.masks.shape[2])
        picture = cv2.resize(np.ascontiguousarray(recording.frame(i).rgb), size, interpolation=cv2.INTER_AREA)
        mask = cv2.resize(made.masks[i].astype(np.uint8), size, interpolation=cv2.INTER_NEAREST).astype(np.uint8)
        text = f"frame {i}: doubt {made.doubt[i]:.2f}" + (f", {made.reasons[i]}" if made.reasons[i] else "")
        pictures.append((text, lit_up(picture.astype(np.uint8), mask)))
    section = Section("Outlines, the most doubtful frames first", _gallery(pictures), place="full", note=lead)
    atomic.write_bytes(out, document(recording.name, [section], "masks", notices=notes).encode())


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
    figures = (figure.format(text, jpeg_url(image, 82)) for text, image in pictures)
    return Markup('<div class="gallery">{}</div>').format(Markup("").join(figures))
