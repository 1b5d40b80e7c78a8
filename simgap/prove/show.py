"""The gap that counts: measured runs, replayed by the files of the asset as it was and of the repaired one.

`simgap.prove.replay` replays; here the two are held against each other.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from freeart21.se3 import Array
from simgap.prove.replay import Replay, RunReplay
from simgap.verdict import Use

WIDER, RUN_WIDER = 0.25, 0.5
"""Floors by which a repair may widen the gap of a regime, and of any one run in it."""


@dataclass(frozen=True)
class Chosen:
    """A run to replay, by its name in the measured set."""

    name: str
    floor: float
    """rad or m: noise of the readings."""
    regime: str = ""
    use: Use = "confirming"


@dataclass(frozen=True)
class ChosenPoses:
    """A run of poses to replay."""

    name: str
    floor: float
    """m: noise of the poses."""
    held_out: bool = True


@dataclass(frozen=True)
class PoseGap:
    """How far the part is off the assets' joints, m: root mean square displacement."""

    run: str
    before: float
    after: float
    floor: float
    held_out: bool


@dataclass(frozen=True)
class ReplayGap:
    """What came out for one run."""

    run: str
    times_s: Array
    """(n,) s."""
    measured: Array
    """(n,) rad or m."""
    before: Array
    """(n,) readings of the asset as it was, in SAPIEN."""
    after: Array
    """(n,) of the repaired asset."""
    gap_before: float
    """Root mean square difference, rad or m."""
    gap_after: float
    floor: float
    regime: str
    use: Use


@dataclass(frozen=True)
class Shown:
    """The gap of all replayed runs, and whether the repair is one."""

    runs: tuple[ReplayGap, ...]
    numerics: float
    """Floors by which the last halving of the time step changed a replay at most; NaN when it was never reached."""
    timestep_s: float
    """The finest one of any run."""
    helps: bool | None
    """Whether the repaired asset is nearer to what was measured, and in no regime further away; None: not one run of
    these was replayed in time."""
    poses: tuple[PoseGap, ...] = ()
    given_up: tuple[str, ...] = ()
    """Runs that were not replayed in time."""
    unsure: tuple[ReplayGap, ...] = ()
    """Runs whose replays hang on a hair: time steps however fine change them, so they tell nothing."""
    changed: bool = True
    """Whether there are two assets, or one replay stands for both."""

    def closed(self, regimes: Iterable[str] | None = None) -> float | None:
        """Part of the gap beyond the floor that is closed in these regimes (all for None); None without any gap."""
        chosen = [r for r in self.runs if regimes is None or r.regime in set(regimes)]
        if not chosen:
            return None
        before, after, floor = (
            float(np.sqrt(np.mean([getattr(r, name) ** 2 for r in chosen])))
            for name in ("gap_before", "gap_after", "floor")
        )
        return (before - after) / (before - floor) if before > floor else None


def alike(shown: Shown, fitted: Iterable[str]) -> list[ReplayGap]:
    """The replayed runs that move as the `fitted` regimes do; all where none does."""
    of = set(fitted)
    return [run for run in shown.runs if run.regime in of] or list(shown.runs)


def closed_alike(shown: Shown, fitted: Iterable[str]) -> tuple[float | None, float | None]:
    """Closed part of the gap in motion of the `fitted` regimes (in all where none of those was replayed), and in other
    motion."""
    regimes = {r.regime for r in shown.runs}
    like = regimes & set(fitted)
    return shown.closed(like or regimes), shown.closed(regimes - like) if like and regimes - like else None


def show(before: Replay, after: Replay, chosen: Sequence[Chosen], poses: Sequence[ChosenPoses] = ()) -> Shown:
    """Two replays of the same runs, by the asset as it was and by the repaired one.

    A run that hangs on a hair counts only where all do.
    """
    of = {each.name: each for each in chosen}
    pairs = list(zip(before.runs, after.runs, strict=True))
    sure = [pair for pair in pairs if pair[0].sure and pair[1].sure] or pairs
    runs = tuple(_gap(*pair, of[pair[0].run]) for pair in sure)
    tracks = tuple(
        PoseGap(track.name, was, is_now, track.floor, track.held_out)
        for track, was, is_now in zip(poses, before.poses, after.poses, strict=False)
    )
    told = [run for pair in sure for run in pair]
    return Shown(
        runs,
        max((run.change for run in told), default=np.nan if chosen else 0.0),
        min((run.timestep_s for run in told), default=np.nan),
        helps(runs, tracks) if runs or tracks else None,
        tracks,
        before.given_up,
        tuple(_gap(*pair, of[pair[0].run]) for pair in pairs if pair not in sure),
        before is not after,
    )


def helps(runs: Sequence[ReplayGap], poses: tuple[PoseGap, ...] = ()) -> bool:
    """Whether the gap, in floors, is smaller in all, in no regime (nor off the joint) wider by a quarter floor, and in
    no run by half a floor: runs of one regime may be of different kinds all the same."""
    groups: dict[str, list[tuple[float, float]]] = {}
    for run in runs:
        groups.setdefault(run.regime, []).append((run.gap_before / run.floor, run.gap_after / run.floor))
    for track in [p for p in poses if p.held_out] or poses:
        groups.setdefault(" off the joint", []).append((track.before / track.floor, track.after / track.floor))
    sizes = [np.sqrt(np.mean(np.square(group), axis=0)) for group in groups.values()]
    whole, left = np.sqrt(np.mean(np.square([pair for group in groups.values() for pair in group]), axis=0))
    if not np.isfinite(sizes).all() or any(after > before + WIDER for before, after in sizes):
        return False
    if any(after > before + RUN_WIDER for group in groups.values() for before, after in group):
        return False
    return bool(left < whole)


def _gap(before: RunReplay, after: RunReplay, chosen: Chosen) -> ReplayGap:
    return ReplayGap(
        before.run,
        before.times_s,
        before.measured,
        before.simulated,
        after.simulated,
        before.error,
        after.error,
        chosen.floor,
        chosen.regime,
        chosen.use,
    )
