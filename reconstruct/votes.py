"""Beliefs of all frames together about each surface: a surface point never changes its part.

Every pixel is placed on both parts, in each part's own frame, by that part's motion. On its own part it meets its other
observations; on the other part it meets whatever passed there, which disagrees unless it belongs to that part.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from freeart21 import se3
from freeart21.se3 import Array, Floats
from reconstruct.evidence import Evidence, fill_between

CELL = 3.0
"""Edge of a surface cell, in units of `Evidence.unit`."""
_HALF = 2**18
"""Cells on either side of the origin."""
_PRIOR_WEIGHT = 8.0
"""Weight, in certain pixels, of belief 0 in every cell."""


class SurfaceVotes:
    """The measured pixels of all frames, sorted into cells of both parts' surfaces by position and normal direction."""

    def __init__(self, evidence: Evidence, Ts: Array, voting: NDArray[np.bool_]) -> None:
        """`Ts` (2, n, 4, 4) are both parts' poses; only the frames `voting` (n, 2) count for a part's surface."""
        scene, self._size = evidence.scene, CELL * evidence.unit
        self._measured = [evidence.measured_pixels(i) for i in range(len(scene))]
        self._ends = np.cumsum([0, *(m.sum() for m in self._measured)])
        self._voting = [np.repeat(voting[:, k], np.diff(self._ends)) for k in (0, 1)]
        self._cells = [self._sort_into_cells(evidence, T) for T in Ts]

    def _sort_into_cells(self, evidence: Evidence, T: Array) -> NDArray[np.int32]:
        """(p,) the cell of every measured pixel on the part with the poses `T` (n, 4, 4)."""
        keys = np.empty(self._ends[-1], np.int64)
        for i, here in enumerate(self._measured):
            to_part = se3.inverse(T[i])
            cell = np.floor(se3.transform(to_part, evidence.scene.points[i][here]) / self._size).astype(np.int64)
            normal = evidence.scene.normals[i][here] @ to_part[:3, :3].T
            axis = np.abs(normal).argmax(1)
            direction = 2 * axis + (np.take_along_axis(normal, axis[:, None], 1)[:, 0] > 0)
            x, y, z = np.clip(cell + _HALF, 0, 2 * _HALF - 1).T
            keys[self._ends[i] : self._ends[i + 1]] = ((x << 38) | (y << 19) | z) * 6 + direction
        order = keys.argsort(kind="stable")
        cells = np.zeros(len(keys), np.int32)
        cells[order[1:]] = np.cumsum(np.diff(keys[order]) > 0, dtype=np.int32)
        return cells

    def surface_beliefs(self, logodds: Floats, sure: float) -> Floats:
        """(p,) belief, -1 (first part) to 1, about the surface under every measured pixel, from `logodds` (n, h, w).

        A pixel's vote is weighted by its certainty, 1 at log-odds of `sure`.
        """
        own = np.concatenate([found[here] for found, here in zip(logodds, self._measured, strict=True)])
        own = np.clip(own / sure, -1, 1)
        total = np.zeros(len(own), np.float32)
        for cells, voting in zip(self._cells, self._voting, strict=True):
            weight = np.where(voting, np.abs(own), 0)
            sums, weights = np.bincount(cells, weight * own), np.bincount(cells, weight)
            total += 0.5 * (sums / (weights + _PRIOR_WEIGHT)).astype(np.float32)[cells]
        return total

    def frame_beliefs(self, beliefs: Floats, frame: int) -> Floats:
        """The `beliefs` (p,) of all measured pixels as an image (h, w) of one frame."""
        found = np.zeros(self._measured[frame].shape, np.float32)
        found[self._measured[frame]] = beliefs[self._ends[frame] : self._ends[frame + 1]]
        return fill_between(found, self._measured[frame])
