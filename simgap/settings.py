"""Settings of `gap`, and the thresholds of a verdict."""

from __future__ import annotations

from dataclasses import dataclass, field


@dataclass(frozen=True)
class JudgementSettings:
    """All numbers that decide a verdict; they are stored in verdict.json."""

    least_motion: float = 15.0
    """Range of motion, in noise sigmas, below which the verdict is `not_excited`."""
    least_readings: int = 60
    """Readings of all runs together below which the verdict is `not_excited`: three stretches with a start state each,
    and the asset's own parameters, need more."""
    least_gap: float = 0.35
    """Normalised RMS (root of the difference of squares) that a set must remove from test runs; coarse time stamps
    alone make up to that."""
    plain_gap: float = 2.5
    """Normalised RMS of the median run above which there is a gap, explained or not."""
    explained_part: float = 0.03
    """Share of a large gap that an explanation may leave, with model error allowed. Strong effects of a second
    simulated world left .002 to .01; a filmed pendulum, whose losses no effect describes, .07."""
    most: float = 10.0
    """Normalised RMS that an explanation may leave of a run at most; above it is named in part."""
    met: float = 0.75
    """Share of the runs that must meet these bounds. A run that just passes a notch or grazes a stop is
    ill-conditioned."""
    dominant: float = 0.5
    """Share of a run's gap that dominant effects may leave."""


@dataclass(frozen=True)
class GapSettings:
    """All settings of `gap`."""

    judgement: JudgementSettings = field(default_factory=JudgementSettings)
    seconds: float = 120.0
    """Processor time, s, after which no further set is tried."""
    seed: int = 0
    """Of permutation tests."""
    without: tuple[str, ...] = ()
    """Effects excluded from the library."""
