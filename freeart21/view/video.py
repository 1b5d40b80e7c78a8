"""The video player: colour and depth images, foreground, and the parts, estimated or true, over them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Literal

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from freeart21.errors import FreeArtError
from freeart21.recording import Recording
from freeart21.view.document import MOVING, REFERENCE, Section, data_url

Image = NDArray[np.uint8]
PartMasks = Callable[[int], Image]
"""Frame index to (height, width) part labels: 0 background, 1 reference, 2 moving."""

QUALITIES = (85, 75, 60, 45, 30, 15)
"""JPEG qualities to try, best first."""
_LABEL_STEP, _CONFIDENCE_STEPS = 100, 40
"""A pixel with label 0, 1, 2 is stored as 0, 100, 200, far enough apart for any colour management, plus up to 40 by its
confidence."""


@dataclass(frozen=True)
class AxisLine:
    """A joint axis in every image."""

    name: Literal["estimate", "truth"]
    colour: str
    ends: NDArray[np.float64]
    """(n, 2, 2) both ends in pixels of the recording, the positive one last; NaN where it is not visible."""


@dataclass(frozen=True)
class VideoSettings:
    """How much of a video goes into a page."""

    max_frames: int = 150
    """Longer videos are thinned out evenly."""
    max_side: int = 640
    """Pixels of the longer side; larger images are scaled down."""
    rgb_bytes: int = 6 << 20
    """Most bytes of all colour images before base64; the JPEG quality is lowered until they fit."""
    depth_bytes: int = 3 << 20
    """The same for the depth images."""


def shown_frames(n: int, most: int) -> NDArray[np.int64]:
    """At most `most` of the frames 0 to n - 1, evenly spread, first and last among them."""
    return np.unique(np.rint(np.linspace(0, n - 1, min(n, most))).astype(np.int64))


def encode_jpeg(image: Image, quality: int) -> bytes:
    """JPEG of an RGB image (height, width, 3)."""
    return _encode(image, ".jpg", [cv2.IMWRITE_JPEG_QUALITY, quality])


def fitting_quality(images: Sequence[Image], max_bytes: int) -> int:
    """The best JPEG quality at which all images fit into `max_bytes`, by a sample of six; the lowest if none does."""
    sample = [images[i] for i in shown_frames(len(images), 6)]
    for quality in QUALITIES:
        if np.mean([len(encode_jpeg(image, quality)) for image in sample]) * len(images) <= max_bytes:
            break
    return quality


def video_section(
    recording: Recording | None,
    estimate: PartMasks | None = None,
    truth: PartMasks | None = None,
    n: int | None = None,
    states: ArrayLike | None = None,
    joint_type: str = "",
    settings: VideoSettings | None = None,
    axes: Sequence[AxisLine] = (),
    confidence: PartMasks | None = None,
) -> Section:
    """The player of a recording with estimated and true parts and joint axes over it.

    Without a recording the parts are drawn on a plain background, and `n` is the number of frames. `states` (n,), rad
    or m by `joint_type`, are shown with the time; `confidence` is that of the estimated parts, 0 to 255. Raises
    FreeArtError when masks and images differ in size.
    """
    settings = settings or VideoSettings()
    masks = {"estimate": estimate, "truth": truth}
    first = next((get for get in masks.values() if get), None)
    if recording is not None:
        total, size = len(recording), (recording.camera.height, recording.camera.width)
    elif first is not None and n is not None:
        total, size = n, first(0).shape
    else:
        raise FreeArtError("a video player needs a recording, or part masks and the number of frames")
    frames = shown_frames(total, settings.max_frames)
    scale = min(1.0, settings.max_side / max(size))
    shown = max(1, round(size[1] * scale)), max(1, round(size[0] * scale))
    rgb: list[Image] = []
    depth: list[NDArray[np.float32]] = []
    labels: list[str] = []
    for i in frames.tolist():
        frame = recording.frame(i) if recording is not None else None
        if frame is not None:
            rgb.append(np.asarray(cv2.resize(frame.rgb, shown, interpolation=cv2.INTER_AREA), np.uint8))
            depth.append(np.asarray(cv2.resize(frame.depth, shown, interpolation=cv2.INTER_NEAREST), np.float32))
        found = [
            frame.mask.astype(np.uint8) if frame is not None else None,
            *(get(i) if get else None for get in masks.values()),
        ]
        labels.append(_label_image(found, i, size, shown, confidence(i) if confidence else None))
    near, far = _depth_range(depth)
    data: dict[str, Any] = {
        "width": shown[0],
        "height": shown[1],
        "frames": frames,
        "times_s": recording.times_s[frames] if recording is not None else None,
        "states": None if states is None else np.asarray(states, float)[frames],
        "joint_type": joint_type,
        "rgb": _jpeg_urls(rgb, settings.rgb_bytes),
        "depth": _jpeg_urls([_depth_image(d, near, far) for d in depth], settings.depth_bytes),
        "depth_range_m": [near, far],
        "depth_colours": _colour_bar() if depth else None,
        "labels": labels,
        "estimate": estimate is not None,
        "truth": truth is not None,
        "confidence": confidence is not None,
        "axes": [
            {"name": axis.name, "colour": axis.colour, "ends": axis_ends(axis.ends[frames], scale)} for axis in axes
        ],
        "colours": [REFERENCE, MOVING],
    }
    return Section("Video", '<div class="player"></div>', "video", data, "left")


def axis_ends(ends: NDArray[np.float64], scale: float) -> list[list[float] | None]:
    """Ends (n, 2, 2) of an axis, times `scale`, as [u0, v0, u1, v1] a frame for the scripts; None where not visible."""
    return [np.round(e * scale, 1).ravel().tolist() if np.isfinite(e).all() else None for e in ends]


def _label_image(
    masks: list[Image | None], index: int, size: tuple[int, ...], shown: tuple[int, int], confidence: Image | None
) -> str:
    """Foreground, estimated and true labels of one frame as red, green and blue of one PNG.

    The confidence of the estimated labels is added to them in eight steps, up to _CONFIDENCE_STEPS.
    """
    image = np.zeros((shown[1], shown[0], 3), np.uint8)
    for k, (what, mask) in enumerate(zip(("foreground", "estimated parts", "true parts"), masks, strict=True)):
        if mask is None:
            continue
        if mask.shape != size:
            raise FreeArtError(
                f"frame {index}: the mask of the {what} is {mask.shape[1]} x {mask.shape[0]}, "
                f"expected {size[1]} x {size[0]} as the video"
            )
        image[..., k] = _LABEL_STEP * cv2.resize(mask, shown, interpolation=cv2.INTER_NEAREST)
        if k == 1 and confidence is not None:
            level = cv2.resize(confidence, shown, interpolation=cv2.INTER_NEAREST).astype(np.uint16)
            steps = (8 * level + 127) // 255 * (_CONFIDENCE_STEPS // 8)
            image[..., k] += np.where(image[..., k] > 0, steps, 0).astype(np.uint8)
    return data_url("image/png", _encode(image, ".png", [cv2.IMWRITE_PNG_COMPRESSION, 6]))


def _jpeg_urls(images: list[Image], max_bytes: int) -> list[str] | None:
    if not images:
        return None
    quality = fitting_quality(images, max_bytes)
    return [data_url("image/jpeg", encode_jpeg(image, quality)) for image in images]


def _encode(image: Image, suffix: str, options: list[int]) -> bytes:
    ok, data = cv2.imencode(suffix, cv2.cvtColor(image, cv2.COLOR_RGB2BGR), options)
    if not ok:
        raise FreeArtError(f"cannot encode an image of shape {image.shape} as {suffix}")
    return data.tobytes()


def _depth_range(depths: list[NDArray[np.float32]]) -> tuple[float, float]:
    """Depths, m, between which 98 % of the measured ones lie."""
    sampled = [depth[::4, ::4] for depth in depths]
    measured = np.concatenate([depth[depth > 0] for depth in sampled]) if sampled else np.zeros(0)
    if not len(measured):
        return 0.0, 1.0
    near, far = np.percentile(measured, [1, 99])
    return float(near), float(max(far, near + 1e-3))


def _depth_image(depth: NDArray[np.float32], near: float, far: float) -> Image:
    """Near bright, far dark; grey where nothing was measured."""
    level = np.clip(255 * (far - depth) / (far - near), 0, 255).astype(np.uint8)
    colours = np.asarray(cv2.applyColorMap(level, cv2.COLORMAP_VIRIDIS)[..., ::-1], np.uint8)
    return np.where((depth <= 0)[..., None], np.uint8(200), colours)


def _colour_bar() -> list[str]:
    """Colours of the depth images from near to far, for the legend."""
    levels = np.linspace(255, 0, 9).astype(np.uint8)[None]
    return [f"#{r:02x}{g:02x}{b:02x}" for b, g, r in cv2.applyColorMap(levels, cv2.COLORMAP_VIRIDIS)[0].tolist()]
