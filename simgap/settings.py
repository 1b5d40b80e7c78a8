"""Settings of every step."""

from __future__ import annotations

from dataclasses import asdict, dataclass, field
from typing import Any


@dataclass(frozen=True)
class SurrogateSettings:
    """The fast simulation that fits search in."""

    phase_per_step: float = 0.1
    """rad of the fastest oscillation a step: the fourth-order step is then off by 1e-7 a radian."""
    max_step_s: float = 0.01
    min_step_s: float = 1e-4


@dataclass(frozen=True)
class FitSettings:
    """Output-error fits."""

    max_iterations: int = 25
    starts: int = 3
    """Starting points of an effect with a place, a width or a speed to find."""
    tilt_rad: float = 7e-3
    """How far the base may lean in the plane of the motion without being called an effect; a usual mounting is 0.3
    degrees off."""
    form_tolerance: float = 0.3
    """By how much of itself a real effect may differ from the library's formula over the range of speeds and
    positions and still have its name."""


@dataclass(frozen=True)
class ChoiceSettings:
    """From fits to a verdict."""

    max_effects: int = 3
    shortlist: int = 7
    """Effects that pairs are made of."""
    least_gap: float = 0.35
    """Floors of gap (beyond the floor) below which nothing is sought: what coarse time stamps alone can leave."""
    p_value: float = 0.01
    explained: float = 2.0
    """Floors of error on held-out runs that an explanation may leave."""
    explained_part: float = 0.04
    """... or this part of the gap before, whichever is more."""
    rival: float = 1.15
    """A set of effects whose held-out error is within this factor of the best is its rival."""


@dataclass(frozen=True)
class GapSettings:
    """Of the whole workflow."""

    surrogate: SurrogateSettings = field(default_factory=SurrogateSettings)
    fit: FitSettings = field(default_factory=FitSettings)
    choice: ChoiceSettings = field(default_factory=ChoiceSettings)
    seed: int = 0
    """Of permutations."""

    def to_json(self) -> dict[str, Any]:
        """All settings as plain data."""
        return asdict(self)
