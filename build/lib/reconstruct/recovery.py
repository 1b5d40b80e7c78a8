"""A part that was hidden is found anew: by all pixels of a frame, at any state met so far, without believing labels."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from freeart21 import se3
from freeart21.se3 import Array
from reconstruct import rigid
from reconstruct.evidence import Pixels, draw
from reconstruct.growth import Growth

_PATCH = 8
"""Sampled pixels in a patch that follows one motion."""

_AS_GOOD = 1.1
"""Times the cost of another explanation at which one is as good."""


def is_lost(growth: Growth, frame: int) -> bool:
    """Whether a part was not seen in `frame`, or what was seen fits worse than it mostly does."""
    usual = np.nanmedian(growth.costs) if np.isfinite(growth.costs).any() else np.inf
    return bool(not growth.seen[frame].all() or growth.costs[frame] > growth.settings.growth.surprising_cost * usual)


def found_anew(growth: Growth, frame: int, neighbour: int, T: Array, q: float) -> tuple[Array, float, bool]:
    """Reference pose and state that explain the pixels of `frame` best at any state met so far, without labels.

    A patch of pixels follows the motion that explains it better. Beyond the states met so far the parts might be taken
    for each other: a lid that opens looks like a box that closes past its lid. `T` and `q` come back, and False, when
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
    look = _Look(growth, frame, others, pixels, _patches(pixels, int(growth.evidence.scene.valid[frame].sum())))
    blank = growth.open[neighbour] and not growth.seen[neighbour].all()  # no labels led to `q`
    rest = float(growth.states[neighbour]) if blank else q
    found = still = look.refined(T, rest, at_rest=True)
    before = best = look.cost(*still)
    low, high = np.percentile(growth.states[known], [1, 99])
    grid = np.linspace(float(low), float(high), settings.searched_states)
    turned = growth.joint.transform(q) @ se3.inverse(growth.joint.transform(grid))
    starts = [(T, q)] if q != rest else []
    for Ts in (np.tile(T, (len(grid), 1, 1)), T @ turned):  # either part stands still
        starts += [(Ts[g], float(grid[g])) for g in np.argsort(look.explained(Ts, grid), kind="stable")[:2]]
    for start in starts:
        refined = look.refined(*start)
        if (cost := look.cost(*refined)) < best:
            best, found = cost, refined
    gained = best < settings.found_cost * before and best < before - growth.settings.seeds.min_gain
    if growth.open[neighbour] and not growth.jumped(found[1] - rest):  # labels say little: go on without
        gained = (settings.rest_cost_freely if blank else settings.rest_cost) * best < before
    if gained and blank:
        found = look.within_range(*found, rest, best)
    if gained and look.same_parts(neighbour, *found):
        return *found, True
    return (*still, True) if growth.open[neighbour] else (T, q, False)


@dataclass(frozen=True)
class _Look:
    """One frame's pixels and the frames that they are compared with, whatever the labels there."""

    growth: Growth
    frame: int
    others: NDArray[np.int64]
    pixels: Pixels
    patches: NDArray[np.int64]
    """(p,) the patch that each pixel belongs to."""

    def costs(self, Ts: Array, states: Array) -> Array:
        """(p, m, 2) costs of the pixels as either part's, for m reference poses and states."""
        growth, others = self.growth, self.others
        assert growth.joint is not None
        here = np.stack([Ts, Ts @ growth.joint.transform(states)], 1)
        there = np.swapaxes(growth.Ts[:, others], 0, 1)[:, None]
        motions = (there @ se3.inverse(here)[None]).reshape(len(others), -1, 4, 4)
        costs = growth.evidence.costs(self.frame, others, motions, self.pixels).mean(1)
        return costs.reshape(len(self.pixels), len(Ts), 2)

    def explained(self, Ts: Array, states: Array) -> Array:
        """(m,) mean cost when every patch follows the motion that explains it better.

        Not every pixel: of two motions, chosen pixel by pixel, the wrong one is taken wherever it fits the noise, so
        that a joint at rest would seem to move.
        """
        sums = np.zeros((self.patches.max() + 1, len(Ts), 2))
        np.add.at(sums, self.patches, self.costs(Ts, states))
        return np.asarray(sums.min(2).sum(0) / len(self.pixels))

    def cost(self, T: Array, q: float) -> float:
        """The same for one pose and state."""
        return float(self.explained(T[None], np.array([q]))[0])

    def refined(self, T: Array, q: float, at_rest: bool = False) -> tuple[Array, float]:
        """Reference pose and state after Gauss-Newton on pixels that choose their part anew in every round."""
        growth, others = self.growth, self.others
        assert growth.joint is not None
        most = growth.longest_step()
        for gate in (12.0, 8.0, 6.0, 5.0):
            second = self.costs(T[None], np.array([q]))[:, 0].argmin(1) == 1
            A, b = np.zeros((7, 7)), np.zeros(7)
            for k, T_k in enumerate(growth.both(T, q)):
                mine = {self.frame: self.pixels[second == bool(k)]}
                motions = growth.Ts[k, others] @ se3.inverse(T_k)
                H, g, _ = growth.evidence.register(np.full(len(others), self.frame), others, motions, mine, gate)
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

    def within_range(self, T: Array, q: float, rest: float, cost: float) -> tuple[Array, float]:
        """`T` and `q`, that cost so much, or what they are with the parts exchanged where they stood at `rest`.

        Both explain the pixels alike as long as no label tells. Then the state goes back to where it has been before: a
        joint mostly rests at its limits.
        """
        growth = self.growth
        assert growth.joint is not None
        states, other = growth.states[growth.measured()], 2 * rest - q
        if states.min() <= q <= states.max() or not states.min() <= other <= states.max():
            return T, q
        exchanged = self.refined(T @ growth.joint.transform(q - rest), other)
        return exchanged if self.cost(*exchanged) < _AS_GOOD * cost else (T, q)

    def same_parts(self, neighbour: int, T: Array, q: float) -> bool:
        """Whether the labels that flow carried here agree with what `T` and `q` say: else the parts are exchanged.

        Of a part that was hidden flow carries nothing: most pixels, at least, are the other's still. Where all was in
        doubt either part may be either, and nothing speaks against.
        """
        growth = self.growth
        costs = self.costs(T[None], np.array([q]))[:, 0]
        carried = growth.labels[self.frame, self.pixels[:, 0], self.pixels[:, 1]]
        told = (carried > 0) & (np.abs(costs[:, 1] - costs[:, 0]) > 0.3)
        agree = (costs.argmin(1) + 1 == carried)[told]
        if len(agree) < growth.settings.growth.min_jointed_pixels:
            return bool(growth.open[neighbour])
        return bool(agree.mean() > (0.8 if growth.seen[neighbour].all() else 0.5))


def _patches(pixels: Pixels, area: int) -> NDArray[np.int64]:
    """(p,) numbers of the square patches that `pixels`, drawn evenly from an `area`, fall into, some eight to each."""
    side = max(1.0, math.sqrt(_PATCH * area / len(pixels)))
    _, patches = np.unique(np.floor(pixels / side), axis=0, return_inverse=True)
    return np.asarray(patches.reshape(-1))


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
