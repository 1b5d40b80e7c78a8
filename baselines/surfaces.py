"""Part labels of pixels, surfaces of parts, and pictures of them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy import ndimage
from scipy.spatial import cKDTree
from skimage.measure import marching_cubes

from baselines.video import UnsolvableError, Video, lift
from freeart21 import se3
from freeart21.camera import Camera
from freeart21.mesh import Mesh
from freeart21.se3 import Array, Bools, Floats
from freeart21.z_buffer import draw_triangles

Labels = NDArray[np.uint8]
"""(h, w): 0 neither, 1 and 2 the parts; or (h, w, 3): RGB."""
CELLS = 96
"""Voxels along the longest side of a part."""
_TRUNCATION = 3.0
"""Voxels over which a signed distance counts."""
_VIEWS = 10
"""Other keyframes that a pixel is looked up in."""
FUSED = 2
"""Every such keyframe is labelled and fused into surfaces."""
_STRIDE = 2
"""Pixels between those that are looked up; the others take the nearest one's label."""
_TRACKS_WEIGHT = 0.2
"""Of the nearest tracks' part against the mean cost of the views, which is 0 to 1."""


def label_pixels(video: Video, Ts: Array, seen: Bools, points: Array, parts: NDArray[np.int64]) -> dict[int, Labels]:
    """A label picture of every FUSED-th keyframe: 0 neither, 1 and 2 the part that a foreground pixel moves with.

    `Ts` (2, F, 4, 4) are the parts' poses, `seen` (2, F) where they were found, `points` (P, F, 3) the tracks and
    `parts` (P,) their part. A pixel's point is moved into other keyframes by both parts: it costs 1 where it then
    stands before the measured surface or off the mask, less where it lies on it. The nearest tracks decide ties.
    """
    camera, tolerance = video.recording.camera, 0.01 * video.size
    pictures: dict[int, Labels] = {}
    both = np.flatnonzero(seen.all(0))
    for k in range(0, len(video.frames), FUSED):
        frame = video.frames[k]
        row, column = np.nonzero(frame.mask & (frame.depth > 0))
        few = (row % _STRIDE == 0) & (column % _STRIDE == 0)
        row, column = row[few], column[few]
        here = lift(camera.K, frame, np.stack([column, row], 1) + 0.5)
        label: Labels = np.zeros(frame.mask.shape, np.uint8)
        if not len(here):
            pictures[k] = label
            continue
        others = both[both != k]
        others = others[np.unique(np.linspace(0, len(others) - 1, _VIEWS).round().astype(int))] if len(others) else []
        cost = np.zeros((2, len(here)))
        for part in range(2):
            for other in others:
                T = Ts[part, other] @ se3.inverse(Ts[part, k])
                cost[part] += _misfit(camera, video.frames[other].depth, video.frames[other].mask, T, here, tolerance)
        cost /= max(len(others), 1)
        own = np.isfinite(points[:, k, 0]) & (parts >= 0)
        if own.any():
            near = min(5, int(own.sum()))
            _, index = cKDTree(points[own, k]).query(here, near)
            share = (parts[own][index].reshape(len(here), near) == 1).mean(1)
            cost += _TRACKS_WEIGHT * np.stack([share, 1 - share])
        label[row, column] = np.where(cost[1] < cost[0], 2, 1)
        pictures[k] = _fill(label, frame.mask)
    return pictures


def _misfit(camera: Camera, depth: Floats, mask: Bools, T: Array, points: Array, tolerance: float) -> Array:
    """(P,) cost, 0 to 1, of `points` moved by `T` (4, 4) into a picture; 0.5 where they are hidden or outside it."""
    moved = se3.transform(T, points)
    K = camera.K
    z = np.maximum(moved[:, 2], 1e-6)
    u = np.floor(K[0, 0] * moved[:, 0] / z + K[0, 2]).astype(int)
    v = np.floor(K[1, 1] * moved[:, 1] / z + K[1, 2]).astype(int)
    inside = (u >= 0) & (v >= 0) & (u < camera.width) & (v < camera.height) & (moved[:, 2] > 0)
    u, v = np.where(inside, u, 0), np.where(inside, v, 0)
    behind = depth[v, u] - moved[:, 2]
    on_surface = np.minimum((behind / tolerance) ** 2, 1.0)
    cost = np.where(behind < -tolerance, 0.5, on_surface)  # hidden behind something
    cost = np.where(mask[v, u] & (depth[v, u] > 0), cost, np.where(mask[v, u], 0.5, 1.0))
    return np.where(inside, cost, 0.5)


def _fill(label: Labels, mask: Bools) -> Labels:
    """Every foreground pixel takes the nearest label; single ones follow their neighbours."""
    if not label.any():
        return np.where(mask, np.uint8(1), np.uint8(0))
    _, (row, column) = ndimage.distance_transform_edt(label == 0, return_indices=True)
    full = label[row, column]
    return np.where(mask, cv2.medianBlur(full, 5), 0).astype(np.uint8)


def fuse(video: Video, Ts: Array, seen: Bools, labels: Mapping[int, Labels], part: int) -> Mesh:
    """The coloured surface of a part (0 or 1) in its own frame: a truncated signed distance (Curless and Levoy 1996)
    of the keyframes' depth near its points, and marching cubes. Raises UnsolvableError when it has no points.

    Pixels of the other part and of the background say that nothing stands before them.
    """
    K, frames = video.recording.camera.K, [k for k in labels if seen[part, k]]
    clouds = []
    for k in frames:
        row, column = np.nonzero((labels[k] == part + 1) & (video.frames[k].depth > 0))
        here = lift(K, video.frames[k], np.stack([column, row], 1)[:: _STRIDE**2] + 0.5)
        clouds.append(se3.transform(se3.inverse(Ts[part, k]), here))
    cloud = np.concatenate([np.zeros((0, 3)), *clouds])
    if len(cloud) < 100:
        raise UnsolvableError("surfaces", f"part {part + 1} has {len(cloud)} points, expected 100")
    low, high = np.quantile(cloud, [0.002, 0.998], axis=0)
    voxel = float((high - low).max()) / CELLS
    low = low - 4 * voxel
    shape = tuple(np.ceil((high - low) / voxel).astype(int) + 5)
    cells = np.floor((cloud - low) / voxel).astype(int)
    cells = cells[((cells >= 0) & (cells < shape)).all(1)]
    active = np.zeros(shape, bool)
    active[tuple(cells.T)] = True
    active = ndimage.binary_dilation(active, np.ones((3, 3, 3), bool), iterations=2)
    index = np.argwhere(active)
    centres = low + (index + 0.5) * voxel
    total, weight = np.zeros(len(index)), np.zeros(len(index))
    colour, colour_weight = np.zeros((len(index), 3)), np.zeros(len(index))
    for k in frames:
        frame = video.frames[k]
        moved = se3.transform(Ts[part, k], centres)
        u = np.floor(K[0, 0] * moved[:, 0] / moved[:, 2] + K[0, 2]).astype(int)
        v = np.floor(K[1, 1] * moved[:, 1] / moved[:, 2] + K[1, 2]).astype(int)
        inside = (u >= 0) & (v >= 0) & (u < frame.depth.shape[1]) & (v < frame.depth.shape[0]) & (moved[:, 2] > 0)
        u, v = np.where(inside, u, 0), np.where(inside, v, 0)
        distance = (frame.depth[v, u] - moved[:, 2]) / voxel
        own = inside & (labels[k][v, u] == part + 1) & (frame.depth[v, u] > 0) & (distance > -_TRUNCATION)
        empty = inside & ~frame.mask[v, u]
        empty |= inside & frame.mask[v, u] & (labels[k][v, u] != part + 1) & (distance > _TRUNCATION)
        total[own] += np.minimum(distance[own], _TRUNCATION)
        total[empty] += _TRUNCATION
        weight[own | empty] += 1
        close = own & (np.abs(distance) < _TRUNCATION)
        colour[close] += frame.rgb[v[close], u[close]]
        colour_weight[close] += 1
    values = np.full(shape, _TRUNCATION)
    values[active] = np.where(weight > 0, total / np.maximum(weight, 1), _TRUNCATION)
    known = np.zeros(shape, bool)
    known[active] = (weight > 0) & (colour_weight > 0)
    try:
        vertices, faces, _, _ = marching_cubes(values, 0.0, mask=known, gradient_direction="ascent")
    except (ValueError, RuntimeError) as error:
        raise UnsolvableError("surfaces", f"part {part + 1} has no surface") from error
    colours = np.zeros((*shape, 3))
    colours[active] = colour / np.maximum(colour_weight, 1)[:, None]
    nearest = np.clip(np.rint(vertices).astype(int), 0, np.array(shape) - 1)
    mesh = Mesh(low + (vertices + 0.5) * voxel, faces, colours[tuple(nearest.T)].astype(np.uint8))
    return _without_specks(mesh)


def _without_specks(mesh: Mesh) -> Mesh:
    """The mesh without pieces of less than a hundredth of its faces."""
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    a, b = mesh.faces[:, [0, 1]].T
    c = mesh.faces[:, 2]
    pairs = np.concatenate([[a, b], [b, c]], axis=1)
    n = len(mesh.vertices)
    _, piece = connected_components(coo_array((np.ones(pairs.shape[1]), tuple(pairs)), shape=(n, n)), directed=False)
    sizes = np.bincount(piece[mesh.faces[:, 0]], minlength=piece.max() + 1)
    return mesh.with_faces(sizes[piece[mesh.faces[:, 0]]] >= 0.01 * len(mesh.faces))


def draw(camera: Camera, mesh: Mesh) -> tuple[Array, Labels]:
    """Depth (h, w), metres, infinite where there is nothing, and colours (h, w, 3), white there, of a mesh that stands
    in the camera's frame."""
    depth = np.full((camera.height, camera.width), np.inf)
    face = np.full(depth.shape, -1, np.int64)
    weights = np.zeros((*depth.shape, 3))
    with np.errstate(invalid="ignore", divide="ignore"):
        at = np.nan_to_num(camera.project(mesh.vertices), nan=-1e6)
    draw_triangles(at, np.ascontiguousarray(mesh.vertices[:, 2]), mesh.faces, depth, face, weights)
    picture = np.full((*depth.shape, 3), 255, np.uint8)
    drawn = face >= 0
    if mesh.colours is not None:
        corners = mesh.colours[mesh.faces[face[drawn]]].astype(float)
        picture[drawn] = np.einsum("pk,pkc->pc", weights[drawn], corners).clip(0, 255).astype(np.uint8)
    return depth, picture


def label_frame(camera: Camera, depth: Floats, mask: Bools, meshes: Sequence[Mesh]) -> Labels:
    """0 neither, 1, 2: the part, of two posed `meshes`, that is drawn nearest to the measured depth of each pixel."""
    label = np.zeros(mask.shape, np.uint8)
    if not mask.any():
        return label
    row, column = (np.flatnonzero(mask.any(axis)) for axis in (1, 0))
    window = slice(row[0], row[-1] + 1), slice(column[0], column[-1] + 1)  # nothing else is labelled
    K = camera.K.copy()
    K[:2, 2] -= column[0], row[0]
    height, width = mask[window].shape
    drawn = np.stack([draw(Camera(K, width, height), mesh)[0] for mesh in meshes])
    here = depth[window]
    miss = np.where(here > 0, np.abs(drawn - here), np.where(np.isfinite(drawn), 0.0, np.inf))
    nearest = np.where(np.isfinite(miss).any(0) & mask[window], 1 + miss.argmin(0), 0).astype(np.uint8)
    label[window] = _fill(nearest, mask[window])
    return label
