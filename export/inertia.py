"""Mass and inertia of a part from the volume of its collision hulls."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import trimesh
from numpy.typing import NDArray

from freeart21.errors import FreeArtError
from freeart21.mesh import Mesh


@dataclass(frozen=True)
class Inertial:
    """Rigid-body mass properties in the axes of a link."""

    mass: float
    """kg."""
    centre: NDArray[np.float64]
    """(3,) centre of mass, m."""
    inertia: NDArray[np.float64]
    """(3, 3) about the centre of mass, kg m^2."""


def inertial_of(hulls: Sequence[Mesh], density: float) -> Inertial:
    """Mass properties of closed solids of `density`, kg/m^3, added up (parallel axes theorem); overlaps count twice.

    Raises FreeArtError when there is no volume.
    """
    solids = [trimesh.Trimesh(hull.vertices, hull.faces, process=False).mass_properties for hull in hulls]
    volume = sum(float(solid.volume) for solid in solids)
    if not volume > 0:
        raise FreeArtError(f"collision hulls have volume {volume:.3g} m^3, expected more than 0")
    centre = sum((solid.volume * solid.center_mass for solid in solids), np.zeros(3)) / volume
    inertia = np.zeros((3, 3))
    for solid in solids:
        arm = solid.center_mass - centre
        inertia += solid.inertia + solid.volume * (arm @ arm * np.eye(3) - np.outer(arm, arm))
    return Inertial(density * volume, centre, density * inertia)


def unphysical(inertial: Inertial) -> str | None:
    """What keeps these numbers from being those of a body, or None: mass > 0, moments > 0, A + B >= C."""
    if not (np.isfinite(inertial.mass) and inertial.mass > 0):
        return f"mass is {inertial.mass:g} kg, expected more than 0"
    if not np.isfinite(inertial.inertia).all():
        return "inertia has entries that are not finite"
    a, b, c = np.linalg.eigvalsh(inertial.inertia)
    if a <= 0:
        return f"principal moments are {a:.3g}, {b:.3g}, {c:.3g} kg m^2, expected all above 0"
    if a + b < c * (1 - 1e-6):
        return f"principal moments {a:.3g}, {b:.3g}, {c:.3g} kg m^2 break the triangle inequality"
    return None
