"""The solver's input: cropped frames with points, normals, colour features and distances to the mask."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import cv2
import numpy as np
from numba import njit
from numpy.typing import NDArray

from freeart21.recording import Frame, Recording
from freeart21.se3 import Array, Bools, Floats
from reconstruct.kernels import FEATURE, NORMAL, OUTSIDE, POINT, run_in_threads
from reconstruct.settings import SceneSettings

CROP_MARGIN = 12
"""Pixels kept round the object's box."""
PLANE_RADIUS = 2
"""Half window, pixels, of the local plane fit; one or two more for noisy depth."""
DEPTH_JUMP = 4.0
"""Footprints: a larger depth step separates two surfaces."""
MIN_PIXELS = 60
"""Foreground pixels with depth that a frame needs to count."""
LIGHTNESS = 0.3
"""Weight of lightness in the colour features: shading changes it."""
MAX_DISTANCE_WIDTHS = 5.0
"""Depths farther than this from the object's are dropped, in object widths (the mask box's diagonal at the object's
depth, median over frames): a sensor's value for "nothing", or a wall seen past the outline. Measured on 16 recordings
of 13 objects, clean and tof: at most 1.7 from the frame's median; depth of 65535 units read as metres: 377."""
LAGS = (2, 3, 4, 6, 8, 12)
"""Distances, pixels, over which errors of the depth are compared. At the first one white noise shows whole: linear
interpolation between pixels lowers it at one pixel."""
LEAST_TEXTURE = 1.0
"""Grey levels a pixel, see `_has_texture`. A box of plain sides that turns by 22 degrees a frame has noise without it.
Of six phone recordings four give the same noise within a seventh for 0, 1 and 2, two up to 4.6 times as much."""
FLOW_ERROR, WHITE_ERROR = 0.45, 1.1
"""What is no correlated noise: standard deviations up to so many footprints, by errors of the flow on slanted surfaces,
and by so much larger than white noise. Fourteen recordings: clean 0.06 to 0.35 footprints, tof and noise2 1.0 to 1.17
times as large at 12 pixels as at 2; the sensor `phone` 0.9 to 3.6 footprints, 5 to 13 times."""
GENTLE_SLOPE, SLOPE_BLUR = 1.0, 4.0
"""Footprints of depth a pixel up to which errors of the flow count little, and pixels over which the depth is blurred
for it, as white noise looks like slopes. A clean cabinet whose flow errs by 1.6 pixels has 0.12 footprints on gentle
slopes and 0.76 on all; eight phone recordings 0.55 to 1.6 on gentle slopes."""
MAX_MEDIAN_RATIO = 3.0
"""Largest ratio between a frame's median depth and that of all frames. In the same recordings: 0.76 to 1.17."""


class UnsolvableError(Exception):
    """The input cannot be solved; the message says why. Becomes the `Failure` of the running stage."""


@dataclass(frozen=True)
class Scene:
    """A recording cropped to its object: n frames of h x w pixels. Metres, camera frame.

    The crop pixel (column x, row y) of frame i looks along ((x - cx[i]) / fx, (y - cy[i]) / fy, 1).
    """

    rgb: NDArray[np.uint8]
    """(n, h, w, 3); black beyond the margin round the mask's box."""
    mask: NDArray[np.bool_]
    """(n, h, w) foreground."""
    pixels: Floats
    """(n, h, w, 10) one record per pixel, contiguous for registration: point, normal, feature, distance to the mask.
    See the properties below."""
    edge: NDArray[np.bool_]
    """(n, h, w) next to a depth step: not used for registration."""
    fx: float
    fy: float
    cx: NDArray[np.float64]
    """(n,) principal point's column in each crop."""
    cy: NDArray[np.float64]
    """(n,) principal point's row in each crop."""
    origin: NDArray[np.int64]
    """(n, 2) column and row of the crop's corner in the full image."""
    factor: int
    """Full pixels per crop pixel, each way."""
    footprint: float
    """Metres that a pixel covers at the object: the unit of all thresholds."""
    noise: float
    """Standard deviation of the points along z after the plane fit, metres."""
    correlation_area: float
    """Pixels over which errors of the points are one error: so many count as one independent pixel."""
    diagonal: float
    """Estimated size of the object, metres."""
    implausible: float = 0.0
    """Share, 0 to 1, of the object's depths that were dropped as implausible."""

    def __len__(self) -> int:
        return len(self.mask)

    @property
    def lens(self) -> tuple[float, float, NDArray[np.float64], NDArray[np.float64]]:
        """fx, fy, cx (n,), cy (n,)."""
        return self.fx, self.fy, self.cx, self.cy

    @property
    def points(self) -> Floats:
        """(n, h, w, 3) plane-fitted points of the object; z is 0 where there is none.

        Off the mask, z is minus the depth measured there: of a hand that may hide the object, or of the background.
        """
        return self.pixels[..., POINT : POINT + 3]

    @property
    def normals(self) -> Floats:
        """(n, h, w, 3) unit normals towards the camera; 0 where there is none."""
        return self.pixels[..., NORMAL : NORMAL + 3]

    @property
    def features(self) -> Floats:
        """(n, h, w, 3) smoothed CIELAB with damped lightness."""
        return self.pixels[..., FEATURE : FEATURE + 3]

    @property
    def outside(self) -> Floats:
        """(n, h, w) distance to the mask, pixels; 0 inside."""
        return self.pixels[..., OUTSIDE]

    @cached_property
    def valid(self) -> NDArray[np.bool_]:
        """(n, h, w) pixels with a point."""
        return self.points[..., 2] > 0


def prepare_scene(recording: Recording, settings: SceneSettings) -> Scene:
    """Load and crop all frames, fit local planes and compute features.

    Raises UnsolvableError when there are too few frames or the masks are empty.
    """
    n = len(recording)
    if n < settings.min_frames:
        raise UnsolvableError(f"{n} frames, at least {settings.min_frames} are needed")
    camera, K = recording.camera, recording.camera.K
    crops = [_crop_frame(recording.frame(i)) for i in range(n)]
    implausible = _drop_implausible_depths(crops, float(K[0, 0]))
    counts = np.array([int((crop.depth > 0).sum()) for crop in crops])
    has_surroundings = any(crop.has_surroundings for crop in crops)
    if (counts >= MIN_PIXELS).sum() < settings.min_frames:
        raise UnsolvableError(
            f"the foreground masks hold {MIN_PIXELS} or more pixels with depth in only "
            f"{int((counts >= MIN_PIXELS).sum())} frames, at least {settings.min_frames} are needed"
            + (f"; {100 * implausible:.2g} % of the depths are implausibly far from the object" if implausible else "")
        )
    boxes = _fill_missing_boxes([crop.box for crop in crops])
    origin, size = _crop_windows(boxes, camera.width, camera.height)
    factor = max(1, math.ceil(math.sqrt(size[0] * size[1] / settings.max_crop_pixels)))
    offset = factor // 2

    def windows(images: list[NDArray[Any]]) -> Iterator[NDArray[Any]]:
        """The window of each frame, zero outside its crop, cut to a multiple of `factor`."""
        for image, crop, (x, y) in zip(images, crops, origin, strict=True):
            window = np.zeros((size[1], size[0], *image.shape[2:]), image.dtype)
            top, left = crop.corner[1] - y, crop.corner[0] - x
            window[top : top + image.shape[0], left : left + image.shape[1]] = image
            yield window[: size[1] // factor * factor, : size[0] // factor * factor]

    sampled = np.s_[offset::factor, offset::factor]
    blur = (factor | 1, factor | 1)  # odd: centred on the sampled pixel
    rgb = np.asarray(np.stack([cv2.blur(a, blur)[sampled] for a in windows([c.rgb for c in crops])]), np.uint8)
    mask = np.stack([a[sampled] for a in windows([c.mask for c in crops])])
    depth = np.stack([a[sampled] for a in windows([c.depth for c in crops])])
    crops.clear()
    fx, fy = K[0, 0] / factor, K[1, 1] / factor
    cx = (K[0, 2] - origin[:, 0] - offset - 0.5) / factor
    cy = (K[1, 2] - origin[:, 1] - offset - 0.5) / factor
    footprint = float(np.median(depth[depth > 0])) / fx
    noise = estimate_depth_noise(depth)
    radius = PLANE_RADIUS + (noise > 0.5 * footprint) + (noise > 2 * footprint)
    white = 1.3 * noise / (2 * radius + 1)  # after the plane fit; 1.3 for rims, where fewer pixels take part
    lasting, area = estimate_correlated_noise(rgb, depth, footprint)  # the plane fit does not lower it
    residual_noise = math.hypot(white, lasting)
    area = 1 + (area - 1) * lasting**2 / (footprint**2 + residual_noise**2)  # errors by footprints are independent
    pixels = np.zeros((*mask.shape, OUTSIDE + 1), np.float32)
    points, normals = pixels[..., POINT : POINT + 3], pixels[..., NORMAL : NORMAL + 3]
    edge = np.zeros(mask.shape, np.bool_)
    jump = DEPTH_JUMP * footprint + 4 * noise
    arguments = (depth, fx, fy, cx, cy, radius, jump, points, normals, edge)
    run_in_threads(lambda begin, end: _fit_planes(begin, end, *arguments), n, 2)
    run_in_threads(lambda begin, end: _compute_features(begin, end, rgb, mask, pixels), n, 2)
    if has_surroundings:
        for i, (x, y) in enumerate(origin):
            around = recording.frame(i).depth[y + offset : y + size[1] : factor, x + offset : x + size[0] : factor]
            around = around[: mask.shape[1], : mask.shape[2]]
            points[i, ..., 2] -= np.where(mask[i], 0, around)
    lens = (float(fx), float(fy), cx, cy)
    sizes = (footprint, residual_noise, area, _estimate_diagonal(points))
    return Scene(rgb, mask, pixels, edge, *lens, origin, factor, *sizes, implausible)


def uncrop_masks(scene: Scene, labels: NDArray[np.uint8], width: int, height: int) -> NDArray[np.uint8]:
    """Crop labels (n, h, w) as full images (n, height, width)."""
    full = np.zeros((len(scene), height, width), np.uint8)
    for i, (x, y) in enumerate(scene.origin):
        part = np.kron(labels[i], np.ones((scene.factor, scene.factor), np.uint8))
        full[i, y : y + part.shape[0], x : x + part.shape[1]] = part
    return full


def uncrop_labels(scene: Scene, labels: NDArray[np.uint8], logodds: Floats, recording: Recording) -> NDArray[np.uint8]:
    """Part masks (n, height, width) within the recording's masks, from crop labels and log-odds (n, h, w).

    Between the pixels of a sampled-down crop the log-odds are interpolated.
    """
    full = np.zeros((len(scene), recording.camera.height, recording.camera.width), np.uint8)
    f, offset = scene.factor, scene.factor // 2
    to_crop = np.array([[1 / f, 0, -offset / f], [0, 1 / f, -offset / f]])
    flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
    for i, (x, y) in enumerate(scene.origin):
        sign = np.where(labels[i] == 2, 1.0, -1.0) * (labels[i] > 0) * np.maximum(np.abs(logodds[i]), 0.01)
        h, w = (f * size for size in sign.shape)
        second = cv2.warpAffine(sign, to_crop, (w, h), flags=flags, borderMode=cv2.BORDER_REPLICATE) > 0
        window = np.s_[y : y + h, x : x + w]
        full[i][window] = np.where(recording.frame(i).mask[window], np.where(second, 2, 1), 0)
    return full


@dataclass(frozen=True)
class _Crop:
    """A frame cut to its mask's box with a margin; full images of all frames would take gigabytes."""

    rgb: NDArray[np.uint8]
    depth: Floats
    """0 off the mask."""
    mask: NDArray[np.bool_]
    corner: tuple[int, int]
    """Column and row in the full image."""
    box: tuple[int, int, int, int] | None
    """x0, y0, x1, y1 of the mask, ends excluded; None when it is empty."""
    has_surroundings: bool
    """Whether depth was measured off the mask."""


def _crop_frame(frame: Frame) -> _Crop:
    ys, xs = np.flatnonzero(frame.mask.any(1)), np.flatnonzero(frame.mask.any(0))
    box = (int(xs[0]), int(ys[0]), int(xs[-1]) + 1, int(ys[-1]) + 1) if len(xs) else None
    x0, y0, x1, y1 = box or (0, 0, 0, 0)
    corner = (max(x0 - CROP_MARGIN, 0), max(y0 - CROP_MARGIN, 0))
    window = np.s_[corner[1] : y1 + CROP_MARGIN if box else 0, corner[0] : x1 + CROP_MARGIN if box else 0]
    mask = frame.mask[window].copy()
    depth = np.where(mask, frame.depth[window], 0).astype(np.float32)
    return _Crop(frame.rgb[window].copy(), depth, mask, corner, box, bool((frame.depth[window][~mask] > 0).any()))


def _drop_implausible_depths(crops: list[_Crop], focal: float) -> float:
    """Set implausibly distant depths to 0; returns their share of all depths. `focal` in pixels.

    Depths are compared with the frame's median depth, or with the median of all frames where that itself is
    implausible.
    """
    found = {i: float(np.median(crop.depth[crop.depth > 0])) for i, crop in enumerate(crops) if (crop.depth > 0).any()}
    if not found:
        return 0.0
    median_depth = float(np.median(list(found.values())))
    boxes = [crops[i].box or (0, 0, 0, 0) for i in found]
    spans = [math.hypot(x1 - x0, y1 - y0) for x0, y0, x1, y1 in boxes]
    width = float(np.median(spans)) * median_depth / focal
    dropped = total = 0
    for i, depth in found.items():
        centre = depth if median_depth / MAX_MEDIAN_RATIO < depth < median_depth * MAX_MEDIAN_RATIO else median_depth
        measured = crops[i].depth > 0
        far = measured & (np.abs(crops[i].depth - centre) > MAX_DISTANCE_WIDTHS * width)
        crops[i].depth[far] = 0
        dropped, total = dropped + int(far.sum()), total + int(measured.sum())
    return dropped / total


def _fill_missing_boxes(boxes: list[tuple[int, int, int, int] | None]) -> NDArray[np.int64]:
    """(n, 4) x0, y0, x1, y1 of each mask, ends excluded; an empty mask takes the box of the nearest frame."""
    known = np.array([i for i, b in enumerate(boxes) if b is not None])
    return np.array([boxes[known[np.abs(known - i).argmin()]] for i in range(len(boxes))])


def _crop_windows(boxes: NDArray[np.int64], width: int, height: int) -> tuple[NDArray[np.int64], tuple[int, int]]:
    """Corners (n, 2) of windows of one size (w, h) that hold every box with its margin, within the image."""
    w = min(width, int((boxes[:, 2] - boxes[:, 0]).max()) + 2 * CROP_MARGIN)
    h = min(height, int((boxes[:, 3] - boxes[:, 1]).max()) + 2 * CROP_MARGIN)
    x = np.clip((boxes[:, 0] + boxes[:, 2] - w) // 2, 0, width - w)
    y = np.clip((boxes[:, 1] + boxes[:, 3] - h) // 2, 0, height - h)
    return np.stack([x, y], 1), (w, h)


def estimate_depth_noise(depth: Floats) -> float:
    """Standard deviation of depth noise, metres, from the median absolute second difference along rows."""
    some = depth[:: max(1, len(depth) // 12)]
    a, b, c = some[:, :, :-2], some[:, :, 1:-1], some[:, :, 2:]
    second = np.abs(a - 2 * b + c)[(a > 0) & (b > 0) & (c > 0)]
    return float(np.median(second)) / (0.6745 * math.sqrt(6)) if len(second) else 0.0


def estimate_correlated_noise(rgb: NDArray[np.uint8], depth: Floats, footprint: float) -> tuple[float, float]:
    """Standard deviation of the depth's correlated noise, metres, and the pixels over which it is one error.

    What optical flow carries from a frame to the next and back differs in depth by a motion, which is linear over some
    pixels, and by the errors of both. Second differences over a distance leave the errors, and of these only what is
    not equal over that distance: white noise shows the same at all distances, correlated noise grows with it. `rgb`
    (n, h, w, 3), `depth` (n, h, w) metres, 0 where there is none. (0, 1) without correlated noise. An error of the flow
    shows in proportion to the slope; so correlated noise must also be seen on gentle slopes, where there are any.
    """
    flow = cv2.DISOpticalFlow.create(cv2.DISOPTICAL_FLOW_PRESET_MEDIUM)
    found: list[list[Floats]] = [[] for _ in LAGS]
    on_gentle_slopes: list[Floats] = []
    at, zero = np.indices(depth.shape[1:], np.float32)[::-1], np.zeros((*depth.shape[1:], 2), np.float32)
    for i in map(int, np.unique(np.linspace(0, len(depth) - 2, 12).astype(int))):
        grey = [cv2.cvtColor(picture, cv2.COLOR_RGB2GRAY) for picture in rgb[i : i + 2]]
        forth, back = (np.moveaxis(flow.calc(a, b, zero.copy()), 2, 0) for a, b in (grey, grey[::-1]))
        u, v = at + forth
        there, seen, back_u, back_v = (
            cv2.remap(np.ascontiguousarray(image), u, v, cv2.INTER_LINEAR)
            for image in (depth[i + 1], (depth[i + 1] > 0).astype(np.float32), *back)
        )
        known = (depth[i] > 0) & (seen > 0.999) & (np.hypot(forth[0] + back_u, forth[1] + back_v) < 1)
        known &= _has_texture(grey[0])
        change = np.where(known, there - depth[i], np.nan)
        for lag, differences in zip(LAGS, found, strict=True):
            differences += _second_differences(change, lag)
        change[_slopes(depth[i]) > GENTLE_SLOPE * footprint] = np.nan
        on_gentle_slopes += _second_differences(change, LAGS[-1])
    if min(sum(map(len, differences)) for differences in found) < MIN_PIXELS:
        return 0.0, 1.0
    total = np.array([_variance(differences) for differences in found])
    excess = total - WHITE_ERROR**2 * total[0]
    by_flow = (FLOW_ERROR * footprint) ** 2
    variance = float(excess[-1]) - by_flow
    gentle = sum(map(len, on_gentle_slopes)) >= MIN_PIXELS
    if variance <= 0 or (gentle and _variance(on_gentle_slopes) < by_flow):
        return 0.0, 1.0
    half = float(np.interp(0.5 * excess[-1], np.maximum.accumulate(excess), LAGS))
    return math.sqrt(variance), 2 * math.pi * (half / 1.39) ** 2  # correlation exp(-d^2 / 2 s^2): half at 1.39 s


def _second_differences(values: Floats, lag: int) -> list[Floats]:
    """Absolute second differences (d,) over `lag` pixels, down and across, of values (h, w), where none is NaN."""
    both = (np.abs(c[: -2 * lag] - 2 * c[lag:-lag] + c[2 * lag :]) for c in (values, values.T))
    return [second[np.isfinite(second)] for second in both]


def _variance(differences: list[Floats]) -> float:
    """Variance of the errors whose second differences these are: 1 + 4 + 1 errors in each of two frames."""
    return float(np.median(np.concatenate(differences))) ** 2 / (0.6745**2 * 12)


def _slopes(depth: Floats) -> Floats:
    """(h, w) change of the depth a pixel, metres, blurred over SLOPE_BLUR pixels."""
    smooth, weight = (cv2.GaussianBlur(image, (0, 0), SLOPE_BLUR) for image in (depth, (depth > 0).astype(np.float32)))
    return np.asarray(np.hypot(*np.gradient(smooth / np.maximum(weight, 1e-3))), np.float32)


def _has_texture(grey: NDArray[np.uint8]) -> Bools:
    """(h, w) whether a picture changes in every direction by LEAST_TEXTURE grey levels a pixel: else flow is a guess,
    equal both ways."""
    least = cv2.cornerMinEigenVal(grey, 7, ksize=3) * (255**2 / 4)  # OpenCV's scale to (levels a pixel)^2
    return np.asarray(least > LEAST_TEXTURE**2)


def _estimate_diagonal(points: Floats) -> float:
    """Object size, metres: 80th percentile over frames of the extent of the points."""
    sizes = []
    shown = np.flatnonzero((points[..., 2] > 0).sum((1, 2)) > 20)
    for i in shown[:: max(1, len(shown) // 24)]:
        p = points[i][points[i, ..., 2] > 0]
        if len(p):
            sizes.append(np.linalg.norm(np.percentile(p, 98, axis=0) - np.percentile(p, 2, axis=0)))
    return float(np.percentile(sizes, 80))


def _compute_features(begin: int, end: int, rgb: NDArray[np.uint8], mask: NDArray[np.bool_], pixels: Floats) -> None:
    """Fill colour features and distances to the mask of the frames begin to end."""
    for i in range(begin, end):
        lab = cv2.cvtColor(rgb[i].astype(np.float32) / 255, cv2.COLOR_RGB2LAB)
        inside = mask[i].astype(np.float32)
        blurred = cv2.GaussianBlur(lab * inside[..., None], (0, 0), 1.2)
        weight = np.maximum(cv2.GaussianBlur(inside, (0, 0), 1.2), 1e-3)
        features = np.where(mask[i][..., None], blurred / weight[..., None], 0)
        features[..., 0] *= LIGHTNESS
        pixels[i, ..., FEATURE : FEATURE + 3] = features
        if mask[i].any():
            pixels[i, ..., OUTSIDE] = cv2.distanceTransform((~mask[i]).astype(np.uint8), cv2.DIST_L2, 3)


@njit(nogil=True, cache=True)
def _fit_planes(
    begin: int, end: int, depth: Floats, fx: float, fy: float, cx: Array, cy: Array, radius: int, jump: float,
    points: Floats, normals: Floats, edge: Bools,
) -> None:  # pragma: no cover  # fmt: skip
    """Least-squares plane through each pixel's neighbourhood: inverse depth is affine in the image."""
    h, w = depth.shape[1:]
    for i in range(begin, end):
        for y in range(h):
            for x in range(w):
                z0 = depth[i, y, x]
                if z0 <= 0:
                    continue
                s = sx = sy = sxx = sxy = syy = sq = sxq = syq = 0.0
                total = 0
                for dy in range(-radius, radius + 1):
                    for dx in range(-radius, radius + 1):
                        yy, xx = y + dy, x + dx
                        if yy < 0 or yy >= h or xx < 0 or xx >= w:
                            continue
                        total += 1
                        z = depth[i, yy, xx]
                        if z <= 0 or abs(z - z0) > jump * (1 + 0.5 * max(abs(dx), abs(dy))):
                            continue
                        q = 1.0 / z - 1.0 / z0
                        s += 1
                        sx += dx
                        sy += dy
                        sxx += dx * dx
                        sxy += dx * dy
                        syy += dy * dy
                        sq += q
                        sxq += dx * q
                        syq += dy * q
                if s < 5:
                    continue
                c11, c12, c13 = sxx * syy - sxy * sxy, sxy * sy - sx * syy, sx * sxy - sxx * sy
                c22, c23, c33 = s * syy - sy * sy, sx * sy - s * sxy, s * sxx - sx * sx
                det = s * c11 + sx * c12 + sy * c13
                if abs(det) < 1e-6:
                    continue
                a = (c11 * sq + c12 * sxq + c13 * syq) / det
                b = (c12 * sq + c22 * sxq + c23 * syq) / det
                c = (c13 * sq + c23 * sxq + c33 * syq) / det
                inverse = 1.0 / z0 + a
                if inverse <= 0:
                    continue
                z = 1.0 / inverse
                n1, n2 = b * fx, c * fy
                n3 = inverse - b * (x - cx[i]) - c * (y - cy[i])
                length = math.sqrt(n1 * n1 + n2 * n2 + n3 * n3)
                points[i, y, x, 0] = (x - cx[i]) / fx * z
                points[i, y, x, 1] = (y - cy[i]) / fy * z
                points[i, y, x, 2] = z
                normals[i, y, x, 0] = -n1 / length
                normals[i, y, x, 1] = -n2 / length
                normals[i, y, x, 2] = -n3 / length
                edge[i, y, x] = s < 0.8 * total
