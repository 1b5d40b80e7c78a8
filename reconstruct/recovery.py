"""A part that was hidden is found anew: by all pixels of a frame, at any state met so far, without believing labels."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from freeart21 import se3
from freeart21.se3 import Array
from reconstruct import rigid
from reconstruct.evidence import Pixels, draw
from reconstruct.growth import Growth


def is_lost(growth: Growth, frame: int) -> bool:
    """Whether a part was not seen in `frame`, or what was seen fits worse than it mostly does."""
    usual = np.nanmedian(growth.costs) if np.isfinite(growth.costs).any() else np.inf
    return bool(not growth.seen[frame].all() or growth.costs[frame] > growth.settings.growth.surprising_cost * usual)


def found_anew(growth: Growth, frame: int, neighbour: int, T: Array, q: float) -> tuple[Array, float, bool]:
    """Reference pose and state that explain the pixels of `frame` best at any state met so far, without labels.

    A pixel follows the motion that explains it better. Beyond the states met so far the parts might be taken for
    each other: a lid that opens looks like a box that closes past its lid. `T` and `q` come back, and False, when
    little is gained. After a frame whose labels were in doubt growth goes on so, at least at rest.
    """
    assert growth.joint is not None
    settings = growth.settings.growth
    known = np.flatnonzero(growth.measured())  # others call all one part, and would agree to it
    pixels = draw(growth.evidence.scene.valid[frame], settings.samples, growth.rng)
    if len(pixels) == 0 or len(known) == 0:
        return T, q, False
    turn = np.minimum(
        *(rigid.view_angle(growth.Ts[k, known, :3, :3], T_k[:3, :3]) for k, T_k in enumerate(growth.both(T, q)))
    )
    turn += np.where(np.abs(known - frame) < settings.look_back, 1.0, 0)  # a joint that starts to move is slow
    others = np.sort(known[np.argsort(turn, kind="stable")[: 2 * settings.references : 2]])
    low, high = np.percentile(growth.states[known], [1, 99])
    grid = np.linspace(float(low), float(high), settings.searched_states)
    found = still = _refined_freely(growth, frame, others, pixels, T, q, at_rest=True)
    before = best = float(_freely(growth, frame, others, pixels, found[0][None], np.array([q])).min(2).mean())
    turned = growth.joint.transform(q) @ se3.inverse(growth.joint.transform(grid))
    for Ts in (np.tile(T, (len(grid), 1, 1)), T @ turned):  # either part stands still
        explained = _freely(growth, frame, others, pixels, Ts, grid).min(2).mean(0)
        for g in np.argsort(explained, kind="stable")[:2]:
            start = _refined_freely(growth, frame, others, pixels, Ts[g], float(grid[g]))
            cost = float(_freely(growth, frame, others, pixels, start[0][None], np.array([start[1]])).min(2).mean())
            if cost < best:
                best, found = cost, start
    gained = best < settings.found_cost * before and best < before - growth.settings.seeds.min_gain
    if growth.open[neighbour] and not growth.jumped(found[1] - q):  # labels say little: go on without
        gained = settings.rest_cost * best < before
    if gained and _same_parts(growth, frame, neighbour, others, pixels, *found):
        return *found, True
    return (*still, True) if growth.open[neighbour] else (T, q, False)


def _same_parts(
    growth: Growth, frame: int, neighbour: int, others: NDArray[np.int64], pixels: Pixels, T: Array, q: float
) -> bool:
    """Whether the labels that flow carried here agree with what `T` and `q` say: else the parts are exchanged.

    Of a part that was hidden flow carries nothing: most pixels, at least, are the other's still. Where all was in
    doubt either part may be either, and nothing speaks against.
    """
    costs = _freely(growth, frame, others, pixels, T[None], np.array([q]))[:, 0]
    carried = growth.labels[frame, pixels[:, 0], pixels[:, 1]]
    told = (carried > 0) & (np.abs(costs[:, 1] - costs[:, 0]) > 0.3)
    agree = (costs.argmin(1) + 1 == carried)[told]
    if len(agree) < growth.settings.growth.min_jointed_pixels:
        return bool(growth.open[neighbour])
    return bool(agree.mean() > (0.8 if growth.seen[neighbour].all() else 0.5))


def _freely(growth: Growth, frame: int, others: NDArray[np.int64], pixels: Pixels, Ts: Array, states: Array) -> Array:
    """(p, m, 2) costs of `pixels` of `frame` as either part's, for m reference poses and states; no labels."""
    assert growth.joint is not None
    here = np.stack([Ts, Ts @ growth.joint.transform(states)], 1)
    there = np.swapaxes(growth.Ts[:, others], 0, 1)[:, None]
    motions = (there @ se3.inverse(here)[None]).reshape(len(others), -1, 4, 4)
    costs = growth.evidence.costs(frame, others, motions, pixels).mean(1)
    return costs.reshape(len(pixels), len(Ts), 2)


def _refined_freely(
    growth: Growth, frame: int, others: NDArray[np.int64], pixels: Pixels, T: Array, q: float, at_rest: bool = False
) -> tuple[Array, float]:
    """Reference pose and state after Gauss-Newton on pixels that choose their part anew in every round."""
    assert growth.joint is not None
    most = growth.longest_step()
    for gate in (12.0, 8.0, 6.0, 5.0):
        second = _freely(growth, frame, others, pixels, T[None], np.array([q]))[:, 0].argmin(1) == 1
        A, b = np.zeros((7, 7)), np.zeros(7)
        for k, T_k in enumerate(growth.both(T, q)):
            mine = {frame: pixels[second == bool(k)]}
            motions = growth.Ts[k, others] @ se3.inverse(T_k)
            H, g, _ = growth.evidence.register(np.full(len(others), frame), others, motions, mine, gate)
            back = -se3.adjoint(motions)
            M = np.eye(6, 7)
            M[:, 6] = se3.adjoint(T) @ growth.joint.screw if k else 0
            M = back @ M
            A += np.einsum("pia,pij,pjb->ab", M, H, M)
            b += np.einsum("pia,pi->a", M, g)
        if at_rest:
            A[6], A[:, 6], b[6] = 0, 0, 0
        T, q = growth.stepped_jointed(T, q, A, b, most)
    return T, q


def doubted_frames(growth: Growth, frame: int, back: int) -> NDArray[np.int64]:
    """The frames from `frame` on in the direction `back` until, and with, a run that shows both parts clearly."""
    s, valid = growth.settings.growth, growth.evidence.scene.valid
    run, frames = 0, []
    while 0 <= frame < len(growth.done) and growth.done[frame] and run < s.sound_frames:
        known = np.abs(growth.logodds[frame][valid[frame]]) >= 1
        second = (growth.logodds[frame][valid[frame]] >= 1).sum() / max(known.sum(), 1)
        sound = len(known) and known.mean() > 1 - s.doubtful and s.sound_share < second < 1 - s.sound_share
        run = run + 1 if sound and growth.seen[frame].all() else 0
        frames.append(frame)
        frame += back
    return np.array(frames, int)
