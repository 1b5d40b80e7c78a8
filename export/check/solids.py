"""Bodies of an asset as solids: everything that one joint moves, and how deep points are inside."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import trimesh
from scipy.spatial import ConvexHull, QhullError

from export.winding_number import Winding
from freeart21.mesh import Mesh
from freeart21.se3 import Array

HULL_GAP = 0.02
"""Distance of an open mesh from its convex hull, over its diagonal, below which it counts as that hull."""
_HULL_POINTS = 200
"""Points on the hull from which the distance is measured."""


@dataclass(frozen=True)
class Convex:
    """The inside of planes."""

    planes: Array
    """(n, 4) outward unit normal and offset: n x + d <= 0 inside."""
    box: Array
    """(2, 3) lowest and highest corner."""

    def depth(self, points: Array) -> Array:
        """(n,) m that each of points (n, 3) is inside, 0 outside."""
        return np.asarray(np.maximum(-(points @ self.planes[:, :3].T + self.planes[:, 3]).max(1), 0.0))

    def depth_between(self, starts: Array, ends: Array) -> Array:
        """(n,) depth at the middle of the part of each segment from starts to ends (n, 3) that is inside; 0 without
        one."""
        a, b = (points @ self.planes[:, :3].T + self.planes[:, 3] for points in (starts, ends))
        with np.errstate(divide="ignore", invalid="ignore"):
            t = a / (a - b)
        enter = np.where((a > 0) & (b <= 0), t, np.where((a > 0) & (b > 0), np.inf, 0.0)).max(1)
        leave = np.where((a <= 0) & (b > 0), t, 1.0).min(1)
        depth, hit = np.zeros(len(starts)), enter < leave
        middle = 0.5 * (enter + leave)[hit, None]
        depth[hit] = self.depth((1 - middle) * starts[hit] + middle * ends[hit])
        return depth


@dataclass(frozen=True)
class Closed:
    """The inside of a closed surface that is not convex."""

    winding: Winding
    box: Array
    """(2, 3) lowest and highest corner."""

    def depth(self, points: Array) -> Array:
        """(n,) m that each of points (n, 3) is inside, 0 outside."""
        return np.where(self.winding.number(points) > 0.5, self.winding.distance(points), 0.0)

    def depth_between(self, starts: Array, ends: Array) -> Array:
        """(n,) depth at the middle of each segment from starts to ends (n, 3)."""
        return self.depth(0.5 * (starts + ends))


@dataclass(frozen=True)
class Body:
    """Shapes that move as one."""

    solids: tuple[Convex | Closed, ...]
    points: Array
    """(n, 3) spread evenly over the surface of all shapes, m."""
    middle: Array
    """(3,) m, centre of the bounding box."""
    size: float
    """Its diagonal, m."""

    def depth(self, points: Array) -> Array:
        """(n,) m that each of points (n, 3) is inside the solid in which it is deepest, 0 outside all."""
        depth = np.zeros(len(points))
        for solid in self.solids:
            near = np.flatnonzero(((points > solid.box[0]) & (points < solid.box[1])).all(1))
            if len(near):
                depth[near] = np.maximum(depth[near], solid.depth(points[near]))
        return depth

    def depth_between(self, starts: Array, ends: Array) -> Array:
        """(n,) the same along segments from starts to ends (n, 3)."""
        depth = np.zeros(len(starts))
        low, high = np.minimum(starts, ends), np.maximum(starts, ends)
        for solid in self.solids:
            near = np.flatnonzero(((high > solid.box[0]) & (low < solid.box[1])).all(1))
            if len(near):
                depth[near] = np.maximum(depth[near], solid.depth_between(starts[near], ends[near]))
        return depth


def make_body(shapes: list[tuple[Array, trimesh.Trimesh]], count: int, seed: int = 0) -> Body | None:
    """The body of shapes, each (pose (4, 4), mesh), with `count` points on its surface; None without a surface.

    A closed mesh is its own inside. An open one close to its convex hull (boards with double faces, boxes without an
    edge) counts as that hull, as in engines. Any other open mesh has no inside.
    """
    solids, meshes = [], []
    for T, mesh in shapes:
        if len(mesh.faces) and np.isfinite(mesh.vertices).all() and mesh.area > 0:
            moved = trimesh.Trimesh(mesh.vertices, mesh.faces, process=False).apply_transform(T)
            meshes.append(moved)
            solid = _make_solid(moved)
            if solid is not None:
                solids.append(solid)
    if not meshes:
        return None
    corners = np.concatenate([mesh.bounds for mesh in meshes])
    whole = trimesh.util.concatenate(meshes) if len(meshes) > 1 else meshes[0]
    points, _ = trimesh.sample.sample_surface(whole, count, seed=seed)
    low, high = corners.min(0), corners.max(0)
    return Body(tuple(solids), np.asarray(points, float), 0.5 * (low + high), float(np.linalg.norm(high - low)))


def _make_solid(mesh: trimesh.Trimesh) -> Convex | Closed | None:
    used = mesh.vertices[np.unique(mesh.faces)]
    try:
        hull = ConvexHull(used)
    except (QhullError, ValueError):
        return None
    box, size = np.array([used.min(0), used.max(0)]), float(np.linalg.norm(np.ptp(used, axis=0)))
    merged = trimesh.Trimesh(mesh.vertices, mesh.faces, process=False)
    merged.merge_vertices(merge_tex=True, merge_norm=True)
    closed = merged.is_watertight and merged.volume > 0
    if closed and merged.volume < hull.volume * (1 - 1e-3):
        return Closed(Winding(Mesh(merged.vertices, merged.faces)), box)
    if not closed and not _is_hull(merged, hull, HULL_GAP * size):
        return None
    return Convex(np.unique(np.round(hull.equations, 9), axis=0), box)


def _is_hull(mesh: trimesh.Trimesh, hull: ConvexHull, gap: float) -> bool:
    """Whether a mesh's surface is that of its convex hull within `gap`, m, both ways."""
    outer = trimesh.Trimesh(hull.points, hull.simplices, process=False)
    on_hull, _ = trimesh.sample.sample_surface(outer, _HULL_POINTS, seed=0)
    on_mesh, _ = trimesh.sample.sample_surface(mesh, _HULL_POINTS, seed=0)
    inside = -(on_mesh @ hull.equations[:, :3].T + hull.equations[:, 3]).max(1)
    surface = Winding(Mesh(mesh.vertices, mesh.faces[mesh.area_faces > 0]))
    return bool(inside.max() <= gap and surface.distance(np.asarray(on_hull, float)).max() <= gap)
