"""RGB-D videos as cameras write them, made into pictures of one undistorted, upright colour camera.

Colours are undistorted and made smaller to a longest side. Depth is brought to the colours: that of another camera is
drawn as a surface into the colour camera, that of the same viewpoint is resampled along the colours' edges. No depth
is made up across an edge of the depth.
"""

from __future__ import annotations

import importlib
import io
import itertools
import re
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from types import ModuleType
from typing import Any

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from freeart21 import se3, z_buffer
from freeart21.camera import Camera
from freeart21.errors import FreeArtError
from freeart21.files import checked
from freeart21.formats import third_party
from freeart21.formats.third_party import Image, ReadOptions, ThirdPartyRecording
from freeart21.recording import Frame, Recording
from freeart21.se3 import Array

Depth = NDArray[np.float32]
Mask = NDArray[np.bool_]

HALF_PIXEL: Array = np.array([[0, 0, 0.5], [0, 0, 0.5], [0, 0, 0]])
"""Our K less one for pixel centres at whole numbers, as OpenCV and ARKit have it."""
LEAST_CONFIDENCE = 1
"""ARKit's depth confidence is 0 low, 1 medium, 2 high; low is no depth."""
MAX_DIFFERENCE_S = 0.02
"""Largest difference between time stamps of one frame's colours and depth, as in associate.py of the TUM RGB-D sets."""

_STEEPEST = np.tan(np.radians(80))
"""Slope of a surface, against the view, from which on a difference of depth between pixels is an edge. Not measured."""
_COLOUR_SIGMA = 12.0
"""Distance of colours, of 255 a channel, that parts two sides of an edge: some twice the noise of a phone's pictures.
Not measured."""
_CENTRED, _OFF_CENTRE = 0.05, 0.1
"""Principal points of cameras are within 5 % of the picture's centre; K is of other pictures when it is 10 % off, but
within 5 % once it is scaled or turned."""
_STEPS, _MISSED_PX = 60, 0.1
"""Steps to invert a distortion, and what a ray may then miss its pixel by."""
_ORIENTATION = 0x0112
_TURNS = {0: 0, 1: 0, 3: 2, 6: 1, 8: 3}
"""EXIF orientation to clockwise quarter turns (Exif 2.3, 4.6.4 A)."""
_FIELD_OF_VIEW = np.radians([1.0, 170.0])


@dataclass(frozen=True)
class Lens:
    """Intrinsics of a camera that can distort."""

    K: Array
    """(3, 3), pixels, centres at +0.5."""
    width: int
    height: int
    distortion: Array = field(default_factory=lambda: np.zeros(0))
    """OpenCV's k1, k2, p1, p2, k3, k4, k5, k6, or the first 4 or 5 of them; empty: none."""

    @property
    def distorts(self) -> bool:
        """Whether any coefficient is not zero."""
        return bool(np.any(self.distortion))

    def scaled(self, width: int, height: int) -> Array:
        """(3, 3) K of the same view in `width` x `height` pixels."""
        return np.diag([width / self.width, height / self.height, 1.0]) @ self.K


@dataclass(frozen=True)
class Picture:
    """One frame as filmed."""

    rgb: Image
    """(height, width, 3)."""
    depth: Depth
    """(rows, columns) of the depth camera, metres along z; 0 where there is none."""
    K: Array | None = None
    """(3, 3) of the colours in this frame; None: that of the video."""


@dataclass(frozen=True)
class RgbdVideo:
    """An RGB-D video as filmed."""

    name: str
    times_s: Array
    """(n,) seconds, increasing."""
    load: Callable[[int], Picture]
    colour: Lens
    depth: Lens | None = None
    """None: depth has the viewpoint of the colours, in its own number of pixels."""
    T_colour_depth: Array = field(default_factory=lambda: np.eye(4))
    turns: int = 0
    """Clockwise quarter turns that make the pictures upright."""
    mask: Callable[[int], Mask] | None = None
    """Foreground of a frame, as filmed or as `align_video` gives it; None: only those in `folder`."""
    folder: Path | None = None
    """Folder of the recording, which can hold masks/, a picture for each frame."""
    notes: tuple[str, ...] = ()
    gravity: Array | None = None
    """(n, 3) unit direction of gravity in the axes of the colours as filmed; None when the file does not have it."""


def import_extra(module: str, what: str) -> ModuleType:
    """An optional package. Raises FreeArtError, which begins with `what`, when it is not installed."""
    try:
        return importlib.import_module(module)
    except ImportError as error:
        raise FreeArtError(f"{what} needs the package {module}: pip install 'freeart21[cameras]' ({error})") from error


def check_intrinsics(K: Array, width: int, height: int, where: str) -> None:
    """Raises FreeArtError, which begins with `where`, when K cannot be that of `width` x `height` pictures.

    As an identity, a normalised K, one of larger or smaller pictures, or of the unturned picture.
    """
    size, focal = np.array([width, height]), np.array([K[0, 0], K[1, 1]])
    centre = K[:2, 2] / size
    ratio = float(np.mean(centre / 0.5))
    scaled = not 0.8 < ratio < 1.25 and np.abs(centre - 0.5 * ratio).max() < _CENTRED * ratio
    unturned = width != height and np.abs(K[:2, 2] / size[::-1] - 0.5).max() < _CENTRED
    angles = 2 * np.arctan2(size / 2, focal)
    if (
        not np.isfinite(K).all()
        or not ((angles > _FIELD_OF_VIEW[0]) & (angles < _FIELD_OF_VIEW[1]) & (centre >= 0) & (centre <= 1)).all()
        or (np.abs(centre - 0.5).max() > _OFF_CENTRE and (scaled or unturned))
    ):
        raise FreeArtError(
            f"{where}: K has fx {focal[0]:.4g}, fy {focal[1]:.4g}, cx {K[0, 2]:.4g}, cy {K[1, 2]:.4g} for {width} x "
            f"{height} pixels, expected that of these pictures, in pixels: not of larger, smaller or unturned ones"
        )


def intrinsics(focus: ArrayLike) -> Array:
    """(3, 3) K for pixel centres at +0.5, from fx, fy, cx, cy for centres at whole numbers (OpenCV, ARKit)."""
    fx, fy, cx, cy = np.asarray(focus, float)
    return np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1.0]]) + HALF_PIXEL


def read_intrinsics(path: Path) -> Array:
    """(3, 3) K for pixel centres at +0.5, from a text of three rows for centres at whole numbers."""
    K = third_party.read_matrix(path)
    if K.shape != (3, 3):
        raise FreeArtError(f"{path} has shape {K.shape}, expected a 3 x 3 matrix")
    return K + HALF_PIXEL


def drop_low_confidence(depth: Depth, confidence: NDArray[Any], where: str) -> Depth:
    """`depth` without the pixels of low `confidence` (0 low, 1 medium, 2 high), of the same shape."""
    if confidence.shape != depth.shape:
        raise FreeArtError(f"{where}: confidence has shape {confidence.shape}, expected {depth.shape} as its depth")
    return np.where(confidence >= LEAST_CONFIDENCE, depth, np.float32(0))


def turn_pixels(image: NDArray[Any], turns: int) -> NDArray[Any]:
    """A picture (height, width, ...) after `turns` clockwise quarter turns."""
    return np.ascontiguousarray(np.rot90(image, -turns))


def turn_intrinsics(K: Array, width: int, height: int, turns: int) -> Array:
    """K (pixel centres at +0.5) of a `width` x `height` picture after `turns` clockwise quarter turns."""
    for _ in range(turns % 4):
        K = np.array([[K[1, 1], 0, height - K[1, 2]], [0, K[0, 0], K[0, 2]], [0, 0, 1.0]])
        width, height = height, width
    return K


def read_unturned(path: Path, data: bytes | None = None) -> tuple[Image, int]:
    """(height, width, 3) colours of the file `path` (or of its bytes `data`) as filmed, and the clockwise quarter turns
    that its EXIF asks for. Raises FreeArtError on a mirrored one."""
    from PIL import Image as Pillow

    data = checked.read_bytes(path, checked.MAX_IMAGE_BYTES) if data is None else data
    image = checked.decode_image(data, path, cv2.IMREAD_COLOR | cv2.IMREAD_IGNORE_ORIENTATION)
    try:
        with Pillow.open(io.BytesIO(data)) as opened:
            orientation = opened.getexif().get(_ORIENTATION, 1)
    except (OSError, ValueError, SyntaxError, Pillow.DecompressionBombError):
        orientation = 1
    if orientation not in _TURNS:
        raise FreeArtError(f"{path} is mirrored by its EXIF (orientation {orientation}), expected 1, 3, 6 or 8")
    return np.ascontiguousarray(image[..., ::-1]), _TURNS[orientation]


def pair_times(colour_s: Array, depth_s: Array) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Indices of the colours and of their depth, the nearest in time within MAX_DIFFERENCE_S; each is used once."""
    at = np.clip(np.searchsorted(depth_s, colour_s), 1, max(len(depth_s) - 1, 1))
    left = np.minimum(at, len(depth_s)) - 1
    right = np.minimum(at, len(depth_s) - 1)
    nearest = np.where(np.abs(colour_s - depth_s[left]) <= np.abs(depth_s[right] - colour_s), left, right)
    difference = np.abs(depth_s[nearest] - colour_s)
    order = np.lexsort((difference, nearest))
    first = np.ones(len(order), bool)
    first[1:] = nearest[order][1:] != nearest[order][:-1]
    chosen = np.sort(order[first])
    chosen = chosen[difference[chosen] < MAX_DIFFERENCE_S]
    return chosen, nearest[chosen]


def pair_streams(
    source: Path, colour_s: Array, depth_s: Array
) -> tuple[NDArray[np.int64], NDArray[np.int64], Array, tuple[str, ...]]:
    """Indices of colours and depth of each frame as `pair_times` gives them, for times (n,), (m,) in any order.

    Then the frames' seconds from the first, and a note of what is left out. Raises FreeArtError when nothing is paired.
    """
    orders = [np.argsort(times, kind="stable") for times in (colour_s, depth_s)]
    pairs = pair_times(colour_s[orders[0]], depth_s[orders[1]])
    colours, depths = (order[pair] for order, pair in zip(orders, pairs, strict=True))
    within = f"within {1e3 * MAX_DIFFERENCE_S:g} ms"
    if not len(colours):
        raise FreeArtError(f"{source}: no colours have depth {within}")
    lost = len(colour_s) - len(colours)
    note = f"{lost} of {len(colour_s)} colours have no depth {within}, and are left out"
    return colours, depths, colour_s[colours] - colour_s[colours[0]], (note,) if lost else ()


class InOrder:
    """Entries of a stream by index; by rising index it is read once. `start` gives a new iterator over all."""

    def __init__(self, start: Callable[[], Iterator[Any]]):
        self._start, self._next = start, 0
        self._entries: Iterator[Any] = iter(())

    def read(self, index: int) -> Any:
        """Entry `index`; None after the last."""
        if index < self._next or not self._next:
            self._entries, self._next = self._start(), 0
        ahead, self._next = index - self._next, index + 1
        return next(itertools.islice(self._entries, ahead, None), None)


def masks_in_order(folder: Path, count: int) -> Callable[[int], Mask]:
    """Frame to foreground, from the pictures in `folder`, as many as frames, ordered by the numbers in their names."""
    if not folder.is_dir():
        raise FreeArtError(f"masks: {folder} is not a folder")
    files = [path for path in folder.iterdir() if path.suffix.lower() in (".png", ".jpg", ".jpeg")]
    files.sort(key=lambda path: ([int(number) for number in re.findall(r"[0-9]{1,18}", path.stem)], path.name))
    if len(files) != count:
        raise FreeArtError(
            f"{folder} has {len(files)} masks, expected {count}: one for each picture that `--to rgbd` writes"
        )
    return lambda index: third_party.read_foreground(third_party.within(folder, files[index]))


def align_video(video: RgbdVideo, options: ReadOptions) -> ThirdPartyRecording:
    """The recording of `video`: undistorted, registered, upright, at most `options.longest_side` wide and high.

    Masks are those of `options.masks`, else of the video. Raises FreeArtError on an impossible K.
    """
    masks, longest_side, lens = options.masks, options.longest_side, video.colour
    check_intrinsics(lens.K, lens.width, lens.height, video.name)
    if longest_side < 16:
        raise FreeArtError(f"longest side is {longest_side}, expected at least 16 pixels")
    scale = min(1.0, longest_side / max(lens.width, lens.height))
    width, height = round(scale * lens.width), round(scale * lens.height)
    flat = Camera(lens.scaled(width, height), width, height)
    upright = (height, width) if video.turns % 2 else (width, height)
    camera = Camera(turn_intrinsics(flat.K, width, height, video.turns), *upright)
    if masks is None and video.mask is None and video.folder is not None and (video.folder / "masks").is_dir():
        masks = video.folder / "masks"
    shown = video.mask if masks is None else masks_in_order(masks, len(video.times_s))

    def load(index: int) -> Frame:
        picture = video.load(index)
        if picture.rgb.shape[:2] != (lens.height, lens.width):
            raise FreeArtError(
                f"{video.name} frame {index}: colours are {picture.rgb.shape[1]} x {picture.rgb.shape[0]}, "
                f"expected {lens.width} x {lens.height}"
            )
        own = lens if picture.K is None else Lens(picture.K, lens.width, lens.height, lens.distortion)
        rgb = _undistort(picture.rgb, own, flat, cv2.INTER_LINEAR)
        depth = _align_depth(picture.depth, own, video.depth, video.T_colour_depth, rgb, flat)
        mask = np.zeros((camera.height, camera.width), bool)
        if shown is not None:
            mask = _fit_mask(shown(index), own, flat, video.turns, f"{video.name} frame {index}")
        return Frame(turn_pixels(rgb, video.turns), turn_pixels(depth, video.turns), mask)

    notes = video.notes
    if scale < 1:
        notes += (f"pictures of {lens.width} x {lens.height} are made {width} x {height} (--longest-side)",)
    gravity = None if video.gravity is None else _turn_vectors(video.gravity, video.turns)
    recording = Recording(camera, video.times_s, load, (), None, video.name, gravity)
    lacks = "a video alone has no truth"
    return ThirdPartyRecording(video.name, video.name, recording, None, lacks, notes, shown is not None)


def _turn_vectors(vectors: Array, turns: int) -> Array:
    """(n, 3) camera axes' vectors in those of pictures that are turned clockwise by `turns` quarters."""
    for _ in range(turns % 4):
        vectors = np.stack([-vectors[:, 1], vectors[:, 0], vectors[:, 2]], -1)
    return vectors


def _undistort(image: NDArray[Any], lens: Lens, flat: Camera, interpolation: int) -> NDArray[Any]:
    """`image` of `lens` as seen by the camera `flat`, of the same viewpoint."""
    if lens.distorts or not np.allclose(lens.scaled(flat.width, flat.height), flat.K, rtol=0, atol=1e-3):
        size = lens.width, lens.height
        K = np.diag([size[0] / flat.width, size[1] / flat.height, 1.0]) @ flat.K
        K_cv, distortion = _opencv(lens)
        across, down = cv2.initUndistortRectifyMap(K_cv, distortion, None, K - HALF_PIXEL, size, cv2.CV_32FC1)
        image = cv2.remap(image, across, down, interpolation, borderMode=cv2.BORDER_CONSTANT)
    if image.shape[:2] == (flat.height, flat.width):
        return image
    return cv2.resize(image, (flat.width, flat.height), interpolation=cv2.INTER_AREA)


def unproject_pixels(lens: Lens, pixels: Array) -> Array:
    """(n, 2) x / z and y / z of the rays through `pixels` (n, 2), centres at +0.5; NaN where the lens model has none.

    OpenCV's own inverse stops after five steps, too early for wide lenses.
    """
    aim = (pixels - lens.K[:2, 2]) / [lens.K[0, 0], lens.K[1, 1]]
    if not lens.distorts or not len(aim):
        return np.asarray(aim)
    at = aim.copy()
    for _ in range(_STEPS):
        one = np.concatenate([at, np.ones((len(at), 1))], 1)[:, None]
        seen, _jacobian = cv2.projectPoints(one, np.zeros(3), np.zeros(3), np.eye(3), lens.distortion)
        missed = aim - seen[:, 0]
        at = at + missed
        if np.nanmax(np.abs(missed), initial=0) < 1e-9:
            break
    at[~(np.abs(missed).max(1) * lens.K[0, 0] < _MISSED_PX)] = np.nan
    return np.asarray(at)


def fit_forward_distortion(lens: Lens, inverse: Array, where: str) -> Lens:
    """`lens` with OpenCV's k1, k2, p1, p2, k3, fitted to those of the inverse model, which undistort pixels.

    The model is linear in its coefficients. Raises FreeArtError when the fit misses a pixel by more than a tenth.
    """
    u, v = np.meshgrid(np.linspace(0, lens.width, 33), np.linspace(0, lens.height, 25))
    aim = (np.stack([u.ravel(), v.ravel()], -1) - lens.K[:2, 2]) / [lens.K[0, 0], lens.K[1, 1]]
    one = np.concatenate([aim, np.ones((len(aim), 1))], 1)[:, None]
    flat = cv2.projectPoints(one, np.zeros(3), np.zeros(3), np.eye(3), inverse)[0][:, 0]
    x, y = flat.T
    r2 = x**2 + y**2
    columns = [
        [x * r2, x * r2**2, 2 * x * y, r2 + 2 * x**2, x * r2**3],
        [y * r2, y * r2**2, r2 + 2 * y**2, 2 * x * y, y * r2**3],
    ]
    A = np.concatenate([np.stack(rows, -1) for rows in columns])
    moved = (aim - flat).T.ravel()
    coefficients = np.linalg.lstsq(A, moved, rcond=None)[0]
    missed = float(np.abs(A @ coefficients - moved).max() * lens.K[0, 0])
    if not missed < _MISSED_PX:
        raise FreeArtError(f"{where}: its inverse distortion is fitted to {missed:.2g} pixels, expected a tenth")
    return Lens(lens.K, lens.width, lens.height, coefficients)


def _project_rays(lens: Lens, rays: Array) -> NDArray[np.float32]:
    """(height, width, 2) pixels of `lens`, centres at whole numbers, that rays (height, width, 3) with z = 1 hit."""
    K = lens.K - HALF_PIXEL
    if not lens.distorts:
        return np.asarray(rays[..., :2] * [K[0, 0], K[1, 1]] + K[:2, 2], np.float32)
    at, _ = cv2.projectPoints(rays.reshape(-1, 1, 3), np.zeros(3), np.zeros(3), K, lens.distortion)
    return np.asarray(at.reshape(*rays.shape[:2], 2), np.float32)


def _opencv(lens: Lens) -> tuple[Array, Array | None]:
    """K for pixel centres at whole numbers, and the distortion."""
    return lens.K - HALF_PIXEL, lens.distortion if lens.distorts else None


def _fit_mask(mask: Mask, lens: Lens, flat: Camera, turns: int, where: str) -> Mask:
    """A mask of the finished picture as it is; one of the colours as filmed is treated as they are."""
    done = (flat.width, flat.height) if turns % 2 else (flat.height, flat.width)
    if mask.shape == done:
        return mask
    if mask.shape == (lens.height, lens.width):
        grey = _undistort(255 * mask.astype(np.uint8), lens, flat, cv2.INTER_LINEAR)
        return turn_pixels(grey > 127, turns)
    raise FreeArtError(
        f"{where}: its mask is {mask.shape[1]} x {mask.shape[0]}, expected {done[1]} x {done[0]}, or "
        f"{lens.width} x {lens.height} as filmed"
    )


def _align_depth(
    depth: Depth, colour: Lens, lens: Lens | None, T_colour_depth: Array, rgb: Image, flat: Camera
) -> Depth:
    """(height, width) depth of the camera `flat`, metres."""
    depth = np.where(np.isfinite(depth) & (depth > 0), depth, 0).astype(np.float32)
    if lens is not None:
        if depth.shape != (lens.height, lens.width):
            raise FreeArtError(
                f"depth is {depth.shape[1]} x {depth.shape[0]}, expected {lens.width} x {lens.height} of its camera"
            )
        return register_depth(depth, lens, T_colour_depth, flat)
    rows, columns = depth.shape
    own = Lens(colour.scaled(columns, rows), columns, rows, colour.distortion)
    if not own.distorts and depth.shape == (flat.height, flat.width) and np.allclose(own.K, flat.K, rtol=0, atol=1e-3):
        return depth
    return enlarge_depth(depth, own, rgb, flat)


def register_depth(depth: Depth, lens: Lens, T_colour_depth: Array, flat: Camera) -> Depth:
    """Depth (rows, columns) of the camera `lens`, metres, as seen by the colour camera `flat`.

    Neighbouring pixels span a surface, unless it is steeper than a camera can see, and the nearest surface is seen.
    """
    rows, columns = depth.shape
    v, u = np.nonzero(depth)
    pixels = np.stack([u, v], -1).astype(np.float64)
    if not len(pixels):
        return np.zeros((flat.height, flat.width), np.float32)
    rays = unproject_pixels(lens, pixels + 0.5)
    z = np.where(np.isfinite(rays).all(1), depth[v, u], np.nan)
    points = se3.transform(T_colour_depth, np.concatenate([rays * z[:, None], z[:, None]], 1))
    number = np.full((rows, columns), -1, np.int64)
    number[v, u] = np.arange(len(z))
    a, b, c, d = number[:-1, :-1], number[:-1, 1:], number[1:, :-1], number[1:, 1:]
    faces = np.concatenate([np.stack([a, b, c], -1).reshape(-1, 3), np.stack([d, c, b], -1).reshape(-1, 3)])
    faces = faces[(faces >= 0).all(1)]
    corners = z[faces]
    nearest, farthest = corners.min(1), corners.max(1)
    faces = faces[farthest - nearest < _STEEPEST * nearest / min(lens.K[0, 0], lens.K[1, 1])]
    seen = np.full((flat.height, flat.width), np.inf)
    front = points[:, 2] > z_buffer.BEHIND  # false where there is no ray
    faces = np.ascontiguousarray(faces[front[faces].all(1)])
    face, weights = np.full(seen.shape, -1, np.int64), np.zeros((*seen.shape, 3))
    z_buffer.draw_triangles(flat.project(points), np.ascontiguousarray(points[:, 2]), faces, seen, face, weights)
    return np.where(np.isfinite(seen), seen, 0).astype(np.float32)


def enlarge_depth(depth: Depth, lens: Lens, rgb: Image, flat: Camera) -> Depth:
    """Depth (rows, columns) of `lens`, metres, in the pixels of the camera `flat` of the same viewpoint.

    Between depths of one surface it is interpolated. At an edge a pixel takes the side of the neighbour that is nearest
    in place and colour (`rgb`, of `flat`), as in joint bilateral upsampling (Kopf et al. 2007), but mixes no two sides.
    """
    at = _project_rays(lens, flat.rays())
    rows, columns = depth.shape
    pixels = np.stack(np.meshgrid(np.arange(columns), np.arange(rows)), -1).reshape(-1, 2).astype(float)
    own = unproject_pixels(lens, pixels + 0.5) * [flat.K[0, 0], flat.K[1, 1]] + flat.K[:2, 2] - 0.5
    wide = (max(1, flat.width // columns), max(1, flat.height // rows))
    across, down = (np.nan_to_num(own[:, k].reshape(rows, columns), nan=-1).astype(np.float32) for k in (0, 1))
    low = cv2.remap(cv2.blur(rgb, wide), across, down, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    corner = np.floor(at)
    part = at - corner
    where = np.stack([corner + np.array([i, j], np.float32) for j in (0, 1) for i in (0, 1)])
    inside = (where[..., 0] >= 0) & (where[..., 0] < columns) & (where[..., 1] >= 0) & (where[..., 1] < rows)
    x, y = (np.clip(where[..., k], 0, n - 1).astype(np.intp) for k, n in ((0, columns), (1, rows)))
    value = np.where(inside, depth[y, x], 0)
    place = np.stack([np.abs(1 - j - part[..., 1]) * np.abs(1 - i - part[..., 0]) for j in (0, 1) for i in (0, 1)])
    differs = np.stack([cv2.absdiff(low[j, i], rgb) for j, i in zip(y, x, strict=True)]).astype(np.float32)
    likeness = np.exp(-0.5 * (differs**2).sum(-1) / _COLOUR_SIGMA**2)
    weight = (place + 1e-6) * likeness * inside + 1e-12 * place
    best = np.take_along_axis(value, weight.argmax(0)[None], 0)[0]
    same = (value > 0) & (np.abs(value - best) < _STEEPEST * best / min(lens.K[0, 0], lens.K[1, 1]))
    smooth = same.all(0)
    weight = np.where(smooth, place, weight) * same
    total = weight.sum(0)
    return np.where((best > 0) & (total > 0), (weight * value).sum(0) / np.where(total > 0, total, 1), 0).astype(
        np.float32
    )
