"""Re-segmentation of stretches in which tracking was lost, from a seed within the stretch.

The new piece has its own part names and canonical frame. In frames where both are reliable, one part of the piece is
aligned with one part of the propagation; the other part may still be off by one constant state, which is searched. All
pairings of parts, on either side of the stretch, are tried; the dense cost decides.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from freeart21 import se3
from freeart21.se3 import Array
from reconstruct.evidence import sample_evenly
from reconstruct.gaps import FRAMES, SAMPLES, STATE_STEPS
from reconstruct.kernels import HIDDEN
from reconstruct.propagation import AGREEING_FRAMES, AGREEMENT, MAX_TURN_DEG, Propagation
from reconstruct.recovery import MIN_GAIN
from reconstruct.rigid import view_angle

Frames = NDArray[np.int64]

LOST_COST = 2.5
"""A frame that costs more than this times the median is lost."""
UNRELIABLE_SHARE = 0.15
"""Share of frames that cost so much more than the best quarter from which a whole propagation is unreliable."""
SHORTEST = 8
"""Fewer lost frames in a run are left as they are."""
BETTER = 0.85
"""Cost of the new segmentation, relative to the present one, below which it is taken."""


@dataclass(frozen=True)
class _Alignment:
    """A piece expressed in the parts and frame of the propagation."""

    swap: bool
    """Whether the piece's first part is the propagation's second."""
    frames: Frames
    """(m,) of the piece."""
    Ts: Array
    """(m, 4, 4) reference part in those frames."""
    states: Array
    """(m,)"""
    cost: float


def find_lost_stretches(propagation: Propagation) -> list[Frames]:
    """Runs of frames that cost far more than the median, extended over their unreliable neighbours; the costliest
    first.

    A frame that costs less than if all of it were hidden is never lost.
    """
    costs = propagation.costs
    if not np.isfinite(costs).any():
        return []
    bad = np.flatnonzero(costs > max(HIDDEN, LOST_COST * np.nanmedian(costs)))
    runs = [run for run in np.split(bad, np.flatnonzero(np.diff(bad) > SHORTEST) + 1) if len(run) >= SHORTEST]
    lost_mask = ~_reliable_frames(propagation)
    for run in runs:
        lost_mask[run[0] : run[-1]] = True
    edges = np.flatnonzero(np.diff(np.concatenate([[False], lost_mask, [False]])))
    wider = [np.arange(first, end) for first, end in edges.reshape(-1, 2) if any(first <= r[0] < end for r in runs)]
    return sorted(wider, key=lambda run: -float(np.nansum(costs[run])))


def is_unreliable(propagation: Propagation) -> bool:
    """Whether many frames cost far more than the best quarter, and more than half of what a hidden frame costs."""
    costs = propagation.costs[np.isfinite(propagation.costs)]
    if len(costs) == 0:
        return False
    return bool((costs > max(0.5 * HIDDEN, LOST_COST * np.percentile(costs, 25))).mean() > UNRELIABLE_SHARE)


def _reliable_frames(propagation: Propagation) -> NDArray[np.bool_]:
    """(n,) frames done whose cost is not surprisingly high."""
    surprising = propagation.settings.growth.surprising_cost * np.nanmedian(propagation.costs)
    return propagation.done & ~(propagation.costs > surprising)


def replace_stretch(propagation: Propagation, piece: Propagation, stretch: Frames) -> bool:
    """Replace the frames of `stretch` by those of `piece` if they then cost much less; returns whether they do.

    Beyond the stretch the piece is used until both agree.
    """
    assert propagation.joint is not None and piece.joint is not None
    if propagation.joint.type != piece.joint.type:
        return False
    reliable = np.setdiff1d(np.flatnonzero(_reliable_frames(propagation)), stretch)
    tested = sample_evenly(np.intersect1d(stretch, np.flatnonzero(piece.done)), FRAMES)
    found = []
    for side in (reliable[reliable < stretch[0]], reliable[reliable > stretch[-1]]):
        common = side[piece.done[side]]
        near = common[np.argsort(np.minimum(abs(common - stretch[0]), abs(common - stretch[-1])), kind="stable")][:12]
        if len(near) == 0:
            continue
        for part in range(2):
            for other in range(2):
                found.append(_align_piece(propagation, piece, part, other, near, tested, reliable))
    best = min(found, key=lambda a: a.cost, default=None)
    if best is None:
        return False
    at = np.searchsorted(best.frames, tested)
    now = _best_explained_cost(propagation, tested, propagation.Ts[0, tested], propagation.states[tested], reliable)
    then = _best_explained_cost(propagation, tested, best.Ts[at], best.states[at], reliable)
    if not then < min(BETTER * now, now - MIN_GAIN):
        return False
    _copy_frames(propagation, piece, best, stretch)
    return True


def _align_piece(
    propagation: Propagation,
    piece: Propagation,
    part: int,
    other: int,
    common: Frames,
    tested: Frames,
    reliable: Frames,
) -> _Alignment:
    """The piece's part `other` aligned with the propagation's `part` over the frames `common`, at the state of least
    cost."""
    assert propagation.joint is not None and piece.joint is not None
    swap = part != other
    X = _medoid_pose(se3.inverse(piece.Ts[other, common]) @ propagation.Ts[part, common], propagation.body_points())
    turned = X[:3, :3].T @ piece.joint.axis
    sign = np.copysign(1.0, turned @ propagation.joint.axis) * (-1 if swap else 1)
    frames = np.flatnonzero(piece.done)
    placed, states = piece.Ts[other, frames] @ X, sign * piece.states[frames]
    at = np.searchsorted(frames, tested)
    middle = float(np.median(propagation.states[common] - sign * piece.states[common]))
    reach, steps = float(np.ptp(propagation.states[reliable])), STATE_STEPS
    shifts, costs = middle + np.linspace(-reach, reach, 2 * steps + 1), np.zeros(0)
    for _ in range(2):
        costs = _state_shift_costs(propagation, piece, part, swap, placed[at], states[at], shifts, tested, reliable)
        best = float(shifts[costs.argmin()])
        shifts = best + np.linspace(-1.5, 1.5, 25) * reach / steps
    states = states + best
    Ts = placed if part == 0 else placed @ propagation.joint.transform(-states)
    return _Alignment(swap, frames, Ts, states, float(costs.min()))


def _medoid_pose(Xs: Array, body: Array) -> Array:
    """The medoid of poses (m, 4, 4), by where they take the points `body` (b, 3)."""
    places = se3.transform(Xs, np.broadcast_to(body, (len(Xs), *body.shape)))
    distance = np.linalg.norm(places[:, None] - places, axis=-1).mean(-1)
    return np.asarray(Xs[np.median(distance, axis=1).argmin()])


def _state_shift_costs(
    propagation: Propagation,
    piece: Propagation,
    part: int,
    swap: bool,
    placed: Array,
    states: Array,
    shifts: Array,
    tested: Frames,
    reliable: Frames,
) -> Array:
    """(s,) mean cost of the piece's pixels in the frames `tested` against the `reliable` ones, at `states` plus
    `shifts` (s,).

    The propagation's `part` has the poses `placed` (m, 4, 4) in these frames.
    """
    assert propagation.joint is not None
    found = []
    for i, T, q in zip(tested, placed, states, strict=True):
        for k in range(2):
            there = T[None]
            if k != part:
                there = T @ propagation.joint.transform(q + shifts if k else -(q + shifts))
            pixels = piece.samples[1 - k if swap else k][int(i)]
            cost = _pixel_costs(propagation, k, int(i), there, pixels, reliable)
            found.append(np.broadcast_to(cost, (len(cost), len(shifts))))
    every = np.concatenate(found) if found else np.zeros((0, len(shifts)))
    return np.asarray(every.mean(0)) if len(every) else np.full(len(shifts), np.inf)


def _best_explained_cost(propagation: Propagation, tested: Frames, Ts: Array, states: Array, reliable: Frames) -> float:
    """Mean cost of all pixels of the frames `tested`, each as the part that explains it better, whatever its label."""
    found = []
    for i, T, q in zip(tested, Ts, states, strict=True):
        pixels = np.argwhere(propagation.evidence.scene.valid[i])
        costs = [
            _pixel_costs(propagation, k, int(i), T_k[None], pixels, reliable)[:, 0]
            for k, T_k in enumerate(propagation.part_poses(T, q))
        ]
        costs = [c for c in costs if len(c)]
        if costs:
            found.append(np.min(costs, axis=0))
    return float(np.concatenate(found).mean()) if found else np.inf


def _pixel_costs(
    propagation: Propagation, part: int, frame: int, Ts: Array, pixels: NDArray[Any], reliable: Frames
) -> Array:
    """(p, s) costs of pixels of `frame` with `part` at `Ts` (s, 4, 4), in three `reliable` frames of the most similar
    view.

    Empty when no view is similar.
    """
    turn = np.min(
        [view_angle(propagation.Ts[part, reliable, :3, :3], T[:3, :3]) for T in Ts[:: max(1, len(Ts) // 8)]], axis=0
    )
    chosen: list[int] = []
    for c in np.argsort(turn, kind="stable"):
        if len(chosen) == 3 or turn[c] > np.radians(MAX_TURN_DEG):
            break
        if all(abs(reliable[c] - j) > 2 for j in chosen):
            chosen.append(int(reliable[c]))
    some = pixels[:: max(1, len(pixels) // SAMPLES)]
    if not chosen or not len(some):
        return np.zeros((0, len(Ts)))
    others = np.array(sorted(chosen))
    motions = propagation.Ts[part, others][:, None] @ se3.inverse(Ts)
    return propagation.evidence.costs(frame, others, motions, some).mean(1)


def _copy_frames(propagation: Propagation, piece: Propagation, found: _Alignment, stretch: Frames) -> None:
    """Copy the piece's frames of `stretch`, and those beyond it until both agree."""
    at = {int(i): m for m, i in enumerate(found.frames)}
    copied = [int(i) for i in stretch if int(i) in at]
    for i, way in ((int(stretch[0]) - 1, -1), (int(stretch[-1]) + 1, 1)):
        agreeing = 0
        while i in at and agreeing < AGREEING_FRAMES:
            moved = propagation.displacement(i, found.Ts[at[i]], found.states[at[i]])
            agreeing = agreeing + 1 if moved < AGREEMENT * propagation.evidence.unit else 0
            copied.append(i)
            i += way
    for i in copied:
        propagation.set_pose(i, found.Ts[at[i]], float(found.states[at[i]]))
        propagation.set_labels(i, -piece.logodds[i] if found.swap else piece.logodds[i].copy())
        propagation.costs[i] = piece.costs[i]
    propagation.body = None
