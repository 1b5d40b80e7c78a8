"""Training images of the Gaussians: windows round the object at the recording's resolution."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from freeart21.recording import Frame, Recording
from freeart21.se3 import Floats
from reconstruct.gaussians.losses import Target
from reconstruct.gaussians.rasteriser import Lens
from reconstruct.kernels import map_in_threads
from reconstruct.scene import Scene, estimate_depth_noise

MARGIN = 8
"""Pixels of a frame's window round its mask."""
NOISE_FRAMES = 12
"""Frames from which the depth noise is estimated."""
EXACT, AS_COLOUR = 0.1, 0.015
"""Accuracy of the model's depth, footprints, and colour error, sRGB from 0 to 1, that weighs as much as one standard
deviation of depth: typical of a model of a video. With the paper's depth weight, blurred outlines drew the surface of
the clean torch_lighter 0.4 pixels inward; with 10 times that, 0.01."""
JUMP = 4.0
"""Footprints plus noise deviations between neighbouring depths above which neither is used: sensors mix depths
there."""


@dataclass(frozen=True)
class Window:
    """A frame's image of the object, with its lens."""

    lens: Lens
    rgb: NDArray[np.uint8]
    """(h, w, 3)."""
    depth: Floats
    """(h, w) metres; minus the depth of anything else; 0 where there is none or it is unreliable."""
    mask: NDArray[np.bool_]
    """(h, w) foreground."""
    corner: tuple[int, int]
    """Column and row of its first pixel in the recording's image."""

    def reduced(self, factor: int) -> Window:
        """The same sampled down by a whole factor, `corner` unchanged."""
        h, w = (side // factor * factor for side in self.mask.shape)
        size = (w // factor, h // factor)
        rgb = np.asarray(cv2.resize(self.rgb[:h, :w], size, interpolation=cv2.INTER_AREA), np.uint8)
        mask = cv2.resize(self.mask[:h, :w].astype(np.float32), size, interpolation=cv2.INTER_AREA) > 0.5
        depth = _at_centres(self.depth[:h, :w], factor)
        depth = np.where(mask, np.maximum(depth, 0), np.minimum(depth, 0))
        fx, fy, cx, cy = (value / factor for value in (self.lens.fx, self.lens.fy, self.lens.cx, self.lens.cy))
        return Window(Lens(fx, fy, cx, cy, *size), rgb, depth, mask, self.corner)

    def target(self) -> Target:
        """The same as numbers."""
        colour = self.rgb.astype(np.float32) / np.float32(255)
        return Target(colour, np.maximum(self.depth, 0), self.mask, np.maximum(-self.depth, 0))


@dataclass(frozen=True)
class Windows:
    """The windows of all frames."""

    frames: tuple[Window | None, ...]
    """None where a frame shows nothing."""
    footprint: float
    """Metres a pixel covers at the object."""
    noise: float
    """Standard deviation of the depth, metres."""
    diagonal: float
    """Size of the object, metres."""
    factor: int
    """Recorded pixels per window pixel, each way."""

    @property
    def nonempty(self) -> NDArray[np.bool_]:
        """(n,) frames that show the object."""
        return np.array([window is not None for window in self.frames])

    @property
    def depth_unit(self) -> float:
        """Unit of the depth loss, metres: half the object's diagonal (the paper's objects are of about 2 m), or less
        where an exact sensor's depth says more than colour."""
        return min(self.diagonal / 2, math.hypot(self.noise, EXACT * self.footprint) / AS_COLOUR)

    def reduced(self, factor: int) -> Windows:
        """The same sampled down by a whole factor."""
        frames = tuple(window and window.reduced(factor) for window in self.frames)
        return replace(self, frames=frames, footprint=factor * self.footprint, factor=factor * self.factor)

    def in_crop(self, i: int, image: Floats, scene: Scene) -> Floats:
        """An image (h, w) of frame i's window resampled to the scene's crop (h, w); NaN outside."""
        h, w = scene.mask.shape[1:]
        left, top = self[i].corner
        found = np.full((h, w), np.nan, np.float32)
        x = (scene.origin[i, 0] + np.arange(w) * scene.factor + scene.factor // 2 - left) // self.factor
        y = (scene.origin[i, 1] + np.arange(h) * scene.factor + scene.factor // 2 - top) // self.factor
        columns, rows = (x >= 0) & (x < image.shape[1]), (y >= 0) & (y < image.shape[0])
        found[np.ix_(rows, columns)] = image[np.ix_(y[rows], x[columns])]
        return found

    def __getitem__(self, i: int) -> Window:
        window = self.frames[i]
        assert window is not None, i
        return window


def make_windows(recording: Recording, scene: Scene, most_pixels: int) -> Windows:
    """The windows of a recording, sampled down by a whole factor where foregrounds have more than `most_pixels`."""
    pixels = float(np.mean(scene.mask.sum((1, 2)))) * scene.factor**2
    factor = max(1, math.ceil(math.sqrt(pixels / most_pixels)))
    footprint = scene.footprint / scene.factor * factor
    K = recording.camera.K
    some = [recording.frame(i) for i in np.linspace(0, len(recording) - 1, NOISE_FRAMES).round().astype(int)]
    noise = estimate_depth_noise(np.stack([np.where(frame.mask, frame.depth, 0) for frame in some]).astype(np.float32))

    def load(i: int) -> Window | None:
        return _window(recording.frame(i), K, factor, JUMP * footprint + 4 * noise)

    frames = tuple(map_in_threads(load, len(recording)))
    return Windows(frames, footprint, noise, scene.diagonal, factor)


def _window(frame: Frame, K: NDArray[np.float64], factor: int, jump: float) -> Window | None:
    ys, xs = np.flatnonzero(frame.mask.any(1)), np.flatnonzero(frame.mask.any(0))
    if not len(xs):
        return None
    height, width = frame.mask.shape
    margin = MARGIN * factor
    top, left = max(0, int(ys[0]) - margin), max(0, int(xs[0]) - margin)
    h, w = (min(height, int(ys[-1]) + 1 + margin) - top), (min(width, int(xs[-1]) + 1 + margin) - left)
    h, w = h // factor * factor, w // factor * factor
    box = np.s_[top : top + h, left : left + w]
    mask = frame.mask[box]
    near = np.where(mask, frame.depth[box], 0).astype(np.float32)
    low = cv2.erode(np.where(near > 0, near, np.float32(np.inf)), np.ones((3, 3)))
    sound = (near > 0) & (cv2.dilate(near, np.ones((3, 3))) - low < jump)
    depth = np.where(mask, np.where(sound, near, 0), -frame.depth[box]).astype(np.float32)
    lens = Lens(K[0, 0], K[1, 1], K[0, 2] - left, K[1, 2] - top, w, h)
    window = Window(lens, frame.rgb[box].copy(), depth, mask.copy(), (left, top))
    return window.reduced(factor) if factor > 1 else window


def _at_centres(depth: Floats, factor: int) -> Floats:
    """Signed depth (h, w) at the centres of blocks of `factor` pixels each way; 0 where unreliable.

    The centre of an even block lies between four pixels: using one of them would be half a pixel off lens and colours.
    """
    middle = ((factor - 1) // 2, factor // 2)
    four = np.stack([depth[i::factor, j::factor] for i in middle for j in middle])
    same_sign = (four > 0).all(0) | (four < 0).all(0)
    return np.where(same_sign, four.mean(0), 0).astype(np.float32)
