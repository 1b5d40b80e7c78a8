"""Samples for the comparison of both films: pixels inside the object, and points on its outline, a few thousand a
frame.

There are three kinds of rows: depth of inner pixels, outline of the mask (which belongs to the colour picture), and
outline of the depth picture. A camera fault is, to first order, a column over these rows.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import map_coordinates

from freeart21 import se3
from freeart21.camera import Camera
from freeart21.camera_faults import CameraFaults, srgb_decode
from freeart21.recording import Frame, Recording
from freeart21.se3 import Array
from simgap.film.drawing import RenderedFrame, interpolate_pose, render
from simgap.film.scene import FilmScene

INNER_PX = 3.0
"""Distance from depth edges, pixels, of inner pixels; published cameras have flying pixels within 1 or 2."""
EDGE_SHARE = 0.03
"""Relative step of the depth at an edge; a surface at 80 degrees steps by 1 % a pixel at f = 570."""
REACH_PX = 7.0
"""Search distance of an outline along its normal."""
STEP_PX = 0.25
PAIR_PX = 4
"""Distance, pixels, of the errors compared for noise: real depth cameras smooth over neighbours."""
BAND_PX = 5.0
"""Distance from a depth edge, on the nearer surface, within which flying pixels are searched."""
MOST_INNER, MOST_EDGE, MOST_BAND = 1500, 400, 600
"""Rows of each kind per frame; more are redundant."""
AHEAD = 0.5
"""Frames over which the speed in the picture is measured."""


@dataclass(frozen=True)
class FrameRows:
    """One frame's rows."""

    frame: int
    share: float
    """Time in the film, 0 to 1."""
    fields: dict[str, NDArray[Any]]
    """As `Rows` has them."""
    pixels: int
    """Of the simulated object."""
    excess: Array
    """(m, 3) measured points, camera frame, in the mask but far before or beside the asset."""
    excess_pixels: int
    """Number of such pixels."""


class Rows:
    """Rows of all frames; `rows["error"]` is one field, frames concatenated.

    Inner pixels (n,): `error` measured less simulated depth, metres, NaN for a hole; `z` simulated depth; `at` (n, 2)
    pixels from the principal point; `slope` (n, 2) of the simulated depth, metres per pixel; `later` change of depth
    per delay of the depth picture, metres per second; `cosine` of the angle of incidence; `measured_brightness` sRGB 0
    to 1; `part` 1 or 2; `normal` (n, 3) camera frame; `pair` second difference of the error over `PAIR_PX` to both
    sides, over sqrt(6), metres, NaN without (equal to the noise for white noise, zero for smooth errors); `near` the
    same over adjacent pixels; `stops` log2 of measured over simulated linear light, NaN where too dark or bright;
    `light` log2 of the simulated light.

    Outlines (e,): `outline` (e, 2) from the principal point, pixels; `outward` (e, 2) unit normals; `mask_off` distance
    of the measured mask's outline beyond the simulated one, pixels, NaN where unknown; `depth_off` the same of the
    depth picture; `moving` outward speed of the outline with a delay, pixels per second.

    Pixels at edges (b,): `band` pixels to the depth edge; `band_z` simulated depth; `band_cosine`; `band_depth`
    measured depth, 0 for a hole; `lonely` fifth smallest depth difference, metres, to the measured 5 x 5 neighbourhood.
    """

    def __init__(self, frames: tuple[FrameRows, ...]) -> None:
        self.frames = frames
        self._joined: dict[str, NDArray[Any]] = {}

    def __getitem__(self, name: str) -> NDArray[Any]:
        if name not in self._joined:
            self._joined[name] = np.concatenate([frame.fields[name] for frame in self.frames])
        return self._joined[name]

    def of(self, name: str) -> NDArray[np.int64]:
        """(rows,) index into `frames` for the rows of the field `name`."""
        return np.repeat(np.arange(len(self.frames)), [len(frame.fields[name]) for frame in self.frames])

    def only(self, chosen: NDArray[np.int64]) -> Rows:
        """The rows of some frames, by their index here."""
        return Rows(tuple(self.frames[int(i)] for i in chosen))


@dataclass(frozen=True)
class Simulated:
    """One frame of the simulated camera."""

    colour: RenderedFrame
    depth: RenderedFrame


def simulate_frame(scene: FilmScene, camera: Camera, faults: CameraFaults, frame: float, fps: float) -> Simulated:
    """Both pictures at a moment, with the geometry and timing of `faults` alone."""
    actual_camera = faults.actual_camera(camera)
    Ts = interpolate_pose(scene.placed.Ts[0], frame), interpolate_pose(scene.placed.Ts[1], frame)
    colour = render(scene, actual_camera, Ts)
    if not (faults.depth_shift_u or faults.depth_shift_v or faults.depth_turn or faults.depth_delay):
        return Simulated(colour, colour)
    K = np.array(actual_camera.K)
    K[:2, 2] += faults.depth_shift_u, faults.depth_shift_v
    roll = se3.pose(se3.exp_so3(np.array([0.0, 0.0, faults.depth_turn])), np.zeros(3))
    then = frame - faults.depth_delay * fps
    Ts = roll @ interpolate_pose(scene.placed.Ts[0], then), roll @ interpolate_pose(scene.placed.Ts[1], then)
    return Simulated(colour, render(scene, Camera(K, camera.width, camera.height), Ts))


def sample_rows(
    recording: Recording,
    scene: FilmScene,
    frames: Sequence[int] | NDArray[np.int64],
    faults: CameraFaults | None = None,
    report: Callable[[], None] = lambda: None,
) -> Rows:
    """The rows of `frames`, about the simulated camera with the geometry and timing of `faults`."""
    faults = faults or CameraFaults()
    fps = 1 / float(np.median(np.diff(recording.times_s)))
    rows = []
    for i in frames:
        rows.append(_frame_rows(recording, scene, int(i), faults, fps))
        report()
    return Rows(tuple(rows))


def _frame_rows(recording: Recording, scene: FilmScene, i: int, faults: CameraFaults, fps: float) -> FrameRows:
    camera, frame = recording.camera, recording.frame(i)
    now, before = (simulate_frame(scene, camera, faults, t, fps) for t in (i, i - AHEAD))
    rng = np.random.default_rng([i, 41])
    principal = faults.actual_camera(camera).K[:2, 2]
    rows = _sample_outlines(now, before, frame, principal, fps, rng)
    rows |= _sample_inner(now, before, frame, principal, fps, rng) | _sample_edges(now.depth, frame, rng)
    pixels = int((now.colour.part > 0).sum())
    return FrameRows(i, i / max(len(recording) - 1, 1), rows, pixels, *_find_excess(now, frame, camera, rng))


def depth_edges(depth: NDArray[Any]) -> tuple[NDArray[np.bool_], NDArray[Any]]:
    """Pixels on the nearer surface at a depth edge, and the distance of all pixels to any edge, px."""
    filled = np.where(depth > 0, depth, 1e3).astype(np.float32)
    kernel = np.ones((3, 3), np.uint8)
    nearer = (depth > 0) & (cv2.dilate(filled, kernel) > (1 + EDGE_SHARE) * filled)
    either = nearer | ((depth > 0) & (cv2.erode(filled, kernel) < (1 - EDGE_SHARE) * filled)) | (depth <= 0)
    return nearer, cv2.distanceTransform((~either).astype(np.uint8), cv2.DIST_L2, 3)


def _draw_pixels(mask: NDArray[np.bool_], most: int, rng: np.random.Generator) -> NDArray[np.int64]:
    flat = np.flatnonzero(mask)
    return np.sort(rng.choice(flat, most, replace=False)) if len(flat) > most else flat


def _sample_inner(
    now: Simulated, before: Simulated, frame: Frame, principal: Array, fps: float, rng: np.random.Generator
) -> dict[str, NDArray[Any]]:
    z = now.depth.depth.astype(float)
    inside = cv2.distanceTransform(frame.mask.astype(np.uint8), cv2.DIST_L2, 3) > INNER_PX
    ok = (depth_edges(z)[1] >= INNER_PX) & inside
    error = np.where(frame.depth > 0, frame.depth - z, np.nan)
    pair = np.full(z.shape, np.nan)
    near = np.full(z.shape, np.nan)
    for out, far in ((pair, PAIR_PX), (near, 1)):
        bent = error[:, 2 * far :] - 2 * error[:, far:-far] + error[:, : -2 * far]
        inside_all = ok[:, 2 * far :] & ok[:, far:-far] & ok[:, : -2 * far]
        out[:, far:-far] = np.where(inside_all, bent / np.sqrt(6), np.nan)
    slope_v, slope_u = np.gradient(z)
    same = before.depth.part == now.depth.part
    later = np.where(same, before.depth.depth - z, 0.0) * fps / AHEAD
    later[np.abs(later) > EDGE_SHARE * z * fps / AHEAD] = 0.0
    k = _draw_pixels(ok, MOST_INNER, rng)
    v, u = np.divmod(k, z.shape[1])
    at = np.stack([u + 0.5, v + 0.5], -1) - principal
    light = srgb_decode(np.asarray(now.colour.rgb[..., 1].flat[k]) / 255)  # one channel: tone curves act on each
    seen = srgb_decode(np.asarray(frame.rgb[..., 1].flat[k]) / 255)
    usable = (now.colour.part.flat[k] > 0) & (light > 0.004) & (seen > 0.004) & (frame.rgb.max(-1).flat[k] < 250)
    with np.errstate(divide="ignore", invalid="ignore"):
        stops = np.where(usable, np.log2(seen / light), np.nan)
    return {
        "error": error.flat[k],
        "z": z.flat[k],
        "at": at,
        "slope": np.stack([slope_u.flat[k], slope_v.flat[k]], -1),
        "later": later.flat[k],
        "cosine": now.depth.cosine.flat[k].astype(float),
        "measured_brightness": np.asarray(frame.rgb.mean(-1).flat[k]) / 255,
        "part": now.depth.part.flat[k].astype(int),
        "normal": now.depth.normals.reshape(-1, 3)[k].astype(float),
        "pair": pair.flat[k],
        "near": near.flat[k],
        "stops": stops,
        "light": np.log2(np.maximum(light, 1e-6)),
    }


def _sample_outlines(
    now: Simulated, before: Simulated, frame: Frame, principal: Array, fps: float, rng: np.random.Generator
) -> dict[str, NDArray[Any]]:
    """Points on the simulated outline of the whole object, and distances of both measured outlines along their
    normals."""
    found: list[dict[str, NDArray[Any]]] = []
    for picture in (now.colour, now.depth)[: 1 if now.depth is now.colour else 2]:
        on = picture.part > 0
        soft = cv2.GaussianBlur(on.astype(np.float32), (0, 0), 1.5)
        rim = on & (cv2.erode(on.astype(np.uint8), np.ones((3, 3), np.uint8)) == 0)
        rim[:8], rim[-8:], rim[:, :8], rim[:, -8:] = False, False, False, False
        k = _draw_pixels(rim, MOST_EDGE, rng)
        v, u = np.divmod(k, on.shape[1])
        gv, gu = np.gradient(soft)
        n = -np.stack([gu.flat[k], gv.flat[k]], -1)
        n /= np.maximum(np.linalg.norm(n, axis=1, keepdims=True), 1e-9)
        crossing, none = _find_crossing(on, u, v, n), np.full(len(k), np.nan)
        rows = {"outline": np.stack([u + 0.5, v + 0.5], -1) - principal, "outward": n, "mask_off": none}
        earlier = before.colour if picture is now.colour else before.depth
        moving = np.nan_to_num(_find_crossing(earlier.part > 0, u, v, n) - crossing) * fps / AHEAD
        rows |= {"depth_off": none, "moving": moving}
        if picture is now.colour:
            rows["mask_off"] = _find_crossing(frame.mask, u, v, n) - crossing
        if picture is now.depth:
            near = (frame.depth > 0) & (np.abs(frame.depth - _extend_depth(picture.depth)) < 0.08 * frame.depth)
            rows["depth_off"] = _find_crossing(near, u, v, n) - crossing
        found.append(rows)
    return {name: np.concatenate([rows[name] for rows in found]) for name in found[0]}


def _extend_depth(depth: NDArray[Any]) -> NDArray[Any]:
    """The depth picture with empty pixels near the object filled by the depth there (15-pixel window)."""
    filled = np.where(depth > 0, depth, 0).astype(np.float32)
    return np.where(depth > 0, depth, cv2.dilate(filled, np.ones((15, 15), np.uint8)))


def _find_crossing(on: NDArray[np.bool_], u: NDArray[Any], v: NDArray[Any], n: Array) -> Array:
    """(k,) position along the normal where `on` ends, by the best split; NaN where there is none."""
    steps = np.arange(-REACH_PX, REACH_PX + STEP_PX / 2, STEP_PX)
    columns, rows = u[:, None] + n[:, :1] * steps, v[:, None] + n[:, 1:] * steps
    values = map_coordinates(on.astype(np.float32), [rows, columns], order=1, mode="nearest")
    score = np.cumsum(values - 0.5, axis=1)
    best = score.argmax(1)
    inside, outside = values[:, : len(steps) // 4].mean(1), values[:, -len(steps) // 4 :].mean(1)
    usable = (best > 0) & (best < len(steps) - 1) & (inside > 0.5) & (outside < 0.5)
    k = np.clip(best, 0, len(steps) - 2)
    a, b = np.take_along_axis(values, k[:, None], 1)[:, 0], np.take_along_axis(values, k[:, None] + 1, 1)[:, 0]
    part = np.clip((a - 0.5) / np.maximum(a - b, 1e-6), 0, 1)
    return np.where(usable, steps[k] + STEP_PX * part, np.nan)


def _sample_edges(depth: RenderedFrame, frame: Frame, rng: np.random.Generator) -> dict[str, NDArray[Any]]:
    """Pixels near a depth edge: distance to it, simulated depth and angle, measured depth, isolation."""
    z = depth.depth
    distance = cv2.distanceTransform((~depth_edges(z)[0]).astype(np.uint8), cv2.DIST_L2, 3) + 1.0
    k = _draw_pixels((z > 0) & (distance <= BAND_PX) & frame.mask, MOST_BAND, rng)
    v, u = np.divmod(k, z.shape[1])
    padded = np.pad(frame.depth, 2)
    d = frame.depth.flat[k]
    off = np.abs([padded[v + dv, u + du] - d for dv in range(5) for du in range(5)])
    lonely = np.partition(off, 5, axis=0)[5]  # includes the pixel itself
    of = {"band": distance, "band_z": z, "band_cosine": depth.cosine}
    return {name: values.flat[k].astype(float) for name, values in of.items()} | {"band_depth": d, "lonely": lonely}


def _find_excess(now: Simulated, frame: Frame, camera: Camera, rng: np.random.Generator) -> tuple[Array, int]:
    """Measured points of the object beyond the asset: outside its outline, or well before it."""
    on = now.colour.part > 0
    away = cv2.distanceTransform((~on).astype(np.uint8), cv2.DIST_L2, 3)
    inside = cv2.distanceTransform(frame.mask.astype(np.uint8), cv2.DIST_L2, 3) > 1.5
    size = np.sqrt(max(int(on.sum()), 1))
    outside = inside & (away > max(4.0, 0.04 * size))
    z = now.depth.depth
    before = inside & on & (z > 0) & (frame.depth > 0) & (frame.depth < z * (1 - 0.02) - 0.004)
    before = cv2.morphologyEx(before.astype(np.uint8), cv2.MORPH_OPEN, np.ones((3, 3), np.uint8)) > 0
    both = (outside | before) & (frame.depth > 0)
    k = _draw_pixels(both, 400, rng)
    rays = camera.rays().reshape(-1, 3)[k]
    return rays * frame.depth.flat[k][:, None], int(both.sum())
