"""Compact arrays for display: integers, differences, variable-length bytes, DEFLATE, base64.

`Packed` collects the arrays of one page and becomes a script that the page loads; `static/packed.js` reads it. Equal
arrays are stored once.
"""

from __future__ import annotations

import base64
import json
import zlib
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from freeart21.mesh import Mesh

LEVELS = 4095
"""Quantisation steps along the longest side of a mesh's bounding box."""
POSE_STEP = 1.0 / 4095
"""Quantisation of rotation entries, and of translations relative to the largest."""
STATE_LEVELS = 4095
"""Quantisation steps over the range of joint states."""


def varints(values: ArrayLike) -> bytes:
    """Integers (n,) as zigzag variable-length bytes, seven bits each, lowest first (as in Protocol Buffers)."""
    v = np.asarray(values, np.int64).reshape(-1)
    rest = ((v << 1) ^ (v >> 63)).astype(np.uint64)
    columns, more = [], []
    while True:
        columns.append((rest & np.uint64(127)).astype(np.uint8))
        rest = rest >> np.uint64(7)
        more.append(rest > 0)
        if not more[-1].any():
            break
    table = np.stack([c | (m.astype(np.uint8) << 7) for c, m in zip(columns, more, strict=True)], 1)
    used = np.ones(table.shape, bool)
    for k in range(1, len(more)):
        used[:, k] = more[k - 1] & used[:, k - 1]
    return table[used].tobytes()


class Packed:
    """The arrays of one page. A packed array is a dictionary with its kind under '$', which the scripts replace."""

    def __init__(self) -> None:
        self._data = bytearray()
        self._places: dict[bytes, list[int]] = {}

    def place(self, values: ArrayLike) -> list[int]:
        """Stores integers (n,); returns [first byte, number of bytes]."""
        data = varints(values)
        if data not in self._places:
            self._places[data] = [len(self._data), len(data)]
            self._data += data
        return self._places[data]

    def curve(self, values: ArrayLike, low: float, step: float) -> dict[str, Any]:
        """Numbers (n,) as `low` plus multiples of `step`."""
        levels = np.rint((np.asarray(values, float) - low) / step).astype(np.int64)
        return {"$": "curve", "low": low, "step": step, "at": self.place(np.diff(levels, prepend=0))}

    def states(self, values: ArrayLike) -> dict[str, Any]:
        """Joint states (n,), rad or m."""
        v = np.asarray(values, float)
        low, step = _rounded(float(v.min())), _rounded(max(float(np.ptp(v)) / STATE_LEVELS, 1e-9))
        return self.curve(v, low, step)

    def poses(self, Ts: ArrayLike) -> dict[str, Any]:
        """Rigid poses (n, 4, 4): the twelve entries of [R t], each a curve over the frames."""
        T = np.asarray(Ts, float)[:, :3].reshape(-1, 12)
        scale = np.ones(12)
        scale[3::4] = _rounded(max(float(np.abs(T[:, 3::4]).max(initial=0.0)), 1e-6))
        columns = [self.curve(T[:, k] / scale[k], 0.0, POSE_STEP) for k in range(12)]
        return {"$": "poses", "scale": scale.tolist(), "columns": columns}

    def lines(self, ends: ArrayLike) -> dict[str, Any]:
        """Line segments (n, 2, 2), pixels, to a tenth of a pixel; null where NaN."""
        table = np.asarray(ends, float).reshape(-1, 4)
        gaps = ~np.isfinite(table).all(1)
        columns = [self.curve(np.where(gaps, 0.0, table[:, k]), 0.0, 0.1) for k in range(4)]
        return {"$": "lines", "gaps": {"$": "integers", "at": self.place(gaps)}, "columns": columns}

    def mesh(self, mesh: Mesh) -> dict[str, Any]:
        """Triangles, with vertices to 1 / `LEVELS` of the longest side of their bounding box."""
        used, faces = np.unique(mesh.faces, return_inverse=True)
        places, faces = mesh.vertices[used], faces.reshape(-1, 3)
        low = places.min(0) if len(places) else np.zeros(3)
        step = max(float(np.ptp(places, axis=0).max()) / LEVELS if len(places) else 0.0, 1e-9)
        low, step = np.array([_rounded(float(x)) for x in low]), _rounded(step)
        cells, index = np.unique(np.rint((places - low) / step).astype(np.int64), axis=0, return_inverse=True)
        order = _along_curve(cells)  # so that differences are small
        rank = np.empty(len(order), np.int64)
        rank[order] = np.arange(len(order))
        faces = rank[index.reshape(-1)[faces]].reshape(-1, 3)
        faces = faces[(faces != np.roll(faces, 1, axis=1)).all(1)]
        first = faces.argmin(1)
        faces = np.take_along_axis(faces, (first[:, None] + np.arange(3)) % 3, 1)  # the smallest first, same order
        faces = faces[np.lexsort(faces.T[::-1])]
        vertices = np.diff(cells[order], axis=0, prepend=np.zeros((1, 3), np.int64))
        steps = np.column_stack([np.diff(faces[:, 0], prepend=0), faces[:, 1:] - faces[:, :1]])
        places_at, faces_at = self.place(vertices.T), self.place(steps.T)
        return {"$": "mesh", "low": low.tolist(), "step": step, "vertices": places_at, "faces": faces_at}

    def labels(self, frames: NDArray[np.uint8]) -> dict[str, Any]:
        """Label maps (n, height, width) of 0, 1, 2 as runs in reading order: three times the length plus the label."""
        runs: list[NDArray[np.int64]] = []
        for frame in frames:
            flat = frame.reshape(-1)
            ends = np.append(np.flatnonzero(np.diff(flat)) + 1, len(flat))
            runs.append(3 * np.diff(ends, prepend=0) + flat[ends - 1])
        return {"$": "integers", "at": self.place(np.concatenate(runs) if runs else [])}

    def script(self, header: dict[str, Any]) -> str:
        """A script that defines `header` and all arrays for `static/packed.js`."""
        text = json.dumps(header, allow_nan=False, separators=(",", ":"), sort_keys=True).encode()
        body = zlib.compress(len(text).to_bytes(4, "little") + text + bytes(self._data), 9)
        return f'var FreeArtPacked="{base64.b64encode(body).decode("ascii")}";\n'


def _rounded(value: float) -> float:
    return float(f"{value:.6g}")


def _along_curve(cells: NDArray[np.int64]) -> NDArray[np.int64]:
    """The order of integer points (n, 3) along a Z-order curve (Morton 1966)."""
    key = np.zeros(len(cells), np.int64)
    for bit in range(12):
        for axis in range(3):
            key |= ((cells[:, axis] >> bit) & 1) << (3 * bit + axis)
    return np.argsort(key, kind="stable")
