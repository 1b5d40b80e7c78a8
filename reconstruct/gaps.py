"""Frames in which a part is hidden: what came before and after them is joined anew, and the states there interpolated.

While a part is hidden the growth can only guess its state, and goes on from its guess when the part comes back. All
frames after the gap are then off by one and the same state, because the other part was seen all along: a search over
one number joins them.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import PchipInterpolator

from freeart21 import se3
from freeart21.se3 import Array
from reconstruct.evidence import Evidence, draw
from reconstruct.segmentation import Grown
from reconstruct.settings import GapSettings

Frames = NDArray[np.int64]


def bridge_gaps(evidence: Evidence, grown: Grown, settings: GapSettings, rng: np.random.Generator) -> Grown:
    """`grown` with every stretch after a gap of either part shifted in state to fit the rest, and gaps interpolated."""
    for part in range(2):
        pieces = seen_pieces(grown.seen[:, part], settings)
        if not pieces:
            continue
        joined = max(pieces, key=len)
        for piece in sorted((p for p in pieces if p is not joined), key=lambda p: abs(p.mean() - joined.mean())):
            shift = _best_shift(evidence, grown, part, joined, piece, settings, rng)
            states = grown.poses.states.copy()
            states[piece] += shift
            grown = _with_states(grown, states, part)
            joined = np.concatenate([joined, piece])
        joined = np.sort(joined)
        frames = np.clip(np.arange(len(grown.labels)), joined[0], joined[-1])
        if 1 < len(joined) < len(frames):
            states = grown.poses.states.copy()
            unseen = np.setdiff1d(np.arange(len(frames)), joined)
            states[unseen] = PchipInterpolator(joined, states[joined])(frames[unseen])
            grown = _with_states(grown, states, part)
    return grown


def seen_pieces(seen: NDArray[np.bool_], settings: GapSettings) -> list[Frames]:
    """Runs of frames in which a part is `seen` (n,), parted by gaps worth the name; short runs are left out."""
    frames = np.flatnonzero(seen)
    breaks = np.flatnonzero(np.diff(frames) > settings.shortest_gap) + 1
    return [piece for piece in np.split(frames, breaks) if len(piece) >= settings.shortest_piece]


def _with_states(grown: Grown, states: Array, part: int) -> Grown:
    """`grown` with other states; `part` moves, the other part stays where it is."""
    poses = grown.poses
    Ts = poses.Ts if part == 1 else poses.Ts_moving @ poses.joint.transform(-states)
    joint = replace(poses.joint, lower=float(states.min()), upper=float(states.max()))
    return replace(grown, poses=replace(poses, joint=joint, states=states, Ts=Ts))


def _best_shift(
    evidence: Evidence,
    grown: Grown,
    part: int,
    joined: Frames,
    piece: Frames,
    settings: GapSettings,
    rng: np.random.Generator,
) -> float:
    """The state to add in the frames `piece` so that `part` there agrees best with the frames `joined`; 0 if unsure."""
    most = max(float(np.ptp(grown.poses.states[joined])), float(np.ptp(grown.poses.states[piece])))
    shifts, best, costs = np.linspace(-most, most, 2 * settings.steps + 1), 0.0, np.zeros(0)
    sample = _Pairs(evidence, grown, part, joined, piece, settings, rng)
    for _ in range(2):
        costs = sample.costs(np.append(best + shifts, 0.0))
        best = float((best + shifts)[costs[:-1].argmin()])
        shifts = np.linspace(-1.5, 1.5, 25) * most / settings.steps
    return best if costs.min() < (1 - settings.least_gain) * costs[-1] else 0.0


class _Pairs:
    """Pixels of one part in frames of two pieces, and what they cost in each other's frames."""

    def __init__(
        self,
        evidence: Evidence,
        grown: Grown,
        part: int,
        joined: Frames,
        piece: Frames,
        settings: GapSettings,
        rng: np.random.Generator,
    ) -> None:
        self.evidence, self.poses, self.part = evidence, grown.poses, part
        self.sides = tuple(_spread(frames, settings.frames) for frames in (joined, piece))
        self.pixels = {
            int(i): draw(evidence.usable(i, grown.labels[i] == part + 1), settings.samples, rng)
            for frames in self.sides
            for i in frames
        }

    def costs(self, shifts: Array) -> Array:
        """(m,) mean cost of all pixels for each of `shifts` (m,) of the second piece's states."""
        fixed, moved = self.sides
        there = self.poses.Ts_moving if self.part == 0 else self.poses.Ts
        states = self.poses.states[moved][:, None] + shifts
        turned = self.poses.joint.transform(states if self.part == 1 else -states)
        Ts_moved = there[moved][:, None] @ turned
        Ts_fixed = (self.poses.Ts, self.poses.Ts_moving)[self.part][fixed]
        found = []
        for T, i in zip(Ts_fixed, fixed, strict=True):
            found.append(self._one(int(i), moved, Ts_moved @ se3.inverse(T)))
        for T, i in zip(Ts_moved, moved, strict=True):
            found.append(self._one(int(i), fixed, Ts_fixed[:, None] @ se3.inverse(T)[None]))
        return np.concatenate(found).mean(0)

    def _one(self, frame: int, others: Frames, Ts: Array) -> Array:
        """(p, m) costs of one frame's pixels under motions (s, m, 4, 4) to other frames."""
        return self.evidence.costs(frame, others, Ts, self.pixels[frame]).mean(1)


def _spread(frames: Frames, most: int) -> Frames:
    """At most `most` frames, evenly drawn."""
    return frames[np.unique(np.linspace(0, len(frames) - 1, most).round().astype(int))]
