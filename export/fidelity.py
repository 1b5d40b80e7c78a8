"""How true collision shapes are to a part: measured between its surface and the outside of their union."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass

import numpy as np
import trimesh
from numba import njit
from scipy.spatial import cKDTree

from export.outside import Outside, even_points
from freeart21.mesh import Mesh
from freeart21.se3 import Array

PER_SHAPES = 60_000
"""Points on the surfaces of all shapes."""
_CHECKED = 6_000
"""Points of the part's surface that are held against them."""
_WITHIN = 1e-6
"""m that a point is inside of a shape before it counts as such."""


@dataclass(frozen=True)
class Fidelity:
    """Distances, m, between the reachable surface of a part and the outer surface of its collision shapes."""

    median: float
    """Of the distances from the part's surface to that of the shapes."""
    worst_of_95: float
    """The 95th percentile of them."""
    worst: float
    """The largest of them."""
    outward_95: float
    """The 95th percentile of how far the shapes' outer surface stands out of the part; within it counts as 0."""
    outward: float
    """The largest of those."""
    uncovered: float
    """The largest distance by which a point of the part's surface lies outside of all shapes."""
    size: float
    """Diagonal of the part's box."""

    def said(self) -> dict[str, float]:
        """For asset.json, to the micrometre."""
        return {f"{name}_m": round(value, 6) for name, value in asdict(self).items()}


def measured(outside: Outside, shapes: Sequence[Mesh], seed: int = 0, count: int = PER_SHAPES) -> Fidelity:
    """Hold the union of convex `shapes`, closed meshes in the part's frame, against the part; `count` points on them.

    Distances are those to the planes of sampled points, so that their spacing does not count.
    """
    solids = [trimesh.Trimesh(shape.vertices, shape.faces, process=False) for shape in shapes]
    planes, first, boxes = half_spaces(solids)
    surface, normals, own, spacing = _sampled(solids, count)
    free = depth_within(surface, own, planes, first, boxes) <= _WITHIN
    surface, normals = surface[free], normals[free]
    excess = outside.excess(surface)
    outer = (excess > 0) | (outside.tree.query(surface)[0] < 2 * outside.spacing)  # not the bounds of hollows within
    chosen = np.random.default_rng(seed).permutation(len(outside.dense))[:_CHECKED]
    points = outside.dense[chosen]
    covered = depth_within(points, np.full(len(points), -1), planes, first, boxes) >= 0
    distance = np.empty(len(points))
    for these, kept in ((covered, outer), (~covered, np.ones(len(surface), bool))):
        distance[these] = _to_planes(points[these], surface[kept], normals[kept], spacing) if kept.any() else np.inf
    return Fidelity(
        float(np.median(distance)),
        float(np.percentile(distance, 95)),
        float(distance.max()),
        float(np.percentile(excess, 95)),
        float(excess.max()),
        float(distance[~covered].max(initial=0.0)),
        outside.size,
    )


def _to_planes(x: Array, surface: Array, normals: Array, spacing: float) -> Array:
    """(k,) m from points `x` (k, 3) to a surface of sampled points, each of which is a small disc."""
    k = min(6, len(surface))
    nearest = cKDTree(surface).query(x, k=k)[1].reshape(len(x), k)
    away = x[:, None] - surface[nearest]
    ahead = np.einsum("ijk,ijk->ij", away, normals[nearest])
    aside = np.sqrt(np.maximum((away**2).sum(-1) - ahead**2, 0.0))
    return np.asarray(np.hypot(ahead, np.maximum(aside - spacing, 0.0)).min(1))


def _sampled(solids: Sequence[trimesh.Trimesh], count: int) -> tuple[Array, Array, Array, float]:
    """Points on all shapes, their corners, too: (n, 3), their normals, whose they are, and m between them."""
    each = float(sum(solid.area for solid in solids)) / count
    points, normals, own = [], [], []
    for k, solid in enumerate(solids):
        between, faces = even_points(solid, each)
        points += [between, solid.triangles.reshape(-1, 3)]
        normals += [solid.face_normals[faces], np.repeat(solid.face_normals, 3, axis=0)]
        own.append(np.full(len(between) + 3 * len(solid.faces), k))
    return np.concatenate(points), np.concatenate(normals), np.concatenate(own), float(np.sqrt(each))


def half_spaces(solids: Sequence[trimesh.Trimesh]) -> tuple[Array, Array, Array]:
    """Planes (m, 4) of all shapes, outwards, where those of each begin (s + 1,), and their boxes (s, 6)."""
    planes = [
        np.hstack([s.face_normals, -np.einsum("ij,ij->i", s.face_normals, s.triangles[:, 0])[:, None]]) for s in solids
    ]
    first = np.concatenate([[0], np.cumsum([len(p) for p in planes])])
    boxes = np.array([s.bounds.ravel() for s in solids])
    return np.concatenate(planes), first, boxes


@njit(cache=True, nogil=True)
def depth_within(x: Array, own: Array, planes: Array, first: Array, boxes: Array) -> Array:
    """(k,) m by which points `x` (k, 3) are inside of a shape that is not their `own` (k,); -1 where of none."""
    out = np.full(len(x), -1.0)
    for i in range(len(x)):
        for s in range(len(boxes)):
            if s == own[i]:
                continue
            inside = True
            for k in range(3):
                if x[i, k] < boxes[s, k] or x[i, k] > boxes[s, 3 + k]:
                    inside = False
            if not inside:
                continue
            depth = np.inf
            for p in range(first[s], first[s + 1]):
                gap = -(planes[p, 0] * x[i, 0] + planes[p, 1] * x[i, 1] + planes[p, 2] * x[i, 2] + planes[p, 3])
                depth = min(depth, gap)
                if depth < 0:
                    break
            out[i] = max(out[i], depth)
    return out
