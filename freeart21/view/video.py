"""The video player: colour and depth images, and the parts of one or more sources over them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from freeart21.errors import FreeArtError
from freeart21.recording import Recording
from freeart21.view.document import Section, data_url
from freeart21.view.source import Source

Image = NDArray[np.uint8]

LABEL_STEP, CONFIDENCE_STEPS = 100, 40
"""A pixel with label 0, 1, 2 is stored as 0, 100, 200, far enough apart for any colour management, plus up to 40 by its
confidence."""


MAX_FRAMES = 150
"""Longer videos are thinned out evenly."""


def shown_frames(n: int, most: int) -> NDArray[np.int64]:
    """At most `most` of the frames 0 to n - 1, evenly spread, first and last among them."""
    return np.unique(np.rint(np.linspace(0, n - 1, min(n, most))).astype(np.int64))


def jpeg_bytes(image: Image, quality: int) -> bytes:
    """JPEG of an RGB image (height, width, 3)."""
    options = [cv2.IMWRITE_JPEG_QUALITY, quality]
    return cv2.imencode(".jpg", cv2.cvtColor(image, cv2.COLOR_RGB2BGR), options)[1].tobytes()


def jpeg_url(image: Image, quality: int) -> str:
    """JPEG of an RGB image (height, width, 3) as a data: address."""
    return data_url("image/jpeg", jpeg_bytes(image, quality))


def video_section(
    recording: Recording | None,
    sources: Sequence[Source] = (),
    max_frames: int = MAX_FRAMES,
    sides: tuple[int, int] = (640, 640),
    quality: int = 80,
    with_depth: bool = True,
    note: str = "Solid outline and stronger colour: moving part; dashed: reference part.",
) -> Section:
    """The player of a recording, with the parts and axes of sources and the recording's own masks over it.

    Without a recording the parts of the first source are drawn on a plain background. The first one's states are shown
    with the time. Images and masks are scaled down to `sides`, pixels of the longer one. `quality` is that of JPEGs:
    150 frames of 640 x 360 pixels take some 6 MB. Raises FreeArtError when masks and images differ in size.
    """
    first = sources[0] if sources else Source("")
    camera = None if recording is None else recording.camera
    if recording is not None:
        total, size = len(recording), (recording.camera.height, recording.camera.width)
    elif first.masks is not None:
        total, (height, width) = len(first.states), first.masks(0).shape
        size = height, width
    else:
        raise FreeArtError("a video player needs a recording, or part masks")
    frames = shown_frames(total, max_frames)
    shown, small = (_scaled(size, side) for side in sides)
    rgb: list[str] = []
    depth: list[NDArray[np.float32]] = []
    given: dict[int, Image] = {}
    note = note if any(source.masks for source in sources) else ""
    if recording is not None:
        sources = [*sources, Source("given mask", ("#ffffff", "#ffffff"), masks=given.pop, shown=False)]
    labels: list[list[str]] = [[] for _ in sources]
    for i in frames.tolist():
        if recording is not None:
            frame = recording.frame(i)
            image = np.asarray(cv2.resize(frame.rgb, shown, interpolation=cv2.INTER_AREA), np.uint8)
            rgb.append(jpeg_url(image, quality))
            if with_depth:
                depth.append(np.asarray(cv2.resize(frame.depth, shown, interpolation=cv2.INTER_NEAREST), np.float32))
            given[i] = 2 * frame.mask.astype(np.uint8)
        for source, found in zip(sources, labels, strict=True):
            if source.masks is not None:
                mask = source.masks(i)
                if mask.shape != size:
                    raise FreeArtError(
                        f"frame {i}: the mask of the {source.name} is {mask.shape[1]} x {mask.shape[0]}, "
                        f"expected {size[1]} x {size[0]} as the video"
                    )
                found.append(_label_image(mask, source.confidence and source.confidence(i), small))
    near, far = _depth_range(depth)
    lines = [source.axis_in_images(camera) for source in sources]
    data: dict[str, Any] = {
        "width": shown[0],
        "height": shown[1],
        "label_size": small,
        "frames": frames,
        "times_s": recording.times_s[frames] if recording is not None else None,
        "states": None if first.articulation is None or first.zero is not None else first.states[frames],
        "joint_type": "" if first.articulation is None else first.joint.type,
        "rgb": rgb or None,
        "depth": [_depth_url(one, near, far, quality) for one in depth] or None,
        "depth_range_m": [near, far],
        "sources": [
            {
                "name": source.name,
                "colours": source.colours,
                "labels": own or None,
                "axis": None
                if line is None
                else [
                    np.round(ends * shown[0] / size[1], 1).ravel() if np.isfinite(ends).all() else None
                    for ends in line[frames]
                ],
                "axis_colour": source.axis_colour or source.colours[1],
                "shown": source.shown,
                "confidence": source.confidence is not None,
                "absent": source.absent,
            }
            for source, own, line in zip(sources, labels, lines, strict=True)
        ],
    }
    return Section("Video", "", "video", data, "left", note)


def _scaled(size: tuple[int, ...], side: int) -> tuple[int, int]:
    """(width, height) of an image of `size` (height, width), scaled down to a longer side of `side` pixels."""
    scale = min(1.0, side / max(size))
    return max(1, round(size[1] * scale)), max(1, round(size[0] * scale))


def _label_image(mask: Image, confidence: Image | None, size: tuple[int, int]) -> str:
    """Labels of one frame as a PNG, with their confidence in eight steps up to CONFIDENCE_STEPS."""
    image = LABEL_STEP * cv2.resize(mask, size, interpolation=cv2.INTER_NEAREST)
    if confidence is not None:
        level = cv2.resize(confidence, size, interpolation=cv2.INTER_NEAREST).astype(np.uint16)
        image = image + np.where(image > 0, (8 * level + 127) // 255 * (CONFIDENCE_STEPS // 8), 0).astype(np.uint8)
    return data_url("image/png", cv2.imencode(".png", image, [cv2.IMWRITE_PNG_COMPRESSION, 6])[1].tobytes())


def _depth_range(depths: list[NDArray[np.float32]]) -> tuple[float, float]:
    """Depths, m, between which 98 % of the measured ones lie."""
    sampled = [depth[::4, ::4] for depth in depths]
    measured = np.concatenate([depth[depth > 0] for depth in sampled]) if sampled else np.zeros(0)
    if not len(measured):
        return 0.0, 1.0
    near, far = np.percentile(measured, [1, 99])
    return float(near), float(max(far, near + 1e-3))


def _depth_url(depth: NDArray[np.float32], near: float, far: float, quality: int) -> str:
    """Near bright, far dark (viridis); grey where nothing was measured."""
    level = np.clip(255 * (far - depth) / (far - near), 0, 255).astype(np.uint8)
    colours = np.asarray(cv2.applyColorMap(level, cv2.COLORMAP_VIRIDIS)[..., ::-1], np.uint8)
    return jpeg_url(np.where((depth <= 0)[..., None], np.uint8(200), colours), quality)
