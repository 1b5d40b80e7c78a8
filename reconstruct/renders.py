"""Held-out views: from the Gaussians (`gaussians.views`), or without them from the fused meshes, with colours from the
frames that saw each place in the most similar way (`lumigraph`)."""

from __future__ import annotations

import math
from dataclasses import dataclass

import cv2
import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy.ndimage import distance_transform_edt

from freeart21 import se3
from freeart21.articulation import PARTS
from freeart21.camera import Camera
from freeart21.mesh import Mesh
from freeart21.reconstruction import Reconstruction
from freeart21.recording import Query, Recording
from freeart21.se3 import Array
from freeart21.z_buffer import draw_triangles
from reconstruct.gaussians.views import posed, render_views
from reconstruct.kernels import run_in_threads
from reconstruct.lumigraph import view_similarity_weight
from reconstruct.settings import RendersFrom
from reconstruct.surfaces import vertex_normals

Image = NDArray[np.uint8]

FRAMES, PIXELS = 150, 40_000_000
"""Frames that are looked at, evenly drawn, and the pixels that they have at most together."""
ALIKE, SPREAD = 24, 24
"""Of these, the frames for one part of one view: so many that see it turned most alike, and so many evenly drawn."""
RIM = 1.5
"""Pixels round the meshes that may be object still: marching cubes rounds off edges, and poses are not exact."""
BELIEVED = 0.5
"""Of the frames that look at such a pixel, the share by weight that must see the part there."""


def render_queries(
    result: Reconstruction, recording: Recording, how: RendersFrom = "gaussians and video"
) -> tuple[list[Image], list[Image]]:
    """One picture (height, width, 3) for each query of the recording, white where there is nothing, twice.

    A query poses the reference part, and where two parts are alike nobody can tell which of them is meant: the
    first pictures take this result's reference part for it, the second its moving part. A result without Gaussians is
    rendered from the video, `how`ever it is asked.
    """
    if not recording.queries:
        return [], []
    if how != "video" and result.appearance is not None and len(result.appearance):
        return render_views(result, recording, with_video=how == "gaussians and video")
    film = _Film.of(result, recording)
    first, second = (
        [_view(result, film, recording.camera, query, other) for query in recording.queries] for other in (False, True)
    )
    return first, second


def render(camera: Camera, meshes: list[Mesh]) -> Image:
    """(height, width, 3) picture of camera-frame meshes with their vertex colours, nearest first, white elsewhere."""
    colours = _look(camera, meshes).colours
    return np.clip(np.rint(colours), 0, 255).astype(np.uint8)


# --- where the meshes are ---------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class _Look:
    """What the rays through the pixels' centres meet, camera frame, metres."""

    mesh: NDArray[np.int8]
    """(h, w) number of the mesh, -1 for none."""
    points: Array
    """(h, w, 3)."""
    normals: Array
    """(h, w, 3), unit length."""
    colours: Array
    """(h, w, 3) of the vertices, 255 where there is nothing or the mesh has none."""


def _look(camera: Camera, meshes: list[Mesh]) -> _Look:
    shape = (camera.height, camera.width)
    depth, which = np.full(shape, np.inf), np.full(shape, -1, np.int8)
    normals, colours = np.zeros((*shape, 3)), np.full((*shape, 3), 255.0)
    for k, mesh in enumerate(meshes):
        if mesh.empty:
            continue
        face, weights = np.full(shape, -1), np.zeros((*shape, 3))
        draw_triangles(camera.project(mesh.vertices), mesh.vertices[:, 2], mesh.faces, depth, face, weights)
        on = face >= 0
        corners, weight = mesh.faces[face[on]], weights[on]
        which[on] = k
        normal = np.einsum("nk,nkd->nd", weight, vertex_normals(mesh.vertices, mesh.faces)[corners])
        normals[on] = normal / np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-12)
        colours[on] = 255 if mesh.colours is None else np.einsum("nk,nkd->nd", weight, mesh.colours[corners])
    points = camera.rays() * np.where(which >= 0, depth, 0)[..., None]
    return _Look(which, points, normals, colours)


def _with_rim(look: _Look, camera: Camera) -> tuple[_Look, NDArray[np.bool_]]:
    """The same, with pixels up to RIM beside the meshes on the planes of the nearest that are on one; and which."""
    drawn = look.mesh >= 0
    if not drawn.any():
        return look, drawn
    distance, (rows, columns) = distance_transform_edt(~drawn, return_indices=True)
    rim = (distance > 0) & (distance <= RIM)
    beside = rows[rim], columns[rim]
    rays, points, normals = camera.rays()[rim], look.points[beside], look.normals[beside]
    across = (rays * normals).sum(1)
    depth = (points * normals).sum(1) / np.where(np.abs(across) < 1e-3, np.inf, across)
    far = np.abs(depth - points[:, 2]) > 2 * RIM / camera.K[0, 0] * points[:, 2]
    depth = np.where(far, points[:, 2], depth)
    wider = _Look(look.mesh.copy(), look.points.copy(), look.normals.copy(), look.colours)
    wider.mesh[rim], wider.normals[rim] = look.mesh[beside], normals
    wider.points[rim] = rays * depth[:, None]
    return wider, rim


# --- what the video shows there ---------------------------------------------------------------------------------------


@dataclass(frozen=True)
class _Film:
    """Frames of the video, cropped to where the object ever is."""

    rgb: Image
    """(n, h, w, 3)."""
    depth: NDArray[np.float32]
    """(n, h, w) metres, 0 where there is none or no object."""
    labels: Image
    """(n, h, w) as `Reconstruction.part_masks`."""
    Ts: tuple[Array, Array]
    """(n, 4, 4) camera from canonical, reference and moving part."""
    seen: NDArray[np.bool_]
    """(n, 2)."""
    lens: tuple[float, float, float, float]
    """fx, fy, cx, cy of the crop, pixel centres at whole numbers."""
    tolerance: tuple[float, float]
    """Metres by which depth may differ from each part's mesh."""

    @classmethod
    def of(cls, result: Reconstruction, recording: Recording) -> _Film:
        ever: NDArray[np.bool_] = result.part_masks.max(0) > 0
        rows, columns = np.flatnonzero(ever.any(1)), np.flatnonzero(ever.any(0))
        box = (slice(rows[0], rows[-1] + 1), slice(columns[0], columns[-1] + 1)) if len(rows) else (slice(1), slice(1))
        h, w = ever[box].shape
        most = int(np.clip(PIXELS // (h * w), 1, min(FRAMES, len(recording))))
        frames = np.linspace(0, len(recording) - 1, most).round().astype(int)
        rgb, depth = np.zeros((most, h, w, 3), np.uint8), np.zeros((most, h, w), np.float32)
        labels = result.part_masks[(frames, *box)]

        def load(begin: int, end: int) -> None:
            for k in range(begin, end):
                frame = recording.frame(int(frames[k]))
                mask = frame.mask[box]
                rgb[k], depth[k] = frame.rgb[box], np.where(mask, frame.depth[box], 0)
                # the outline is the object's own: the parts' masks may stop a little short of it, or go beyond
                beside = cv2.dilate(labels[k], np.ones((3, 3)))
                labels[k] = np.where(mask, np.where(labels[k] > 0, labels[k], beside), 0)

        run_in_threads(load, most, 8)
        K = recording.camera.K
        Ts = result.Ts_camera_reference[frames], result.Ts_camera_moving[frames]
        lens = (K[0, 0], K[1, 1], K[0, 2] - columns[:1].sum() - 0.5, K[1, 2] - rows[:1].sum() - 0.5)
        film = cls(rgb, depth, labels, Ts, result.seen[frames], lens, (0.0, 0.0))
        tolerance = tuple(_tolerance(film, k, result.articulation.part(name)) for k, name in enumerate(PARTS))
        return cls(rgb, depth, labels, Ts, result.seen[frames], lens, (tolerance[0], tolerance[1]))


def _tolerance(film: _Film, part: int, mesh: Mesh) -> float:
    """Metres: what poses, fusion and sensor make between the mesh and its pixels' depth, with room to spare."""
    fx, fy, cx, cy = film.lens
    h, w = film.depth.shape[1:]
    gaps, footprints = [np.zeros(0)], [np.zeros(0)]
    normals = vertex_normals(mesh.vertices, mesh.faces)
    some = slice(None, None, max(1, len(mesh.vertices) // 2000))
    for i in np.flatnonzero(film.seen[:, part])[:: max(1, len(film.rgb) // 10)]:
        T = film.Ts[part][i]
        p, n = se3.transform(T, mesh.vertices[some]), normals[some] @ T[:3, :3].T
        p = p[(p[:, 2] > 0) & ((n * p).sum(1) < -0.5 * np.linalg.norm(p, axis=1))]
        x, y = np.rint(fx * p[:, 0] / p[:, 2] + cx).astype(int), np.rint(fy * p[:, 1] / p[:, 2] + cy).astype(int)
        inside = (x >= 0) & (y >= 0) & (x < w) & (y < h)
        x, y, z = x[inside], y[inside], p[inside, 2]
        on = (film.labels[i, y, x] == part + 1) & (film.depth[i, y, x] > 0)
        gaps.append(np.abs(film.depth[i, y, x] - z)[on])
        footprints.append(z[on] / fx)
    if not len(np.concatenate(gaps)):
        return 0.0
    return float(2 * np.median(np.concatenate(footprints)) + 4 * np.median(np.concatenate(gaps)))


def _view(result: Reconstruction, film: _Film, camera: Camera, query: Query, other: bool) -> Image:
    poses = posed(result, query, other)
    meshes = [result.articulation.part(name).moved(P) for name, P in zip(PARTS, poses, strict=True)]
    look, rim = _with_rim(_look(camera, meshes), camera)
    picture = np.where(rim[..., None], 255, look.colours)
    back = se3.inverse(query.T_newcam_cam)
    for k, pose in enumerate(poses):
        on = look.mesh == k
        if not on.any():
            continue
        inverse = se3.inverse(pose)
        points = se3.transform(inverse, look.points[on])
        normals, views = look.normals[on] @ pose[:3, :3], inverse[:3, 3] - points
        views /= np.linalg.norm(views, axis=1, keepdims=True)
        frames = _frames(film, k, back @ pose)
        lit = look.normals[on] @ back[:3, :3].T  # as the recording camera would see them, with which the lamps stand
        colours, agreed = _blended(film, k, frames, points, normals, lit, views)
        here = picture[on]
        believed = agreed > np.where(rim[on], BELIEVED, 0)
        here[believed] = colours[believed]
        picture[on] = here
    return np.clip(np.rint(picture), 0, 255).astype(np.uint8)


def _frames(film: _Film, part: int, T_camera_part: Array) -> NDArray[np.int64]:
    """Frames in which the part was seen: those that have it turned most alike, and some from all round."""
    seen = np.flatnonzero(film.seen[:, part])
    if len(seen) <= ALIKE + SPREAD:
        return seen
    turn = se3.rotation_angle(film.Ts[part][seen, :3, :3] @ T_camera_part[:3, :3].T)
    alike = seen[np.argsort(turn, kind="stable")[:ALIKE]]
    return np.union1d(alike, seen[np.linspace(0, len(seen) - 1, SPREAD).round().astype(int)])


def _blended(
    film: _Film, part: int, frames: NDArray[np.int64], points: Array, normals: Array, lit: Array, views: Array
) -> tuple[Array, Array]:
    """Colours (n, 3) of points (n, 3) of a part, and by how much the frames agree that it is there, 0 to 1 (n,).

    Normals and directions to the new camera are in the part's frame, as the points are; `lit` are the normals to find
    in the frames, in the recording camera's.
    """
    colours, agreed = np.zeros((len(points), 3)), np.zeros(len(points))
    pictures = (film.rgb, film.depth, film.labels, part + 1, *film.lens, film.tolerance[part])
    arguments = (points, normals, lit, views, film.Ts[part], frames, *pictures, colours, agreed)
    run_in_threads(lambda begin, end: _blend(begin, end, *arguments), len(points), 500)
    return colours, agreed


@njit(nogil=True, cache=True)
def _blend(
    begin, end, points, normals, lit, views, Ts, frames, rgb, depth, labels, part, fx, fy, cx, cy, tolerance, colours,
    agreed,
):  # pragma: no cover  # fmt: skip
    """Weighted means of bilinear samples of what the frames show at `points`, part frame.

    `agreed` is the share, by weight, of the frames that look there that see the part there and not what lies behind;
    0 when none sees it.
    """
    h, w = labels.shape[1:]
    sample, total = np.zeros(3), np.zeros(3)
    for k in range(begin, end):
        weight, spoke, agreeing = 0.0, 0.0, 0.0
        total[:] = 0
        for i in frames:
            good, u, v, pz, tilt = view_similarity_weight(
                Ts[i], points[k], normals[k], lit[k], views[k], fx, fy, cx, cy
            )
            if good == 0:
                continue
            x0, y0 = math.floor(u), math.floor(v)
            if x0 < 0 or y0 < 0 or x0 >= w - 1 or y0 >= h - 1:
                continue
            share, free = 0.0, 0.0
            sample[:] = 0
            slope = tolerance + 0.7 * tilt
            for row in range(y0, y0 + 2):
                for column in range(x0, x0 + 2):
                    s = (1 - abs(u - column)) * (1 - abs(v - row))
                    far, label = depth[i, row, column], labels[i, row, column]
                    if label == part and far > 0 and abs(far - pz) <= slope:
                        share += s
                        for d in range(3):
                            sample[d] += s * rgb[i, row, column, d]
                    elif label == 0 or far > pz + slope:
                        free += s
            spoke += good * (share + free)
            agreeing += good * share
            if share >= 0.1:
                weight += good * share * share
                for d in range(3):
                    total[d] += good * share * sample[d]
        if weight > 0:
            agreed[k] = agreeing / spoke
            for d in range(3):
                colours[k, d] = total[d] / weight
