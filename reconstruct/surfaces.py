"""Fusion of every part's depth into a coloured mesh. What no frame showed gets no triangle."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components
from skimage.measure import marching_cubes

from freeart21 import se3
from freeart21.mesh import Mesh
from freeart21.se3 import Array
from reconstruct.kernels import in_threads
from reconstruct.scene import Scene
from reconstruct.settings import SurfaceSettings

Labels = NDArray[np.uint8]
Faces = NDArray[np.int64]


def fuse(
    scene: Scene, labels: Labels, part: int, Ts: Array, used: NDArray[np.bool_], settings: SurfaceSettings
) -> Mesh:
    """The mesh of one part (1 or 2), in the frame that `Ts` (n, 4, 4) take to the camera; empty when never seen.

    A truncated signed distance field averaged over the frames `used` (n,) (Curless and Levoy 1996); pixels of the
    other part and of the background say what is free, and cells no frame spoke of are left open.
    """
    points = _cloud(scene, labels, part, Ts, used)
    if len(points) < 100:
        return Mesh(np.zeros((0, 3)), np.zeros((0, 3), int), np.zeros((0, 3), np.uint8))
    low, high = np.percentile(points, 0.2, axis=0), np.percentile(points, 99.8, axis=0)
    voxel = max(settings.voxel * scene.footprint, float((np.prod(high - low) / settings.max_voxels) ** (1 / 3)))
    pad = (settings.truncation + 3) * voxel + 0.01 * scene.diagonal
    low, high = low - pad, high + pad
    shape = np.ceil((high - low) / voxel).astype(int) + 1
    field, weight = np.zeros(shape, np.float32), np.zeros(shape, np.float32)
    truncation = settings.truncation * voxel + 2 * scene.noise
    frames = np.flatnonzero(used)
    frames = frames[:: max(1, -(-len(frames) // settings.max_frames))].copy()
    depth = np.ascontiguousarray(scene.points[..., 2])
    arguments = (field, weight, low, voxel, Ts, frames, depth, labels, part)
    lens = (scene.fx, scene.fy, scene.cx, scene.cy, truncation)
    in_threads(lambda begin, end: _integrate(begin, end, *arguments, *lens), len(field), 2)
    if not ((field < 0) & (weight > 0)).any():
        return Mesh(np.zeros((0, 3)), np.zeros((0, 3), int), np.zeros((0, 3), np.uint8))
    field[weight <= 0] = 1
    vertices, faces, _, _ = marching_cubes(field, 0.0)
    vertices, faces = _observed(vertices, faces, weight)
    vertices, faces = _large_pieces(vertices, faces, settings.min_component)
    vertices = low + voxel * vertices
    colours = _colours(scene, labels, part, Ts, frames, vertices, faces, 2 * truncation)
    return Mesh(vertices, faces, colours)


def _cloud(scene: Scene, labels: Labels, part: int, Ts: Array, used: NDArray[np.bool_]) -> Array:
    """A thin sample of the part's points in its own frame."""
    clouds = [np.zeros((0, 3))]
    for i in np.flatnonzero(used):
        mine = (labels[i] == part) & scene.valid[i] & ~scene.edge[i]
        clouds.append(se3.transform(se3.inverse(Ts[i]), scene.points[i][mine][::7]))
    return np.concatenate(clouds)


def _observed(vertices: Array, faces: Faces, weight: NDArray[np.float32]) -> tuple[Array, Faces]:
    """Faces all of whose vertices lie between two voxels that some frame measured."""
    lower, upper = np.floor(vertices).astype(int), np.ceil(vertices).astype(int)
    known = (weight[tuple(lower.T)] > 0) & (weight[tuple(upper.T)] > 0)
    return _used_only(vertices, faces[known[faces].all(1)])


def _large_pieces(vertices: Array, faces: Faces, least: float) -> tuple[Array, Faces]:
    """Connected pieces with at least the share `least` of the largest piece's faces."""
    if len(faces) == 0:
        return vertices, faces
    n = len(vertices)
    rows, columns = faces[:, [0, 1]].ravel(), faces[:, [1, 2]].ravel()
    piece = connected_components(coo_matrix((np.ones(len(rows)), (rows, columns)), (n, n)), directed=False)[1]
    sizes = np.bincount(piece[faces[:, 0]])
    return _used_only(vertices, faces[sizes[piece[faces[:, 0]]] >= least * sizes.max()])


def _used_only(vertices: Array, faces: Faces) -> tuple[Array, Faces]:
    """The same faces without vertices that none of them uses."""
    used, new = np.unique(faces, return_inverse=True)
    return vertices[used], new.reshape(-1, 3).astype(np.int64)


def _colours(
    scene: Scene,
    labels: Labels,
    part: int,
    Ts: Array,
    frames: NDArray[np.int64],
    vertices: Array,
    faces: Faces,
    tolerance: float,
) -> NDArray[np.uint8]:
    """(V, 3) RGB: mean over the frames that see a vertex, those that face it squarely counting more."""
    a, b, c = (vertices[faces[:, k]] for k in range(3))
    face_normals = np.cross(b - a, c - a)
    normals = np.zeros_like(vertices)
    for k in range(3):
        np.add.at(normals, faces[:, k], face_normals)
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-300)
    total, weight = np.zeros((len(vertices), 3)), np.full(len(vertices), 1e-9)
    h, w = scene.mask.shape[1:]
    for i in frames:
        p, m = se3.transform(Ts[i], vertices), normals @ Ts[i, :3, :3].T
        x = np.rint(scene.fx * p[:, 0] / p[:, 2] + scene.cx[i]).astype(int)
        y = np.rint(scene.fy * p[:, 1] / p[:, 2] + scene.cy[i]).astype(int)
        facing = -(m * p).sum(1) / np.linalg.norm(p, axis=1)
        seen = np.flatnonzero((x >= 0) & (y >= 0) & (x < w) & (y < h) & (facing > 0.1))
        at = (i, y[seen], x[seen])
        seen_here = (labels[at] == part) & (np.abs(scene.points[at][:, 2] - p[seen, 2]) < tolerance)
        seen, at = seen[seen_here], (i, y[seen][seen_here], x[seen][seen_here])
        share = facing[seen] ** 2 * np.where(scene.edge[at], 0.05, 1.0)
        total[seen] += share[:, None] * scene.rgb[at]
        weight[seen] += share
    unseen = weight < 1e-6
    colours = total / weight[:, None]
    if unseen.any() and not unseen.all():
        colours[unseen] = np.average(colours[~unseen], axis=0)
    return np.clip(np.rint(colours), 0, 255).astype(np.uint8)


@njit(nogil=True, cache=True)
def _integrate(
    begin, end, field, weight, low, voxel, Ts, frames, depth, labels, part, fx, fy, cx, cy, truncation
):  # pragma: no cover
    """Average, over frames, of the signed distance along z in units of the truncation, in [-1, 1]; > 0 is free."""
    ny, nz = field.shape[1:]
    h, w = depth.shape[1], depth.shape[2]
    for a in range(begin, end):
        for b in range(ny):
            for c in range(nz):
                x, y, z = low[0] + a * voxel, low[1] + b * voxel, low[2] + c * voxel
                total = 0.0
                count = 0.0
                for f in range(frames.shape[0]):
                    i = frames[f]
                    T = Ts[i]
                    pz = T[2, 0] * x + T[2, 1] * y + T[2, 2] * z + T[2, 3]
                    if pz <= 0:
                        continue
                    u = fx * (T[0, 0] * x + T[0, 1] * y + T[0, 2] * z + T[0, 3]) / pz + cx[i] + 0.5
                    v = fy * (T[1, 0] * x + T[1, 1] * y + T[1, 2] * z + T[1, 3]) / pz + cy[i] + 0.5
                    if u < 0 or v < 0 or u >= w or v >= h:
                        continue
                    xi, yi = int(u), int(v)
                    label = labels[i, yi, xi]
                    if label == 0:
                        total += 1
                        count += 1
                        continue
                    d = depth[i, yi, xi] - pz
                    if depth[i, yi, xi] <= 0 or d < -truncation:
                        continue
                    if label == part:
                        total += min(1.0, d / truncation)
                        count += 1
                    elif d > truncation:
                        total += 1
                        count += 1
                if count > 0:
                    field[a, b, c] = total / count
                    weight[a, b, c] = count
