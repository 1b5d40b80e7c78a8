"""What the solver works on: cropped pictures with points, normals, colour features and distances to the mask."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property

import cv2
import numpy as np
from numba import njit
from numpy.typing import NDArray

from freeart21.recording import Frame, Recording
from reconstruct.kernels import FEATURE, NORMAL, OUTSIDE, POINT, in_threads
from reconstruct.settings import SceneSettings

Floats = NDArray[np.float32]


LIGHTNESS = 0.3
"""Weight of lightness in the colour features: shading changes it."""
FARTHEST = 5.0
"""Widths of the object (median over the frames of its picture's diagonal at its depth) beyond which a depth is none: a
sensor's value for "nothing", or a wall seen past the outline. Sixteen recordings, clean and tof, of 13 objects: up to
1.7 from the frame's median; depth of 65535 units taken as metres: 377."""
NEAR_TO_FAR = 3.0
"""Times by which a frame's median depth may differ from that of all frames. The same recordings: .76 to 1.17."""


class HopelessError(Exception):
    """The input cannot be solved by anyone, and why: becomes a Failure of the stage that runs."""


@dataclass(frozen=True)
class Scene:
    """A recording cropped to its object: n frames of h x w pixels, metres, camera frame.

    A crop pixel (column x, row y) of frame i shows the direction ((x - cx[i]) / fx, (y - cy[i]) / fy, 1).
    """

    rgb: NDArray[np.uint8]
    """(n, h, w, 3); black further than the margin from the mask's box."""
    mask: NDArray[np.bool_]
    """(n, h, w) foreground."""
    pixels: Floats
    """(n, h, w, 10) one record a pixel, as registration reads it at one place of memory: point, normal, feature and
    distance to the mask, each described below."""
    edge: NDArray[np.bool_]
    """(n, h, w) next to a depth step: no good for registration."""
    fx: float
    fy: float
    cx: NDArray[np.float64]
    """(n,) principal column of each crop."""
    cy: NDArray[np.float64]
    """(n,) principal row of each crop."""
    origin: NDArray[np.int64]
    """(n, 2) column and row of the crop's corner in the full picture."""
    factor: int
    """Full pixels per crop pixel, each way."""
    footprint: float
    """Metres a pixel covers at the object: the unit of every threshold."""
    noise: float
    """Metres: standard deviation of the points along z; the plane fits leave but a part of the depth noise."""
    diagonal: float
    """Metres: estimate of the object's size."""
    implausible: float = 0.0
    """Share, 0 to 1, of the object's depths that lie too far from it to be its own, and are taken as none."""

    def __len__(self) -> int:
        return len(self.mask)

    @property
    def points(self) -> Floats:
        """(n, h, w, 3) plane-fitted points of the object; z is 0 where there is none.

        Off the mask, z is minus the depth measured there: of a hand that may hide the object, or of what stands behind.
        """
        return self.pixels[..., POINT : POINT + 3]

    @property
    def normals(self) -> Floats:
        """(n, h, w, 3) unit normals towards the camera; 0 where there is none."""
        return self.pixels[..., NORMAL : NORMAL + 3]

    @property
    def features(self) -> Floats:
        """(n, h, w, 3) smoothed CIELAB, lightness damped against shading."""
        return self.pixels[..., FEATURE : FEATURE + 3]

    @property
    def outside(self) -> Floats:
        """(n, h, w) pixels to the mask; 0 inside."""
        return self.pixels[..., OUTSIDE]

    @cached_property
    def valid(self) -> NDArray[np.bool_]:
        """(n, h, w) pixels with a point."""
        return self.points[..., 2] > 0


def prepare(recording: Recording, settings: SceneSettings) -> Scene:
    """Load and crop all frames, fit local planes, and compute what every stage needs.

    Raises HopelessError when there are too few frames or the masks are empty.
    """
    n = len(recording)
    if n < settings.min_frames:
        raise HopelessError(f"{n} frames, at least {settings.min_frames} are needed")
    camera = recording.camera
    cuts = [_cut(recording.frame(i), settings.margin) for i in range(n)]
    implausible = _drop_implausible(cuts, float(camera.K[0, 0]))
    counts = np.array([int((cut.depth > 0).sum()) for cut in cuts])
    surrounded = any(cut.surrounded for cut in cuts)
    if (counts >= settings.min_pixels).sum() < settings.min_frames:
        raise HopelessError(
            f"the foreground masks hold {settings.min_pixels} or more pixels with depth in only "
            f"{int((counts >= settings.min_pixels).sum())} frames, at least {settings.min_frames} are needed"
            + (f"; {100 * implausible:.2g} % of the depths are implausibly far from the object" if implausible else ""),
        )
    boxes = _boxes([cut.box for cut in cuts])
    origin, size = _windows(boxes, settings.margin, camera.width, camera.height)
    factor = max(1, math.ceil(math.sqrt(size[0] * size[1] / settings.max_crop_pixels)))
    at = factor // 2

    def crops(images: list[NDArray]) -> Iterator[NDArray]:
        """The window of each frame, zero where nothing was cut, of a whole number of crop pixels."""
        for image, cut, (x, y) in zip(images, cuts, origin, strict=True):
            window = np.zeros((size[1], size[0], *image.shape[2:]), image.dtype)
            top, left = cut.corner[1] - y, cut.corner[0] - x
            window[top : top + image.shape[0], left : left + image.shape[1]] = image
            yield window[: size[1] // factor * factor, : size[0] // factor * factor]

    blur = (factor | 1, factor | 1)  # odd, so that colours stand where depth does
    rgb = np.asarray(
        np.stack([cv2.blur(a, blur)[at::factor, at::factor] for a in crops([c.rgb for c in cuts])]), np.uint8
    )
    mask = np.stack([a[at::factor, at::factor] for a in crops([c.mask for c in cuts])])
    depth = np.stack([a[at::factor, at::factor] for a in crops([c.depth for c in cuts])])
    cuts.clear()
    K = camera.K
    fx, fy = K[0, 0] / factor, K[1, 1] / factor
    cx = (K[0, 2] - origin[:, 0] - at - 0.5) / factor
    cy = (K[1, 2] - origin[:, 1] - at - 0.5) / factor
    footprint = float(np.median(depth[depth > 0])) / fx
    noise = depth_noise(depth)
    radius = settings.plane_radius + (noise > 0.5 * footprint) + (noise > 2 * footprint)
    left = 1.3 * noise / (2 * radius + 1)  # after the plane fit; at rims fewer pixels share in it
    pixels = np.zeros((*mask.shape, OUTSIDE + 1), np.float32)
    points, normals = pixels[..., POINT : POINT + 3], pixels[..., NORMAL : NORMAL + 3]
    edge = np.zeros(mask.shape, np.bool_)
    jump = settings.depth_jump * footprint + 4 * noise
    arguments = (depth, fx, fy, cx, cy, radius, jump, points, normals, edge)
    in_threads(lambda begin, end: _fit_planes(begin, end, *arguments), n, 2)
    in_threads(lambda begin, end: _fill_features(begin, end, rgb, mask, pixels), n, 2)
    if surrounded:
        for i, (x, y) in enumerate(origin):
            around = recording.frame(i).depth[y + at : y + size[1] : factor, x + at : x + size[0] : factor]
            around = around[: mask.shape[1], : mask.shape[2]]
            points[i, ..., 2] -= np.where(mask[i], 0, around)
    return Scene(
        rgb,
        mask,
        pixels,
        edge,
        float(fx),
        float(fy),
        cx,
        cy,
        origin,
        factor,
        footprint,
        left,
        _diagonal(points),
        implausible,
    )


def full_masks(scene: Scene, labels: NDArray[np.uint8], width: int, height: int) -> NDArray[np.uint8]:
    """Crop labels (n, h, w) put back into full pictures (n, height, width)."""
    full = np.zeros((len(scene), height, width), np.uint8)
    for i, (x, y) in enumerate(scene.origin):
        part = np.kron(labels[i], np.ones((scene.factor, scene.factor), np.uint8))
        full[i, y : y + part.shape[0], x : x + part.shape[1]] = part
    return full


def full_labels(scene: Scene, labels: NDArray[np.uint8], logodds: Floats, recording: Recording) -> NDArray[np.uint8]:
    """Part masks (n, height, width) within the recording's own masks, from crop labels and log-odds (n, h, w).

    Where the crop is sampled down the log-odds between its pixels are interpolated, and the outline is the recording's.
    """
    full = np.zeros((len(scene), recording.camera.height, recording.camera.width), np.uint8)
    f, at = scene.factor, scene.factor // 2
    back = np.array([[1 / f, 0, -at / f], [0, 1 / f, -at / f]])
    how = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
    for i, (x, y) in enumerate(scene.origin):
        sign = np.where(labels[i] == 2, 1.0, -1.0) * (labels[i] > 0) * np.maximum(np.abs(logodds[i]), 0.01)
        h, w = (f * size for size in sign.shape)
        second = cv2.warpAffine(sign, back, (w, h), flags=how, borderMode=cv2.BORDER_REPLICATE) > 0
        window = np.s_[y : y + h, x : x + w]
        full[i][window] = np.where(recording.frame(i).mask[window], np.where(second, 2, 1), 0)
    return full


@dataclass(frozen=True)
class _Cut:
    """What is kept of a frame: its mask's box with a margin. Whole pictures of all frames would be gigabytes."""

    rgb: NDArray[np.uint8]
    depth: Floats
    """0 off the mask."""
    mask: NDArray[np.bool_]
    corner: tuple[int, int]
    """Column and row in the picture."""
    box: tuple[int, int, int, int] | None
    """x0, y0, x1, y1 of the mask, ends excluded; None when it is empty."""
    surrounded: bool
    """Whether depth was measured off the mask."""


def _cut(frame: Frame, margin: int) -> _Cut:
    ys, xs = np.flatnonzero(frame.mask.any(1)), np.flatnonzero(frame.mask.any(0))
    box = (int(xs[0]), int(ys[0]), int(xs[-1]) + 1, int(ys[-1]) + 1) if len(xs) else None
    x0, y0, x1, y1 = box or (0, 0, 0, 0)
    corner = (max(x0 - margin, 0), max(y0 - margin, 0))
    kept = np.s_[corner[1] : y1 + margin if box else 0, corner[0] : x1 + margin if box else 0]
    mask = frame.mask[kept].copy()
    depth = np.where(mask, frame.depth[kept], 0).astype(np.float32)
    return _Cut(frame.rgb[kept].copy(), depth, mask, corner, box, bool((frame.depth[kept][~mask] > 0).any()))


def _drop_implausible(cuts: list[_Cut], focal: float) -> float:
    """Set depths to 0 that lie FARTHEST widths or more from the object; returns their share of all depths.

    `focal` in pixels. A frame's object lies at its median depth, or, where most of that is implausible, at that of all
    frames.
    """
    found = {i: float(np.median(cut.depth[cut.depth > 0])) for i, cut in enumerate(cuts) if (cut.depth > 0).any()}
    if not found:
        return 0.0
    usual = float(np.median(list(found.values())))
    boxes = [cuts[i].box or (0, 0, 0, 0) for i in found]
    spans = [math.hypot(x1 - x0, y1 - y0) for x0, y0, x1, y1 in boxes]
    width = float(np.median(spans)) * usual / focal
    dropped = total = 0
    for i, depth in found.items():
        centre = depth if usual / NEAR_TO_FAR < depth < usual * NEAR_TO_FAR else usual
        measured = cuts[i].depth > 0
        far = measured & (np.abs(cuts[i].depth - centre) > FARTHEST * width)
        cuts[i].depth[far] = 0
        dropped, total = dropped + int(far.sum()), total + int(measured.sum())
    return dropped / total


def _boxes(boxes: list[tuple[int, int, int, int] | None]) -> NDArray[np.int64]:
    """(n, 4) x0, y0, x1, y1 of each mask, ends excluded; an empty mask takes the box of its neighbour in time."""
    known = np.array([i for i, b in enumerate(boxes) if b is not None])
    return np.array([boxes[known[np.abs(known - i).argmin()]] for i in range(len(boxes))])


def _windows(
    boxes: NDArray[np.int64], margin: int, width: int, height: int
) -> tuple[NDArray[np.int64], tuple[int, int]]:
    """Corners (n, 2) of windows of one size (w, h) that hold every box with its margin where the picture allows."""
    w = min(width, int((boxes[:, 2] - boxes[:, 0]).max()) + 2 * margin)
    h = min(height, int((boxes[:, 3] - boxes[:, 1]).max()) + 2 * margin)
    x = np.clip((boxes[:, 0] + boxes[:, 2] - w) // 2, 0, width - w)
    y = np.clip((boxes[:, 1] + boxes[:, 3] - h) // 2, 0, height - h)
    return np.stack([x, y], 1), (w, h)


def depth_noise(depth: Floats) -> float:
    """Standard deviation of depth noise, metres: median absolute second difference along rows."""
    some = depth[:: max(1, len(depth) // 12)]
    a, b, c = some[:, :, :-2], some[:, :, 1:-1], some[:, :, 2:]
    second = np.abs(a - 2 * b + c)[(a > 0) & (b > 0) & (c > 0)]
    return float(np.median(second)) / (0.6745 * math.sqrt(6)) if len(second) else 0.0


def _diagonal(points: Floats) -> float:
    """The largest extent of the object over frames: a robust estimate of its size, metres."""
    sizes = []
    shown = np.flatnonzero((points[..., 2] > 0).sum((1, 2)) > 20)
    for i in shown[:: max(1, len(shown) // 24)]:
        p = points[i][points[i, ..., 2] > 0]
        if len(p):
            sizes.append(np.linalg.norm(np.percentile(p, 98, axis=0) - np.percentile(p, 2, axis=0)))
    return float(np.percentile(sizes, 80))


def _fill_features(begin: int, end: int, rgb: NDArray[np.uint8], mask: NDArray[np.bool_], pixels: Floats) -> None:
    """Colour features and distances to the mask of the frames begin to end."""
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
def _fit_planes(begin, end, depth, fx, fy, cx, cy, radius, jump, points, normals, edge):  # pragma: no cover
    """Least-squares plane through each pixel's neighbourhood: inverse depth is affine in the picture."""
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
