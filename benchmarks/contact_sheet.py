"""All answers of a results folder beside a frame of their video, to be looked at: the picture of docs/results.md.

    .venv/bin/python -m benchmarks.contact_sheet --data out/freeart21-v1 --results out/reconstruct/public/results/ours

takes the middle frame and the asset's preview.png (closed and open), and writes one JPEG.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from PIL import Image, ImageDraw, ImageFont

from benchmarks.common import ROOT, run_cli
from freeart21.errors import FreeArtError
from freeart21.files.benchmark import read_benchmark
from freeart21.files.sequence import read_sequence

HEIGHT, COLUMNS, LABEL = 150, 3, 22
"""Pixels of a picture and of the line above it; objects side by side."""


def tile(frame: Image.Image, preview: Image.Image, name: str) -> Image.Image:
    """The frame and the preview, equally high, under the object's name."""
    both = [picture.resize((round(picture.width * HEIGHT / picture.height), HEIGHT)) for picture in (frame, preview)]
    made = Image.new("RGB", (sum(picture.width for picture in both), HEIGHT + LABEL), "white")
    ImageDraw.Draw(made).text((4, 3), name, "black", ImageFont.load_default(14))
    made.paste(both[0], (0, LABEL))
    made.paste(both[1], (both[0].width, LABEL))
    return made


def main(data: Path, results: Path, out: Path = ROOT / "docs" / "assets.jpg") -> None:
    """Write the sheet.

    Args:
        data: Data folder.
        results: Results folder of the same sequences, with assets.
        out: The picture.
    """
    tiles = []
    for name in read_benchmark(data).sequences:
        preview = results / name / "asset" / "preview.png"
        if preview.is_file():
            recording = read_sequence(data / "sequences" / name)
            frame = Image.fromarray(np.ascontiguousarray(recording.frame(len(recording) // 2).rgb))
            tiles.append(tile(frame, Image.open(preview).convert("RGB"), name.removesuffix("-v1")))
    if not tiles:
        raise FreeArtError(f"{results} has the preview of an asset of none of the sequences of {data}")
    width, height = max(t.width for t in tiles) + 6, HEIGHT + LABEL + 6
    sheet = Image.new("RGB", (COLUMNS * width, -(-len(tiles) // COLUMNS) * height), "white")
    for i, made in enumerate(tiles):
        sheet.paste(made, (i % COLUMNS * width, i // COLUMNS * height))
    sheet.save(out, quality=82)
    print(f"{out}: {len(tiles)} objects, {sheet.width} x {sheet.height}, {out.stat().st_size / 1e3:.0f} kB")


if __name__ == "__main__":
    run_cli(main)
