"""Settings of all steps."""

from __future__ import annotations

from dataclasses import asdict, dataclass, field
from typing import Any


@dataclass(frozen=True)
class SurrogateSettings:
    """The fast simulation used in fits."""

    phase_per_step: float = 0.15
    """rad of the fastest oscillation per step; the RK4 step is then off by 4e-6 of the motion."""
    local_phase_per_step: float = 0.4
    """The same for effects that are stiff at one place only; a run spends little time there."""
    max_step_s: float = 0.02
    min_step_s: float = 5e-4
    """Oscillations for which this is too coarse are not resolved by readings at usual rates."""


@dataclass(frozen=True)
class FitSettings:
    """Output-error fits."""

    max_iterations: int = 15
    starts: int = 3
    """Initial guesses of an effect with a place, a width or a speed to find."""
    tilt_rad: float = 7e-3
    """Prior standard deviation of the base's tilt in the plane of motion; a usual mounting is 0.3 degrees off."""
    shaft_damping: float = 0.35
    """Minimum damping ratio of a drive's inertia against the part on the shaft between them. Less damping is an elastic
    drive, not an armature."""
    swing_tolerance: float = 0.02
    """Maximum time of one radian of that oscillation, as a share of the time to cross the range at top speed. A slower
    one is an elastic drive."""
    travel_tolerance: float = 1e-2
    """Maximum presliding travel of dry friction after a reversal, as a share of the range. Filmed pendula had 8e-3."""


@dataclass(frozen=True)
class SearchSettings:
    """Effort of the search. None of these decides between two sets that were found."""

    max_effects: int = 3
    singles: int = 7
    """Effects fitted alone: those with the best first-order guesses."""
    shortlist: int = 5
    """Sets with one more effect that are fitted to convergence."""
    parents: int = 3
    """Sets that larger ones are started from."""
    contenders: int = 8
    """Sets of each size that are evaluated on test runs."""
    all_told: float = 1.1
    """Normalised RMS of a fit below which no larger set is tried."""
    lost: float = 1.35
    """Normalised RMS of the best single effect above which effects without a first guess are fitted, too."""


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
    drift: float = 0.2
    """Relative change of an effect's size over the session above which it is not constant."""


@dataclass(frozen=True)
class GapSettings:
    """All settings of `gap`."""

    surrogate: SurrogateSettings = field(default_factory=SurrogateSettings)
    fit: FitSettings = field(default_factory=FitSettings)
    search: SearchSettings = field(default_factory=SearchSettings)
    judgement: JudgementSettings = field(default_factory=JudgementSettings)
    seconds: float = 120.0
    """Processor time, s, after which no further set is tried."""
    seed: int = 0
    """Of permutation tests."""
    without: tuple[str, ...] = ()
    """Effects excluded from the library."""

    def to_json(self) -> dict[str, Any]:
        """All settings as plain data."""
        return asdict(self)
