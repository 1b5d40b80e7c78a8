"""Where growth lost its way for long, a second piece, grown from a seed of its own, takes the place of what it found.

The piece has names and a canonical frame of its own. Where both are sound, one part of the piece is laid on one part
of the growth; the other part may then still be off by one state, which is searched. Which part is laid on which, and
on which side of the stretch, is tried in all ways, and the dense cost decides.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from freeart21 import se3
from freeart21.se3 import Array
from reconstruct.evidence import evenly
from reconstruct.growth import Growth
from reconstruct.kernels import HIDDEN
from reconstruct.rigid import view_angle

Frames = NDArray[np.int64]


@dataclass(frozen=True)
class _Join:
    """How a piece stands to the growth."""

    swap: bool
    """Whether the piece's first part is the growth's second."""
    frames: Frames
    """(m,) of the piece."""
    Ts: Array
    """(m, 4, 4) the growth's reference part in those frames."""
    states: Array
    """(m,)"""
    cost: float


def lost_stretches(growth: Growth) -> list[Frames]:
    """Runs of frames that cost far more than is usual, with those about them that cost more; the costliest first.

    A frame that costs less than if all of it were hidden is never taken for lost.
    """
    s, costs = growth.settings.pieces, growth.costs
    if not np.isfinite(costs).any():
        return []
    bad = np.flatnonzero(costs > max(HIDDEN, s.lost_cost * np.nanmedian(costs)))
    runs = [run for run in np.split(bad, np.flatnonzero(np.diff(bad) > s.shortest) + 1) if len(run) >= s.shortest]
    unsound = ~_sound(growth)
    for run in runs:
        unsound[run[0] : run[-1]] = True
    edges = np.flatnonzero(np.diff(np.concatenate([[False], unsound, [False]])))
    wider = [np.arange(first, end) for first, end in edges.reshape(-1, 2) if any(first <= r[0] < end for r in runs)]
    return sorted(wider, key=lambda run: -float(np.nansum(costs[run])))


def is_doubtful(growth: Growth) -> bool:
    """Whether many frames cost far more than the best quarter does, and half as much as if all of them were hidden."""
    s, costs = growth.settings.pieces, growth.costs[np.isfinite(growth.costs)]
    if len(costs) == 0:
        return False
    return bool((costs > max(0.5 * HIDDEN, s.lost_cost * np.percentile(costs, 25))).mean() > s.doubtful)


def _sound(growth: Growth) -> NDArray[np.bool_]:
    """(n,) the frames done that cost no more than is usual."""
    surprising = growth.settings.growth.surprising_cost * np.nanmedian(growth.costs)
    return growth.done & ~(growth.costs > surprising)


def join(growth: Growth, piece: Growth, stretch: Frames) -> bool:
    """Put what `piece` found in the frames of `stretch` into `growth`, if they then cost much less; whether they do.

    Beyond the stretch the piece goes on to count until both agree.
    """
    assert growth.joint is not None and piece.joint is not None
    if growth.joint.type != piece.joint.type:
        return False
    sound = np.setdiff1d(np.flatnonzero(_sound(growth)), stretch)
    asked = evenly(np.intersect1d(stretch, np.flatnonzero(piece.done)), growth.settings.gaps.frames)
    found = []
    for side in (sound[sound < stretch[0]], sound[sound > stretch[-1]]):
        common = side[piece.done[side]]
        near = common[np.argsort(np.minimum(abs(common - stretch[0]), abs(common - stretch[-1])), kind="stable")][:12]
        if len(near) == 0:
            continue
        for part in range(2):
            for other in range(2):
                found.append(_laid_on(growth, piece, part, other, near, asked, sound))
    best = min(found, key=_by_cost, default=None)
    if best is None:
        return False
    at = np.searchsorted(best.frames, asked)
    now = _unexplained(growth, asked, growth.Ts[0, asked], growth.states[asked], sound)
    then = _unexplained(growth, asked, best.Ts[at], best.states[at], sound)
    if not then < min(growth.settings.pieces.better * now, now - growth.settings.seeds.min_gain):
        return False
    _take_over(growth, piece, best, stretch)
    return True


def _by_cost(found: _Join) -> float:
    return found.cost


def _laid_on(
    growth: Growth, piece: Growth, part: int, other: int, common: Frames, asked: Frames, sound: Frames
) -> _Join:
    """The piece's part `other` laid on the growth's `part` as they stand in `common`, at the state that fits best."""
    assert growth.joint is not None and piece.joint is not None
    swap = part != other
    X = _middle(se3.inverse(piece.Ts[other, common]) @ growth.Ts[part, common], growth.body_points())
    turned = X[:3, :3].T @ piece.joint.axis
    sign = np.copysign(1.0, turned @ growth.joint.axis) * (-1 if swap else 1)
    frames = np.flatnonzero(piece.done)
    laid, states = piece.Ts[other, frames] @ X, sign * piece.states[frames]
    at = np.searchsorted(frames, asked)
    middle = float(np.median(growth.states[common] - sign * piece.states[common]))
    reach, steps = float(np.ptp(growth.states[sound])), growth.settings.gaps.steps
    shifts, costs = middle + np.linspace(-reach, reach, 2 * steps + 1), np.zeros(0)
    for _ in range(2):
        costs = _costs(growth, piece, part, swap, laid[at], states[at], shifts, asked, sound)
        best = float(shifts[costs.argmin()])
        shifts = best + np.linspace(-1.5, 1.5, 25) * reach / steps
    states = states + best
    Ts = laid if part == 0 else laid @ growth.joint.transform(-states)
    return _Join(swap, frames, Ts, states, float(costs.min()))


def _middle(Xs: Array, body: Array) -> Array:
    """Of poses (m, 4, 4) the one nearest to most others, by where it takes the points `body` (b, 3)."""
    places = se3.transform(Xs, np.broadcast_to(body, (len(Xs), *body.shape)))
    apart = np.linalg.norm(places[:, None] - places, axis=-1).mean(-1)
    return np.asarray(Xs[np.median(apart, axis=1).argmin()])


def _costs(
    growth: Growth,
    piece: Growth,
    part: int,
    swap: bool,
    laid: Array,
    states: Array,
    shifts: Array,
    asked: Frames,
    sound: Frames,
) -> Array:
    """(s,) mean cost of the piece's pixels in the frames `asked` against the `sound` ones, `states` plus `shifts` (s,).

    The growth's `part` stands at `laid` (m, 4, 4) in these frames.
    """
    assert growth.joint is not None
    found = []
    for i, T, q in zip(asked, laid, states, strict=True):
        for k in range(2):
            there = T[None]
            if k != part:
                there = T @ growth.joint.transform(q + shifts if k else -(q + shifts))
            pixels = piece.samples[1 - k if swap else k][int(i)]
            cost = _against(growth, k, int(i), there, pixels, sound)
            found.append(np.broadcast_to(cost, (len(cost), len(shifts))))
    every = np.concatenate(found) if found else np.zeros((0, len(shifts)))
    return np.asarray(every.mean(0)) if len(every) else np.full(len(shifts), np.inf)


def _unexplained(growth: Growth, asked: Frames, Ts: Array, states: Array, sound: Frames) -> float:
    """Mean cost of all pixels of the frames `asked`, each as the part that explains it better, whatever its label."""
    found = []
    for i, T, q in zip(asked, Ts, states, strict=True):
        pixels = np.argwhere(growth.evidence.scene.valid[i])
        costs = [_against(growth, k, int(i), T_k[None], pixels, sound)[:, 0] for k, T_k in enumerate(growth.both(T, q))]
        costs = [c for c in costs if len(c)]
        if costs:
            found.append(np.min(costs, axis=0))
    return float(np.concatenate(found).mean()) if found else np.inf


def _against(growth: Growth, part: int, frame: int, Ts: Array, pixels: NDArray, sound: Frames) -> Array:
    """(p, s) costs of pixels of `frame` when `part` stands at `Ts` (s, 4, 4), in the `sound` frames of most alike view.

    A frame with no alike view has no say.
    """
    s = growth.settings.growth
    turn = np.min([view_angle(growth.Ts[part, sound, :3, :3], T[:3, :3]) for T in Ts[:: max(1, len(Ts) // 8)]], axis=0)
    chosen: list[int] = []
    for c in np.argsort(turn, kind="stable"):
        if len(chosen) == 3 or turn[c] > np.radians(s.max_turn_deg):
            break
        if all(abs(sound[c] - j) > 2 for j in chosen):
            chosen.append(int(sound[c]))
    some = pixels[:: max(1, len(pixels) // growth.settings.gaps.samples)]
    if not chosen or not len(some):
        return np.zeros((0, len(Ts)))
    others = np.array(sorted(chosen))
    return growth.evidence.costs(frame, others, growth.Ts[part, others][:, None] @ se3.inverse(Ts), some).mean(1)


def _take_over(growth: Growth, piece: Growth, found: _Join, stretch: Frames) -> None:
    """Let the piece's frames of `stretch` be the growth's, and those beyond it until both agree."""
    s = growth.settings.growth
    at = {int(i): m for m, i in enumerate(found.frames)}
    taken = [int(i) for i in stretch if int(i) in at]
    for i, way in ((int(stretch[0]) - 1, -1), (int(stretch[-1]) + 1, 1)):
        alike = 0
        while i in at and alike < s.agreeing_frames:
            near = growth.moved(i, found.Ts[at[i]], found.states[at[i]]) < s.agreeing * growth.evidence.unit
            alike = alike + 1 if near else 0
            taken.append(i)
            i += way
    for i in taken:
        growth.place(i, found.Ts[at[i]], float(found.states[at[i]]))
        growth.put_labels(i, -piece.logodds[i] if found.swap else piece.logodds[i].copy())
        growth.costs[i] = piece.costs[i]
    growth.body = None
