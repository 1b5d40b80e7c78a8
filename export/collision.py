"""What a part collides with: convex pieces that follow its surface within a tolerance, so that openings stay open."""

from __future__ import annotations

from dataclasses import dataclass, replace

import manifold3d
import numpy as np
from numpy.typing import NDArray

from export.clearance import cleared
from export.decomposition import Tolerance, convex_pieces, thickened
from export.outside import Outside, even_directions, outside_of
from export.primitive_fit import primitive_of
from export.primitives import Primitive
from freeart21.errors import FreeArtError
from freeart21.joint import Joint
from freeart21.mesh import Mesh

_GRID = 1e-5
"""m between corners of a piece, at least: of 42 assets Drake refused five with pieces that had some 3e-8 to 3e-6 m
apart."""
_FEET = 4
"""One of so many directions that a piece keeps its furthest points in looks down, a little to one side: twelve of the
48 corners that it may have, from which a round foot is narrower by 3 %."""
_LEVEL = 5e-5
"""m by which a primitive may miss the ground: of a foot 1 cm long that is a tilt of .005."""
_ASIDE = 1e-3
"""How much to the side: of two corners the outer one is kept, if it is no more than this part of the way above. Over a
foot of 5 cm that is `_LEVEL`."""


@dataclass(frozen=True)
class CollisionSettings:
    """How a part is cut into convex pieces."""

    tolerance_m: float = 1.2e-3
    """m by which a piece may stand out of the part. Of parts under 6 cm a fiftieth of their size; of large ones half
    the spacing of the points that are looked at, 1.5 mm for a cabinet of 65 cm."""
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
    """The convex pieces of a part."""

    hulls: tuple[Mesh, ...]
    """Closed convex meshes in the part's frame."""
    primitives: tuple[Primitive, ...]
    """Pieces that are a box, a cylinder or a ball."""
    outside: Outside
    """Of the part, in its frame."""

    @property
    def shapes(self) -> list[Mesh]:
        """All of them as meshes."""
        return [*self.hulls, *(shape.mesh() for shape in self.primitives)]


def convex_parts(
    mesh: Mesh, settings: CollisionSettings, ground: float | None = None, whole: bool = False
) -> Collision:
    """The part as at most `max_hulls` convex pieces, primitives where these are as good; as one if it is left `whole`.

    Pieces end at `ground`, the height z, m, of the plane that the object stands on: pieces that stand out of the part
    by different amounts would make it tilt. Raises FreeArtError when the mesh has no area.
    """
    outside = outside_of(mesh)
    stands_out = max(min(settings.tolerance_m, outside.size / 50), outside.spacing / 2)
    tolerance = Tolerance(
        stands_out,
        stands_out / 12,
        settings.min_thickness_m,
        settings.patches,
        settings.pairs,
        settings.max_vertices,
    )
    pieces = [mesh.vertices] if whole else convex_pieces(outside, tolerance, settings.max_hulls)
    hulls: list[Mesh] = []
    primitives: list[Primitive] = []
    for piece in pieces:
        shape = primitive_of(piece, outside, stands_out) if settings.primitives else None
        if shape is not None and (ground is None or _stands(shape.mesh(), ground, stands_out)):
            primitives.append(shape)
            continue
        hull = convex_hull(piece, settings.min_thickness_m, settings.max_vertices)
        hulls.append(hull if ground is None else _grounded(hull, ground, stands_out, settings))
    return Collision(tuple(hulls), tuple(primitives), outside)


def kept_apart(
    collisions: dict[str, Collision], joint: Joint, root: str, tolerance: float, settings: CollisionSettings
) -> tuple[dict[str, Collision], dict[str, int]]:
    """Both parts' shapes cut back until none is in the other's by more than `tolerance`, m, in the joint's range; how
    many were cut and dropped. Both as they were where nothing would be left of one.

    Args:
        collisions: by the part's name, in link frames; that of the part that is not `root` stands at the pivot.
        joint: in the root link's frame, with the range of the asset.
        root: 'reference' or 'moving'.
        tolerance: m.
        settings: of the collisions.
    """
    origins = {name: np.zeros(3) if name == root else joint.pivot for name in collisions}
    pieces = {name: [s.vertices + origins[name] for s in found.shapes] for name, found in collisions.items()}
    surfaces = {
        name: (found.outside.points + origins[name], found.outside.area / len(found.outside.points))
        for name, found in collisions.items()
    }
    left = cleared(pieces, surfaces, joint, root, tolerance, settings.min_thickness_m)
    counts = {"cut": 0, "dropped": 0}
    out = {}
    for name, found in collisions.items():
        hulls: list[Mesh] = []
        primitives: list[Primitive] = []
        for k, (old, new) in enumerate(zip(pieces[name], left[name], strict=True)):
            if new is None:
                counts["dropped"] += 1
            elif new is not old:
                counts["cut"] += 1
                hulls.append(convex_hull(new - origins[name], 0.0, settings.max_vertices))
            elif k < len(found.hulls):
                hulls.append(found.hulls[k])
            else:
                primitives.append(found.primitives[k - len(found.hulls)])
        if not hulls and not primitives:  # a part without any shape falls through the ground
            return collisions, {"cut": 0, "dropped": 0}
        out[name] = replace(found, hulls=tuple(hulls), primitives=tuple(primitives))
    return out, counts


def _stands(shape: Mesh, ground: float, near: float) -> bool:
    """Whether a shape ends at the ground, or above all that is taken to touch it."""
    low = float(shape.vertices[:, 2].min()) - ground
    return abs(low) <= _LEVEL or low > near


def _grounded(hull: Mesh, ground: float, near: float, settings: CollisionSettings) -> Mesh:
    """A convex piece cut off at z = `ground`, to which corners less than `near` above it are moved down.

    One that is left thinner than allowed is made as thick as it must be upwards: nothing stands out below.
    """
    z = hull.vertices[:, 2]
    lack = ground - float(z.min())
    if lack < -near:
        return hull
    if float(z.max()) < ground + settings.min_thickness_m:
        return Mesh(hull.vertices + np.array([0.0, 0.0, lack]), hull.faces)
    if lack > 0:
        solid = manifold3d.Manifold(manifold3d.Mesh64(np.array(hull.vertices), hull.faces.astype(np.uint64, order="C")))
        hull = _mesh(solid.trim_by_plane((0, 0, 1), ground), np.zeros(3))
    points = np.array(hull.vertices)
    points[points[:, 2] < ground + near, 2] = ground
    hull = convex_hull(points, settings.min_thickness_m, settings.max_vertices)
    return Mesh(hull.vertices + np.array([0.0, 0.0, max(ground - float(hull.vertices[:, 2].min()), 0.0)]), hull.faces)


def convex_hull(points: NDArray[np.float64], min_thickness_m: float, max_vertices: int) -> Mesh:
    """The closed convex hull of points (n, 3), made at least `min_thickness_m` thick in every direction.

    When it has more than `max_vertices`, only the points furthest in as many directions are kept: down, so that what it
    stands on stays as wide as it is (all links of an asset have z up), and even ones. Raises FreeArtError without
    points.
    """
    if len(points) == 0:
        raise FreeArtError("there are no points to make a convex hull of")
    hull = _hull(thickened(points, min_thickness_m))
    if len(hull.vertices) > max_vertices:
        feet = max_vertices // _FEET
        about = 2 * np.pi * np.arange(feet) / max(feet, 1)
        down = np.stack([_ASIDE * np.cos(about), _ASIDE * np.sin(about), np.full(feet, -1.0)], -1)
        ways = np.concatenate([down, even_directions(max_vertices - feet)])
        furthest = np.unique(np.argmax(hull.vertices @ ways.T, axis=0))
        hull = _hull(hull.vertices[furthest])
    return hull


def _hull(points: NDArray[np.float64]) -> Mesh:
    """By manifold3d: qhull's triangles, less those without area, leave gaps where three points are on a line."""
    points = np.unique(np.round(points / _GRID), axis=0) * _GRID
    middle = points.mean(0)
    return _mesh(manifold3d.Manifold.hull_points(np.ascontiguousarray(points - middle)), middle)


def _mesh(solid: manifold3d.Manifold, origin: NDArray[np.float64]) -> Mesh:
    found = solid.to_mesh64()
    return Mesh(np.asarray(found.vert_properties)[:, :3] + origin, np.asarray(found.tri_verts).astype(np.int64))
