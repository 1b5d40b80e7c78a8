"""Casts rays against the two sides of a posed object with Embree: depth, side and face of the first hit."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from embreex import rtcore_scene
from embreex.mesh_construction import TriangleMesh
from numpy.typing import NDArray

from freeart21 import se3
from freeart21.camera import Camera
from freeart21.mesh import Mesh
from freeart21.se3 import Array

_FAR = 1e20


@dataclass(frozen=True)
class Hits:
    """First hits of n rays."""

    distance: Array
    """(n,) in units of the length of the ray's direction; inf for no hit."""
    side: NDArray[np.int64]
    """(n,) 0 or 1, the index of the side; -1 for no hit."""
    face: NDArray[np.int64]
    """(n,) face index in the mesh of that side; -1 for no hit."""


class Caster:
    """Two sides of an object, each in its own ray tracing scene: moving a side only transforms the rays."""

    def __init__(self, meshes: tuple[Mesh, Mesh]) -> None:
        """`meshes` are the sides in the object's frame at joint state zero."""
        self._scenes = []
        for mesh in meshes:
            scene = rtcore_scene.EmbreeScene()
            TriangleMesh(scene, mesh.vertices.astype(np.float32), mesh.faces.astype(np.int32))
            self._scenes.append(scene)

    def cast(self, origins: Array, directions: Array, Ts: tuple[Array, Array]) -> Hits:
        """First hits of rays (n, 3) in a common frame; `Ts` (4, 4 each) map the two sides into it."""
        posed = []
        for T in Ts:
            T_side_world = se3.inverse(T)
            posed.append((se3.transform(T_side_world, origins), directions @ T_side_world[:3, :3].T))
        return self.meet((posed[0], posed[1]))

    def meet(self, rays: tuple[tuple[Array, Array], tuple[Array, Array]]) -> Hits:
        """First hits of n rays, each given as origins and directions (n, 3) in the frame of side 0 and of side 1."""
        n = len(rays[0][0])
        distance, side, face = np.full(n, np.inf), np.full(n, -1), np.full(n, -1)
        for k, (scene, (origins, directions)) in enumerate(zip(self._scenes, rays, strict=True)):
            o, d = origins.astype(np.float32), directions.astype(np.float32)
            out = scene.run(o, d, output=True, dists=np.full(n, _FAR, np.float32))
            t = np.where(out["primID"] >= 0, out["tfar"].astype(float), np.inf)
            nearer = t < distance
            distance[nearer], side[nearer], face[nearer] = t[nearer], k, out["primID"][nearer]
        return Hits(distance, side, face)

    def look(self, camera: Camera, Ts_camera: tuple[Array, Array], pixels: NDArray[np.bool_] | None = None) -> Hits:
        """First hits through all pixel centres, or those of the mask `pixels` (height, width); distance is z-depth."""
        rays = camera.rays() if pixels is None else camera.rays()[pixels]
        directions = rays.reshape(-1, 3)
        return self.cast(np.zeros_like(directions), directions, Ts_camera)
