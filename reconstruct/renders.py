"""Held-out views, from the Gaussians (`gaussians.views`) or from the fused meshes.

Colours on meshes come from the frames that saw each place most similarly (`lumigraph`).
"""

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
from freeart21.se3 import Array, Floats, Ints
from freeart21.z_buffer import draw_triangles
from reconstruct.gaussians.views import render_views
from reconstruct.kernels import run_in_threads
from reconstruct.lumigraph import choose_frames, object_box, query_poses, view_similarity_weight
from reconstruct.settings import RendersFrom
from reconstruct.surfaces import vertex_normals

Image = NDArray[np.uint8]

FRAMES, PIXELS = 150, 40_000_000
"""Frames used, evenly spaced, and the limit of their pixels together."""
SIMILAR, EVENLY = 24, 24
"""Of these, the frames for one part of one view: those with the most similar orientation, and evenly spaced ones."""
RIM = 1.5
"""Pixels round the meshes that may still be object: marching cubes rounds off edges, and poses are not exact."""
BELIEVED = 0.5
"""Share by weight of the frames that look at such a pixel that must see the part there."""


def render_queries(
    result: Reconstruction, recording: Recording, source: RendersFrom = "gaussians and video"
) -> tuple[list[Image], list[Image]]:
    """One image (height, width, 3) per query of the recording, white where there is nothing; two lists of them.

    A query poses the reference part. Since two similar parts are indistinguishable, the first list takes this result's
    reference part for it, the second its moving part. Without Gaussians, views come from the video, whatever the
    `source`.
    """
    if not recording.queries:
        return [], []
    if source != "video" and result.appearance is not None and len(result.appearance):
        return render_views(result, recording, with_video=source == "gaussians and video")
    video = _VideoFrames.of(result, recording)
    first, second = (
        [_render_view(result, video, recording.camera, query, by_moving_part) for query in recording.queries]
        for by_moving_part in (False, True)
    )
    return first, second


def render(camera: Camera, meshes: list[Mesh]) -> Image:
    """(height, width, 3) image of camera-frame meshes with their vertex colours, nearest first, white elsewhere."""
    colours = _trace_meshes(camera, meshes).colours
    return np.clip(np.rint(colours), 0, 255).astype(np.uint8)


# --- where the meshes are ---------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class _MeshHits:
    """First hits of the rays through the pixels' centres, camera frame, metres."""

    mesh: NDArray[np.int8]
    """(h, w) number of the mesh, -1 for none."""
    points: Array
    """(h, w, 3)."""
    normals: Array
    """(h, w, 3), unit length."""
    colours: Array
    """(h, w, 3) interpolated vertex colours; 255 without a hit or where the mesh has none."""


def _trace_meshes(camera: Camera, meshes: list[Mesh]) -> _MeshHits:
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
    return _MeshHits(which, points, normals, colours)


def _extend_rim(hits: _MeshHits, camera: Camera) -> tuple[_MeshHits, NDArray[np.bool_]]:
    """The same, extended by RIM pixels beyond the meshes on the planes of the nearest hits; and which pixels those
    are."""
    drawn = hits.mesh >= 0
    if not drawn.any():
        return hits, drawn
    distance, (rows, columns) = distance_transform_edt(~drawn, return_indices=True)
    rim = (distance > 0) & (distance <= RIM)
    beside = rows[rim], columns[rim]
    rays, points, normals = camera.rays()[rim], hits.points[beside], hits.normals[beside]
    across = (rays * normals).sum(1)
    depth = (points * normals).sum(1) / np.where(np.abs(across) < 1e-3, np.inf, across)
    far = np.abs(depth - points[:, 2]) > 2 * RIM / camera.K[0, 0] * points[:, 2]
    depth = np.where(far, points[:, 2], depth)
    wider = _MeshHits(hits.mesh.copy(), hits.points.copy(), hits.normals.copy(), hits.colours)
    wider.mesh[rim], wider.normals[rim] = hits.mesh[beside], normals
    wider.points[rim] = rays * depth[:, None]
    return wider, rim


# --- what the video shows there ---------------------------------------------------------------------------------------


@dataclass(frozen=True)
class _VideoFrames:
    """Frames of the video, cropped to the object's box over all frames."""

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
    def of(cls, result: Reconstruction, recording: Recording) -> _VideoFrames:
        box = object_box(result)
        h, w = (side.stop - side.start for side in box)
        most = int(np.clip(PIXELS // (h * w), 1, min(FRAMES, len(recording))))
        frames = np.linspace(0, len(recording) - 1, most).round().astype(int)
        rgb, depth = np.zeros((most, h, w, 3), np.uint8), np.zeros((most, h, w), np.float32)
        labels = result.part_masks[(frames, *box)]

        def load(begin: int, end: int) -> None:
            for k in range(begin, end):
                frame = recording.frame(int(frames[k]))
                mask = frame.mask[box]
                rgb[k], depth[k] = frame.rgb[box], np.where(mask, frame.depth[box], 0)
                # exactly the recorded mask: the part masks differ from it by a pixel or so
                dilated = cv2.dilate(labels[k], np.ones((3, 3)))
                labels[k] = np.where(mask, np.where(labels[k] > 0, labels[k], dilated), 0)

        run_in_threads(load, most, 8)
        K = recording.camera.K
        Ts = result.Ts_camera_reference[frames], result.Ts_camera_moving[frames]
        lens = (K[0, 0], K[1, 1], K[0, 2] - box[1].start - 0.5, K[1, 2] - box[0].start - 0.5)
        video = cls(rgb, depth, labels, Ts, result.seen[frames], lens, (0.0, 0.0))
        tolerance = tuple(_depth_tolerance(video, k, result.articulation.part(name)) for k, name in enumerate(PARTS))
        return cls(rgb, depth, labels, Ts, result.seen[frames], lens, (tolerance[0], tolerance[1]))


def _depth_tolerance(video: _VideoFrames, part: int, mesh: Mesh) -> float:
    """Metres by which poses, fusion and sensor displace the mesh from its pixels' depth, with a margin."""
    fx, fy, cx, cy = video.lens
    h, w = video.depth.shape[1:]
    gaps, footprints = [np.zeros(0)], [np.zeros(0)]
    normals = vertex_normals(mesh.vertices, mesh.faces)
    some = slice(None, None, max(1, len(mesh.vertices) // 2000))
    for i in np.flatnonzero(video.seen[:, part])[:: max(1, len(video.rgb) // 10)]:
        T = video.Ts[part][i]
        p, n = se3.transform(T, mesh.vertices[some]), normals[some] @ T[:3, :3].T
        p = p[(p[:, 2] > 0) & ((n * p).sum(1) < -0.5 * np.linalg.norm(p, axis=1))]
        x, y = np.rint(fx * p[:, 0] / p[:, 2] + cx).astype(int), np.rint(fy * p[:, 1] / p[:, 2] + cy).astype(int)
        inside = (x >= 0) & (y >= 0) & (x < w) & (y < h)
        x, y, z = x[inside], y[inside], p[inside, 2]
        on = (video.labels[i, y, x] == part + 1) & (video.depth[i, y, x] > 0)
        gaps.append(np.abs(video.depth[i, y, x] - z)[on])
        footprints.append(z[on] / fx)
    if not len(np.concatenate(gaps)):
        return 0.0
    return float(2 * np.median(np.concatenate(footprints)) + 4 * np.median(np.concatenate(gaps)))


def _render_view(
    result: Reconstruction, video: _VideoFrames, camera: Camera, query: Query, by_moving_part: bool
) -> Image:
    poses = query_poses(result, query, by_moving_part)
    meshes = [result.articulation.part(name).moved(P) for name, P in zip(PARTS, poses, strict=True)]
    hits, rim = _extend_rim(_trace_meshes(camera, meshes), camera)
    picture = np.where(rim[..., None], 255, hits.colours)
    back = se3.inverse(query.T_newcam_cam)
    for k, pose in enumerate(poses):
        on = hits.mesh == k
        if not on.any():
            continue
        inverse = se3.inverse(pose)
        points = se3.transform(inverse, hits.points[on])
        normals, views = hits.normals[on] @ pose[:3, :3], inverse[:3, 3] - points
        views /= np.linalg.norm(views, axis=1, keepdims=True)
        frames = choose_frames(video.Ts[k], video.seen[:, k], back @ pose, SIMILAR, EVENLY)
        lit = hits.normals[on] @ back[:3, :3].T  # in the recording camera's frame
        colours, agreed = _blend_frames(video, k, frames, points, normals, lit, views)
        here = picture[on]
        believed = agreed > np.where(rim[on], BELIEVED, 0)
        here[believed] = colours[believed]
        picture[on] = here
    return np.clip(np.rint(picture), 0, 255).astype(np.uint8)


def _blend_frames(
    video: _VideoFrames, part: int, frames: NDArray[np.int64], points: Array, normals: Array, lit: Array, views: Array
) -> tuple[Array, Array]:
    """Colours (n, 3) of points (n, 3) of a part, and the share by weight of the frames that confirm it there, 0 to 1
    (n,).

    Points, normals and directions to the new camera are in the part's frame; `lit` are the normals in the recording
    camera's frame, in which the lamps stand.
    """
    colours, agreed = np.zeros((len(points), 3)), np.zeros(len(points))
    pictures = (video.rgb, video.depth, video.labels, part + 1, *video.lens, video.tolerance[part])
    arguments = (points, normals, lit, views, video.Ts[part], frames, *pictures, colours, agreed)
    run_in_threads(lambda begin, end: _blend(begin, end, *arguments), len(points), 500)
    return colours, agreed


@njit(nogil=True, cache=True)
def _blend(
    begin: int, end: int, points: Array, normals: Array, lit: Array, views: Array, Ts: Array, frames: Ints,
    rgb: NDArray[np.uint8], depth: Floats, labels: NDArray[np.uint8], part: int, fx: float, fy: float, cx: float,
    cy: float, tolerance: float, colours: Array, agreed: Array,
) -> None:  # pragma: no cover  # fmt: skip
    """Weighted means of bilinear samples of the frames at `points`, part frame.

    `agreed` is the share, by weight, of the frames looking there that see the part and not what lies behind; 0 if none
    sees it.
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
