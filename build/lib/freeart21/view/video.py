"""The video player: pictures, depth, foreground, and the parts that were found or are true."""

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
"""Frame index to (height, width) part labels: 0 neither, 1 reference, 2 moving."""

_LABEL_STEP = 100
"""Labels 0, 1, 2 are stored as 0, 100, 200, far enough apart to survive any colour management."""


_SURE = 40
"""Added to the label of a pixel of full confidence."""


@dataclass(frozen=True)
class AxisLine:
    """A joint axis as it stands in every picture."""

    name: Literal["found", "truth"]
    colour: str
    ends: NDArray[np.float64]
    """(n, 2, 2) both ends in pixels of the recording, the positive one last; NaN where there is nothing to draw."""


@dataclass(frozen=True)
class VideoSettings:
    """How much of a video goes into a page."""

    max_frames: int = 150
    """Frames in the page; longer videos are thinned out evenly."""
    max_side: int = 640
    """Pixels of the longer side; larger pictures are scaled down."""
    rgb_bytes: int = 6 << 20
    """Most bytes of all pictures together, before base64: the JPEG quality comes down until they fit."""
    depth_bytes: int = 3 << 20
    """The same for the coloured depth."""
    qualities: tuple[int, ...] = (85, 75, 60, 45, 30, 15)
    """JPEG qualities to try, best first."""


def shown_frames(n: int, most: int) -> NDArray[np.int64]:
    """At most `most` of the frames 0 to n - 1, evenly spread, first and last among them."""
    return np.unique(np.rint(np.linspace(0, n - 1, min(n, most))).astype(np.int64))


def video_section(
    recording: Recording | None,
    found: PartMasks | None = None,
    truth: PartMasks | None = None,
    n: int | None = None,
    states: ArrayLike | None = None,
    joint_type: str = "",
    settings: VideoSettings | None = None,
    axes: Sequence[AxisLine] = (),
    confidence: PartMasks | None = None,
) -> Section:
    """The player of a recording with found and true parts and joint axes over it.

    Without a recording the parts stand on a plain ground and `n` tells how many frames there are. `states` (n,), rad
    or m by `joint_type`, are told beside the time; `confidence` is that of the found parts, in 255ths. Raises
    FreeArtError when masks have another size than the pictures.
    """
    settings = settings or VideoSettings()
    total = len(recording) if recording is not None else n
    if total is None or (recording is None and found is None and truth is None):
        raise FreeArtError("a video player needs a recording, or part masks and the number of frames")
    frames = shown_frames(total, settings.max_frames)
    first = next(masks(0) for masks in (found, truth) if masks) if recording is None else None
    size = first.shape if first is not None else (recording.camera.height, recording.camera.width)  # type: ignore[union-attr]
    scale = min(1.0, settings.max_side / max(size))
    width, height = max(1, round(size[1] * scale)), max(1, round(size[0] * scale))
    pictures: list[Any] = []
    depths: list[Any] = []
    labels: list[str] = []
    for i in frames.tolist():
        frame = recording.frame(i) if recording is not None else None
        if frame is not None:
            pictures.append(cv2.resize(frame.rgb, (width, height), interpolation=cv2.INTER_AREA))
            depths.append(cv2.resize(frame.depth, (width, height), interpolation=cv2.INTER_NEAREST))
        masks = [
            frame.mask.astype(np.uint8) if frame is not None else None,
            *(masks(i) if masks else None for masks in (found, truth)),
        ]
        sure = confidence(i) if confidence is not None else None
        labels.append(_labels(masks, i, (size[0], size[1]), (width, height), sure))
    near, far = _depth_range(depths)
    return Section(
        "Video",
        '<div class="player"></div>',
        "video",
        {
            "width": width,
            "height": height,
            "total": total,
            "frames": frames,
            "times_s": recording.times_s[frames] if recording is not None else None,
            "states": None if states is None else np.asarray(states, float)[frames],
            "joint_type": joint_type,
            "rgb": _jpegs(pictures, settings.rgb_bytes, settings.qualities) if pictures else None,
            "depth": _jpegs(
                [_depth_colours(depth, near, far) for depth in depths], settings.depth_bytes, settings.qualities
            )
            if depths
            else None,
            "depth_range_m": [near, far],
            "depth_colours": _colour_bar() if depths else None,
            "labels": labels,
            "found": found is not None,
            "truth": truth is not None,
            "confidence": confidence is not None,
            "axes": [
                {
                    "name": axis.name,
                    "colour": axis.colour,
                    "ends": [
                        np.round(ends * scale, 1).ravel() if np.isfinite(ends).all() else None
                        for ends in axis.ends[frames]
                    ],
                }
                for axis in axes
            ],
            "colours": [REFERENCE, MOVING],
        },
        "left",
    )


def _labels(
    masks: list[Image | None], index: int, size: tuple[int, int], shown: tuple[int, int], confidence: Image | None
) -> str:
    """Foreground, found and true labels of one frame as the red, green and blue of one PNG.

    The confidence of the found ones is added to them in eight steps, up to _SURE.
    """
    image = np.zeros((shown[1], shown[0], 3), np.uint8)
    for k, (what, mask) in enumerate(zip(("foreground", "found parts", "true parts"), masks, strict=True)):
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
            image[..., k] += np.where(image[..., k] > 0, (8 * level + 127) // 255 * (_SURE // 8), 0).astype(np.uint8)
    return data_url("image/png", _encode(image, ".png", [cv2.IMWRITE_PNG_COMPRESSION, 6]))


def _jpegs(images: list[Image], budget: int, qualities: tuple[int, ...]) -> list[str]:
    """JPEGs of the best quality at which they fit the budget, judged by a few of them."""
    sample = [images[i] for i in shown_frames(len(images), 6)]
    for quality in qualities:
        options = [cv2.IMWRITE_JPEG_QUALITY, quality]
        mean = np.mean([len(_encode(image, ".jpg", options)) for image in sample])
        if mean * len(images) <= budget:
            break
    return [data_url("image/jpeg", _encode(image, ".jpg", options)) for image in images]


def _encode(image: Image, suffix: str, options: list[int]) -> bytes:
    ok, data = cv2.imencode(suffix, cv2.cvtColor(image, cv2.COLOR_RGB2BGR), options)
    if not ok:
        raise FreeArtError(f"cannot encode an image of shape {image.shape} as {suffix}")
    return data.tobytes()


def _depth_range(depths: list[NDArray[np.float32]]) -> tuple[float, float]:
    """Metres between which 98 % of all measured depths lie."""
    some = [depth[::4, ::4] for depth in depths]
    measured = np.concatenate([depth[depth > 0] for depth in some]) if some else np.zeros(0)
    if not len(measured):
        return 0.0, 1.0
    near, far = np.percentile(measured, [1, 99])
    return float(near), float(max(far, near + 1e-3))


def _depth_colours(depth: NDArray[np.float32], near: float, far: float) -> Image:
    """Near bright, far dark; mid-grey where nothing was measured."""
    level = np.clip(255 * (far - depth) / (far - near), 0, 255).astype(np.uint8)
    colours = cv2.cvtColor(cv2.applyColorMap(level, cv2.COLORMAP_VIRIDIS), cv2.COLOR_BGR2RGB)
    colours[depth <= 0] = 200
    return colours


def _colour_bar() -> list[str]:
    """The depth colours from near to far, for the legend."""
    levels = np.linspace(255, 0, 9).astype(np.uint8)[None]
    return [f"#{r:02x}{g:02x}{b:02x}" for b, g, r in cv2.applyColorMap(levels, cv2.COLORMAP_VIRIDIS)[0].tolist()]
