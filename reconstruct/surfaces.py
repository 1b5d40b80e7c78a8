"""Fusion of each part's depth into a coloured mesh. Unobserved places get no triangle."""

from __future__ import annotations

import math

import cv2
import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy.ndimage import binary_dilation
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree
from skimage.measure import marching_cubes

from freeart21 import se3
from freeart21.mesh import Mesh
from freeart21.se3 import Array, Bools, Floats, Ints
from reconstruct.evidence import sample_evenly
from reconstruct.kernels import run_in_threads
from reconstruct.scene import Scene
from reconstruct.settings import SurfaceSettings

Labels = NDArray[np.uint8]
Faces = NDArray[np.int64]

BLOCK = 4
"""Voxels along the edge of a block: the unit in which the neighbourhood of the surface is marked."""
MAX_VOXELS = 16_000_000
"""In the box round a part; most of them are far from any surface and never visited."""
TRUNCATION = 3.0
"""Voxels in front of the surface over which a depth measurement counts."""
BEHIND = 2.0
"""Voxels behind the surface over which it counts: thinner sheets grow thicker."""
MAX_FRAMES = 80
"""Frames that are fused, evenly spaced."""
MIN_COMPONENT = 0.1
"""Connected components smaller than this share of the largest are dropped."""
SHARPNESS = 6.0
"""Power of a view's quality (frontal, near) in the mean colour: high values let the best views dominate."""
FOREIGN = 3
"""Frames that must show the other part at a vertex before it is removed from this one."""
AROUND = 6
"""Pixels round a block's middle within which its voxels lie, with voxels not much larger than a pixel."""
EMPTY = 0.5
"""Weight of a background pixel as evidence of free space; a pixel that faces the surface has 1."""


def fuse(
    scene: Scene, labels: Labels, part: int, Ts: Array, used: NDArray[np.bool_], settings: SurfaceSettings
) -> Mesh:
    """The mesh of one part (1 or 2), in the frame that `Ts` (n, 4, 4) take to the camera; empty when never seen.

    A truncated signed distance field averaged over the frames `used` (n,) (Curless and Levoy 1996), of distances to the
    pixels' planes. Pixels of the other part and of the background mark free space; unobserved cells stay open.
    """
    frames = sample_evenly(np.flatnonzero(used), MAX_FRAMES)
    points = _part_points(scene, labels, part, Ts, frames)
    if len(points) < 100:
        return _empty_mesh()
    T_part_grid, shape, voxel = _grid(scene, points, settings)
    Ts_grid = Ts @ T_part_grid
    reach = TRUNCATION * voxel + 2 * scene.noise
    near = _blocks_near_points(se3.transform(se3.inverse(T_part_grid), points), voxel, shape, reach)
    field, weight = np.zeros(shape, np.float32), np.zeros(shape, np.float32)
    pictures = (scene.points, scene.normals, scene.mask, labels, _rim_distances(scene, labels, part, frames))
    distances = (reach, BEHIND * voxel + 2 * scene.noise, 0.5 * voxel + scene.noise)
    blocks = np.argwhere(near)
    limits = _depth_limits(scene, labels, frames, reach)
    arguments = (field, weight, blocks, voxel, Ts_grid, frames, *pictures, limits, part, *scene.lens, *distances)
    run_in_threads(lambda begin, end: _integrate(begin, end, *arguments), len(blocks), 100)
    known = weight > 0
    if not (field[known] < 0).any():
        return _empty_mesh()
    field[~known] = 1
    vertices, faces, _, _ = marching_cubes(field, 0.0)
    vertices, faces = _drop_unobserved(vertices, faces, known)
    vertices, faces = _drop_small_components(vertices, faces)
    vertices = (vertices * voxel).astype(float)
    tolerance = 2 * voxel + 3 * scene.noise
    colours, foreign = _colour_vertices(scene, labels, part, Ts_grid, frames, vertices, faces, tolerance)
    mesh = Mesh(se3.transform(T_part_grid, vertices), faces, colours)
    return mesh.with_faces(foreign[faces].sum(1) == 0)


def _empty_mesh() -> Mesh:
    return Mesh(np.zeros((0, 3)), np.zeros((0, 3), int), np.zeros((0, 3), np.uint8))


def _part_points(scene: Scene, labels: Labels, part: int, Ts: Array, frames: NDArray[np.int64]) -> Array:
    """Every third point of the part, in its own frame."""
    clouds = [np.zeros((0, 3))]
    for i in frames:
        mine = (labels[i] == part) & scene.valid[i]
        clouds.append(se3.transform(se3.inverse(Ts[i]), scene.points[i][mine][::3]))
    return np.concatenate(clouds)


def _grid(scene: Scene, points: Array, settings: SurfaceSettings) -> tuple[Array, NDArray[np.int64], float]:
    """T_part_grid of a box along the principal axes of the points, its voxels each way, and a voxel's edge, metres.

    The grid's origin is the centre of the first voxel.
    """
    axes = np.linalg.eigh(np.cov(points.T))[1]
    axes[:, 2] *= np.sign(np.linalg.det(axes))
    along = points @ axes
    low, high = np.percentile(along, 0.1, axis=0), np.percentile(along, 99.9, axis=0)
    voxel = settings.voxel * scene.footprint
    for _ in range(3):
        pad = (TRUNCATION + 3) * voxel + 2 * scene.noise + 0.01 * scene.diagonal
        volume = float(np.prod(high - low + 2 * pad))
        voxel = max(voxel, (volume / MAX_VOXELS) ** (1 / 3))
    shape = (np.ceil((high - low + 2 * pad) / voxel / BLOCK).astype(int) + 1) * BLOCK
    return se3.pose(axes, axes @ (low - pad)), shape, voxel


def _blocks_near_points(points_grid: Array, voxel: float, shape: NDArray[np.int64], reach: float) -> NDArray[np.bool_]:
    """(shape / BLOCK) blocks within `reach`, metres, of a point."""
    blocks = shape // BLOCK
    at = np.floor(points_grid / (BLOCK * voxel)).astype(int)
    at = at[((at >= 0) & (at < blocks)).all(1)]
    near = np.zeros(blocks, bool)
    near[tuple(at.T)] = True
    return binary_dilation(near, np.ones((3, 3, 3)), math.ceil((reach + voxel) / (BLOCK * voxel)))


def _rim_distances(scene: Scene, labels: Labels, part: int, frames: NDArray[np.int64]) -> Floats:
    """(frames, h, w) signed distance, pixels, to the part's rim: its pixels next to others, or in front of a depth
    step.

    Positive within the part, 0 on the rim; outside, minus the distance to the part.
    """
    distance = np.zeros((len(frames), *scene.mask.shape[1:]), np.float32)
    jump = 4 * (scene.footprint + scene.noise)
    for k, i in enumerate(frames):
        mine = labels[i] == part
        depth = scene.points[i, ..., 2]
        depth = np.where(mine & scene.valid[i], depth, np.where(scene.mask[i] | (depth == 0), np.float32(1e6), -depth))
        rim = (cv2.dilate(depth, np.ones((3, 3))) > depth + jump) & mine
        distance[k] = _distance_to(rim) * mine - _distance_to(mine)
    return distance


def _depth_limits(scene: Scene, labels: Labels, frames: NDArray[np.int64], reach: float) -> Floats:
    """(frames, h, w) depth, metres, beyond which no pixel within AROUND pixels tells anything; see `_observe`."""
    limits = np.zeros((len(frames), *scene.mask.shape[1:]), np.float32)
    window = np.ones((2 * AROUND + 1, 2 * AROUND + 1), np.uint8)
    for f, i in enumerate(frames):
        depth, mask = scene.points[i, ..., 2], scene.mask[i]
        seen = np.where(mask & (labels[i] > 0) & (depth > 0), depth + 2.2 * reach, -np.inf)
        free = np.where(depth < 0, -depth - reach, np.inf)
        limits[f] = cv2.dilate(np.where(mask, seen, free).astype(np.float32), window)
    return limits


def _distance_to(places: NDArray[np.bool_]) -> Floats:
    """(h, w) pixels to the nearest of the places; the sum of the image's sides when there is none."""
    if not places.any():
        return np.full(places.shape, sum(places.shape), np.float32)
    return cv2.distanceTransform((~places).astype(np.uint8), cv2.DIST_L2, 5).astype(np.float32, copy=False)


def _drop_unobserved(vertices: Array, faces: Faces, known: NDArray[np.bool_]) -> tuple[Array, Faces]:
    """Faces all of whose vertices lie between two observed voxels."""
    lower, upper = np.floor(vertices).astype(int), np.ceil(vertices).astype(int)
    seen = known[tuple(lower.T)] & known[tuple(upper.T)]
    return _drop_unused_vertices(vertices, faces[seen[faces].all(1)])


def _drop_small_components(vertices: Array, faces: Faces) -> tuple[Array, Faces]:
    """Connected components with at least MIN_COMPONENT of the faces of the largest."""
    if len(faces) == 0:
        return vertices, faces
    component = label_components(faces, len(vertices))
    sizes = np.bincount(component)
    return _drop_unused_vertices(vertices, faces[sizes[component] >= MIN_COMPONENT * sizes.max()])


def label_components(faces: Faces, n: int) -> NDArray[np.int64]:
    """(F,) connected component of each face; `n` is the number of vertices."""
    rows, columns = faces[:, [0, 1]].ravel(), faces[:, [1, 2]].ravel()
    component = connected_components(coo_matrix((np.ones(len(rows)), (rows, columns)), (n, n)), directed=False)[1]
    return np.asarray(component[faces[:, 0]], np.int64)


def _drop_unused_vertices(vertices: Array, faces: Faces) -> tuple[Array, Faces]:
    """The same faces without unused vertices."""
    used, new = np.unique(faces, return_inverse=True)
    return vertices[used], new.reshape(-1, 3).astype(np.int64)


def vertex_normals(vertices: Array, faces: Faces) -> Array:
    """(V, 3) unit outward normals, weighted by face area."""
    a, b, c = (vertices[faces[:, k]] for k in range(3))
    face_normals = np.cross(b - a, c - a)
    normals = np.stack(
        [sum(np.bincount(faces[:, k], face_normals[:, d], len(vertices)) for k in range(3)) for d in range(3)], 1
    )
    return normals / np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-300)


def _colour_vertices(
    scene: Scene,
    labels: Labels,
    part: int,
    Ts: Array,
    frames: NDArray[np.int64],
    vertices: Array,
    faces: Faces,
    tolerance: float,
) -> tuple[NDArray[np.uint8], NDArray[np.bool_]]:
    """(V, 3) RGB from the frames that see a vertex best; unseen vertices take the colour of the nearest seen one.

    Also (V,) which vertices belong to the other part: its pixels lie on them far more often, so some labels were wrong.
    """
    normals = vertex_normals(vertices, faces)
    colours, weight = np.zeros((len(vertices), 3)), np.zeros(len(vertices))
    owners = np.zeros((len(vertices), 2), np.int32)
    pictures = (scene.rgb, scene.points, scene.edge, labels)
    arguments = (vertices, normals, Ts, frames, *pictures, part, *scene.lens, tolerance, colours, weight, owners)
    run_in_threads(lambda begin, end: _sample_colours(begin, end, *arguments), len(vertices), 1000)
    seen = weight > 0
    if seen.any() and not seen.all():
        colours[~seen] = colours[seen][cKDTree(vertices[seen]).query(vertices[~seen])[1]]
    foreign = (owners[:, 1] >= FOREIGN) & (owners[:, 1] > 2 * owners[:, 0])
    return np.clip(np.rint(colours), 0, 255).astype(np.uint8), foreign


@njit(nogil=True, cache=True, error_model="numpy")
def _sample_colours(
    begin: int, end: int, vertices: Array, normals: Array, Ts: Array, frames: Ints, rgb: NDArray[np.uint8],
    points: Floats, edge: Bools, labels: NDArray[np.uint8], part: int, fx: float, fy: float, cx: Array, cy: Array,
    tolerance: float, colours: Array, weights: Array, owners: NDArray[np.int32],
) -> None:  # pragma: no cover  # fmt: skip
    """Mean of bilinear samples, weighted by (cosine of the view angle over depth) to the power SHARPNESS.

    `owners` (V, 2) counts the frames whose nearest pixel lies on the vertex: of this part, and of the other.
    """
    h, w = labels.shape[1], labels.shape[2]
    for k in range(begin, end):
        total = np.zeros(3)
        sample = np.zeros(3)
        weight = 0.0
        for f in range(frames.shape[0]):
            i = frames[f]
            T = Ts[i]
            px = T[0, 0] * vertices[k, 0] + T[0, 1] * vertices[k, 1] + T[0, 2] * vertices[k, 2] + T[0, 3]
            py = T[1, 0] * vertices[k, 0] + T[1, 1] * vertices[k, 1] + T[1, 2] * vertices[k, 2] + T[1, 3]
            pz = T[2, 0] * vertices[k, 0] + T[2, 1] * vertices[k, 1] + T[2, 2] * vertices[k, 2] + T[2, 3]
            if pz <= 0:
                continue
            facing = 0.0
            for d in range(3):
                n = T[d, 0] * normals[k, 0] + T[d, 1] * normals[k, 1] + T[d, 2] * normals[k, 2]
                facing -= n * (px if d == 0 else py if d == 1 else pz)
            facing /= math.sqrt(px * px + py * py + pz * pz)
            if facing < 0.1:
                continue
            u, v = fx * px / pz + cx[i], fy * py / pz + cy[i]
            x0, y0 = math.floor(u), math.floor(v)
            if x0 < 0 or y0 < 0 or x0 >= w - 1 or y0 >= h - 1:
                continue
            x, y = x0 + (u - x0 > 0.5), y0 + (v - y0 > 0.5)
            if facing > 0.3 and abs(points[i, y, x, 2] - pz) <= tolerance and labels[i, y, x] > 0:
                owners[k, 0 if labels[i, y, x] == part else 1] += 1
            share = 0.0
            sample[:] = 0
            slope = tolerance + 0.7 * (pz / fx) * math.sqrt(1 - min(1.0, facing * facing)) / facing
            for dy in range(2):
                for dx in range(2):
                    x, y = x0 + dx, y0 + dy
                    z = points[i, y, x, 2]
                    if labels[i, y, x] != part or z <= 0 or abs(z - pz) > slope:
                        continue
                    s = (1 - abs(u - x)) * (1 - abs(v - y)) * (0.3 if edge[i, y, x] else 1.0)
                    share += s
                    for d in range(3):
                        sample[d] += s * rgb[i, y, x, d]
            if share < 0.1:
                continue
            good = (share * facing / pz) ** SHARPNESS
            weight += good
            for d in range(3):
                total[d] += good * sample[d] / share
        weights[k] = weight
        if weight > 0:
            for d in range(3):
                colours[k, d] = total[d] / weight


@njit(nogil=True, cache=True, inline="always")
def _interpolate(image: Floats, u: float, v: float) -> float:  # pragma: no cover
    """Bilinear value of `image` (h, w) at column u and row v."""
    x0, y0 = math.floor(u), math.floor(v)
    p, q = u - x0, v - y0
    above = (1 - p) * image[y0, x0] + p * image[y0, x0 + 1]
    below = (1 - p) * image[y0 + 1, x0] + p * image[y0 + 1, x0 + 1]
    return (1 - q) * above + q * below


@njit(inline="always")
def _observe(
    px: float, py: float, pz: float, xi: int, yi: int, points: Floats, normals: Floats, mask: Bools,
    labels: NDArray[np.uint8], part: int, reach: float, behind: float, sure: float,
) -> tuple[float, float]:  # pragma: no cover  # fmt: skip
    """Distance, in units of `reach`, and weight of the voxel at (px, py, pz), camera frame, from the pixel (xi, yi).

    Weight 0 without evidence.
    """
    around = -points[yi, xi, 2]
    if around > 0 and pz > around - reach:
        return 1.0, 0.0
    if not mask[yi, xi]:
        return 1.0, EMPTY
    depth, label = points[yi, xi, 2], labels[yi, xi]
    if depth <= 0 or label == 0 or pz - depth > 2.2 * reach:
        return 1.0, 0.0
    n0, n1, n2 = normals[yi, xi, 0], normals[yi, xi, 1], normals[yi, xi, 2]
    across = n0 * px + n1 * py + n2 * pz
    distance = across - (n0 * points[yi, xi, 0] + n1 * points[yi, xi, 1] + n2 * depth)
    if distance < -behind:
        return 1.0, 0.0
    facing = -across / math.sqrt(px * px + py * py + pz * pz)
    if facing < 0.05:
        return 1.0, 0.0
    weight = facing * facing
    if label != part and distance < 2 * sure:
        return 1.0, 0.0
    if distance < -sure:
        weight *= (distance + behind) / (behind - sure)
    return min(1.0, distance / reach), weight


@njit(nogil=True, cache=True, error_model="numpy")
def _integrate(
    begin: int, end: int, field: Floats, weight: Floats, blocks: Ints, voxel: float, Ts: Array, frames: Ints,
    points: Floats, normals: Floats, mask: Bools, labels: NDArray[np.uint8], rim_distance: Floats, limits: Floats,
    part: int, fx: float, fy: float, cx: Array, cy: Array, reach: float, behind: float, sure: float,
) -> None:  # pragma: no cover  # fmt: skip
    """Average, over frames, of the distance in units of `reach`, in [-1, 1]; > 0 is free. Blocks begin to end.

    A pixel of the part is a piece of plane. In front of it the distance has full weight; behind it, where the far side
    of a thin sheet may be, the weight falls from `sure` to `behind`. Any other pixel marks the space in front of its
    surface as free. The distance of free space is at most the one, across the image, to the part's rim. Blocks that lie
    beyond the `limits` are passed over.
    """
    h, w = labels.shape[1], labels.shape[2]
    middle = 0.5 * (BLOCK - 1) * voxel
    radius = math.sqrt(3.0) * middle
    sums, weights = np.zeros((BLOCK, BLOCK, BLOCK)), np.zeros((BLOCK, BLOCK, BLOCK))
    for block in range(begin, end):
        first = blocks[block] * BLOCK
        sums[:], weights[:] = 0, 0
        for f in range(frames.shape[0]):
            i = frames[f]
            T = Ts[i]
            x, y, z = first[0] * voxel + middle, first[1] * voxel + middle, first[2] * voxel + middle
            px = T[0, 0] * x + T[0, 1] * y + T[0, 2] * z + T[0, 3]
            py = T[1, 0] * x + T[1, 1] * y + T[1, 2] * z + T[1, 3]
            pz = T[2, 0] * x + T[2, 1] * y + T[2, 2] * z + T[2, 3]
            nearest = pz - radius
            if nearest > 0:
                xi, yi = math.floor(fx * px / pz + cx[i] + 0.5), math.floor(fy * py / pz + cy[i] + 0.5)
                across = max(fx, fy) * radius / nearest * (1 + max(abs(px), abs(py)) / pz)
                inside = xi >= 0 and yi >= 0 and xi < w and yi < h
                if inside and across < AROUND - 1 and nearest > limits[f, yi, xi]:
                    continue
            frame_points, frame_normals, frame_mask, frame_labels = points[i], normals[i], mask[i], labels[i]
            for a in range(BLOCK):
                for b in range(BLOCK):
                    x, y, z = (first[0] + a) * voxel, (first[1] + b) * voxel, first[2] * voxel
                    row_x = T[0, 0] * x + T[0, 1] * y + T[0, 2] * z + T[0, 3]
                    row_y = T[1, 0] * x + T[1, 1] * y + T[1, 2] * z + T[1, 3]
                    row_z = T[2, 0] * x + T[2, 1] * y + T[2, 2] * z + T[2, 3]
                    for c in range(BLOCK):
                        pz = row_z + T[2, 2] * (c * voxel)
                        if pz <= 0:
                            continue
                        px, py = row_x + T[0, 2] * (c * voxel), row_y + T[1, 2] * (c * voxel)
                        u = fx * px / pz + cx[i]
                        v = fy * py / pz + cy[i]
                        xi, yi = math.floor(u + 0.5), math.floor(v + 0.5)
                        if xi < 1 or yi < 1 or xi >= w - 1 or yi >= h - 1:
                            continue
                        value, vote = _observe(
                            px, py, pz, xi, yi, frame_points, frame_normals, frame_mask, frame_labels, part, reach,
                            behind, sure,
                        )  # fmt: skip
                        if vote == 0:
                            continue
                        if value > 0 and rim_distance[f, yi, xi] != 0 and abs(rim_distance[f, yi, xi]) < 12:
                            rim = _interpolate(rim_distance[f], u, v)
                            value = min(value, max(0.0, abs(rim) - 0.5) * pz / (fx * reach))
                        sums[a, b, c] += vote * value
                        weights[a, b, c] += vote
        for a in range(BLOCK):
            for b in range(BLOCK):
                for c in range(BLOCK):
                    if weights[a, b, c] > 0:
                        field[first[0] + a, first[1] + b, first[2] + c] = sums[a, b, c] / weights[a, b, c]
                        weight[first[0] + a, first[1] + b, first[2] + c] = weights[a, b, c]
