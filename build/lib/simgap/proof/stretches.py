"""A run that hangs on a hair, judged in stretches.

A part that is just caught by a notch or just not, or that grazes a stop, goes on in one way or the other for reasons
that nobody measured: what it does later says nothing of a repair, however right that is. Cut into stretches, each from
a start of its own, the run still tells what it tells before and after such an event.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from simgap.fitting.fit import Fit, pieces, placed
from simgap.judgement.judge import RUNS
from simgap.measure.data import FitRun
from simgap.proof.show import Replayed, ReplayGap, Shown, helps, judged_runs

CROSSINGS = 4.0
"""Of the range, at top speed, that a stretch lasts for, such as a second: little more than a swing there and back. From
starts of their own shorter ones follow wrong repairs, too, and longer ones are soon whole runs."""


@dataclass(frozen=True)
class Stretch:
    """A piece of a run, from a state of its own for each of the two assets."""

    begin_s: float
    """Time of its first reading, on the run's clock; it lasts until the next one begins."""
    start_before: tuple[float, float]
    """Position and velocity, rad or m, at that reading, that suit the asset as it was."""
    start_after: tuple[float, float]
    """The same for the repaired asset."""


def stretches_of(runs: tuple[FitRun, ...], before: Fit, after: Fit, name: str) -> tuple[Stretch, ...]:
    """The run of this name cut into stretches, their starts fitted with the asset as it was and with the effects."""
    cut = pieces(tuple(run for run in runs if run.name == name), CROSSINGS * before.theory.problem.crossing_s)
    first, second = (placed(fit, cut).starts for fit in (before, after))
    return tuple(Stretch(float(piece.times_s[0]), first[piece.name], second[piece.name]) for piece in cut)


def at_fault(runs: tuple[ReplayGap, ...]) -> ReplayGap | None:
    """The one held-out run without which the repair helps on all others, of which there must be `RUNS`; None when there
    is no such run, or more than one."""
    judged = judged_runs(runs)
    if len(judged) <= RUNS or helps(runs):
        return None
    found = [run for run in judged if helps([other for other in judged if other is not run])]
    return found[0] if len(found) == 1 and found[0].held_out else None


def as_replays(whole: Replayed, stretches: Sequence[Stretch]) -> tuple[Replayed, ...]:
    """The stretches as runs to replay: each has the readings of its own and the clock and the inputs of the whole run,
    so that an effort may have begun before it, and delays reach back."""
    run, ends = whole.run, [*(s.begin_s for s in stretches[1:]), np.inf]
    found = []
    for stretch, end in zip(stretches, ends, strict=True):
        inside = (run.times_s >= stretch.begin_s) & (run.times_s < end)
        own = replace(run, name=f"{run.name} from {stretch.begin_s:.3f} s", q=np.where(inside, run.q, np.nan))
        found.append(replace(whole, run=own, start_before=stretch.start_before, start_after=stretch.start_after))
    return tuple(found)


def judged_so(shown: Shown, whole: ReplayGap, parts: Shown) -> Shown:
    """What was shown, with the run `whole` as its stretches have it: one behind the other, and the root mean square
    differences of all their readings."""
    times, measured, before, after = (
        np.concatenate([getattr(part, name) for part in parts.runs])
        for name in ("times_s", "measured", "before", "after")
    )
    gap_before, gap_after = (float(np.sqrt(np.mean((series - measured) ** 2))) for series in (before, after))
    joined = replace(
        whole,
        times_s=times,
        measured=measured,
        before=before,
        after=after,
        gap_before=gap_before,
        gap_after=gap_after,
        stretches=len(parts.runs),
    )
    runs = tuple(joined if run is whole else run for run in shown.runs)
    return replace(
        shown,
        runs=runs,
        numerics=max(shown.numerics, parts.numerics),
        timestep_s=min(shown.timestep_s, parts.timestep_s),
        helps=helps(runs, shown.poses),
    )


def said_of(whole: ReplayGap, joined: ReplayGap) -> str:
    """For the page: that the run was judged in stretches, and what its gap is as a whole and so."""
    seconds = float(joined.times_s[-1] - joined.times_s[0]) / joined.stretches
    (whole_after, whole_before), (after, before) = (
        (run.gap_after / run.floor, run.gap_before / run.floor) for run in (whole, joined)
    )
    return (
        f"{whole.run} hangs on a hair: as a whole its gap is {whole_after:.3g} floors with the repair and "
        f"{whole_before:.3g} without, in stretches of {seconds:.1f} s, each from its own start, {after:.2g} and "
        f"{before:.2g}. It was judged in stretches, and its curves are drawn so."
    )
