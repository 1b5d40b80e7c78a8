"""Mass and inertia of a part, as a solid or as a shell."""

from __future__ import annotations

import numpy as np
import trimesh

from freeart21.errors import FreeArtError
from freeart21.files.urdf import UrdfInertial
from freeart21.mesh import Mesh

THINNEST_WALL = 1e-3
"""m, of a hollow part: moulded housings have walls of 1 to 3 mm, sheet metal of drawers and cans less at a higher
density."""


def compute_inertial(mesh: Mesh, density: float, wall: float | None = None) -> UrdfInertial:
    """Mass properties of a mesh of `density`, kg/m^3: of the solid inside, or with `wall`, m, of a shell along the
    mesh.

    A shell may be open; its mass is area x wall x density. Raises FreeArtError when there is no volume or no area.
    """
    if wall is not None:
        return _shell_inertial(mesh, density * wall)
    solid = trimesh.Trimesh(mesh.vertices, mesh.faces, process=False)
    volume = float(solid.volume)
    if not (volume > 0 and solid.is_watertight):
        raise FreeArtError(f"mesh bounds no volume ({volume:.3g} m^3), expected a closed one, faces outwards")
    mass = solid.mass_properties
    return UrdfInertial(density * volume, np.asarray(mass.center_mass), density * np.asarray(mass.inertia))


def fill_range(mesh: Mesh, wall: float | None) -> tuple[float, float]:
    """Least and most m^3 of material in a closed mesh: a shell of `THINNEST_WALL`, and the whole solid.

    A given `wall`, m, leaves no doubt: both are its volume.
    """
    area = float(mesh.areas().sum())
    if wall is not None:
        return area * wall, area * wall
    volume = float(trimesh.Trimesh(mesh.vertices, mesh.faces, process=False).volume)
    return min(area * THINNEST_WALL, volume), volume


def _shell_inertial(mesh: Mesh, density: float) -> UrdfInertial:
    """Mass properties of triangles of `density`, kg/m^2. The integral of x x^T over a triangle with corners v and
    centroid c is area / 12 (sum of v v^T + 9 c c^T)."""
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
    return UrdfInertial(density * float(area.sum()), centre, density * (np.trace(second) * np.eye(3) - second))


def find_unphysical(inertial: UrdfInertial) -> str | None:
    """Why no rigid body has these mass properties, or None: needs mass > 0, moments > 0 and A + B >= C."""
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
