"""A part that the asset lacks: measured points beyond the asset that keep their place on one of its parts.

A hand comes and goes; a part is there whenever its place is visible.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from freeart21 import se3
from freeart21.camera import Camera
from freeart21.recording import Recording
from freeart21.se3 import Array
from simgap.film.samples import Rows
from simgap.film.scene import FilmScene

CELLS = 30
"""Cells along the object's diagonal; a cell is larger than the errors of poses and depth (1 % of the diagonal)."""
LEAST_SHARE = 0.01
"""Least share of the object's pixels that it covers in frames that show it; less is a mask's rim."""
MIN_PRESENCE = 0.6
"""Share of the frames that see a cell in which it must be occupied."""
LEAST_FRAMES = 4
LEAST_CELLS = 3
MIN_EXPLAINED = 0.5
"""Share of the confirming frames' excess points that must lie in the cells."""


@dataclass(frozen=True)
class MissingPart:
    """Something rigidly attached to a part of the asset, which it lacks."""

    part: str
    """'reference' or 'moving'."""
    middle_m: Array
    """(3,) metres, canonical frame at state zero."""
    size_m: Array
    """(3,) metres: sides of its bounding box."""
    frames: int
    """Confirming frames that show it."""
    share_explained: float
    """Share of the confirming frames' excess points that lie in it."""
    share_of_pixels: float
    """Share of the object's pixels that it covers in such frames."""


def find_missing_part(
    recording: Recording,
    scene: FilmScene,
    rows: Rows,
    split: tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.int64]],
) -> MissingPart | None:
    """The excess points that keep their place on a part; None without any."""
    learn = np.sort(np.concatenate(split[:2]))
    counts = np.array([len(f.excess) for f in rows.frames])
    if (counts[learn] > 5).sum() < LEAST_FRAMES:
        return None
    cell = scene.diagonal / CELLS
    found = []
    for k, name in enumerate(("reference", "moving")):
        cells = _persistent_cells(recording, scene, rows, learn, k, cell)
        if len(cells) >= LEAST_CELLS:
            explained, frames, pixels = _explained_share(rows, scene, split[2], k, cells, cell)
            found.append((explained, name, cells, frames, pixels))
    if not found:
        return None
    explained, name, cells, frames, pixels = max(found, key=lambda f: f[0])
    if explained < MIN_EXPLAINED or frames < 2 or pixels < LEAST_SHARE:
        return None
    low, high = cells.min(0) * cell, (cells.max(0) + 1) * cell
    return MissingPart(name, (low + high) / 2, high - low, frames, explained, pixels)


def _excess_cells(rows: Rows, scene: FilmScene, i: int, k: int, cell: float) -> NDArray[np.int64]:
    """(m, 3) cells of a frame's excess points in the frame of part `k`."""
    frame = rows.frames[i]
    return np.floor(se3.transform(se3.inverse(scene.placed.Ts[k][frame.frame]), frame.excess) / cell).astype(int)


def _persistent_cells(
    recording: Recording, scene: FilmScene, rows: Rows, learn: NDArray[np.int64], k: int, cell: float
) -> NDArray[np.int64]:
    """(m, 3) cells of part `k` that are occupied in most frames that see them."""
    shown: dict[tuple[int, ...], int] = {}
    for i in learn:
        for place in {tuple(p) for p in _excess_cells(rows, scene, int(i), k, cell).tolist()}:
            shown[place] = shown.get(place, 0) + 1
    cells = np.array([place for place, times in shown.items() if times >= LEAST_FRAMES], int).reshape(-1, 3)
    if not len(cells):
        return cells
    empty = np.zeros(len(cells))
    for i in learn:
        frame = recording.frame(rows.frames[int(i)].frame)
        points = se3.transform(scene.placed.Ts[k][rows.frames[int(i)].frame], (cells + 0.5) * cell)
        empty += _is_empty(recording.camera, frame.depth, frame.mask, points, cell)
    times = np.array([shown[tuple(c)] for c in cells.tolist()])
    return np.asarray(cells[times / (times + empty) >= MIN_PRESENCE])


def _is_empty(
    camera: Camera, depth: NDArray[Any], mask: NDArray[np.bool_], points: Array, cell: float
) -> NDArray[np.bool_]:
    """Whether the picture shows something behind each point, or nothing of the object there."""
    at = np.floor(camera.project(points)).astype(int)
    inside = (at[:, 0] >= 0) & (at[:, 1] >= 0) & (at[:, 0] < camera.width) & (at[:, 1] < camera.height)
    out = np.zeros(len(points), bool)
    u, v = at[inside, 0], at[inside, 1]
    behind = depth[v, u] > points[inside, 2] + 2 * cell
    nothing = ~mask[v, u] & ((depth[v, u] == 0) | behind)
    out[inside] = behind | nothing
    return out


def _explained_share(
    rows: Rows, scene: FilmScene, frames: NDArray[np.int64], k: int, cells: NDArray[np.int64], cell: float
) -> tuple[float, int, float]:
    """Share of the frames' excess points in or next to the cells, number of frames that show some, share of pixels."""
    reach = np.stack(np.meshgrid(*[np.arange(-1, 2)] * 3, indexing="ij"), -1).reshape(-1, 3)
    wide = {tuple(c) for c in (cells[:, None] + reach).reshape(-1, 3).tolist()}
    inside, total, seen, shares = 0, 0, 0, []
    for i in frames:
        places = _excess_cells(rows, scene, int(i), k, cell).tolist()
        hits = sum(tuple(p) in wide for p in places)
        inside, total = inside + hits, total + len(places)
        if hits > 5:
            seen += 1
            shares.append(rows.frames[int(i)].excess_pixels * hits / len(places) / max(rows.frames[int(i)].pixels, 1))
    return inside / max(total, 1), seen, float(np.median(shares)) if shares else 0.0
