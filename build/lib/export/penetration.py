"""How deep two parts are in each other, at any state of their joint."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from export.winding import Winding
from freeart21 import se3
from freeart21.articulation import PARTS, Articulation
from freeart21.joint import Joint
from freeart21.mesh import Mesh
from freeart21.se3 import Array

SAMPLES = 12_000
"""Points on each part that are looked for in the other: one for 1.6 x 1.6 mm of a stapler's lid."""
_SEED = 0


class Overlap:
    """Two parts, and how deep points of each one's surface are inside the other.

    Inside is where the other's surface winds round the point by more than a half (`export.winding`), so that open
    surfaces have an inside, too: what they enclose for the most part. Depth is the distance to the surface.
    """

    def __init__(
        self, parts: Articulation, observed: dict[str, NDArray[np.bool_]] | None = None, samples: int = SAMPLES
    ) -> None:
        """`parts` in any frame, metres, the moving part at state zero; meshes may be open.

        Where triangles are told that were `observed`, (F,) of each part, only they touch: a point counts when it is on
        one of them and inside of the other part with one nearest. The rest of a surface, which closes what nobody saw,
        then says what is inside, and stops nothing.
        """
        self.joint: Joint = parts.joint
        meshes = {name: parts.part(name) for name in PARTS}
        seen = {name: np.ones(len(mesh.faces), bool) for name, mesh in meshes.items()} if observed is None else observed
        self._surfaces = [_Surface(mesh, seen[name]) for name, mesh in meshes.items()]
        self._points = [_even(_only(mesh, seen[name]), samples, _SEED) for name, mesh in meshes.items()]
        self.speeds: Array = np.concatenate([_speeds(self.joint, points) for points in self._points])
        """(n,) of the sampled points against the other part, m per unit of state."""
        self._at = [np.full(len(points), np.nan) for points in self._points]
        self._clear = [np.zeros(len(points)) for points in self._points]

    def depths(self, state: float) -> Array:
        """(n,) metres by which each sampled point is inside the other part at a joint state; 0 outside.

        Points of the reference part come first. A point that was so far outside that it cannot have got in since is not
        looked at again.
        """
        found = []
        T = self.joint.transform(state)
        for k, T_other in enumerate((se3.inverse(T), T)):
            points, surface = self._points[k], self._surfaces[1 - k]
            speeds = _speeds(self.joint, points)
            due = ~(np.abs(state - self._at[k]) * speeds < self._clear[k])
            depth = np.zeros(len(points))
            if due.any():
                inside, touches = surface.depth(se3.transform(T_other, points[due]))
                self._at[k][due], self._clear[k][due] = state, np.maximum(-inside, 0)
                depth[due] = np.where(touches, np.maximum(inside, 0), 0)
            found.append(depth)
        return np.concatenate(found)

    def deepest(self, states: Array) -> Array:
        """(n,) metres, the depth of the deepest point at each of the joint states (n,)."""
        return np.array([self.depths(float(state)).max(initial=0.0) for state in states])


def _only(mesh: Mesh, faces: NDArray[np.bool_]) -> Mesh:
    return Mesh(mesh.vertices, mesh.faces[faces])


def _speeds(joint: Joint, points: Array) -> Array:
    """(n,) length that each point (n, 3) moves in a unit of state."""
    if joint.type == "prismatic":
        return np.ones(len(points))
    return np.linalg.norm(np.cross(joint.axis, points - joint.pivot), axis=1)


def _even(mesh: Mesh, count: int, seed: int) -> Array:
    """Points (count, 3) spread over the area of a mesh, stratified along its list of triangles; none without area."""
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
    """The triangles of a part, to measure signed distances to."""

    def __init__(self, mesh: Mesh, touches: NDArray[np.bool_]) -> None:
        real = mesh.areas() > 0
        self._winding, self._touches = Winding(_only(mesh, real)), touches[real]

    def depth(self, points: Array) -> tuple[Array, NDArray[np.bool_]]:
        """(n,) metres inside the surface, negative outside; and whether its nearest triangle is one that touches."""
        distance, triangle = self._winding.nearest(points)
        return np.where(self._winding.number(points) > 0.5, distance, -distance), self._touches[triangle]
