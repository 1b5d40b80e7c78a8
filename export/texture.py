"""Textures from the video of a reconstruction, or from its vertex colours.

Every texel is looked up in the frames that show it. Lights do not turn with the object, so frames differ in low
frequencies and agree in high ones. Low frequencies are averaged over all frames; high frequencies come from the
sharpest ones (two bands of Burt and Adelson, ACM Transactions on Graphics 1983). Sharp means many pixels per texel
(Waechter, Moehrle, Goesele, ECCV 2014) and little motion.
"""

from __future__ import annotations

import math

import cv2
import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from export.atlas import Atlas, Texels, Texture, find_texels, paint_texture, unwrap
from export.meshes import number_cells, vertex_normals
from export.symmetry import Supposed
from freeart21.errors import FreeArtError
from freeart21.mesh import Mesh, bounding_diagonal
from freeart21.reconstruction import Reconstruction
from freeart21.recording import Recording
from freeart21.se3 import Array
from freeart21.z_buffer import BEHIND, draw_triangles

TEXELS_PER_PIXEL = 2.0
"""Texels along a pixel of the nearest frames: two, so that resampling loses little."""
_NEAR_QUANTILE = 0.1
"""Quantile of the frames' distances that counts as near."""
_BAND_SIGMA = 6.0
"""Pixels of near frames, standard deviation of the blur between the bands: shading is coarser, texture is finer."""
_SHARPNESS_POWER = 6.0
"""Power of a frame's sharpness in the high band: half as sharp weighs a 64th."""
_FILL_CELL = 8.0
"""Texels along a cell of unseen surface, which gets a single colour."""
_FILL_CELLS, _FILL_TURN = 64, 0.25
"""Cells of seen surface whose colours mix in one of unseen surface, and diagonals of the part that normals that differ
by 1 count as. Held-out pixels of supposed faces, seven objects: 18.5 dB by the nearest cell, 18.9 by the nearest that
faces so, 19.5 by 64 however they face, 19.9 by both; half or twice the figures, or eight times the cells: within .1."""
_EDGE_PIXELS = 2
"""Pixels along a part's outline that are ignored: they mix with the background."""
MAX_FRAMES = 120
"""Frames per texture, evenly spread over those that show the object."""
_MIN_COSINE = 0.15
"""Cosine of the viewing angle below which a pixel is ignored."""


def texture_from_vertices(mesh: Mesh, part: Mesh) -> Texture | None:
    """A texture of `mesh` with the colours of the original `part`'s vertices; None when it has none."""
    if part.colours is None:
        return None
    used = np.unique(part.faces)
    atlas = unwrap(mesh, 0.5 * float(np.sqrt(4 / np.sqrt(3) * part.areas().mean())))
    texels = find_texels(atlas)
    k = min(3, len(used))
    distance, nearest = cKDTree(part.vertices[used]).query(texels.interpolate(mesh, mesh.vertices), k=k)
    weights = 1 / np.maximum(distance.reshape(-1, k), 1e-9)
    colours = part.colours[used[nearest.reshape(-1, k)]].astype(float)
    return Texture(
        atlas, paint_texture(atlas, texels, np.einsum("nk,nki->ni", weights, colours) / weights.sum(1)[:, None])
    )


def check_recording(reconstruction: Reconstruction, recording: Recording) -> None:
    """Raise FreeArtError when the recording has another length or size than the reconstruction."""
    camera, masks = recording.camera, reconstruction.part_masks.shape
    if (len(recording), camera.height, camera.width) != masks:
        raise FreeArtError(
            f"{recording.name} has {len(recording)} frames of {camera.width} x {camera.height}, expected {masks[0]} "
            f"frames of {masks[2]} x {masks[1]}, as the result has"
        )


def textures_from_video(
    reconstruction: Reconstruction,
    meshes: tuple[Mesh, Mesh],
    recording: Recording,
    supposed: tuple[Supposed, Supposed] = (Supposed(), Supposed()),
) -> tuple[Texture, Texture]:
    """Textures of both parts, whose surfaces `meshes` are in the canonical frame at state zero, as what symmetries
    `supposed` of them. The recording is the reconstruction's (`check_recording`)."""
    camera = recording.camera
    size = (len(reconstruction), camera.height, camera.width)
    poses = (reconstruction.Ts_camera_reference, reconstruction.Ts_camera_moving)
    seen = np.flatnonzero(reconstruction.seen.any(1))
    frames = seen[np.unique(np.linspace(0, len(seen) - 1, MAX_FRAMES).round().astype(int))] if len(seen) else seen
    parts = [_PartTexels(mesh, Ts, camera.K, frames) for mesh, Ts in zip(meshes, poses, strict=True)]
    for i in frames:
        _accumulate_frame(parts, recording, reconstruction, int(i), size)
    return parts[0].texture(supposed[0]), parts[1].texture(supposed[1])


class _PartTexels:
    """One part's texels and their accumulated colours."""

    def __init__(self, mesh: Mesh, Ts: Array, K: Array, frames: NDArray[np.int64]) -> None:
        self.mesh, self.Ts = mesh, Ts
        distance = (Ts[frames] @ np.append(mesh.vertices.mean(0), 1))[:, 2] if len(frames) else np.ones(1)
        near = max(float(np.quantile(distance, _NEAR_QUANTILE)), 1e-6)
        self.atlas: Atlas = unwrap(mesh, near / math.sqrt(K[0, 0] * K[1, 1]) / TEXELS_PER_PIXEL)
        self.texels: Texels = find_texels(self.atlas)
        self.points = self.texels.interpolate(mesh, mesh.vertices)
        self.normals = self.texels.interpolate(mesh, vertex_normals(mesh))
        self.near = near
        count = len(self.points)
        self.bands = np.zeros((2, count, 3), np.float32)
        self.weights = np.zeros((2, count), np.float32)

    def texture(self, supposed: Supposed) -> Texture:
        """The texture so far; texels that no frame showed take those of their surroundings (`_fill_unseen`), and there
        belong the copies that symmetries `supposed`, with the colours of what they are copies of."""
        known = self.weights.min(0) > 0
        colours = np.full((len(known), 3), 128.0, np.float32)
        if known.any():
            bands = self.bands[:, known] / self.weights[:, known, None]
            colours[known] = bands.sum(0)
            if not known.all():
                size, turn = _FILL_CELL * self.atlas.texel_m, _FILL_TURN * bounding_diagonal(self.mesh)
                at, facing, paint = self._paint_copies(supposed, colours, known, size)
                colours[~known] = _fill_unseen(
                    np.concatenate([self.points, at]),
                    np.concatenate([self.normals, facing]),
                    np.concatenate([colours, paint]),
                    np.append(known, np.ones(len(paint), bool)),
                    size,
                    turn,
                )
        return Texture(self.atlas, paint_texture(self.atlas, self.texels, colours))

    def _paint_copies(
        self, supposed: Supposed, colours: NDArray[np.float32], known: NDArray[np.bool_], size: float
    ) -> tuple[Array, Array, NDArray[np.float32]]:
        """Points, normals and colours of the supposed copies that have a known texel within `size`, m, of the seen
        point that they are copies of."""
        if not len(supposed.points):
            return supposed.points, supposed.normals, colours[:0]
        distance, nearest = cKDTree(self.points[known]).query(supposed.sources, distance_upper_bound=size)
        met = np.isfinite(distance)
        return supposed.points[met], supposed.normals[met], colours[known][nearest[met]]


def _fill_unseen(
    points: NDArray[np.floating],
    normals: NDArray[np.floating],
    colours: NDArray[np.float32],
    known: NDArray[np.bool_],
    size: float,
    turn: float,
) -> NDArray[np.float32]:
    """(m, 3) colours of those points of (n, 3) that are not `known` (n,): the mean over the nearest cells of known
    ones, by the inverse square of their distance.

    A cell holds points within a cube of side `size`, m, that face one octant. Unit normals that differ by 1 count as
    `turn`, m: behind a thin wall the nearest surface is its inside, which looks another way.
    """
    facing = normals / np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-30)
    octant = (facing > 0) @ np.array([1, 2, 4])
    _, cell, count = np.unique(8 * number_cells(points, size) + octant, return_inverse=True, return_counts=True)
    rows = np.concatenate([points, turn * facing, colours], 1).astype(float)

    def means_of(chosen: NDArray[np.bool_]) -> tuple[NDArray[np.int64], Array]:
        """The cells that hold chosen points, and the means of these."""
        own = np.bincount(cell[chosen], minlength=len(count))
        sums = np.stack([np.bincount(cell[chosen], column, len(count)) for column in rows[chosen].T], -1)
        return np.flatnonzero(own), sums[own > 0] / own[own > 0, None]

    (_, means), (targets, middles) = means_of(known), means_of(~known)
    near = min(_FILL_CELLS, len(means))
    distance, nearest = (x.reshape(-1, near) for x in cKDTree(means[:, :6]).query(middles[:, :6], k=near))
    weights = 1 / np.maximum(distance, size) ** 2
    found = np.zeros((len(count), 3), np.float32)
    found[targets] = np.einsum("nk,nki->ni", weights, means[nearest, 6:]) / weights.sum(1, keepdims=True)
    return found[cell[~known]]


def _accumulate_frame(
    parts: list[_PartTexels], recording: Recording, reconstruction: Reconstruction, i: int, size: tuple[int, int, int]
) -> None:
    """Add frame `i` to the texels of both parts."""
    n, height, width = size
    K = recording.camera.K
    lens = np.array([K[0, 0], K[1, 1], K[0, 2], K[1, 2]])
    depth, label = _render_parts(parts, i, lens, (height, width))
    rgb = recording.frame(i).rgb
    across = np.ones((3, 3), np.uint8)  # where depth jumps within a pixel, two surfaces mix
    walls = np.stack([cv2.erode(depth, across), cv2.dilate(depth, across)])
    before, after = max(i - 1, 0), min(i + 1, n - 1)
    for k, part in enumerate(parts):
        own = ((reconstruction.part_masks[i] == k + 1) & (label == k + 1)).astype(np.uint8)
        own = cv2.erode(own, np.ones((2 * _EDGE_PIXELS - 1, 2 * _EDGE_PIXELS - 1), np.uint8))
        if not reconstruction.seen[i, k] or not own.any():
            continue
        # the same width on the surface in every frame
        blur = _BAND_SIGMA * part.near / max(float(np.median(depth[own > 0])), 1e-6)
        left, top, columns, rows = cv2.boundingRect(own)
        window = np.s_[top : top + rows, left : left + columns]
        bands = _split_bands(rgb[window].astype(np.float32), own[window].astype(np.float32), blur)
        motion = np.stack([part.Ts[before], part.Ts[i], part.Ts[after]])[:, :3]
        _accumulate_texels(
            part.points,
            part.normals,
            motion,
            lens,
            walls[(slice(None), *window)],
            own[window],
            bands,
            np.array([left, top]),
            part.near,
            max(after - before, 1),
            part.bands,
            part.weights,
        )


def _render_parts(
    parts: list[_PartTexels], i: int, lens: Array, shape: tuple[int, int]
) -> tuple[NDArray[np.float32], NDArray[np.uint8]]:
    """Depth, m (inf without a surface), and part (1 or 2, else 0) of each pixel of frame `i`."""
    points = [part.mesh.vertices @ part.Ts[i][:3, :3].T + part.Ts[i][:3, 3] for part in parts]
    faces = np.concatenate([parts[0].mesh.faces, parts[1].mesh.faces + len(points[0])])
    corners = np.concatenate(points)
    z = corners[:, 2]
    pixels = lens[:2] * corners[:, :2] / np.where(z > BEHIND, z, 1.0)[:, None] + lens[2:]
    depth, face = np.full(shape, np.inf), np.full(shape, -1)
    draw_triangles(pixels, z, faces, depth, face, np.zeros((*shape, 3)))
    label = np.where(face < 0, 0, np.where(face < len(parts[0].mesh.faces), 1, 2))
    return depth.astype(np.float32), label.astype(np.uint8)


def _split_bands(rgb: NDArray[np.float32], own: NDArray[np.float32], blur: float) -> NDArray[np.float32]:
    """(2, height, width, 3) low and high frequencies of the pixels in `own` (0 or 1); they sum to the image."""
    share = cv2.GaussianBlur(own, (0, 0), blur, borderType=cv2.BORDER_CONSTANT)
    low = cv2.GaussianBlur(rgb * own[..., None], (0, 0), blur, borderType=cv2.BORDER_CONSTANT)
    low = low / np.maximum(share, 1e-6)[..., None]
    return np.stack([low, rgb - low]).astype(np.float32)


@njit(cache=True)
def _transform_point(T: Array, p: NDArray[np.float32]) -> tuple[float, float, float]:
    """-"""
    x = T[0, 0] * p[0] + T[0, 1] * p[1] + T[0, 2] * p[2] + T[0, 3]
    y = T[1, 0] * p[0] + T[1, 1] * p[1] + T[1, 2] * p[2] + T[1, 3]
    z = T[2, 0] * p[0] + T[2, 1] * p[1] + T[2, 2] * p[2] + T[2, 3]
    return x, y, z


@njit(cache=True)
def _accumulate_texels(
    points: NDArray[np.float32],
    normals: NDArray[np.float32],
    Ts: Array,
    lens: Array,
    walls: NDArray[np.generic],
    own: NDArray[np.generic],
    bands: NDArray[np.float32],
    corner: NDArray[np.int64],
    near: float,
    frames_apart: int,
    sums: NDArray[np.float32],
    weights: NDArray[np.float32],
) -> None:
    """Add to `sums` (2, n, 3) and `weights` (2, n) the two `bands` (2, height, width, 3) of a frame at the texels.

    `Ts` (3, 3, 4) are the part's poses one frame before, now and one after; the first and last are `frames_apart`
    frames apart. `walls` (2, height, width) are the smallest and largest depth around a pixel. The images are windows
    that begin at column and row `corner` of the frame.
    """
    height, width = own.shape
    for i in range(len(points)):
        p, n = points[i], normals[i]
        x, y, z = _transform_point(Ts[1], p)
        if z <= 1e-6:
            continue
        column, row = lens[0] * x / z + lens[2] - corner[0], lens[1] * y / z + lens[3] - corner[1]
        c, r = int(np.floor(column)), int(np.floor(row))
        if c < 1 or r < 1 or c >= width - 1 or r >= height - 1 or own[r, c] == 0:
            continue
        T = Ts[1]
        away = x * (T[0, 0] * n[0] + T[0, 1] * n[1] + T[0, 2] * n[2])
        away += y * (T[1, 0] * n[0] + T[1, 1] * n[1] + T[1, 2] * n[2])
        away += z * (T[2, 0] * n[0] + T[2, 1] * n[1] + T[2, 2] * n[2])
        cosine = -away / math.sqrt((x * x + y * y + z * z) * (n[0] ** 2 + n[1] ** 2 + n[2] ** 2) + 1e-30)
        if cosine < _MIN_COSINE:
            continue
        pixel = z / math.sqrt(lens[0] * lens[1])
        slope = math.sqrt(1 - min(cosine, 1.0) ** 2) / cosine
        slack = pixel * (2 + 2 * slope)
        if walls[0, r, c] < z - slack or walls[1, r, c] > z + slack:
            continue
        x0, y0, z0 = _transform_point(Ts[0], p)
        x1, y1, z1 = _transform_point(Ts[2], p)
        if z0 <= 1e-6 or z1 <= 1e-6:
            continue
        moved_x = lens[0] * (x1 / z1 - x0 / z0) / frames_apart
        moved_y = lens[1] * (y1 / z1 - y0 / z0) / frames_apart
        density = cosine * (near / z) ** 2
        smear = math.sqrt(1 + 0.25 * (moved_x * moved_x + moved_y * moved_y))  # a shutter open half of the time
        c0, r0 = int(np.floor(column - 0.5)), int(np.floor(row - 0.5))
        s, t = column - 0.5 - c0, row - 0.5 - r0
        for band in range(2):
            weight = density if band == 0 else (density / smear) ** _SHARPNESS_POWER
            weights[band, i] += weight
            for k in range(3):
                image = bands[band]
                upper = (1 - s) * image[r0, c0, k] + s * image[r0, c0 + 1, k]
                lower = (1 - s) * image[r0 + 1, c0, k] + s * image[r0 + 1, c0 + 1, k]
                sums[band, i, k] += weight * ((1 - t) * upper + t * lower)
