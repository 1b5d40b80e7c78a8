"""Held-out views: the fused meshes ray-cast with their vertex colours on white."""

from __future__ import annotations

import numpy as np
import trimesh
from numpy.typing import NDArray

from freeart21.camera import Camera
from freeart21.mesh import Mesh
from freeart21.reconstruction import Reconstruction
from freeart21.recording import Query


def render_queries(result: Reconstruction, camera: Camera, queries: tuple[Query, ...]) -> list[NDArray[np.uint8]]:
    """One picture (height, width, 3) for each query."""
    pictures = []
    for query in queries:
        T = result.Ts_camera_reference[query.pose_of_frame]
        parts = result.articulation.posed(T, float(result.states[query.state_of_frame]))
        pictures.append(render(camera, [part.moved(query.T_newcam_cam) for part in parts]))
    return pictures


def render(camera: Camera, meshes: list[Mesh]) -> NDArray[np.uint8]:
    """(height, width, 3) picture of camera-frame meshes, nearest first, white where there is nothing."""
    picture = np.full((camera.height, camera.width, 3), 255, np.uint8)
    meshes = [m for m in meshes if not m.empty]
    if not meshes:
        return picture
    offsets = np.cumsum([0, *(len(m.vertices) for m in meshes)])
    vertices = np.concatenate([m.vertices for m in meshes])
    faces = np.concatenate([m.faces + o for m, o in zip(meshes, offsets, strict=False)])
    white = np.full(3, 255, np.uint8)
    colours = np.concatenate(
        [np.broadcast_to(white, m.vertices.shape) if m.colours is None else m.colours for m in meshes]
    ).astype(float)
    box = _box(camera, vertices)
    rays = camera.rays()[box]
    shape = rays.shape[:2]
    rays = rays.reshape(-1, 3)
    if len(rays) == 0:
        return picture
    caster = trimesh.ray.ray_pyembree.RayMeshIntersector(trimesh.Trimesh(vertices, faces, process=False))
    hits, ray, face = caster.intersects_location(np.zeros_like(rays), rays, multiple_hits=False)
    corners = trimesh.triangles.points_to_barycentric(vertices[faces[face]], hits) if len(face) else np.zeros((0, 3))
    flat = np.full((len(rays), 3), 255.0)
    flat[ray] = np.einsum("fk,fkc->fc", np.clip(corners, 0, 1), colours[faces[face]])
    picture[box] = np.clip(np.rint(flat), 0, 255).reshape(*shape, 3).astype(np.uint8)
    return picture


def _box(camera: Camera, vertices: NDArray[np.float64]) -> tuple[slice, slice]:
    """Rows and columns that hold the projected vertices; the whole picture when one is behind the camera."""
    if (vertices[:, 2] <= 0).any():
        return slice(0, camera.height), slice(0, camera.width)
    at = camera.project(vertices)
    low, high = np.floor(at.min(0)).astype(int), np.ceil(at.max(0)).astype(int)
    columns = slice(int(np.clip(low[0], 0, camera.width)), int(np.clip(high[0], 0, camera.width)))
    return slice(int(np.clip(low[1], 0, camera.height)), int(np.clip(high[1], 0, camera.height))), columns
