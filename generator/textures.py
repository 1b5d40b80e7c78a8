"""Textures drawn by code: small (h, w, 3) uint8 pictures, the same for the same seed."""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np
from numpy.typing import NDArray

Image = NDArray[np.uint8]
Colour = tuple[float, float, float]


def shade(colour: Colour, factor: float, offset: float = 0.0) -> Colour:
    """A darker (or lighter) kin of a colour."""
    r, g, b = (min(1.0, factor * c + offset) for c in colour)
    return r, g, b


def wood(rng: np.random.Generator, light: Colour, dark: Colour, size: int = 512) -> Image:
    """Wood with its grain along u."""
    v, u = np.mgrid[0:size, 0:size] / size
    bend = _noise(rng, size, 3, 3) * 0.55 + _noise(rng, size, 8, 6) * 0.05
    rings = 0.5 + 0.5 * np.sin(2 * np.pi * (11 * v + bend + 0.08 * np.sin(2 * np.pi * u)))
    fibres = _noise(rng, size, 5, 160)
    mix = np.clip(0.25 + 0.45 * rings**2 + 0.35 * fibres, 0, 1)[..., None]
    picture = np.array(light) * (1 - mix) + np.array(dark) * mix
    for _ in range(2):  # knots
        cu, cv = rng.integers(0, size, 2)
        centre, axes = (int(cu), int(cv)), (int(rng.integers(10, 20)), int(rng.integers(5, 9)))
        cv2.ellipse(picture, centre, axes, 0, 0, 360, (np.array(dark) * 0.55).tolist(), -1, cv2.LINE_AA)
    return to_uint8(cv2.GaussianBlur(picture, (0, 0), 0.8))


def brushed_metal(rng: np.random.Generator, colour: Colour, size: int = 256) -> Image:
    """Metal brushed along u."""
    streaks = _noise(rng, size, 6, size) * 0.06 + _noise(rng, size, 2, 64) * 0.03
    return to_uint8(np.array(colour) * (1 + streaks[..., None]))


def speckle(rng: np.random.Generator, colour: Colour, strength: float = 0.12, size: int = 256) -> Image:
    """Moulded plastic or rubber: a fine grain."""
    return to_uint8(
        np.array(colour) * (1 + strength * (_noise(rng, size, 96, 96) + 0.5 * _noise(rng, size, 40, 40))[..., None])
    )


def knurl(colour: Colour, lines: int = 10, size: int = 256) -> Image:
    """Two crossing sets of grooves."""
    v, u = np.mgrid[0:size, 0:size] / size
    grooves = np.maximum(np.cos(2 * np.pi * lines * (u + v)), np.cos(2 * np.pi * lines * (u - v)))
    return to_uint8(np.array(colour) * (0.45 + 0.55 * np.clip(grooves, 0, 1)[..., None]))


def stripes(colours: Sequence[Colour], repeats: int, size: int = 256) -> Image:
    """Stripes that change along u."""
    index = (np.arange(size) * repeats * len(colours) // size) % len(colours)
    return to_uint8(np.broadcast_to(np.array(colours)[index][None], (size, size, 3)))


def page_edges(colour: Colour, leaves: int = 24, size: int = 128) -> Image:
    """The edges of a block of paper, one leaf above the other."""
    lines = 0.90 + 0.10 * np.cos(2 * np.pi * leaves * np.arange(size) / size)
    return to_uint8(np.broadcast_to(np.array(colour) * lines[:, None, None], (size, size, 3)))


def plain(colour: Colour) -> Image:
    """One colour all over."""
    return to_uint8(np.broadcast_to(np.array(colour), (4, 4, 3)))


def label(
    lines: Sequence[str],
    paper: Colour | Image,
    ink: Colour,
    aspect: float,
    rng: np.random.Generator | None = None,
    border: bool = True,
    height: int = 256,
) -> Image:
    """A printed label, `aspect` times as wide as high, with one or more lines of text and, given `rng`, a bar code."""
    width = round(height * aspect)
    ground = paper if isinstance(paper, np.ndarray) else plain(paper)
    picture = cv2.resize(ground, (width, height))
    colour = _ink(ink)
    if border:
        cv2.rectangle(picture, (6, 6), (width - 7, height - 7), colour, 4)
    right = width - 24
    if rng is not None:
        right = round(width * 0.72)
        x = right + 10
        while x < width - 28:
            w = int(rng.integers(3, 9))
            cv2.rectangle(picture, (x, round(height * 0.18)), (x + w, round(height * 0.82)), colour, -1)
            x += w + int(rng.integers(4, 10))
    step = (height - 40) / len(lines)
    for i, text in enumerate(lines):
        scale = min(step / 34, (right - 40) / max(1, cv2.getTextSize(text, cv2.FONT_HERSHEY_DUPLEX, 1.0, 2)[0][0]))
        (w, h), _ = cv2.getTextSize(text, cv2.FONT_HERSHEY_DUPLEX, scale, 2)
        at = (round(20 + (right - 20 - w) / 2), round(20 + step * (i + 0.5) + h / 2))
        cv2.putText(picture, text, at, cv2.FONT_HERSHEY_DUPLEX, scale, colour, max(2, round(2.2 * scale)), cv2.LINE_AA)
    return np.asarray(picture, np.uint8)


def emblem(rng: np.random.Generator, ground: Image, ink: Colour, text: str) -> Image:
    """An engraved emblem on a ground texture: a ringed star with a word below."""
    picture = cv2.resize(ground, (320, 320))
    colour, centre = _ink(ink), (160, 130)
    points = int(rng.integers(5, 9))
    for radius, thick in ((96, 5), (82, 2)):
        cv2.circle(picture, centre, radius, colour, thick, cv2.LINE_AA)
    angle = np.pi * np.arange(2 * points) / points - np.pi / 2
    reach = np.where(np.arange(2 * points) % 2 == 0, 74, 32)
    star = np.stack([centre[0] + reach * np.cos(angle), centre[1] + reach * np.sin(angle)], -1)
    cv2.fillPoly(picture, [np.rint(star).astype(np.int32)], colour, cv2.LINE_AA)
    (w, _), _ = cv2.getTextSize(text, cv2.FONT_HERSHEY_TRIPLEX, 1.4, 3)
    cv2.putText(picture, text, (160 - w // 2, 290), cv2.FONT_HERSHEY_TRIPLEX, 1.4, colour, 3, cv2.LINE_AA)
    return np.asarray(picture, np.uint8)


def _ink(colour: Colour) -> tuple[float, ...]:
    return tuple(float(round(255 * c)) for c in colour)


def _noise(rng: np.random.Generator, size: int, cells_u: int, cells_v: int) -> NDArray[np.float64]:
    """Smooth noise in -1 to 1 that tiles, with the given number of cells along u (columns) and v (rows)."""
    grid = rng.uniform(-1, 1, (cells_v, cells_u))
    grid = np.pad(grid, 2, mode="wrap")
    big = cv2.resize(
        grid, (size * (cells_u + 4) // cells_u, size * (cells_v + 4) // cells_v), interpolation=cv2.INTER_CUBIC
    )
    top, left = 2 * size // cells_v, 2 * size // cells_u
    return np.clip(big[top : top + size, left : left + size], -1, 1)


def to_uint8(picture: NDArray[np.float64]) -> Image:
    """Colours from 0 to 1 as bytes."""
    return np.clip(np.rint(picture * 255), 0, 255).astype(np.uint8)
