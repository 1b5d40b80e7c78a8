"""The simulated film: depth, colours and angles of a frame, by a z-buffer on the CPU.

It shares no code with the renderer of recordings, so common errors do not cancel.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from freeart21 import se3
from freeart21.camera import Camera
from freeart21.se3 import Array
from freeart21.z_buffer import BEHIND, draw_triangles
from simgap.film.scene import FilmScene

Map = NDArray[np.float32]


@dataclass(frozen=True)
class RenderedFrame:
    """One simulated picture."""

    depth: Map
    """(height, width) z-depth, metres; 0 where there is nothing."""
    part: NDArray[np.uint8]
    """(height, width): 0 nothing, 1 reference, 2 moving."""
    normals: Map
    """(height, width, 3) unit normals in the camera frame, towards the camera; zero where there is nothing."""
    cosine: Map
    """(height, width) of the angle of incidence; 1 where there is nothing."""
    rgb: Map
    """(height, width, 3) sRGB, 0 to 255, unlit texture colours."""

    @property
    def brightness(self) -> Map:
        """(height, width) mean of sRGB, 0 to 1."""
        return np.asarray(self.rgb.mean(-1) / np.float32(255))


def render(scene: FilmScene, camera: Camera, Ts: tuple[Array, Array]) -> RenderedFrame:
    """The picture of both parts at the poses `Ts` (4, 4), camera from canonical."""
    shape = (camera.height, camera.width)
    depth, face, weights = np.full(shape, np.inf), np.full(shape, -1), np.zeros((*shape, 3))
    vertices = np.where((scene.part == 1)[:, None], *(se3.transform(T, scene.vertices) for T in Ts))
    at = camera.project(np.where(vertices[:, 2:] > BEHIND, vertices, [0.0, 0.0, 1.0]))
    draw_triangles(at, vertices[:, 2], scene.faces, depth, face, weights)
    on = face >= 0
    corners, part = scene.faces[face[on]], np.zeros(shape, np.uint8)
    part[on] = scene.part[corners[:, 0]]
    a, b, c = (vertices[corners[:, i]] for i in range(3))
    n = np.cross(b - a, c - a)
    n /= np.maximum(np.linalg.norm(n, axis=1, keepdims=True), 1e-15)
    ray = camera.rays()[on]
    across = (n * ray).sum(1)
    normals, rgb = np.zeros((*shape, 3), np.float32), np.zeros((*shape, 3), np.float32)
    cosine = np.ones(shape, np.float32)
    normals[on] = np.where(across[:, None] > 0, -n, n)
    cosine[on] = np.abs(across) / np.linalg.norm(ray, axis=1)
    rgb[on] = _colours(scene, corners, face[on], weights[on])
    return RenderedFrame(np.where(on, depth, 0).astype(np.float32), part, normals, cosine, rgb)


def interpolate_pose(Ts: Array, t: float) -> Array:
    """The pose (4, 4) at time `t`, in frames, of poses (n, 4, 4): constant twists between frames, and beyond."""
    k = int(np.clip(np.floor(t), 0, max(len(Ts) - 2, 0)))
    if len(Ts) == 1:
        return np.asarray(Ts[0])
    return np.asarray(Ts[k] @ se3.exp_se3((t - k) * se3.log_se3(se3.inverse(Ts[k]) @ Ts[k + 1])))


def _colours(scene: FilmScene, corners: NDArray[np.int64], faces: NDArray[np.int64], weights: Array) -> Array:
    out = np.einsum("nk,nkd->nd", weights, scene.colours[corners])
    index = scene.texture[faces]
    for t, picture in enumerate(scene.textures):
        on = index == t
        if on.any():
            uv = np.einsum("nk,nkd->nd", weights[on], scene.uv[corners[on]])
            h, width = picture.shape[:2]
            column = np.floor(np.mod(uv[:, 0], 1.0) * width).astype(int).clip(0, width - 1)
            row = np.floor(np.mod(1.0 - uv[:, 1], 1.0) * h).astype(int).clip(0, h - 1)
            out[on] = picture[row, column]
    return out
