"""Mass and inertia of a part, from the solid that its mesh bounds or from a wall along it."""

from __future__ import annotations

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


def inertial_of(mesh: Mesh, density: float, wall: float | None = None) -> Inertial:
    """Mass properties of a part of `density`, kg/m^3: of the solid that a closed mesh bounds, or of a wall along it.

    With `wall`, metres, the part is a shell: its mass is area x wall x density, spread over the mesh, open or closed.
    Raises FreeArtError when there is no volume, or no area.
    """
    if wall is not None:
        return _shell(mesh, density * wall)
    solid = trimesh.Trimesh(mesh.vertices, mesh.faces, process=False)
    volume = float(solid.volume)
    if not (volume > 0 and solid.is_watertight):
        raise FreeArtError(f"mesh bounds no volume ({volume:.3g} m^3), expected a closed one, faces outwards")
    mass = solid.mass_properties
    return Inertial(density * volume, np.asarray(mass.center_mass), density * np.asarray(mass.inertia))


def _shell(mesh: Mesh, density: float) -> Inertial:
    """Of thin triangles of `density`, kg/m^2: the integral of x x^T over one is area / 12 (sum of v v^T + 9 c c^T)."""
    area = mesh.areas()
    if not area.sum() > 0:
        raise FreeArtError("mesh has no area, expected triangles")
    corners = mesh.vertices[mesh.faces]
    middle = corners.mean(1)
    centre = area @ middle / area.sum()
    corners, middle = corners - centre, middle - centre
    second = np.einsum("f,fki,fkj->ij", area / 12, corners, corners) + np.einsum(
        "f,fi,fj->ij", 9 * area / 12, middle, middle
    )
    return Inertial(density * float(area.sum()), centre, density * (np.trace(second) * np.eye(3) - second))


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
