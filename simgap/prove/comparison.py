"""Comparison of two replays: measured runs with the files of the asset as given and of the repaired one."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field

import numpy as np

from freeart21.se3 import Array
from simgap.geometry.track_geometry import TrackGeometry
from simgap.prove.replay import Replay
from simgap.verdict import GEOMETRY, RunGap, Use, root_mean_square

WIDER, RUN_WIDER = 0.25, 0.5
"""Increase of the normalised gap that a repair may cause: of a regime, and of any one run."""


@dataclass(frozen=True, eq=False)
class ReplayGap(RunGap):
    """The gap of one run with its curves: positions (rad or m), or force for prescribed motion."""

    times_s: Array = field(kw_only=True)
    """(n,) s."""
    measured: Array = field(kw_only=True)
    """(n,) readings."""
    curves: tuple[Array, Array] = field(kw_only=True)
    """(n,) with the asset as given, and with the repaired one."""


def compare_curves(
    run: str,
    times_s: Array,
    measured: Array,
    curves: tuple[Array, Array],
    floor: float,
    regime: str = "",
    use: Use = "fitted",
) -> ReplayGap:
    """The gap between curves (n,) and measurement (n,)."""
    before, after = (root_mean_square(curve - measured) for curve in curves)
    held_out = use != "fitted"
    return ReplayGap(
        run, before, after, floor, held_out, regime, use, times_s=times_s, measured=measured, curves=curves
    )


@dataclass(frozen=True)
class ReplayComparison:
    """The gaps of all replayed runs."""

    runs: tuple[ReplayGap, ...]
    numerics: float
    """Largest normalised change of a replay by the last halving of the time step; NaN without any."""
    timestep_s: float
    """The finest of any run."""
    poses: tuple[RunGap, ...] = ()
    """RMS displacement, m, of the part off the assets' joints in each run of poses."""
    given_up: tuple[str, ...] = ()
    """Runs that were not replayed in time."""
    inconclusive: tuple[ReplayGap, ...] = ()
    """Ill-conditioned runs: they change with the time step, however small."""
    changed: bool = True
    """Whether there are two assets; else one replay stands for both."""

    def split(self, fitted: Iterable[str]) -> tuple[list[ReplayGap], list[ReplayGap]]:
        """Runs of the `fitted` regimes (all where none is), and the others."""
        of = set(fitted)
        near = [run for run in self.runs if run.regime in of] or list(self.runs)
        return near, [run for run in self.runs if run not in near]


def closed_part(runs: Sequence[RunGap]) -> float | None:
    """Closed share of the gap beyond noise in these runs; None without a gap."""
    if not runs:
        return None
    before, after, floor = (root_mean_square([getattr(r, name) for r in runs]) for name in ("before", "after", "floor"))
    return (before - after) / (before - floor) if before > floor else None


def track_use(track: TrackGeometry) -> Use:
    """Use of a run of poses."""
    return "choosing" if track.held_out else "fitted"


def compare_replays(
    before: Replay,
    after: Replay,
    floor: float,
    judged: Iterable[RunGap],
    poses: Sequence[TrackGeometry] = (),
) -> ReplayComparison:
    """The comparison of two replays of the same runs, with the asset as given and the repaired one.

    Ill-conditioned runs count only where all are. `floor` is the noise of the readings, rad or m; `judged` gives the
    use of the runs, and `poses` are the replayed runs of poses.
    """
    of = {gap.run: gap for gap in judged if gap.regime != GEOMETRY}
    gaps, sure = [], []
    for was, is_now in zip(before.runs, after.runs, strict=True):
        curves, about = (was.simulated, is_now.simulated), of[was.run]
        gaps.append(compare_curves(was.run, was.times_s, was.measured, curves, floor, about.regime, about.use))
        sure.append(was.is_converged and is_now.is_converged)
    counts_too = sure if any(sure) else [True] * len(sure)
    counted = [run for asset in (before, after) for run, counts in zip(asset.runs, counts_too, strict=True) if counts]
    return ReplayComparison(
        tuple(gap for gap, counts in zip(gaps, counts_too, strict=True) if counts),
        max((run.change for run in counted), default=np.nan if before.given_up else 0.0),
        min((run.timestep_s for run in counted), default=np.nan),
        tuple(
            RunGap(track.name, was, is_now, track.floor, track.held_out, GEOMETRY, track_use(track))
            for track, was, is_now in zip(poses, before.poses, after.poses, strict=False)
        ),
        before.given_up,
        tuple(gap for gap, counts in zip(gaps, counts_too, strict=True) if not counts),
        before is not after,
    )


def is_improved(gaps: Sequence[RunGap]) -> bool:
    """Whether the normalised gap decreased overall, and increased in no regime by a quarter sigma and in no run by half
    a sigma; runs of one regime may still differ."""
    groups: dict[str, list[tuple[float, float]]] = {}
    for gap in gaps:
        groups.setdefault(gap.regime, []).append((gap.before / gap.floor, gap.after / gap.floor))
    sizes = [np.sqrt(np.mean(np.square(group), axis=0)) for group in groups.values()]
    whole, left = np.sqrt(np.mean(np.square([pair for group in groups.values() for pair in group]), axis=0))
    if not np.isfinite(sizes).all() or any(after > before + WIDER for before, after in sizes):
        return False
    if any(after > before + RUN_WIDER for group in groups.values() for before, after in group):
        return False
    return bool(left < whole)
