"""Held-out views: the Gaussians' rendering plus what the video shows beyond them.

The addition is a weighted mean of residuals (video minus rendering of its frame) from the frames that saw each place
most similarly, an unstructured lumigraph (Buehler et al. 2001) of residuals: shadows, highlights, and texture finer
than a Gaussian. Where no frame saw a place, nothing is added.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import cv2
import numpy as np
from numba import njit
from numpy.typing import NDArray

from freeart21 import se3
from freeart21.camera import Camera
from freeart21.gaussians import Gaussians
from freeart21.reconstruction import Reconstruction
from freeart21.recording import Query, Recording
from freeart21.se3 import Array, Floats, Ints
from reconstruct.gaussians.losses import COVERED
from reconstruct.gaussians.model import make_splats
from reconstruct.gaussians.numba_backend import rasterise
from reconstruct.gaussians.rasteriser import Lens, Picture
from reconstruct.kernels import run_in_threads
from reconstruct.lumigraph import choose_frames, object_box, query_poses, view_similarity_weight

Image = NDArray[np.uint8]

FRAMES, PIXELS = 300, 20_000_000
"""Frames, evenly spaced, whose residuals are used, and the limit of their pixels together."""
SIMILAR, EVENLY = 48, 24
"""Of these, the frames for one part of one view: those with the most similar orientation, and evenly spaced ones."""
REACH = 0.2
"""Standard deviation, pixels, of the spatial weight of a frame's pixels. Half a pixel, or bilinear weights alone,
blurs: 0.2 dB less on two objects."""
RIM = 0.05
"""Opacity above which a pixel next to a covered one shows the object: without anti-aliasing, a pixel that the object
touches has its colour. With 0.5 the rim was missing: 1 to 2 dB less."""
TOLERANCE = 3.0
"""Footprints by which a frame's depth may differ from the view's."""


def render_views(result: Reconstruction, recording: Recording, with_video: bool) -> tuple[list[Image], list[Image]]:
    """Images (height, width, 3), white where there is nothing, one per query: posed by the reference part, and by the
    moving one.

    `with_video` adds what the frames show beyond the Gaussians.
    """
    assert result.appearance is not None
    video = _VideoFrames.of(result, recording) if with_video else None
    first, second = (
        [
            _render_view(result.appearance, query_poses(result, q, by_moving_part), video, recording.camera, q)
            for q in recording.queries
        ]
        for by_moving_part in (False, True)
    )
    return first, second


def _lens(camera: Camera) -> Lens:
    K = camera.K
    return Lens(K[0, 0], K[1, 1], K[0, 2], K[1, 2], camera.width, camera.height)


def _render_colours(gaussians: Gaussians, Ts: Array, lens: Lens, lit: Array) -> tuple[Picture, Floats]:
    """The rendered image, and its colours (h, w, 3) from 0 to 255, opacity divided out."""
    picture, _ = rasterise(make_splats(gaussians, Ts, lit)[0], Ts, lens)
    over = 255 / np.maximum(picture.alpha, 1e-3)[..., None]
    return picture, np.clip(picture.colour * over, 0, 255).astype(np.float32)


def _alpha_depth(picture: Picture) -> Floats:
    return np.where(picture.alpha > RIM, picture.depth / np.maximum(picture.alpha, RIM), 0).astype(np.float32)


@dataclass(frozen=True)
class _VideoFrames:
    """Residuals of video frames against the Gaussians, cropped to the object's box over all frames."""

    residuals: Floats
    """(n, h, w, 3) grey levels."""
    depth: Floats
    """(n, h, w) metres, of the Gaussians; 0 off them or off the object."""
    part: Image
    """(n, h, w) 1 where the reference part shows, 2 where the moving part does."""
    Ts: Array
    """(2, n, 4, 4) camera from canonical of both parts."""
    seen: NDArray[np.bool_]
    """(n, 2)."""
    lens: Lens

    @classmethod
    def of(cls, result: Reconstruction, recording: Recording) -> _VideoFrames:
        box = object_box(result)
        h, w = (side.stop - side.start for side in box)
        whole = _lens(recording.camera)
        lens = replace(whole, cx=whole.cx - box[1].start, cy=whole.cy - box[0].start, width=w, height=h)
        most = int(np.clip(PIXELS // (h * w), 1, min(FRAMES, len(recording))))
        frames = np.linspace(0, len(recording) - 1, most).round().astype(int)
        Ts = np.stack([result.Ts_camera_reference[frames], result.Ts_camera_moving[frames]])
        residuals, depth = np.zeros((most, h, w, 3), np.float32), np.zeros((most, h, w), np.float32)
        part = np.zeros((most, h, w), np.uint8)
        assert result.appearance is not None
        for k, i in enumerate(frames):
            frame = recording.frame(int(i))
            picture, colours = _render_colours(result.appearance, Ts[:, k], lens, Ts[:, k])
            on = frame.mask[box] & (picture.alpha > COVERED)
            residuals[k] = np.where(on[..., None], frame.rgb[box] - colours, 0)
            depth[k] = np.where(on, _alpha_depth(picture), 0)
            part[k] = np.where(on, 1 + (picture.moving > 0.5 * picture.alpha), 0)
        return cls(residuals, depth, part, Ts, result.seen[frames], lens)


def _render_view(
    gaussians: Gaussians, poses: tuple[Array, Array], video: _VideoFrames | None, camera: Camera, query: Query
) -> Image:
    Ts, back = np.stack(poses), se3.inverse(query.T_newcam_cam)
    lens = _lens(camera)
    picture, colours = _render_colours(gaussians, Ts, lens, back @ Ts)
    covered = (picture.alpha > COVERED).astype(np.uint8)
    shown = (picture.alpha > RIM) & (cv2.dilate(covered, np.ones((3, 3))) > 0)
    image = np.where(shown[..., None], colours, 255)
    if video is not None:
        normals = _normals(gaussians, Ts, lens)
        points = camera.rays() * _alpha_depth(picture)[..., None]
        for part in range(2):
            on = shown & ((picture.moving > 0.5 * picture.alpha) == bool(part))
            if on.any():
                image[on] += _residuals(video, part, Ts[part], back, points[on], normals[on])
    return np.clip(np.rint(image), 0, 255).astype(np.uint8)


def _normals(gaussians: Gaussians, Ts: Array, lens: Lens) -> Array:
    """(h, w, 3) unit normals in the camera's frame, rendered like colours."""
    unlit = replace(gaussians, colours=gaussians.normals, light=None)
    splats, _ = make_splats(unlit, Ts)
    R = np.ascontiguousarray(Ts[splats.motion][:, :3, :3], np.float32)
    turned = np.einsum("nij,nj->ni", R, splats.colours).astype(np.float32)
    total = rasterise(replace(splats, colours=turned), Ts, lens)[0].colour.astype(float)
    return np.asarray(total / np.maximum(np.linalg.norm(total, axis=2, keepdims=True), 1e-9), float)


def _residuals(video: _VideoFrames, part: int, T: Array, back: Array, points: Array, normals: Array) -> Array:
    """(n, 3) grey levels that the video shows beyond the Gaussians at a part's points (n, 3), camera frame of a view.

    T (4, 4) is the part's pose there, `back` takes the view's camera to the recording one.
    """
    inverse = se3.inverse(T)
    own = se3.transform(inverse, points)
    views = inverse[:3, 3] - own
    views /= np.linalg.norm(views, axis=1, keepdims=True)
    tolerance = TOLERANCE * float(np.median(points[:, 2])) / video.lens.fx
    found = np.zeros((len(points), 3))
    frames = choose_frames(video.Ts[part], video.seen[:, part], back @ T, SIMILAR, EVENLY)
    lens = (video.lens.fx, video.lens.fy, video.lens.cx - 0.5, video.lens.cy - 0.5)
    pictures = (video.Ts[part], frames, video.residuals, video.depth, video.part, part + 1)
    arguments = (own, normals @ T[:3, :3], normals @ back[:3, :3].T, views, *pictures, *lens, tolerance, found)
    run_in_threads(lambda a, b: _blend(a, b, *arguments), len(points), 200)
    return found


@njit(nogil=True, cache=True)
def _blend(
    begin: int, end: int, points: Array, normals: Array, lit: Array, views: Array, Ts: Array, frames: Ints,
    residuals: Floats, depth: Floats, parts: NDArray[np.uint8], part: int, fx: float, fy: float, cx: float, cy: float,
    tolerance: float, found: Array,
) -> None:  # pragma: no cover  # fmt: skip
    """Weighted means of the residuals of the pixels nearest to `points`, part frame.

    Normals and directions to the new camera are in the part's frame, too; `lit` are the normals in the recording
    camera's frame, in which the lamps stand.
    """
    h, w = parts.shape[1:]
    total = np.zeros(3)
    for k in range(begin, end):
        total[:] = 0
        weight = 0.0
        for i in frames:
            good, u, v, pz, tilt = view_similarity_weight(
                Ts[i], points[k], normals[k], lit[k], views[k], fx, fy, cx, cy
            )
            if good == 0:
                continue
            x0, y0 = math.floor(u), math.floor(v)
            if x0 < 0 or y0 < 0 or x0 >= w - 1 or y0 >= h - 1:
                continue
            slope = tolerance + 0.7 * tilt
            for row in range(y0, y0 + 2):
                for column in range(x0, x0 + 2):
                    if parts[i, row, column] != part or abs(depth[i, row, column] - pz) > slope:
                        continue
                    s = good * math.exp(-((u - column) ** 2 + (v - row) ** 2) / (2 * REACH * REACH))
                    weight += s
                    for d in range(3):
                        total[d] += s * residuals[i, row, column, d]
        if weight > 0:
            for d in range(3):
                found[k, d] = total[d] / weight
