"""The sensor `phone`: depth of a phone's LiDAR, a few dots filled in along the colours.

Sources
-------
[1] Apple, ARKit, `ARDepthData` and `ARFrame.sceneDepth`: LiDAR and colour are fused to a depth map over the picture;
    it has 256 x 192 pixels.
[2] Luetzenburg, Kroon, Bjørk, Evaluation of the Apple iPhone 12 Pro LiDAR for an Application in Geosciences, Scientific
    Reports 11:22221, 2021: 576 dots, which is 24 x 24; objects of 10 cm and more to about 1 cm.
[3] Teo, Yang, Evaluating the accuracy and quality of an iPad Pro's built-in lidar for 3D indoor mapping, Developments
    in the Built Environment 14:100169, 2023: under 1 mm from the best plane with the device at rest, 1 cm in motion.
[4] A Record3D clip of a desk (github.com/mbertini/record3d_viewer, d09534a), measured here, 16 frames: rms distance
    from planes fitted to windows of 24 x 24 pixels of the map .40 mm at .28 m, .86 at .45, 1.2 at .6, 1.4 at .85, 1.0
    at 1.2 and 6 at 3 m: about 1.7 mm a metre. Its autocorrelation in windows of 40 x 40 is .81 to .89 at 2 pixels, .7
    at 4, .53 at 6, .36 at 8, .1 at 12 and none at 16. Values are half-precision floats. A depth step takes 5 pixels
    from 10 to 90 % (median of 984; quartiles 3 and 9).

Model
-----
- 24 x 24 dots [2], a fixed pattern in the picture. A dot measures the depth at its centre: of two surfaces in a dot the
  stronger echo counts, not their mean (assumed). Outside of what is drawn it meets a wall, `tof.ROOM_BEHIND_M` behind.
- noise of a dot: normal, a share of the depth, that makes the rms distances of [4].
- filling: at every pixel of the map a plane in inverse depth is fitted to the dots around it, weighted by distance and
  by difference of base colour. The widths are those that make the autocorrelation and the steps of [4]. So edges are
  rounded and displaced, and what is smaller than the spacing of the dots has the depth of what is around it.
- the map, in half precision [4], is sampled up to the video's size linearly.
Not modelled: noise that lasts for some frames (in [4] .6 to .9 of it is there a sixtieth of a second later, a third
after 4), confidence, lost dots, a common offset of the distance.
"""

from __future__ import annotations

import math

import cv2
import numpy as np
from numba import njit
from numpy.typing import NDArray

from generator.sensors.base import SensorModel
from generator.tof import ROOM_BEHIND_M

Map = NDArray[np.float32]
"""(height, width)."""

DOTS = 24
"""Across the picture and down a picture of 3:4."""
MAP_WIDTH = 256
"""Pixels of the depth map across the picture."""
NOISE_SHARE = 0.0085
"""Standard deviation of a dot, as a share of its depth: filled in, 0.17 % remain."""
SPREAD, SPREAD_COLOUR = 0.65, 0.1
"""Standard deviations of the weights: in spacings of the dots, and in sRGB-like colour (root of the linear one)."""
REACH = 2
"""Dots each way that a pixel is filled from."""
STIFFNESS = 0.05
"""Weight of a flat surface against the slopes that the dots show, in dots."""


class Phone(SensorModel):
    """A phone of the iPhone 12 Pro class."""

    name = "phone"
    replaces = "depth"

    def depth(self, depth: NDArray[np.float32], rng: np.random.Generator) -> NDArray[np.float32]:
        """See `SensorModel.depth`."""
        if not (depth > 0).any():
            return depth
        base, _ = self.video.scene.materials()
        return np.where(depth > 0, measure(depth, np.sqrt(np.clip(base, 0, 1)), rng), np.float32(0))


def measure(depth: Map, colour: NDArray[np.float32], rng: np.random.Generator) -> Map:
    """The depth (height, width), metres, that a phone gives of `depth`, 0 where nothing is drawn, guided by `colour`
    (height, width, 3), 0 to 1."""
    height, width = depth.shape
    size = MAP_WIDTH, max(round(MAP_WIDTH * height / width), 1)
    spacing = np.array([MAP_WIDTH * 3 / 4, MAP_WIDTH]) / DOTS  # row, column
    counts = np.maximum(np.round(np.array(size[::-1]) / spacing).astype(int), 2)
    rows, columns = ((np.arange(n) + 0.5) * full / n for n, full in zip(counts, (height, width), strict=True))
    at = np.ix_(rows.astype(int), columns.astype(int))
    wall = np.float32(depth.max() + ROOM_BEHIND_M)
    dots = np.where(depth > 0, depth, wall)[at]
    dots = dots * (1 + np.float32(NOISE_SHARE) * rng.standard_normal(dots.shape, np.float32))
    guide = np.asarray(cv2.resize(colour, size, interpolation=cv2.INTER_AREA), np.float32)
    filled = _fill(1 / dots, np.ascontiguousarray(colour[at]), guide).astype(np.float16).astype(np.float32)
    return np.asarray(cv2.resize(filled, (width, height), interpolation=cv2.INTER_LINEAR), np.float32)


@njit(cache=True)
def _fill(inverse: Map, colours: Map, guide: Map) -> Map:  # pragma: no cover
    """Depth (h, w) of planes in inverse depth, each fitted to the dots (r, c) around a pixel of `guide` (h, w, 3)."""
    h, w = guide.shape[:2]
    filled = np.zeros((h, w), np.float32)
    for y in range(h):
        for x in range(w):
            v, u = (y + 0.5) * inverse.shape[0] / h - 0.5, (x + 0.5) * inverse.shape[1] / w - 0.5
            s = sx = sy = sxx = sxy = syy = sq = sxq = syq = 0.0
            least, most = np.inf, 0.0
            for j in range(max(round(v) - REACH, 0), min(round(v) + REACH + 1, inverse.shape[0])):
                for i in range(max(round(u) - REACH, 0), min(round(u) + REACH + 1, inverse.shape[1])):
                    dx, dy, q, off = i - u, j - v, inverse[j, i], 0.0
                    for c in range(3):
                        off += ((guide[y, x, c] - colours[j, i, c]) / SPREAD_COLOUR) ** 2
                    k = math.exp(-0.5 * ((dx * dx + dy * dy) / SPREAD**2 + off)) + 1e-6
                    s += k
                    sx += k * dx
                    sy += k * dy
                    sxx += k * dx * dx
                    sxy += k * dx * dy
                    syy += k * dy * dy
                    sq += k * q
                    sxq += k * dx * q
                    syq += k * dy * q
                    least, most = min(least, q), max(most, q)
            sxx += STIFFNESS * s
            syy += STIFFNESS * s
            c11, c12, c13 = sxx * syy - sxy * sxy, sxy * sy - sx * syy, sx * sxy - sxx * sy
            q = (c11 * sq + c12 * sxq + c13 * syq) / (s * c11 + sx * c12 + sy * c13)
            filled[y, x] = 1 / min(max(q, least), most)
    return filled
