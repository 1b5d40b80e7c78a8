"""Frames in which a part is hidden: the runs before and after are joined, and the states within are interpolated.

While a part is hidden, propagation guesses its state and continues from that guess when the part reappears. All frames
after the gap are then off by one constant state, because the other part was visible throughout: a search over one
number joins the runs. The same holds where a part that was seen edge-on reappears with a jump of the state.

Within a gap, states in which the part would be visible are excluded.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import PchipInterpolator

from freeart21 import se3
from freeart21.joint import Joint
from freeart21.se3 import Array
from reconstruct.evidence import Evidence, sample_evenly, sample_pixels
from reconstruct.kernels import HIDDEN
from reconstruct.propagation import PartEstimate
from reconstruct.rigid import view_angle
from reconstruct.settings import GapSettings

Frames = NDArray[np.int64]

SHORTEST_RUN = 5
"""Shorter runs between two gaps are not used."""
FRAMES = 10
"""Frames, evenly spaced on each side, that are compared."""
SAMPLES = 200
"""Pixels of the part per frame."""
STATE_STEPS = 40
"""Steps of the state, each way, over the range of motion."""
MIN_GAIN = 0.05
"""Share by which the cost must fall for the states to be shifted."""
FOREIGN = 1.25
"""A run that costs more than this times what the others cost among themselves does not show the part."""
HIDDEN_STATES = 61
"""States that are tried in frames in which a part is hidden."""
EVENNESS = 20.0
"""Weight of squared deviations from smooth motion, in ranges, against the mean exposure cost."""


def bridge_gaps(
    evidence: Evidence, estimate: PartEstimate, settings: GapSettings, rng: np.random.Generator
) -> PartEstimate:
    """`estimate` with every run after a gap of either part shifted in state to fit the rest, and gaps filled.

    A run that begins with a jump and fits nowhere did not show that part: it counts as not seen.
    """
    for part in range(2):
        jumps = _find_jumps(estimate, part, settings)
        runs = visible_runs(estimate.seen[:, part], jumps, settings)
        if not runs:
            continue
        joined, rejected = max(runs, key=len), [np.zeros(0, int)]
        for run in sorted((p for p in runs if p is not joined), key=lambda p: abs(p.mean() - joined.mean())):
            expected = _continuing_shift(estimate, jumps, joined, run, settings)
            shift = _find_state_shift(evidence, estimate, part, joined, run, expected, rng)
            if shift is None:
                rejected.append(run)
                continue
            states = estimate.poses.states.copy()
            states[run] = _remove_full_turns(estimate.poses.joint, states, joined, run, states[run] + shift)
            estimate = _replace_states(estimate, states, part)
            joined = np.concatenate([joined, run])
        if len(joined) > len(np.concatenate(rejected)):
            seen = estimate.seen.copy()
            seen[np.concatenate(rejected), part] = False
            estimate = replace(estimate, seen=seen)
        estimate = _interpolate_states(evidence, estimate, part, np.sort(joined), settings, rng)
    return estimate


def fill_gaps(
    evidence: Evidence, estimate: PartEstimate, settings: GapSettings, rng: np.random.Generator
) -> PartEstimate:
    """`estimate` with the states of frames that hide a part interpolated again from those that show it."""
    for part in range(2):
        estimate = _interpolate_states(evidence, estimate, part, np.flatnonzero(estimate.seen[:, part]), settings, rng)
    return estimate


def _interpolate_states(
    evidence: Evidence,
    estimate: PartEstimate,
    part: int,
    joined: Frames,
    settings: GapSettings,
    rng: np.random.Generator,
) -> PartEstimate:
    """`estimate` with smooth states in all frames but `joined`, such that `part` stays hidden there.

    States a little beyond the range of the frames `joined` are tried, too: a joint may turn back while it is hidden.
    """
    n = len(estimate.labels)
    if not 1 < len(joined) < n:
        return estimate
    frames = np.clip(np.arange(n), joined[0], joined[-1])
    states, unseen = estimate.poses.states.copy(), np.setdiff1d(np.arange(n), joined)
    states[unseen] = PchipInterpolator(joined, states[joined])(frames[unseen])
    estimate, states = _replace_states(estimate, states, part), states.copy()
    low, high = float(states[joined].min()), float(states[joined].max())
    beyond = 0.1 * (high - low)
    grid = np.linspace(low - beyond, high + beyond, HIDDEN_STATES)
    for run in np.split(unseen, np.flatnonzero(np.diff(unseen) > 1) + 1):
        if len(run) > settings.shortest_gap and high > low and estimate.seen[run, 1 - part].all():
            exposure = np.stack([_exposure_costs(evidence, estimate, part, int(i), joined, grid, rng) for i in run])
            ends_known = run[0] > 0, run[-1] < n - 1
            states[run] = _find_hidden_path(exposure, states[run], grid, ends_known)
    return _replace_states(estimate, states, part)


def _exposure_costs(
    evidence: Evidence,
    estimate: PartEstimate,
    part: int,
    frame: int,
    joined: Frames,
    grid: Array,
    rng: np.random.Generator,
) -> Array:
    """(m,) cost of `part`, as seen in the frames `joined`, being visible in `frame` at the states `grid` (m,)."""
    poses = estimate.poses
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
        pixels = sample_pixels(evidence.usable_pixels(i, estimate.labels[i] == part + 1), SAMPLES // 2, rng)
        costs = evidence.costs(i, np.array([frame]), (here @ se3.inverse(Ts[i]))[None], pixels)[:, 0]
        found.append(np.maximum(costs - HIDDEN, 0))
    return np.asarray(np.concatenate(found).mean(0))


def _find_hidden_path(exposure: Array, smooth: Array, grid: Array, ends_known: tuple[bool, bool]) -> Array:
    """States (r,) of a run of frames with the least `exposure` (r, m) and deviation from `smooth` (r,) states.

    Dynamic programming over the states `grid` (m,). `ends_known`: whether the frames before and after the run are
    known.
    """
    deviation = (grid - smooth[:, None]) / np.ptp(grid)
    cost, back = exposure[0] + ends_known[0] * EVENNESS * deviation[0] ** 2, np.zeros(exposure.shape, int)
    for r in range(1, len(smooth)):
        step = cost[:, None] + EVENNESS * (deviation[r - 1][:, None] - deviation[r]) ** 2
        back[r] = step.argmin(0)
        cost = step.min(0) + exposure[r]
    at = int((cost + ends_known[1] * EVENNESS * deviation[-1] ** 2).argmin())
    path = [at]
    for r in range(len(smooth) - 1, 0, -1):
        path.append(at := int(back[r, at]))
    return np.asarray(grid[path[::-1]])


def visible_runs(seen: NDArray[np.bool_], jumps: Frames, settings: GapSettings) -> list[Frames]:
    """Runs of frames in which a part is `seen` (n,), split at gaps and before each of `jumps`; short runs are left
    out."""
    frames = np.flatnonzero(seen)
    before = np.searchsorted(jumps, frames, "right")
    parted = (np.diff(frames) > settings.shortest_gap) | (np.diff(before) > 0)
    return [run for run in np.split(frames, np.flatnonzero(parted) + 1) if len(run) >= SHORTEST_RUN]


def _find_jumps(estimate: PartEstimate, part: int, settings: GapSettings) -> Frames:
    """Frames before which the state jumps, and `part` with it, while the other part moves on smoothly."""
    poses, seen = estimate.poses, np.asarray(estimate.seen.all(1))
    steps = np.abs(np.diff(poses.states))
    known = steps[seen[1:] & seen[:-1]]
    if len(known) == 0:
        return np.zeros(0, int)
    typical_step = max(float(np.percentile(known, 90)), 0.01 * float(np.ptp(poses.states[seen])))
    turns, moves = [], []
    for Ts in (poses.Ts, poses.Ts_moving):
        moved = Ts[1:] @ se3.inverse(Ts[:-1])
        turns.append(se3.rotation_angle(moved[:, :3, :3]))
        moves.append(np.linalg.norm(se3.transform(moved, Ts[:-1, :3, 3][:, None])[:, 0] - Ts[:-1, :3, 3], axis=1))
    strides = turns if poses.joint.type == "revolute" else moves
    return np.flatnonzero((steps > settings.jump * typical_step) & (strides[part] > strides[1 - part])) + 1


def _continuing_shift(
    estimate: PartEstimate, jumps: Frames, joined: Frames, run: Frames, settings: GapSettings
) -> float | None:
    """The state to add in `run` to remove a jump between it and the frames `joined`; None when there is none."""
    states = estimate.poses.states
    for jump in map(int, jumps):
        for earlier, later in ((joined, run), (run, joined)):
            before, after = earlier[earlier < jump], later[later >= jump]
            if len(before) and len(after) and after.min() - before.max() <= settings.shortest_gap + 1:
                step = float(states[before.max()] - states[after.min()])
                return step if earlier is joined else -step
    return None


def _replace_states(estimate: PartEstimate, states: Array, part: int) -> PartEstimate:
    """`estimate` with other states; `part` moves, the other part keeps its poses."""
    poses = estimate.poses
    Ts = poses.Ts if part == 1 else poses.Ts_moving @ poses.joint.transform(-states)
    return replace(estimate, poses=replace(poses, joint=poses.joint.spanning(states), states=states, Ts=Ts))


def _remove_full_turns(joint: Joint, states: Array, joined: Frames, run: Frames, shifted: Array) -> Array:
    """`shifted` states of `run` without the full turns of a hinge against the nearest of the frames `joined`."""
    if joint.type == "prismatic":
        return shifted
    distances = np.abs(run[:, None] - joined)
    mine, other = np.unravel_index(distances.argmin(), distances.shape)
    turns = np.round((shifted[mine] - states[joined[other]]) / (2 * np.pi))
    return np.asarray(shifted - 2 * np.pi * turns)


def _find_state_shift(
    evidence: Evidence,
    estimate: PartEstimate,
    part: int,
    joined: Frames,
    run: Frames,
    expected: float | None,
    rng: np.random.Generator,
) -> float | None:
    """The state to add in the frames `run` so that `part` agrees best with the frames `joined`.

    The `expected` shift, or 0, when no other is clearly better. None when a jump has to be undone and yet no state
    fits.
    """
    most = float(np.ptp(estimate.poses.states[np.concatenate([joined, run])]))
    prior = 0.0 if expected is None else expected
    shifts, costs = np.linspace(-most, most, 2 * STATE_STEPS + 1), np.zeros(0)
    sample = _CrossCosts(evidence, estimate, part, joined, run, rng)
    for _ in range(2):
        costs = sample.costs(np.append(shifts, prior))
        best = float(shifts[costs[:-1].argmin()])
        shifts = best + np.linspace(-1.5, 1.5, 25) * most / STATE_STEPS
    if expected is not None and costs.min() > HIDDEN:
        even, odd = np.sort(joined)[::2], np.sort(joined)[1::2]
        own = _CrossCosts(evidence, estimate, part, even, odd, rng).costs(np.zeros(1))[0]
        if costs.min() > FOREIGN * own:  # relative: an occluder raises all costs
            return None
    return best if costs.min() < (1 - MIN_GAIN) * costs[-1] else prior


class _CrossCosts:
    """Costs of pixels of one part, in frames of two runs, in each other's frames."""

    def __init__(
        self,
        evidence: Evidence,
        estimate: PartEstimate,
        part: int,
        joined: Frames,
        run: Frames,
        rng: np.random.Generator,
    ) -> None:
        self.evidence, self.poses, self.part = evidence, estimate.poses, part
        self.sides = tuple(sample_evenly(frames, FRAMES) for frames in (joined, run))
        self.pixels = {
            int(i): sample_pixels(evidence.usable_pixels(i, estimate.labels[i] == part + 1), SAMPLES, rng)
            for frames in self.sides
            for i in frames
        }

    def costs(self, shifts: Array) -> Array:
        """(m,) mean cost of all pixels for each of `shifts` (m,) of the second run's states."""
        fixed, moved = self.sides
        there = self.poses.Ts_moving if self.part == 0 else self.poses.Ts
        states = self.poses.states[moved][:, None] + shifts
        turned = self.poses.joint.transform(states if self.part == 1 else -states)
        Ts_moved = there[moved][:, None] @ turned
        Ts_fixed = (self.poses.Ts, self.poses.Ts_moving)[self.part][fixed]
        found = []
        for T, i in zip(Ts_fixed, fixed, strict=True):
            found.append(self._frame_costs(int(i), moved, Ts_moved @ se3.inverse(T)))
        for T, i in zip(Ts_moved, moved, strict=True):
            found.append(self._frame_costs(int(i), fixed, Ts_fixed[:, None] @ se3.inverse(T)[None]))
        return np.concatenate(found).mean(0)

    def _frame_costs(self, frame: int, others: Frames, Ts: Array) -> Array:
        """(p, m) costs of one frame's pixels under motions (s, m, 4, 4) to other frames."""
        return self.evidence.costs(frame, others, Ts, self.pixels[frame]).mean(1)
