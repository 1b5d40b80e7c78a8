"""Result of the analysis of a joint's geometry, and its settings."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal

import numpy as np

from freeart21.effects.base import Effect
from freeart21.se3 import Array
from simgap.geometry.track_geometry import TrackGeometry
from simgap.verdict import NamedEffect

GeometryVerdict = Literal["no_gap", "named", "ambiguous", "unexplained", "not_excited"]


@dataclass(frozen=True)
class KinematicsSettings:
    """Settings of the search and thresholds."""

    without: tuple[str, ...] = ()
    """Effects excluded from the library."""
    most_effects: int = 3
    """Effects that may be named together."""
    level: float = 0.01
    """Largest p-value of a named effect on runs that it was not fitted to."""
    least_share: float = 0.03
    """Least decrease of the held-out loss per effect, as a share of the noise's: 0.17 sigmas of displacement."""
    form: float = 0.1
    """Share of the whole displacement that the form error of a named effect may leave: an effect that explains no more
    is not named. Rocking depends on time, so it is exempt both ways."""
    unexplained_floors: float = 0.5
    """Normalised displacement beyond the named effects, explained by a free function of position, above which it is
    unexplained."""
    tracker_floors: float = 2.0
    """The same without any named effect, where tracker errors over position reach this far."""
    closed: float = 0.75
    """Share of the gap that named effects must close while something remains."""
    least_span: tuple[float, float] = (0.05, 0.005)
    """Range of motion, rad and m, below which nothing is reported."""
    registration_std: tuple[float, float] = (1e-3, 1e-3)
    """Standard deviation, m and rad, of the tracker's part frame: a constant, no effect."""
    most_frames: int = 1000
    """Frames of all runs used by the search; neighbouring poses are redundant."""


@dataclass(frozen=True)
class KinematicsFinding:
    """The estimated geometry of a joint."""

    verdict: GeometryVerdict
    named: tuple[NamedEffect, ...]
    """Effects with their intervals, outermost displacement first."""
    rivals: tuple[tuple[str, ...], ...]
    """Sets of effects that explain the poses equally well, the best first; empty without doubt."""
    tracks: tuple[TrackGeometry, ...]
    ranking: tuple[tuple[tuple[str, ...], float, float], ...]
    """Sets of effects, held-out loss relative to noise (1 is noise alone), p-value of no gain over no effect."""
    unexplained_rms: float
    """Normalised displacement that depends on the joint's position and has no name."""
    next_experiment: str | None = None
    registrations: tuple[Array, Array] = field(default_factory=lambda: (np.zeros(6), np.zeros(6)))
    """Twists of the tracker's part frame, with the ideal joint and with the named effects: measured motion = model @
    exp(twist), in the parent link's frame."""
    p_values: tuple[float, ...] = field(default=())
    """Of every named effect: that the others do as well without it."""

    @property
    def effects(self) -> tuple[Effect, ...]:
        """The named effects."""
        return tuple(each.effect for each in self.named)
