"""Settings of every step."""

from __future__ import annotations

from dataclasses import asdict, dataclass, field
from typing import Any


@dataclass(frozen=True)
class SurrogateSettings:
    """The fast simulation that fits search in."""

    phase_per_step: float = 0.15
    """rad of the fastest oscillation a step: the fourth-order step is then late by 4e-6 of the way."""
    local_phase_per_step: float = 0.4
    """The same of what is stiff at a place only: little of a run is spent there."""
    max_step_s: float = 0.02
    min_step_s: float = 5e-4
    """What swings so fast that this is coarse, readings at usual rates do not show."""


@dataclass(frozen=True)
class FitSettings:
    """Output-error fits."""

    max_iterations: int = 15
    starts: int = 3
    """Starting points of an effect with a place, a width or a speed to find."""
    tilt_rad: float = 7e-3
    """How far the base may lean in the plane of the motion without being called an effect; a usual mounting is 0.3
    degrees off."""
    shaft_damping: float = 0.35
    """Least damping ratio with which a drive's inertia and the part's own swing about the shaft between them. What
    loses less is an elastic drive, not an armature."""
    swing_tolerance: float = 0.02
    """Part of the time of a crossing at top speed in which a drive's inertia and the part's own swing by a radian about
    the shaft between them, at most: what swings slower is an elastic drive."""
    travel_tolerance: float = 1e-2
    """Part of the way moved through over which dry friction may build up after a reversal: no real one does at once,
    and small swings are the faster for it. Of filmed pendula 8e-3 were measured."""


@dataclass(frozen=True)
class SearchSettings:
    """How far sets are looked for; none of it decides between two that were found."""

    max_effects: int = 3
    singles: int = 7
    """Effects that are fitted alone: those of the best first-order guesses."""
    shortlist: int = 5
    """Sets of one effect more that are fitted to the end."""
    parents: int = 3
    """Sets that larger ones start from."""
    contenders: int = 8
    """Sets of a size that are put before runs that they were not fitted to."""
    all_told: float = 1.1
    """Floors of a fit from which on no larger set is looked for: nothing is left to explain."""
    lost: float = 1.35
    """Floors of the best single effect from which on those are fitted, too, that first guesses tell nothing of."""


@dataclass(frozen=True)
class JudgementSettings:
    """All numbers that decide a verdict; they stand in verdict.json."""

    least_motion: float = 15.0
    """Floors that the joint must move through for anything to be said."""
    least_readings: int = 60
    """Readings, of all runs together, below which nothing is said: three stretches, each with a start of its own, and
    the asset's own doubts leave none to spare."""
    least_gap: float = 0.35
    """Floors that an explanation must take of choosing runs for a small gap to be one: less may come of coarse time
    stamps alone."""
    plain_gap: float = 2.5
    """Floors of error of the middle run at which there is a gap, whether anything explains it or not."""
    explained_part: float = 0.03
    """Part of a large gap that an explanation may leave, departures of its formulas being counted. Of strong effects
    of a second world .002 to .01 are left; of a filmed pendulum, whose losses have no such names, .07."""
    most: float = 10.0
    """Floors that it may leave of a run in any case: more is a name in part."""
    met: float = 0.75
    """Part of the runs that must be met so: what just passes a notch or grazes a stop hangs on a hair."""
    dominant: float = 0.5
    """Part of a run's gap that what dominates may leave."""
    drift: float = 0.2
    """Part of itself by which the size of an effect must change over the session for it not to be a constant."""


@dataclass(frozen=True)
class GapSettings:
    """Of the whole workflow."""

    surrogate: SurrogateSettings = field(default_factory=SurrogateSettings)
    fit: FitSettings = field(default_factory=FitSettings)
    search: SearchSettings = field(default_factory=SearchSettings)
    judgement: JudgementSettings = field(default_factory=JudgementSettings)
    seconds: float = 120.0
    """Of processor time after which no further set of effects is looked for."""
    seed: int = 0
    """Of permutations."""
    without: tuple[str, ...] = ()
    """Effects that are left out of the library."""

    def to_json(self) -> dict[str, Any]:
        """All settings as plain data."""
        return asdict(self)
