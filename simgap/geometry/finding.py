"""What can be told of a joint's geometry, and when it is believed."""

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
    """How geometry is looked for and when it is believed."""

    without: tuple[str, ...] = ()
    """Effects that are left out of the library."""
    most_effects: int = 3
    """Effects that may be named together."""
    level: float = 0.01
    """p-value that every named effect must reach on runs that it was not fitted to."""
    least_share: float = 0.03
    """Share of the noise's loss by which an effect must lower the held-out loss: about 0.17 floors of displacement."""
    form: float = 0.1
    """Part of the whole displacement that may be a named effect's real form being other than the library's: what
    closes no more than that has no name of its own. Rocking goes with time, so neither is it the form of another effect
    nor is another one its form."""
    unexplained_floors: float = 0.5
    """Floors of displacement, besides the named effects, that a free function of the joint's position explains."""
    tracker_floors: float = 2.0
    """The same without any effect, where none explains it: so far a tracker's own errors go with the position."""
    closed: float = 0.75
    """Part of the gap that must be closed for a name to be given while something remains."""
    least_span: tuple[float, float] = (0.05, 0.005)
    """Motion, rad and m, below which nothing can be said."""
    registration_std: tuple[float, float] = (1e-3, 1e-3)
    """Metres and radians by which the tracker's idea of the part's frame may be off: a constant, no effect."""
    most_frames: int = 1000
    """Frames, of all runs together, that the search looks at: poses next to each other say the same."""


@dataclass(frozen=True)
class KinematicsFinding:
    """The geometry of the joint, as far as it can be told."""

    verdict: GeometryVerdict
    named: tuple[NamedEffect, ...]
    """Effects with their intervals, outermost displacement first."""
    rivals: tuple[tuple[str, ...], ...]
    """Sets of names that explain the poses as well as each other, the best one first; empty when there is no doubt."""
    tracks: tuple[TrackGeometry, ...]
    ranking: tuple[tuple[tuple[str, ...], float, float], ...]
    """Sets of names, their held-out loss over the noise's (1 is noise alone), p-value of no gain over no effect."""
    unexplained_rms: float
    """Floors of displacement that depend on the joint's position and have no name here."""
    next_experiment: str | None = None
    registrations: tuple[Array, Array] = field(default_factory=lambda: (np.zeros(6), np.zeros(6)))
    """Twists by which the tracker's idea of the part's frame is off, with the ideal joint and with the named effects:
    measured motion = model @ exp(twist), in the parent link's frame."""
    p_values: tuple[float, ...] = field(default=())
    """Of every named effect: that the others do as well without it."""

    @property
    def effects(self) -> tuple[Effect, ...]:
        """The named effects."""
        return tuple(each.effect for each in self.named)
