"""Textures from the video that a reconstruction was made of, or from its vertices' colours.

Every texel is looked up in the frames that show it. Lamps do not turn with the object, so frames disagree on how bright
a place is and agree on its print: low frequencies are the mean of all frames, high ones come from those that see the
place sharpest (two bands of Burt and Adelson: A multiresolution spline, ACM Transactions on Graphics 1983), where
sharp means many pixels on the texel (Waechter, Moehrle, Goesele: Let there be color!, ECCV 2014) and little motion.
"""

from __future__ import annotations

import math

import cv2
import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from export.atlas import Atlas, Skin, Texels, painted, texels_of, unfolded
from export.meshes import smooth_normals
from freeart21.errors import FreeArtError
from freeart21.mesh import Mesh
from freeart21.reconstruction import Reconstruction
from freeart21.recording import Recording
from freeart21.se3 import Array

TEXELS_A_PIXEL = 2.0
"""Texels along a pixel of the nearest frames: sampling twice, at other places than the pixels', loses little."""
_NEAREST = 0.1
"""The quantile of the frames' distances that counts as near."""
_BAND = 6.0
"""Standard deviation, pixels of near frames, of the blur that parts the bands: shading is wider, print is finer."""
_SHARPEST = 6.0
"""Power of the sharpness with which a frame counts for the high band: half as sharp counts a 64th."""
_COARSE = 8.0
"""Texels along a cell of those that no frame showed: they have one colour."""
_EDGE = 2
"""Pixels from a part's outline that are not believed: they mix with what lies behind."""
_GRAZING = 0.15
"""Cosine of the viewing angle below which a pixel tells nothing of a place."""


def vertex_skin(mesh: Mesh, part: Mesh) -> Skin | None:
    """A skin with the colours of the original `part`'s vertices, on the surface `mesh`; None when it has none."""
    if part.colours is None:
        return None
    used = np.unique(part.faces)
    atlas = unfolded(mesh, 0.5 * float(np.sqrt(4 / np.sqrt(3) * part.areas().mean())))
    texels = texels_of(atlas)
    k = min(3, len(used))
    distance, nearest = cKDTree(part.vertices[used]).query(texels.of_corners(mesh, mesh.vertices), k=k)
    weights = 1 / np.maximum(distance.reshape(-1, k), 1e-9)
    colours = part.colours[used[nearest.reshape(-1, k)]].astype(float)
    return Skin(atlas, painted(atlas, texels, np.einsum("nk,nki->ni", weights, colours) / weights.sum(1)[:, None]))


def video_skins(
    reconstruction: Reconstruction, meshes: tuple[Mesh, Mesh], recording: Recording, max_frames: int
) -> tuple[Skin, Skin]:
    """Skins of both parts, whose surfaces `meshes` stand in the canonical frame at state zero, from at most
    `max_frames` frames of the video, evenly spread.

    Raises FreeArtError when the recording is not the one that was reconstructed: another length or size.
    """
    camera, n = recording.camera, len(reconstruction)
    size = (n, camera.height, camera.width)
    if (len(recording), camera.height, camera.width) != reconstruction.part_masks.shape:
        masks = reconstruction.part_masks.shape
        raise FreeArtError(
            f"{recording.name} has {len(recording)} frames of {camera.width} x {camera.height}, expected {masks[0]} "
            f"frames of {masks[2]} x {masks[1]}, as the result has"
        )
    poses = (reconstruction.Ts_camera_reference, reconstruction.Ts_camera_moving)
    seen = np.flatnonzero(reconstruction.seen.any(1))
    frames = seen[np.unique(np.linspace(0, len(seen) - 1, max_frames).round().astype(int))] if len(seen) else seen
    parts = [_Part(mesh, Ts, camera.K, frames) for mesh, Ts in zip(meshes, poses, strict=True)]
    for i in frames:
        _add(parts, recording, reconstruction, int(i), size)
    return parts[0].skin(), parts[1].skin()


class _Part:
    """One part's texels, and what the frames so far say of them."""

    def __init__(self, mesh: Mesh, Ts: Array, K: Array, frames: NDArray[np.int64]) -> None:
        self.mesh, self.Ts = mesh, Ts
        distance = (Ts[frames] @ np.append(mesh.vertices.mean(0), 1))[:, 2] if len(frames) else np.ones(1)
        near = max(float(np.quantile(distance, _NEAREST)), 1e-6)
        self.atlas: Atlas = unfolded(mesh, near / math.sqrt(K[0, 0] * K[1, 1]) / TEXELS_A_PIXEL)
        self.texels: Texels = texels_of(self.atlas)
        self.points = self.texels.of_corners(mesh, mesh.vertices)
        self.normals = self.texels.of_corners(mesh, smooth_normals(mesh))
        self.near = near
        count = len(self.points)
        self.bands = np.zeros((2, count, 3), np.float32)
        self.weights = np.zeros((2, count), np.float32)

    def skin(self) -> Skin:
        """What the texels have come to; those that no frame showed have the colour of the nearest that one did."""
        known = self.weights.min(0) > 0
        colours = np.full((len(known), 3), 128.0, np.float32)
        if known.any():
            bands = self.bands[:, known] / self.weights[:, known, None]
            colours[known] = bands.sum(0)
            if not known.all():
                colours[~known] = _from_nearest(
                    self.points[known], colours[known], self.points[~known], _COARSE * self.atlas.texel_m
                )
        return Skin(self.atlas, painted(self.atlas, self.texels, colours))


def _from_nearest(
    points: NDArray[np.float32], colours: NDArray[np.float32], asked: NDArray[np.float32], size: float
) -> NDArray[np.float32]:
    """(m, 3) the colours at the points nearest to those `asked` (m, 3), one for all in a cubic cell of side `size`.

    A colour is the mean of the `points` (n, 3) in such a cell.
    """
    _, cell, count = np.unique(np.floor(points / size), axis=0, return_inverse=True, return_counts=True)
    means = [np.bincount(cell.ravel(), values[:, k]) / count for values in (points, colours) for k in range(3)]
    _, first, back = np.unique(np.floor(asked / size), axis=0, return_index=True, return_inverse=True)
    nearest = cKDTree(np.stack(means[:3], -1)).query(asked[first])[1]
    return np.stack(means[3:], -1).astype(np.float32)[nearest[back.ravel()]]


def _add(
    parts: list[_Part], recording: Recording, reconstruction: Reconstruction, i: int, size: tuple[int, int, int]
) -> None:
    """Let frame `i` say what it shows."""
    n, height, width = size
    K = recording.camera.K
    lens = np.array([K[0, 0], K[1, 1], K[0, 2], K[1, 2]])
    depth, label = np.full((height, width), np.inf, np.float32), np.zeros((height, width), np.uint8)
    for k, part in enumerate(parts):
        T = part.Ts[i]
        _draw(depth, label, k + 1, part.mesh.vertices @ T[:3, :3].T + T[:3, 3], part.mesh.faces, lens)
    rgb = recording.frame(i).rgb
    across = np.ones((3, 3), np.uint8)  # where depth jumps within a pixel, two surfaces mix
    walls = np.stack([cv2.erode(depth, across), cv2.dilate(depth, across)])
    before, after = max(i - 1, 0), min(i + 1, n - 1)
    for k, part in enumerate(parts):
        own = ((reconstruction.part_masks[i] == k + 1) & (label == k + 1)).astype(np.uint8)
        own = cv2.erode(own, np.ones((2 * _EDGE - 1, 2 * _EDGE - 1), np.uint8))
        if not reconstruction.seen[i, k] or not own.any():
            continue
        blur = _BAND * part.near / max(float(np.median(depth[own > 0])), 1e-6)  # as wide on the surface in every frame
        left, top, columns, rows = cv2.boundingRect(own)
        window = np.s_[top : top + rows, left : left + columns]
        bands = _two_bands(rgb[window].astype(np.float32), own[window].astype(np.float32), blur)
        motion = np.stack([part.Ts[before], part.Ts[i], part.Ts[after]])[:, :3]
        _look(
            *(part.points, part.normals, motion, lens, walls[(slice(None), *window)], own[window], bands),
            *(np.array([left, top]), part.near, max(after - before, 1), part.bands, part.weights),
        )


def _two_bands(rgb: NDArray[np.float32], own: NDArray[np.float32], blur: float) -> NDArray[np.float32]:
    """(2, height, width, 3) low and high frequencies of the pixels `own` (0 or 1), which sum to them."""
    share = cv2.GaussianBlur(own, (0, 0), blur, borderType=cv2.BORDER_CONSTANT)
    low = cv2.GaussianBlur(rgb * own[..., None], (0, 0), blur, borderType=cv2.BORDER_CONSTANT)
    low = low / np.maximum(share, 1e-6)[..., None]
    return np.stack([low, rgb - low]).astype(np.float32)


@njit(cache=True)
def _draw(depth, label, value, points, faces, lens):
    """A z-buffer: draw triangles, `points` (V, 3) in the camera's frame, into `depth` and `label` (height, width)."""
    height, width = depth.shape
    for f in range(len(faces)):
        a, b, c = points[faces[f, 0]], points[faces[f, 1]], points[faces[f, 2]]
        if min(a[2], b[2], c[2]) <= 1e-6:
            continue
        ax, ay = lens[0] * a[0] / a[2] + lens[2], lens[1] * a[1] / a[2] + lens[3]
        bx, by = lens[0] * b[0] / b[2] + lens[2], lens[1] * b[1] / b[2] + lens[3]
        cx, cy = lens[0] * c[0] / c[2] + lens[2], lens[1] * c[1] / c[2] + lens[3]
        whole = (bx - ax) * (cy - ay) - (by - ay) * (cx - ax)
        if whole == 0:
            continue
        left, right = max(min(ax, bx, cx), 0.0), min(max(ax, bx, cx), float(width))
        top, bottom = max(min(ay, by, cy), 0.0), min(max(ay, by, cy), float(height))
        for y in range(int(np.ceil(top - 0.5)), int(np.floor(bottom - 0.5)) + 1):
            for x in range(int(np.ceil(left - 0.5)), int(np.floor(right - 0.5)) + 1):
                px, py = x + 0.5, y + 0.5
                u = ((bx - px) * (cy - py) - (by - py) * (cx - px)) / whole
                v = ((cx - px) * (ay - py) - (cy - py) * (ax - px)) / whole
                w = 1 - u - v
                if u < 0 or v < 0 or w < 0:
                    continue
                z = 1 / (u / a[2] + v / b[2] + w / c[2])
                if z < depth[y, x]:
                    depth[y, x] = z
                    label[y, x] = value


@njit(cache=True)
def _posed(T, p):
    x = T[0, 0] * p[0] + T[0, 1] * p[1] + T[0, 2] * p[2] + T[0, 3]
    y = T[1, 0] * p[0] + T[1, 1] * p[1] + T[1, 2] * p[2] + T[1, 3]
    z = T[2, 0] * p[0] + T[2, 1] * p[1] + T[2, 2] * p[2] + T[2, 3]
    return x, y, z


@njit(cache=True)
def _look(points, normals, Ts, lens, walls, own, bands, corner, near, frames_apart, sums, weights):
    """Add to `sums` (2, n, 3) and `weights` (2, n) what a frame's two `bands` (2, height, width, 3) show of the texels.

    `Ts` (3, 3, 4) is the part's pose one frame before, now and one after, the first and last `frames_apart` apart;
    `walls` (2, height, width) the least and greatest depth round a pixel. The pictures are windows that begin at the
    frame's column and row `corner`.
    """
    height, width = own.shape
    for i in range(len(points)):
        p, n = points[i], normals[i]
        x, y, z = _posed(Ts[1], p)
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
        if cosine < _GRAZING:
            continue
        pixel = z / math.sqrt(lens[0] * lens[1])
        slope = math.sqrt(1 - min(cosine, 1.0) ** 2) / cosine
        slack = pixel * (2 + 2 * slope)
        if walls[0, r, c] < z - slack or walls[1, r, c] > z + slack:
            continue
        x0, y0, z0 = _posed(Ts[0], p)
        x1, y1, z1 = _posed(Ts[2], p)
        if z0 <= 1e-6 or z1 <= 1e-6:
            continue
        moved_x = lens[0] * (x1 / z1 - x0 / z0) / frames_apart
        moved_y = lens[1] * (y1 / z1 - y0 / z0) / frames_apart
        density = cosine * (near / z) ** 2
        smear = math.sqrt(1 + 0.25 * (moved_x * moved_x + moved_y * moved_y))  # a shutter open half of the time
        c0, r0 = int(np.floor(column - 0.5)), int(np.floor(row - 0.5))
        s, t = column - 0.5 - c0, row - 0.5 - r0
        for band in range(2):
            weight = density if band == 0 else (density / smear) ** _SHARPEST
            weights[band, i] += weight
            for k in range(3):
                image = bands[band]
                upper = (1 - s) * image[r0, c0, k] + s * image[r0, c0 + 1, k]
                lower = (1 - s) * image[r0 + 1, c0, k] + s * image[r0 + 1, c0 + 1, k]
                sums[band, i, k] += weight * ((1 - t) * upper + t * lower)
