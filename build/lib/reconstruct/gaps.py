"""Frames in which a part is hidden: what came before and after them is joined anew, and the states there are guessed.

While a part is hidden the growth can only guess its state, and goes on from its guess when the part comes back. All
frames after the gap are then off by one and the same state, because the other part was seen all along: a search over
one number joins them. So it is where a part seen edge-on came back with a jump, as no joint moves.

Within the gap little is known of the state, but where the part would stick out behind what hides it, it is not.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import PchipInterpolator

from freeart21 import se3
from freeart21.joint import Joint
from freeart21.se3 import Array
from reconstruct.evidence import Evidence, draw, evenly
from reconstruct.growth import Grown
from reconstruct.kernels import HIDDEN
from reconstruct.rigid import view_angle
from reconstruct.settings import GapSettings

Frames = NDArray[np.int64]


def bridge_gaps(evidence: Evidence, grown: Grown, settings: GapSettings, rng: np.random.Generator) -> Grown:
    """`grown` with every stretch after a gap of either part shifted in state to fit the rest, and gaps filled.

    A stretch that begins with a jump and fits nowhere was not that part: it counts as not seen.
    """
    for part in range(2):
        jumps = _jumps(grown, part, settings)
        pieces = seen_pieces(grown.seen[:, part], jumps, settings)
        if not pieces:
            continue
        joined, refused = max(pieces, key=len), [np.zeros(0, int)]
        for piece in sorted((p for p in pieces if p is not joined), key=lambda p: abs(p.mean() - joined.mean())):
            likely = _to_go_on(grown, jumps, joined, piece, settings)
            shift = _best_shift(evidence, grown, part, joined, piece, likely, settings, rng)
            if shift is None:
                refused.append(piece)
                continue
            states = grown.poses.states.copy()
            states[piece] = _without_turns(grown.poses.joint, states, joined, piece, states[piece] + shift)
            grown = _with_states(grown, states, part)
            joined = np.concatenate([joined, piece])
        if len(joined) > len(np.concatenate(refused)):
            seen = grown.seen.copy()
            seen[np.concatenate(refused), part] = False
            grown = replace(grown, seen=seen)
        grown = _filled(evidence, grown, part, np.sort(joined), settings, rng)
    return grown


def fill_gaps(evidence: Evidence, grown: Grown, settings: GapSettings, rng: np.random.Generator) -> Grown:
    """`grown` with the states of frames in which a part was not seen guessed anew from those in which it was."""
    for part in range(2):
        grown = _filled(evidence, grown, part, np.flatnonzero(grown.seen[:, part]), settings, rng)
    return grown


def _filled(
    evidence: Evidence, grown: Grown, part: int, joined: Frames, settings: GapSettings, rng: np.random.Generator
) -> Grown:
    """`grown` with states in all frames but `joined` that go on evenly where `part` stays hidden by that.

    States a little beyond the range of those joined are thought of too: a joint may turn back while it is hidden.
    """
    n = len(grown.labels)
    if not 1 < len(joined) < n:
        return grown
    frames = np.clip(np.arange(n), joined[0], joined[-1])
    states, unseen = grown.poses.states.copy(), np.setdiff1d(np.arange(n), joined)
    states[unseen] = PchipInterpolator(joined, states[joined])(frames[unseen])
    grown, states = _with_states(grown, states, part), states.copy()
    low, high = float(states[joined].min()), float(states[joined].max())
    beyond = 0.1 * (high - low)
    grid = np.linspace(low - beyond, high + beyond, settings.hidden_states)
    for run in np.split(unseen, np.flatnonzero(np.diff(unseen) > 1) + 1):
        if len(run) > settings.shortest_gap and high > low and grown.seen[run, 1 - part].all():
            exposed = np.stack([_exposed(evidence, grown, part, int(i), joined, grid, settings, rng) for i in run])
            held = run[0] > 0, run[-1] < n - 1
            states[run] = _hidden_path(exposed, states[run], grid, held, settings.evenness)
    return _with_states(grown, states, part)


def _exposed(
    evidence: Evidence,
    grown: Grown,
    part: int,
    frame: int,
    joined: Frames,
    grid: Array,
    settings: GapSettings,
    rng: np.random.Generator,
) -> Array:
    """(m,) how much of `part`, as known from the frames `joined`, would show in `frame` in the states `grid` (m,)."""
    poses = grown.poses
    Ts = (poses.Ts, poses.Ts_moving)[part]
    here = poses.Ts[frame] @ poses.joint.transform(grid)
    if part == 0:
        here = poses.Ts_moving[frame] @ poses.joint.transform(-grid)
    chosen: set[int] = set()
    for T in here[:: max(1, len(grid) // 4)]:
        turn = view_angle(Ts[joined, :3, :3], T[:3, :3])
        chosen |= set(map(int, joined[np.argsort(turn, kind="stable")[:9:3]]))
    found = []
    for i in sorted(chosen):
        pixels = draw(evidence.usable(i, grown.labels[i] == part + 1), settings.samples // 2, rng)
        costs = evidence.costs(i, np.array([frame]), (here @ se3.inverse(Ts[i]))[None], pixels)[:, 0]
        found.append(np.maximum(costs - HIDDEN, 0))
    return np.asarray(np.concatenate(found).mean(0))


def _hidden_path(exposed: Array, even: Array, grid: Array, held: tuple[bool, bool], evenness: float) -> Array:
    """The states (r,) of a run of frames that expose the least, `exposed` (r, m), and stray the least from `even` (r,).

    Dynamic programming over the states `grid` (m,). `held` says whether the frames before and after the run are known.
    """
    stray = (grid - even[:, None]) / np.ptp(grid)
    cost, back = exposed[0] + held[0] * evenness * stray[0] ** 2, np.zeros(exposed.shape, int)
    for r in range(1, len(even)):
        step = cost[:, None] + evenness * (stray[r - 1][:, None] - stray[r]) ** 2
        back[r] = step.argmin(0)
        cost = step.min(0) + exposed[r]
    at = int((cost + held[1] * evenness * stray[-1] ** 2).argmin())
    path = [at]
    for r in range(len(even) - 1, 0, -1):
        path.append(at := int(back[r, at]))
    return np.asarray(grid[path[::-1]])


def seen_pieces(seen: NDArray[np.bool_], jumps: Frames, settings: GapSettings) -> list[Frames]:
    """Runs of frames in which a part is `seen` (n,), parted by gaps worth the name and before every one of `jumps`.

    Short runs are left out.
    """
    frames = np.flatnonzero(seen)
    before = np.searchsorted(jumps, frames, "right")
    parted = (np.diff(frames) > settings.shortest_gap) | (np.diff(before) > 0)
    return [piece for piece in np.split(frames, np.flatnonzero(parted) + 1) if len(piece) >= settings.shortest_piece]


def _jumps(grown: Grown, part: int, settings: GapSettings) -> Frames:
    """Frames before which the state jumps, and `part` with it, while the other part goes on."""
    poses, seen = grown.poses, np.asarray(grown.seen.all(1))
    steps = np.abs(np.diff(poses.states))
    known = steps[seen[1:] & seen[:-1]]
    if len(known) == 0:
        return np.zeros(0, int)
    usual = max(float(np.percentile(known, 90)), 0.01 * float(np.ptp(poses.states[seen])))
    turns, moves = [], []
    for Ts in (poses.Ts, poses.Ts_moving):
        moved = Ts[1:] @ se3.inverse(Ts[:-1])
        turns.append(se3.rotation_angle(moved[:, :3, :3]))
        moves.append(np.linalg.norm(se3.transform(moved, Ts[:-1, :3, 3][:, None])[:, 0] - Ts[:-1, :3, 3], axis=1))
    strides = turns if poses.joint.type == "revolute" else moves
    return np.flatnonzero((steps > settings.jump * usual) & (strides[part] > strides[1 - part])) + 1


def _to_go_on(grown: Grown, jumps: Frames, joined: Frames, piece: Frames, settings: GapSettings) -> float | None:
    """The state to add in `piece` so that there is no jump to the frames `joined`; None unless a jump parts them."""
    states = grown.poses.states
    for jump in map(int, jumps):
        for earlier, later in ((joined, piece), (piece, joined)):
            before, after = earlier[earlier < jump], later[later >= jump]
            if len(before) and len(after) and after.min() - before.max() <= settings.shortest_gap + 1:
                step = float(states[before.max()] - states[after.min()])
                return step if earlier is joined else -step
    return None


def _with_states(grown: Grown, states: Array, part: int) -> Grown:
    """`grown` with other states; `part` moves, the other part stays where it is."""
    poses = grown.poses
    Ts = poses.Ts if part == 1 else poses.Ts_moving @ poses.joint.transform(-states)
    return replace(grown, poses=replace(poses, joint=poses.joint.spanning(states), states=states, Ts=Ts))


def _without_turns(joint: Joint, states: Array, joined: Frames, piece: Frames, shifted: Array) -> Array:
    """`shifted` states of `piece`, less the full turns by which a hinge seems to be away from its nearest neighbour."""
    if joint.type == "prismatic":
        return shifted
    apart = np.abs(piece[:, None] - joined)
    mine, other = np.unravel_index(apart.argmin(), apart.shape)
    turns = np.round((shifted[mine] - states[joined[other]]) / (2 * np.pi))
    return np.asarray(shifted - 2 * np.pi * turns)


def _best_shift(
    evidence: Evidence,
    grown: Grown,
    part: int,
    joined: Frames,
    piece: Frames,
    likely: float | None,
    settings: GapSettings,
    rng: np.random.Generator,
) -> float | None:
    """The state to add in the frames `piece` so that `part` there agrees best with the frames `joined`.

    If unsure, what is `likely`, or else 0. None when there is a jump to undo and yet no state fits.
    """
    most = float(np.ptp(grown.poses.states[np.concatenate([joined, piece])]))
    prior = 0.0 if likely is None else likely
    shifts, costs = np.linspace(-most, most, 2 * settings.steps + 1), np.zeros(0)
    sample = _Pairs(evidence, grown, part, joined, piece, settings, rng)
    for _ in range(2):
        costs = sample.costs(np.append(shifts, prior))
        best = float(shifts[costs[:-1].argmin()])
        shifts = best + np.linspace(-1.5, 1.5, 25) * most / settings.steps
    if likely is not None and costs.min() > HIDDEN:
        even, odd = np.sort(joined)[::2], np.sort(joined)[1::2]
        own = _Pairs(evidence, grown, part, even, odd, settings, rng).costs(np.zeros(1))[0]
        if costs.min() > settings.foreign * own:  # what hides the object makes all costs high
            return None
    return best if costs.min() < (1 - settings.least_gain) * costs[-1] else prior


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
        self.sides = tuple(evenly(frames, settings.frames) for frames in (joined, piece))
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
