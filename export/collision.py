"""Collision shapes of a part: convex hulls and primitives that follow its surface within a tolerance."""

from __future__ import annotations

from dataclasses import dataclass, replace

import manifold3d
import numpy as np
from numpy.typing import NDArray

from export.boxes import fit_boxes
from export.clearance import separate_shapes
from export.decomposition import MAX_VERTICES, MIN_THICKNESS_M, Tolerance, decompose, thicken
from export.outer_surface import OuterSurface, even_directions, sample_outer_surface
from export.primitive_fit import fit_primitive
from export.primitives import Box, Cylinder, Primitive
from export.settings import CollisionSettings
from freeart21.errors import FreeArtError
from freeart21.joint import Joint
from freeart21.mesh import Mesh

_GRID = 1e-5
"""m, grid of hull corners: of 42 assets Drake rejected five whose corners were 3e-8 to 3e-6 m apart."""
_FEET_SHARE = 4
"""One direction in this many, in which a hull keeps its furthest points, looks down and slightly sideways: twelve of
48, with which a round foot is 3 % narrower."""
_LEVEL_M = 5e-5
"""m that a primitive's base may miss the ground anywhere; a tilt of .005 for a foot 1 cm long."""
_SIDEWAYS = 1e-3
"""Sideways component of the downward directions, so that the outer of two corners is kept unless it is higher by more
than this fraction of their distance. For a foot of 5 cm that is `_LEVEL_M`."""


MAX_BOXES = 12
"""Most boxes of a part that are found by its planes."""


@dataclass(frozen=True)
class Collision:
    """The collision shapes of a part."""

    hulls: tuple[Mesh, ...]
    """Closed convex meshes in the part's frame."""
    primitives: tuple[Primitive, ...]
    """Boxes, cylinders and spheres."""
    surface: OuterSurface
    """Of the part, in its frame."""

    @property
    def shapes(self) -> list[Mesh]:
        """All shapes as meshes."""
        return [*self.hulls, *(shape.mesh() for shape in self.primitives)]


def make_collision(
    mesh: Mesh, settings: CollisionSettings, ground: float | None = None, single: bool = False
) -> Collision:
    """The part as at most `max_hulls` convex shapes, primitives where they fit as well; as one hull if `single`.

    Shapes end at `ground`, height z in m of the plane that the object stands on: hulls with different excess would tilt
    it. Raises FreeArtError when the mesh has no area.
    """
    surface = sample_outer_surface(mesh)
    excess = max(min(settings.tolerance_m, surface.size / 50), surface.spacing / 2)
    tolerance = Tolerance(excess, excess / 12, settings.pairs)
    boxes = [] if single else fit_boxes(mesh, surface, excess, min(MAX_BOXES, settings.max_hulls))
    corners_of_boxes = [box.mesh().vertices for box in boxes]
    pieces = (
        [mesh.vertices]
        if single
        else decompose(surface, tolerance, settings.max_hulls, corners_of_boxes, settings.min_share)
    )
    known = {id(corners): box for corners, box in zip(corners_of_boxes, boxes, strict=True)}
    hulls: list[Mesh] = []
    primitives: list[Primitive] = []
    for corners in pieces:
        shape = known.get(id(corners)) or fit_primitive(corners, surface, excess) if settings.primitives else None
        if shape is not None and (ground is None or _fits_ground(shape, ground, excess)):
            primitives.append(shape)
            continue
        hull = convex_hull(corners, MIN_THICKNESS_M, MAX_VERTICES)
        hulls.append(hull if ground is None else _cut_at_ground(hull, ground, excess))
    return Collision(tuple(hulls), tuple(primitives), surface)


def separate_collisions(
    collisions: dict[str, Collision], joint: Joint, root: str, tolerance: float
) -> tuple[dict[str, Collision], dict[str, int]]:
    """Both parts' shapes, cut so that they overlap by at most `tolerance`, m, in the joint's range; and counts of cut
    and dropped shapes. Unchanged where nothing would be left of a part.

    Args:
        collisions: by part, in link frames; the link that is not `root` has its origin at the pivot.
        joint: in the root link's frame, with the asset's range.
        root: 'reference' or 'moving'.
        tolerance: m.
    """
    origins = {name: np.zeros(3) if name == root else joint.pivot for name in collisions}
    corners = {name: [s.vertices + origins[name] for s in found.shapes] for name, found in collisions.items()}
    surfaces = {
        name: (found.surface.points + origins[name], found.surface.area / len(found.surface.points))
        for name, found in collisions.items()
    }
    separated = separate_shapes(corners, surfaces, joint, root, tolerance, MIN_THICKNESS_M)
    counts = {"cut": 0, "dropped": 0}
    out = {}
    for name, found in collisions.items():
        hulls: list[Mesh] = []
        primitives: list[Primitive] = []
        for k, (old, new) in enumerate(zip(corners[name], separated[name], strict=True)):
            if new is None:
                counts["dropped"] += 1
            elif new is not old:
                counts["cut"] += 1
                hulls.append(convex_hull(new - origins[name], 0.0, MAX_VERTICES))
            elif k < len(found.hulls):
                hulls.append(found.hulls[k])
            else:
                primitives.append(found.primitives[k - len(found.hulls)])
        if not hulls and not primitives:  # a part without collision shapes would fall through the ground
            return collisions, {"cut": 0, "dropped": 0}
        out[name] = replace(found, hulls=tuple(hulls), primitives=tuple(primitives))
    return out, counts


def _fits_ground(shape: Primitive, ground: float, near: float) -> bool:
    """Whether a shape stands level on the ground, or is above everything that is taken to touch it.

    A face that looks down may rise by `_LEVEL_M`, or by more than `near`, m: then the part leans there itself.
    """
    low = float(shape.mesh().vertices[:, 2].min()) - ground
    across = np.abs(shape.T_link_shape[2, :3])  # of its axes, upwards
    rise = 0.0
    if isinstance(shape, Box):
        rise = float(across @ shape.size - (across * shape.size)[across.argmax()])
    elif isinstance(shape, Cylinder) and across.argmax() == 2:
        rise = 2 * shape.radius * float(np.hypot(*across[:2]))
    return low > near or (abs(low) <= _LEVEL_M and not _LEVEL_M < rise <= near)


def _cut_at_ground(hull: Mesh, ground: float, near: float) -> Mesh:
    """A hull cut off at z = `ground`; corners less than `near` above the ground are moved down to it.

    A hull that gets too thin is thickened upwards: nothing extends below the ground.
    """
    z = hull.vertices[:, 2]
    lack = ground - float(z.min())
    if lack < -near:
        return hull
    if float(z.max()) < ground + MIN_THICKNESS_M:
        return Mesh(hull.vertices + np.array([0.0, 0.0, lack]), hull.faces)
    if lack > 0:
        solid = manifold3d.Manifold(manifold3d.Mesh64(np.array(hull.vertices), hull.faces.astype(np.uint64, order="C")))
        hull = _to_mesh(solid.trim_by_plane((0, 0, 1), ground), np.zeros(3))
    points = np.array(hull.vertices)
    points[points[:, 2] < ground + near, 2] = ground
    hull = convex_hull(points, MIN_THICKNESS_M, MAX_VERTICES)
    return Mesh(hull.vertices + np.array([0.0, 0.0, max(ground - float(hull.vertices[:, 2].min()), 0.0)]), hull.faces)


def convex_hull(points: NDArray[np.float64], min_thickness_m: float, max_vertices: int) -> Mesh:
    """The closed convex hull of points (n, 3), at least `min_thickness_m` thick in every direction.

    With more than `max_vertices` only the furthest points in as many directions are kept: even ones, and downward ones,
    so that the base keeps its width (all links of an asset have z up). Raises FreeArtError without points.
    """
    if len(points) == 0:
        raise FreeArtError("there are no points to make a convex hull of")
    hull = _hull_mesh(thicken(points, min_thickness_m))
    if len(hull.vertices) > max_vertices:
        feet = max_vertices // _FEET_SHARE
        about = 2 * np.pi * np.arange(feet) / max(feet, 1)
        down = np.stack([_SIDEWAYS * np.cos(about), _SIDEWAYS * np.sin(about), np.full(feet, -1.0)], -1)
        directions = np.concatenate([down, even_directions(max_vertices - feet)])
        furthest = np.unique(np.argmax(hull.vertices @ directions.T, axis=0))
        hull = _hull_mesh(hull.vertices[furthest])
    return hull


def _hull_mesh(points: NDArray[np.float64]) -> Mesh:
    """By manifold3d: qhull's triangles, without those of no area, leave gaps where three points are collinear."""
    points = np.unique(np.round(points / _GRID), axis=0) * _GRID
    middle = points.mean(0)
    return _to_mesh(manifold3d.Manifold.hull_points(np.ascontiguousarray(points - middle)), middle)


def _to_mesh(solid: manifold3d.Manifold, origin: NDArray[np.float64]) -> Mesh:
    found = solid.to_mesh64()
    return Mesh(np.asarray(found.vert_properties)[:, :3] + origin, np.asarray(found.tri_verts).astype(np.int64))
