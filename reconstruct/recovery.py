"""Recovery of a part that was hidden: from all pixels of a frame, at any state seen so far, without using labels."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from freeart21 import se3
from freeart21.se3 import Array
from reconstruct import rigid
from reconstruct.evidence import Pixels, sample_pixels
from reconstruct.propagation import MIN_JOINTED_PIXELS, REFERENCES, REST_COST, SAMPLES, UNCERTAIN_SHARE, Propagation
from reconstruct.registration import step_with_joint

GATES = (12.0, 8.0, 6.0, 5.0)
"""Point-to-plane gates of the registration, coarse to fine."""
REST_COST_UNLABELLED = 1.12
"""`REST_COST` where there are no labels: pixels that choose their part freely fit noise, too."""
SEARCHED_STATES = 41
"""States tried over the range seen so far."""
MAX_COST_RATIO = 0.75
"""Cost of a recovered state, relative to that of going on as before, below which it is taken."""
MIN_GAIN = 0.03
"""Smallest fall of a frame's mean cost that counts as better. Not measured."""
LOOK_BACK = 8
"""Frames nearer than this are avoided as references: a joint that starts to move is slow."""
SOUND_FRAMES, SOUND_SHARE = 8, 0.05
"""So many consecutive frames, each with at least this share of certain pixels of either part, were tracked reliably."""
_PATCH = 8
"""Sampled pixels per patch; a patch follows one motion."""
_AS_GOOD = 1.1
"""Ratio of costs up to which two explanations count as equally good."""


def is_lost(propagation: Propagation, frame: int) -> bool:
    """Whether a part was not seen in `frame`, or its cost is far above the median."""
    median = np.nanmedian(propagation.costs) if np.isfinite(propagation.costs).any() else np.inf
    limit = propagation.settings.growth.surprising_cost * median
    return bool(not propagation.seen[frame].all() or propagation.costs[frame] > limit)


def recover_frame(
    propagation: Propagation, frame: int, neighbour: int, T: Array, q: float
) -> tuple[Array, float, bool]:
    """Reference pose and state that explain `frame` best at any state seen so far, and whether they replace `T`, `q`.

    Labels are not used: each patch of pixels follows the motion that explains it better. States outside the range seen
    so far are excluded, since there the parts can be confused: a lid that opens looks like a box that closes past its
    lid. After an ambiguous frame the result counts as recovered at rest, too.
    """
    assert propagation.joint is not None
    known = np.flatnonzero(propagation.measured_frames())  # other frames may have all pixels on one part
    valid = propagation.evidence.scene.valid[frame]
    pixels = sample_pixels(valid, SAMPLES, propagation.rng)
    if len(pixels) == 0 or len(known) == 0:
        return T, q, False
    others = _choose_references(propagation, frame, T, q, known)
    view = _UnlabelledFrame(propagation, frame, others, pixels, _assign_patches(pixels, int(valid.sum())))
    unlabelled = propagation.ambiguous[neighbour] and not propagation.seen[neighbour].all()  # `q` is then a guess
    rest = float(propagation.states[neighbour]) if unlabelled else q
    found = resting = view.refine(T, rest, at_rest=True)
    before = best = view.cost(*resting)
    for guess in _guess_states(propagation, view, T, q, rest, known):
        refined = view.refine(*guess)
        if (cost := view.cost(*refined)) < best:
            best, found = cost, refined
    better = best < MAX_COST_RATIO * before and best < before - MIN_GAIN
    if propagation.ambiguous[neighbour] and not propagation.is_state_jump(found[1] - rest):
        better = (REST_COST_UNLABELLED if unlabelled else REST_COST) * best < before
    if better and unlabelled:
        found = view.prefer_known_state(*found, rest, best)
    if better and view.agrees_with_flow(neighbour, *found):
        return *found, True
    return (*resting, True) if propagation.ambiguous[neighbour] else (T, q, False)


def _choose_references(
    propagation: Propagation, frame: int, T: Array, q: float, known: NDArray[np.int64]
) -> NDArray[np.int64]:
    """Those of the frames `known` with the most similar view of either part, avoiding the nearest in time."""
    poses = propagation.part_poses(T, q)
    turn = np.minimum(*(rigid.view_angle(propagation.Ts[k, known, :3, :3], T_k[:3, :3]) for k, T_k in enumerate(poses)))
    turn += np.where(np.abs(known - frame) < LOOK_BACK, 1.0, 0)
    return np.sort(known[np.argsort(turn, kind="stable")[: 2 * REFERENCES : 2]])


def _guess_states(
    propagation: Propagation, view: _UnlabelledFrame, T: Array, q: float, rest: float, known: NDArray[np.int64]
) -> list[tuple[Array, float]]:
    """The best states of the range seen so far, with either part standing still, and `T`, `q` unless at rest."""
    assert propagation.joint is not None
    low, high = np.percentile(propagation.states[known], [1, 99])
    grid = np.linspace(float(low), float(high), SEARCHED_STATES)
    turned = propagation.joint.transform(q) @ se3.inverse(propagation.joint.transform(grid))
    guesses = [(T, q)] if q != rest else []
    for Ts in (np.tile(T, (len(grid), 1, 1)), T @ turned):
        guesses += [(Ts[g], float(grid[g])) for g in np.argsort(view.patch_costs(Ts, grid), kind="stable")[:2]]
    return guesses


@dataclass(frozen=True)
class _UnlabelledFrame:
    """The pixels of a frame and the frames that they are compared with, whatever the labels."""

    propagation: Propagation
    frame: int
    others: NDArray[np.int64]
    pixels: Pixels
    patches: NDArray[np.int64]
    """(p,) patch of each pixel."""

    def costs(self, Ts: Array, states: Array) -> Array:
        """(p, m, 2) costs of the pixels as either part's, for m reference poses and states."""
        propagation, others = self.propagation, self.others
        assert propagation.joint is not None
        here = np.stack([Ts, Ts @ propagation.joint.transform(states)], 1)
        there = np.swapaxes(propagation.Ts[:, others], 0, 1)[:, None]
        motions = (there @ se3.inverse(here)[None]).reshape(len(others), -1, 4, 4)
        costs = propagation.evidence.costs(self.frame, others, motions, self.pixels).mean(1)
        return costs.reshape(len(self.pixels), len(Ts), 2)

    def patch_costs(self, Ts: Array, states: Array) -> Array:
        """(m,) mean cost when every patch follows the motion that explains it better.

        Patches instead of single pixels: pixel by pixel, either motion fits some noise, and a joint at rest would seem
        to move.
        """
        sums = np.zeros((self.patches.max() + 1, len(Ts), 2))
        np.add.at(sums, self.patches, self.costs(Ts, states))
        return np.asarray(sums.min(2).sum(0) / len(self.pixels))

    def cost(self, T: Array, q: float) -> float:
        """The same for one pose and state."""
        return float(self.patch_costs(T[None], np.array([q]))[0])

    def refine(self, T: Array, q: float, at_rest: bool = False) -> tuple[Array, float]:
        """Reference pose and state after Gauss-Newton on pixels that choose their part again in every round."""
        propagation, others = self.propagation, self.others
        assert propagation.joint is not None
        most = propagation.max_state_step()
        for gate in GATES:
            second = self.costs(T[None], np.array([q]))[:, 0].argmin(1) == 1
            A, b = np.zeros((7, 7)), np.zeros(7)
            for k, T_k in enumerate(propagation.part_poses(T, q)):
                mine = {self.frame: self.pixels[second == bool(k)]}
                motions = propagation.Ts[k, others] @ se3.inverse(T_k)
                H, g, _ = propagation.evidence.register(np.full(len(others), self.frame), others, motions, mine, gate)
                to_source = -se3.adjoint(motions)
                M = np.eye(6, 7)
                M[:, 6] = se3.adjoint(T) @ propagation.joint.screw if k else 0
                M = to_source @ M
                A += np.einsum("pia,pij,pjb->ab", M, H, M)
                b += np.einsum("pia,pi->a", M, g)
            T, q = step_with_joint(T, q, A, b, most, at_rest)
        return T, q

    def prefer_known_state(self, T: Array, q: float, rest: float, cost: float) -> tuple[Array, float]:
        """`T` and `q` of cost `cost`, or their mirror image with the parts swapped at the state `rest`, if only that
        was seen.

        Both explain the pixels equally well while there are no labels; a joint mostly rests at its limits.
        """
        propagation = self.propagation
        assert propagation.joint is not None
        states, other = propagation.states[propagation.measured_frames()], 2 * rest - q
        if states.min() <= q <= states.max() or not states.min() <= other <= states.max():
            return T, q
        swapped = self.refine(T @ propagation.joint.transform(q - rest), other)
        return swapped if self.cost(*swapped) < _AS_GOOD * cost else (T, q)

    def agrees_with_flow(self, neighbour: int, T: Array, q: float) -> bool:
        """Whether labels carried by optical flow agree with `T` and `q`; otherwise the parts are swapped.

        Flow carries nothing of a part that was hidden, so then a majority is enough. Without labels nothing disagrees.
        """
        propagation = self.propagation
        costs = self.costs(T[None], np.array([q]))[:, 0]
        carried = propagation.labels[self.frame, self.pixels[:, 0], self.pixels[:, 1]]
        decided = (carried > 0) & (np.abs(costs[:, 1] - costs[:, 0]) > 0.3)
        agree = (costs.argmin(1) + 1 == carried)[decided]
        if len(agree) < MIN_JOINTED_PIXELS:
            return bool(propagation.ambiguous[neighbour])
        return bool(agree.mean() > (0.8 if propagation.seen[neighbour].all() else 0.5))


def _assign_patches(pixels: Pixels, area: int) -> NDArray[np.int64]:
    """(p,) number of the square patch, of about `_PATCH` pixels, of each of `pixels` drawn evenly from an `area`."""
    side = max(1.0, math.sqrt(_PATCH * area / len(pixels)))
    _, patches = np.unique(np.floor(pixels / side), axis=0, return_inverse=True)
    return np.asarray(patches.reshape(-1))


def unreliable_frames(propagation: Propagation, frame: int, direction: int) -> NDArray[np.int64]:
    """Frames from `frame` on in `direction`, up to and including the first run of reliably tracked ones."""
    valid = propagation.evidence.scene.valid
    run, frames = 0, []
    while 0 <= frame < len(propagation.done) and propagation.done[frame] and run < SOUND_FRAMES:
        known = np.abs(propagation.logodds[frame][valid[frame]]) >= 1
        second = (propagation.logodds[frame][valid[frame]] >= 1).sum() / max(known.sum(), 1)
        sound = len(known) and known.mean() > 1 - UNCERTAIN_SHARE and SOUND_SHARE < second < 1 - SOUND_SHARE
        run = run + 1 if sound and propagation.seen[frame].all() else 0
        frames.append(frame)
        frame += direction
    return np.array(frames, int)
