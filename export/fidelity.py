"""Distances between a part's surface and the outer surface of its collision shapes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass

import numpy as np
import trimesh
from numba import njit
from scipy.spatial import cKDTree

from export.outer_surface import OuterSurface, sample_evenly
from freeart21.mesh import Mesh
from freeart21.se3 import Array

PER_SHAPES = 60_000
"""Points on all shapes together."""
_CHECKED = 6_000
"""Points of the part's surface that are compared."""
_WITHIN = 1e-6
"""m that a point must be inside a shape to count as inside."""


@dataclass(frozen=True)
class Fidelity:
    """Distances, m, between the reachable surface of a part and the outer surface of its collision shapes."""

    median: float
    """Of the distances from the part's surface to the shapes'."""
    worst_of_95: float
    """Their 95th percentile."""
    worst: float
    """Their maximum."""
    outward_95: float
    """95th percentile of how far the shapes' outer surface extends beyond the part; 0 within it."""
    outward: float
    """Maximum of these."""
    uncovered: float
    """Largest distance of a point of the part's surface that lies outside all shapes."""
    size: float
    """Diagonal of the part's bounding box."""

    def to_json(self) -> dict[str, float]:
        """For asset.json, rounded to micrometres."""
        return {f"{name}_m": round(value, 6) for name, value in asdict(self).items()}


def measure_fidelity(part: OuterSurface, shapes: Sequence[Mesh], seed: int = 0, count: int = PER_SHAPES) -> Fidelity:
    """Compare the union of convex `shapes`, closed meshes in the part's frame, with the part; `count` points on the
    shapes.

    Distances are measured to the planes of sampled points, so the sampling's spacing does not matter.
    """
    solids = [trimesh.Trimesh(shape.vertices, shape.faces, process=False) for shape in shapes]
    planes, first, boxes = shape_planes(solids)
    surface, normals, own, spacing = _sample_shapes(solids, count)
    free = depth_in_shapes(surface, own, planes, first, boxes) <= _WITHIN
    surface, normals = surface[free], normals[free]
    excess = part.excess(surface)
    outer = (excess > 0) | (part.tree.query(surface)[0] < 2 * part.spacing)  # not the bounds of hollows within
    chosen = np.random.default_rng(seed).permutation(len(part.dense))[:_CHECKED]
    points = part.dense[chosen]
    covered = depth_in_shapes(points, np.full(len(points), -1), planes, first, boxes) >= 0
    distance = np.empty(len(points))
    for these, use in ((covered, outer), (~covered, np.ones(len(surface), bool))):
        distance[these] = (
            _distance_to_discs(points[these], surface[use], normals[use], spacing) if use.any() else np.inf
        )
    return Fidelity(
        float(np.median(distance)),
        float(np.percentile(distance, 95)),
        float(distance.max()),
        float(np.percentile(excess, 95)),
        float(excess.max()),
        float(distance[~covered].max(initial=0.0)),
        part.size,
    )


def _distance_to_discs(x: Array, surface: Array, normals: Array, spacing: float) -> Array:
    """(k,) m from points `x` (k, 3) to a surface of sampled points, each a small disc."""
    k = min(6, len(surface))
    nearest = cKDTree(surface).query(x, k=k)[1].reshape(len(x), k)
    away = x[:, None] - surface[nearest]
    ahead = np.einsum("ijk,ijk->ij", away, normals[nearest])
    aside = np.sqrt(np.maximum((away**2).sum(-1) - ahead**2, 0.0))
    return np.asarray(np.hypot(ahead, np.maximum(aside - spacing, 0.0)).min(1))


def _sample_shapes(solids: Sequence[trimesh.Trimesh], count: int) -> tuple[Array, Array, Array, float]:
    """Points on all shapes and their corners: (n, 3), normals, index of the shape, and the spacing, m."""
    each = float(sum(solid.area for solid in solids)) / count
    points, normals, own = [], [], []
    for k, solid in enumerate(solids):
        between, faces = sample_evenly(solid, each)
        points += [between, solid.triangles.reshape(-1, 3)]
        normals += [solid.face_normals[faces], np.repeat(solid.face_normals, 3, axis=0)]
        own.append(np.full(len(between) + 3 * len(solid.faces), k))
    return np.concatenate(points), np.concatenate(normals), np.concatenate(own), float(np.sqrt(each))


def shape_planes(solids: Sequence[trimesh.Trimesh]) -> tuple[Array, Array, Array]:
    """Planes (m, 4) of all shapes, outwards; index (s + 1,) of each shape's first plane; and bounding boxes (s, 6)."""
    planes = [
        np.hstack([s.face_normals, -np.einsum("ij,ij->i", s.face_normals, s.triangles[:, 0])[:, None]]) for s in solids
    ]
    first = np.concatenate([[0], np.cumsum([len(p) for p in planes])])
    boxes = np.array([s.bounds.ravel() for s in solids])
    return np.concatenate(planes), first, boxes


@njit(cache=True, nogil=True)
def depth_in_shapes(x: Array, own: Array, planes: Array, first: Array, boxes: Array) -> Array:
    """(k,) m by which points `x` (k, 3) are inside a shape other than their `own` (k,); -1 outside all."""
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
