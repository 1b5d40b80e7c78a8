"""What all frames together believe of a surface: no point of it ever changes its part.

A pixel is laid on both parts, each in its own frame, under that part's motion. What other pixels there believe speaks
for or against it: on its own part it meets itself, as seen in all the other frames; on the other part it meets whatever
passed there, which contradicts unless it is truly that part's.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from freeart21 import se3
from freeart21.se3 import Array
from reconstruct.evidence import Evidence, spread

Floats = NDArray[np.float32]

_HALF = 2**18  # cells on either side of the origin
_HUSH = 8.0  # pixels' worth of not knowing in every cell


class SurfaceVotes:
    """The measured pixels of all frames, sorted into cells of both parts' surfaces; cells that face apart are apart."""

    def __init__(self, evidence: Evidence, Ts: Array, voting: NDArray[np.bool_]) -> None:
        """`Ts` (2, n, 4, 4) are both parts' poses; only frames `voting` (n, 2) have a say on a part's surface."""
        scene, self._size = evidence.scene, evidence.label_settings.vote_cell * evidence.unit
        self._measured = [evidence.measured(i) for i in range(len(scene))]
        self._ends = np.cumsum([0, *(m.sum() for m in self._measured)])
        self._voting = [np.repeat(voting[:, k], np.diff(self._ends)) for k in (0, 1)]
        self._cells = [self._sorted(evidence, T) for T in Ts]

    def _sorted(self, evidence: Evidence, T: Array) -> NDArray[np.int32]:
        """(p,) the cell of every measured pixel, on a part that has the poses `T` (n, 4, 4)."""
        keys = np.empty(self._ends[-1], np.int64)
        for i, here in enumerate(self._measured):
            back = se3.inverse(T[i])
            cell = np.floor(se3.transform(back, evidence.scene.points[i][here]) / self._size).astype(np.int64)
            normal = evidence.scene.normals[i][here] @ back[:3, :3].T
            along = np.abs(normal).argmax(1)
            way = 2 * along + (np.take_along_axis(normal, along[:, None], 1)[:, 0] > 0)
            cell = np.clip(cell + _HALF, 0, 2 * _HALF - 1)
            keys[self._ends[i] : self._ends[i + 1]] = ((cell[:, 0] << 38) | (cell[:, 1] << 19) | cell[:, 2]) * 6 + way
        order = keys.argsort(kind="stable")
        cells = np.zeros(len(keys), np.int32)
        cells[order[1:]] = np.cumsum(np.diff(keys[order]) > 0, dtype=np.int32)
        return cells

    def beliefs(self, logodds: Floats, sure: float) -> Floats:
        """(p,) what the surface under every measured pixel is believed to be, given all `logodds` (n, h, w).

        From -1 (surely the first part) to 1; log-odds of `sure` know. Who is surer is louder.
        """
        mine = np.concatenate([found[here] for found, here in zip(logodds, self._measured, strict=True)])
        mine = np.clip(mine / sure, -1, 1)
        total = np.zeros(len(mine), np.float32)
        for cells, voting in zip(self._cells, self._voting, strict=True):
            loud = np.where(voting, np.abs(mine), 0)
            said, size = np.bincount(cells, loud * mine), np.bincount(cells, loud)
            total += 0.5 * (said / (size + _HUSH)).astype(np.float32)[cells]
        return total

    def in_frame(self, beliefs: Floats, frame: int) -> Floats:
        """The `beliefs` (p,) of all measured pixels as a picture (h, w) of one frame."""
        found = np.zeros(self._measured[frame].shape, np.float32)
        found[self._measured[frame]] = beliefs[self._ends[frame] : self._ends[frame + 1]]
        return spread(found, self._measured[frame])
