"""The page of `freeart21 look`: what a video shows, with grades, and its contact sheet."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from freeart21.files import atomic
from freeart21.view.document import Section, data_url, document
from freeart21.view.tables import table
from freeart21.view.video import encode_jpeg


def write_look_page(rows: Sequence[tuple[str, str, str, str]], sheet: NDArray[np.uint8], out: Path, title: str) -> None:
    """Write one file that needs no network.

    Args:
        rows: Property, its value, its grade ('good', 'poor', 'bad'), and what to do.
        sheet: (h, w, 3) RGB contact sheet.
        out: The page.
        title: Of the page.
    """
    source = data_url("image/jpeg", encode_jpeg(sheet, 85))
    picture = f'<img alt="contact sheet" style="width:100%" src="{source}">'
    sections = [
        Section("What it shows", table(rows, ["property", "measured", "", "what to do"]), place="full"),
        Section("Frames, masks and depth", picture, place="full", note="Outlined: the mask. Below: depth inside it."),
    ]
    notices = [f"{what}: {value}. {advice}" for what, value, grade, advice in rows if grade == "bad"]
    atomic.write_bytes(out, document(title, sections, "video", notices=notices).encode())
