"""Penetration depth between two parts at any state of their joint."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
import trimesh
from numpy.typing import NDArray

from export.winding_number import Winding
from freeart21 import se3
from freeart21.articulation import PARTS, Articulation
from freeart21.files.urdf import UrdfJoint
from freeart21.joint import Joint
from freeart21.mesh import Mesh, join_meshes
from freeart21.se3 import Array

SAMPLES = 12_000
"""Points per part: one per 1.6 x 1.6 mm of a stapler's lid."""
_SEED = 0


class Overlap:
    """Two parts, and how deep points of each surface are inside the other part.

    Inside is where the winding number of the other surface exceeds 0.5 (`export.winding_number`), so open surfaces have
    an inside, too. Depth is the distance to the surface.
    """

    def __init__(
        self, parts: Articulation, observed: dict[str, NDArray[np.bool_]] | None = None, samples: int | None = SAMPLES
    ) -> None:
        """`parts` in any frame, m, the moving part at state zero; meshes may be open.

        Points are `samples` a part, spread by area, or with None the vertices: what is sharp is deepest there.
        With `observed`, (F,) of each part, only observed triangles count: a point counts when it lies on one and its
        nearest triangle of the other part is one. Patches that close a surface only define its inside.
        """
        self.joint: Joint = parts.joint
        meshes = {name: parts.part(name) for name in PARTS}
        seen = {name: np.ones(len(mesh.faces), bool) for name, mesh in meshes.items()} if observed is None else observed
        self._surfaces = [_Surface(mesh, seen[name]) for name, mesh in meshes.items()]
        self._points = [
            mesh.vertices[np.unique(mesh.faces[seen[name]])]
            if samples is None
            else _sample_surface(_select_faces(mesh, seen[name]), samples, _SEED)
            for name, mesh in meshes.items()
        ]
        self.speeds: Array = np.concatenate([_point_speeds(self.joint, points) for points in self._points])
        """(n,) m per unit of state that each sampled point moves against the other part."""
        self._at = [np.full(len(points), np.nan) for points in self._points]
        self._depth = [np.zeros(len(points)) for points in self._points]

    def depths(self, state: float, least: float = 0.0) -> Array:
        """(n,) m that each sampled point is inside the other part at a joint state; 0 outside, and 0 where it is no
        more than `least`, m. Reference points come first.

        A point is skipped while the joint's motion cannot have brought it so deep since it was last measured.
        """
        found = []
        T = self.joint.transform(state)
        for k, T_other in enumerate((se3.inverse(T), T)):
            points, surface = self._points[k], self._surfaces[1 - k]
            speeds = _point_speeds(self.joint, points)
            due = ~(np.abs(state - self._at[k]) * speeds + self._depth[k] < least)
            depth = np.zeros(len(points))
            if due.any():
                inside, touches = surface.depth(se3.transform(T_other, points[due]))
                self._at[k][due], self._depth[k][due] = state, inside
                depth[due] = np.where(touches & (inside > least), inside, 0)
            found.append(depth)
        return np.concatenate(found)

    def max_depth(self, states: Array) -> float:
        """m, the largest depth at any of the joint states (n,)."""
        deepest = 0.0
        for state in states:
            deepest = max(deepest, float(self.depths(float(state), deepest).max(initial=0.0)))
        return deepest

    def deep_points(self, states: Array, least: float) -> tuple[Array, Array, Array]:
        """The sampled points that are deeper than `least`, m, at one of the joint states (n,): (k, 3) in the reference
        part's frame, (k,) m, and (k,) the state at which each is deepest."""
        points, own = np.concatenate(self._points), len(self._points[0])
        depth, at = np.full(len(points), least), np.full(len(points), np.nan)
        for state in states:
            found = self.depths(float(state), least)
            at = np.where(found > depth, state, at)
            depth = np.maximum(depth, found)
        deep = np.flatnonzero(np.isfinite(at))
        moved = se3.transform(self.joint.transform(at[deep]), points[deep, None])[:, 0]
        return np.where((deep < own)[:, None], points[deep], moved), depth[deep], at[deep]


def measure_visual_depth(
    joint: UrdfJoint, visuals: Mapping[str, Sequence[tuple[Array, trimesh.Trimesh]]], count: int
) -> float:
    """m that the visual meshes of a joint's two links are in each other at most, over `count` positions of its range.

    `visuals` are poses (4, 4) in the link, and meshes, by link, as read from an asset's files. 0 where a link has none.
    """
    low, high = (float(np.clip(end, -np.pi, np.pi)) for end in (joint.lower, joint.upper))
    fixed, moving = (
        join_meshes([Mesh(se3.transform(pose @ T, np.asarray(mesh.vertices, float)), mesh.faces) for T, mesh in shapes])
        for pose, shapes in (
            (np.eye(4), visuals.get(joint.parent, ())),
            (joint.T_parent_joint, visuals.get(joint.child, ())),
        )
    )
    if joint.joint_type is None or not (fixed.areas().sum() > 0 and moving.areas().sum() > 0):
        return 0.0
    axis, pivot = joint.T_parent_joint[:3, :3] @ joint.axis, joint.T_parent_joint[:3, 3]
    parts = Articulation(Joint(joint.name, joint.joint_type, axis, pivot, low, high), fixed, moving)
    return Overlap(parts).max_depth(np.linspace(low, high, count))


def _select_faces(mesh: Mesh, faces: NDArray[np.bool_]) -> Mesh:
    return Mesh(mesh.vertices, mesh.faces[faces])


def _point_speeds(joint: Joint, points: Array) -> Array:
    """(n,) m that each point (n, 3) moves per unit of state."""
    if joint.type == "prismatic":
        return np.ones(len(points))
    return np.asarray(np.linalg.norm(np.cross(joint.axis, points - joint.pivot), axis=1))


def _sample_surface(mesh: Mesh, count: int, seed: int) -> Array:
    """(count, 3) points spread over a mesh by area, stratified along its list of triangles; none without area."""
    if not mesh.areas().sum() > 0:
        return np.zeros((0, 3))
    u = np.random.default_rng(seed).random((count, 3))
    total = np.cumsum(mesh.areas())
    face = np.searchsorted(total, (np.arange(count) + u[:, 0]) / count * total[-1], side="right")
    face = np.minimum(face, len(total) - 1)
    a, b, c = (mesh.vertices[mesh.faces[face, k]] for k in range(3))
    root, share = np.sqrt(u[:, 1:2]), u[:, 2:]
    points: Array = (1 - root) * a + root * (1 - share) * b + root * share * c
    return points


class _Surface:
    """Triangles of a part, for signed distances."""

    def __init__(self, mesh: Mesh, touches: NDArray[np.bool_]) -> None:
        real = mesh.areas() > 0
        mesh = _select_faces(mesh, real)
        corners = mesh.vertices[mesh.faces].reshape(-1, 3)
        self._low, self._high = corners.min(0, initial=np.inf), corners.max(0, initial=-np.inf)
        self._winding, self._touches = Winding(mesh), touches[real]

    def depth(self, points: Array) -> tuple[Array, NDArray[np.bool_]]:
        """(n,) m inside the surface, negative outside; and whether the nearest triangle counts.

        Outside the surface's bounding box it is the distance from that, which is no more, and no triangle counts.
        """
        depth = -np.linalg.norm(np.maximum(np.maximum(self._low - points, points - self._high), 0.0), axis=1)
        touches, near = np.zeros(len(points), bool), depth == 0
        if near.any():
            distance, triangle = self._winding.nearest(points[near])
            depth[near] = np.where(self._winding.number(points[near]) > 0.5, distance, -distance)
            touches[near] = self._touches[triangle]
        return depth, touches
