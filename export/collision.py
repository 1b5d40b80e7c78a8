"""What a part collides with: convex pieces that follow its surface within a tolerance, so that openings stay open."""

from __future__ import annotations

from dataclasses import dataclass

import manifold3d
import numpy as np
from numpy.typing import NDArray

from export.decomposition import Tolerance, convex_pieces, thickened
from export.fidelity import Fidelity, measured
from export.outside import even_directions, outside_of
from export.primitive_fit import primitive_of
from export.primitives import Primitive
from freeart21.errors import FreeArtError
from freeart21.mesh import Mesh


@dataclass(frozen=True)
class CollisionSettings:
    """How a part is cut into convex pieces."""

    tolerance_m: float = 1.2e-3
    """m by which a piece may stand out of the part. Of parts under 6 cm a fiftieth of their size; of those over 60 cm a
    five hundredth: there it is the spacing of the points that are looked at."""
    max_hulls: int = 256
    """Pieces a part may have; beyond, the tolerance is widened. A stapler's base takes 62."""
    max_vertices: int = 48
    """Vertices a piece may have; PhysX takes at most 255, MuJoCo likes few."""
    min_thickness_m: float = 1e-3
    """Thinner pieces are made this thick: simulators refuse flat solids."""
    primitives: bool = True
    """Whether boxes, cylinders and balls stand for pieces that are as good as such."""
    patches: int = 2500
    """Pieces that the surface is split into at most, before they are joined."""
    pairs: int = 60_000
    """Pairs of pieces at most whose joining is thought of: bounds the time."""


@dataclass(frozen=True)
class Collision:
    """The convex pieces of a part, and how true they are to it."""

    hulls: tuple[Mesh, ...]
    """Closed convex meshes in the part's frame."""
    primitives: tuple[Primitive, ...]
    """Pieces that are a box, a cylinder or a ball."""
    fidelity: Fidelity


def convex_parts(mesh: Mesh, settings: CollisionSettings) -> Collision:
    """The part as at most `max_hulls` convex pieces, primitives where these are as good; FreeArtError when it has no
    area."""
    outside = outside_of(mesh)
    stands_out = max(min(settings.tolerance_m, outside.size / 50), outside.size / 500)
    tolerance = Tolerance(
        stands_out,
        stands_out / 12,
        settings.min_thickness_m,
        settings.patches,
        settings.pairs,
        settings.max_vertices,
    )
    pieces = convex_pieces(outside, tolerance, settings.max_hulls)
    found = [(p, primitive_of(p, outside, stands_out) if settings.primitives else None) for p in pieces]
    primitives = tuple(shape for _, shape in found if shape is not None)
    rest = (piece for piece, shape in found if shape is None)
    hulls = tuple(convex_hull(piece, settings.min_thickness_m, settings.max_vertices) for piece in rest)
    return Collision(hulls, primitives, measured(outside, [*hulls, *(shape.mesh() for shape in primitives)]))


def convex_hull(points: NDArray[np.float64], min_thickness_m: float, max_vertices: int) -> Mesh:
    """The closed convex hull of points (n, 3), made at least `min_thickness_m` thick in every direction.

    When it has more than `max_vertices`, only the points furthest in as many even directions are kept. Raises
    FreeArtError without points.
    """
    if len(points) == 0:
        raise FreeArtError("there are no points to make a convex hull of")
    hull = _hull(thickened(points, min_thickness_m))
    if len(hull.vertices) > max_vertices:
        furthest = np.unique(np.argmax(hull.vertices @ even_directions(max_vertices).T, axis=0))
        hull = _hull(hull.vertices[furthest])
    return hull


def _hull(points: NDArray[np.float64]) -> Mesh:
    """By manifold3d: qhull's triangles, less those without area, leave gaps where three points are on a line."""
    middle = points.mean(0)
    solid = manifold3d.Manifold.hull_points(np.ascontiguousarray(points - middle)).to_mesh64()
    return Mesh(np.asarray(solid.vert_properties)[:, :3] + middle, np.asarray(solid.tri_verts).astype(np.int64))
