"""What fits and choice have come to, before the confirming frames speak."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from freeart21.camera_faults import CameraFaults
from freeart21.recording import Recording
from simgap.film.colour import Colours
from simgap.film.counts import Family
from simgap.film.geometry import Geometry
from simgap.film.library import Design
from simgap.film.missing import MissingPart
from simgap.film.samples import Rows
from simgap.film.scene import FilmScene


@dataclass(frozen=True)
class Found:
    """What fits and choice have come to."""

    recording: Recording
    scene: FilmScene
    frames: NDArray[np.int64]
    split: tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.int64]]
    """Indices into `frames`: to fit, to choose, to confirm."""
    rows: Rows
    design: Design
    geometry: Geometry
    camera: CameraFaults
    """Geometry alone."""
    simulated_with: CameraFaults
    """The camera about which the rows are."""
    families: tuple[Family, Family, Family]
    """Noise, holes, flying pixels."""
    drift: Colours | None
    part: MissingPart | None
    shut: frozenset[str]
    quiet: float
    """Floor of a pixel's noise, metres."""
