"""What is compared between two films, and what the page shows beyond the verdict."""

from __future__ import annotations

from dataclasses import dataclass

from freeart21.recording import Recording
from simgap.film.choose import Chosen
from simgap.film.maps import FilmMap
from simgap.film.samples import Rows
from simgap.film.scene import FilmScene


@dataclass(frozen=True)
class Film:
    """Two films to compare."""

    recording: Recording
    scene: FilmScene
    depth_unit: float
    """Metres: quantisation of the measured depth."""


@dataclass(frozen=True)
class FilmResult:
    """Results for the page beyond the verdict."""

    film: Film
    kinds: tuple[Chosen, ...]
    maps: tuple[FilmMap, ...]
    rows: Rows
    """For the asset's film as it is."""
