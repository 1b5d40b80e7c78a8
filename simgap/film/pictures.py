"""One frame three times: as it was measured, as it is simulated, and as the simulated camera with its faults has it."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from freeart21.camera_faults import CameraFaults
from freeart21.recording import Recording
from simgap.film.samples import simulated
from simgap.film.scene import FilmScene

Image = NDArray[np.uint8]
MARGIN = 0.12
"""Share of the object's box that is shown round it."""
WIDEST = 420
"""Pixels of a picture on the page, at most."""


@dataclass(frozen=True)
class Shown:
    """Pictures of one frame."""

    frame: int
    colours: tuple[Image, Image, Image]
    """(h, w, 3) measured, simulated, after."""
    depths: tuple[Image, Image, Image]
    near: float
    far: float
    """Metres: the depth's darkest and lightest colour."""


def shown(recording: Recording, scene: FilmScene, index: int, camera: CameraFaults) -> Shown:
    """The frame `index` before and after. What is random is drawn from the frame's number."""
    fps = 1 / float(np.median(np.diff(recording.times_s)))
    frame = recording.frame(index)
    ideal = simulated(scene, recording.camera, CameraFaults(), index, fps).colour
    then = simulated(scene, recording.camera, camera, index, fps)
    share = index / max(len(recording) - 1, 1)
    rest = CameraFaults(**{**vars(camera), "depth_shift_u": 0.0, "depth_shift_v": 0.0, "depth_turn": 0.0})
    rng = np.random.default_rng([index, 51])
    depth = rest.depth(then.depth.depth, then.depth.brightness, then.depth.cosine, recording.camera, rng)
    rgb = camera.colour(np.rint(then.colour.rgb).astype(np.uint8), share)
    on = frame.mask | (ideal.part > 0)
    rows, columns = np.flatnonzero(on.any(1)), np.flatnonzero(on.any(0))
    h, w = on.shape
    pad = int(MARGIN * max(np.ptp(rows), np.ptp(columns))) + 4
    box = (
        slice(max(rows[0] - pad, 0), min(rows[-1] + pad, h)),
        slice(max(columns[0] - pad, 0), min(columns[-1] + pad, w)),
    )
    seen = ideal.depth[ideal.depth > 0]
    near, far = float(seen.min()), float(seen.max())
    room = 0.15 * max(far - near, 0.02 * far)
    near, far = near - room, far + room
    depths = [np.where(on | (d > 0) & (d < far), d, 0)[box] for d in (frame.depth, ideal.depth, depth)]
    colours = [frame.rgb[box], np.rint(ideal.rgb).astype(np.uint8)[box], rgb[box]]
    return Shown(
        index,
        tuple(_sized(c) for c in colours),  # type: ignore[arg-type]
        tuple(_sized(_coloured(d, near, far)) for d in depths),  # type: ignore[arg-type]
        near,
        far,
    )


def _sized(image: NDArray) -> Image:
    factor = min(WIDEST / image.shape[1], 4.0)
    how = cv2.INTER_NEAREST if factor > 1 else cv2.INTER_AREA
    return np.asarray(cv2.resize(image, None, fx=factor, fy=factor, interpolation=how), np.uint8)


def _coloured(depth: NDArray, near: float, far: float) -> Image:
    """Near dark, far light (viridis); none is white, beyond is grey."""
    level = np.clip((depth - near) / max(far - near, 1e-9), 0, 1)
    out = cv2.applyColorMap((255 * level).astype(np.uint8), cv2.COLORMAP_VIRIDIS)[..., ::-1].copy()
    out[depth <= 0] = 255
    out[depth > far] = 128
    return np.asarray(out, np.uint8)


def heat(values: NDArray[np.float64], reach: float) -> Image:
    """(h, w, 3) of signed values: blue below zero, red above, white at zero, light grey where there are none."""
    level = np.clip(np.nan_to_num(values) / max(reach, 1e-15), -1, 1)[..., None]
    red, blue, white = np.array([213, 94, 0.0]), np.array([0, 114, 178.0]), np.array([255, 255, 255.0])
    out = np.where(level > 0, white + level * (red - white), white - level * (blue - white))
    out[~np.isfinite(values)] = 225
    return np.asarray(np.rint(out).astype(np.uint8))
