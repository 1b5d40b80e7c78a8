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
    rebound_tolerance: float = 0.6
    """By how much of itself what comes back from a stop may differ from its formula, which no law describes well: with
    the speed of the impact."""
    shaft_damping: float = 0.35
    """Least damping ratio with which a drive's inertia and the part's own swing about the shaft between them. What
    loses less is an elastic drive, not an armature."""
    swing_tolerance: float = 0.02
    """Part of the time of a crossing at top speed in which a drive's inertia and the part's own swing by a radian about
    the shaft between them, at most: what swings slower is an elastic drive."""
    travel_tolerance: float = 1e-3
    """Part of the way moved through over which dry friction may build up after a reversal: no real one does at once,
    and small swings are the faster for it."""
    springy_tolerance: float = 0.2
    """Part of the top speed up to which half of the speed at which the flanks of a slack meet may come back."""
    twist_tolerance: float = 1e-3
    """Part of the way moved through by which the shaft of a drive may twist under the forces at work: what twists more
    is an elastic drive, not an armature."""
    bend_tolerance: float = 0.4
    """Part of itself by which a force of position may differ from a spring's, that is no spring's."""
    give_tolerance: float = 0.01
    """Part of the way moved through by which the flanks of a slack may give way under the forces at work."""


@dataclass(frozen=True)
class ChoiceSettings:
    """From fits to a verdict."""

    least_motion: float = 15.0
    """Floors that the joint must move through for anything to be said."""
    least_readings: int = 60
    """Readings, of all runs together, below which nothing is said: three stretches, each with a start of its own, and
    the asset's own doubts leave none to spare."""
    max_effects: int = 3
    singles: int = 7
    """Effects that are fitted alone: those of the best first-order guesses."""
    shortlist: int = 5
    """Sets of one effect more that are fitted to the end."""
    parents: int = 3
    """Sets that larger ones start from."""
    contenders: int = 4
    """Sets of a size that are put before held-out runs."""
    least_gap: float = 0.35
    """Floors that must be explained for a gap to be one: less may come of coarse time stamps alone."""
    hint: float = 0.6
    """Part of the least gap that some effect must promise to explain, to first order, for any to be fitted when the
    asset alone leaves no more than an explanation may."""
    plain_gap: float = 2.5
    """Floors of error, of all runs but one of four or more, at which there is a gap, whether anything explains it or
    not."""
    p_value: float = 0.01
    explained: float = 1.35
    """Floors of error on held-out runs that an explanation of a small gap may leave; the floor is an estimate."""
    explained_part: float = 0.06
    """Part of a large gap that it may leave besides."""
    missed: float = 2.0
    """Times what an explanation may leave of held-out runs that it may leave of the runs that it was fitted to."""
    spared: float = 0.24
    """Part of the runs with a plain gap of their own in which an explanation need not halve it."""
    widest: float = 1 / 3
    """Part of its gap that an explanation may leave of a run that is far wider than all others, held out or fitted; of
    one of them more."""
    wild: float = 5.0
    """Times the gap of the others of its kind from which on a run is far wider."""
    same_size: float = 1.6
    """Times by which the sizes of a set that misses a run may change when they are free within the form tolerance."""
    well_explained: float = 0.2
    """Part of a large bar at which no larger set is looked for."""
    nameless: float = 0.6
    """Floors of what is left that a force without a name may explain beside an explanation, its sizes free; and"""
    nameless_part: float = 0.05
    """... the part of the gap that it may,"""
    nameless_usual: float = 0.15
    """... but no more than this part of the gap without the run that is widest."""
    drift: float = 0.2
    """Part of itself by which the size of an effect must change over the session for it not to be a constant."""
    form_doubt: float = 2.0
    """Floors that a plain formula may leave before sets of other effects are tried, though its form explains it."""
    form_factor: float = 8.0
    """Bars of error beyond which no departure from a formula is tried."""
    hopeless: float = 3.0
    """Bars of error that the best set may leave for a third effect to be looked for."""
    much_better: float = 0.6
    """A larger set must leave less than this part of what a smaller one leaves, both beyond noise."""
    rival: float = 1.15
    """A set whose held-out error is within this factor of the best is its rival,"""
    rival_sum: float = 9.0
    """... and so is one whose sum of squares is not larger by this many units of noise,"""
    many_floors: float = 10.0
    """Floors that a name may leave of runs kept back and be all that is said: more is a name in part."""
    dominant: float = 0.5
    """Part of a run's gap that what dominates may leave."""
    nameless_dominates: float = 0.1
    """Part of the gap from which on a force without a name, that does away with most of what a set leaves, dominates
    as well. Not measured."""
    rival_power: float = 0.2
    """... unless another beats it on held-out runs and, by this part of noise's power, on those that both were fitted
    to."""


@dataclass(frozen=True)
class GapSettings:
    """Of the whole workflow."""

    surrogate: SurrogateSettings = field(default_factory=SurrogateSettings)
    fit: FitSettings = field(default_factory=FitSettings)
    choice: ChoiceSettings = field(default_factory=ChoiceSettings)
    seed: int = 0
    """Of permutations."""
    without: tuple[str, ...] = ()
    """Effects that are left out of the library."""

    def to_json(self) -> dict[str, Any]:
        """All settings as plain data."""
        return asdict(self)
