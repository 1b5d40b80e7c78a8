"""A time-of-flight depth camera of the Orbbec Femto Bolt class (the depth camera of Microsoft's Azure Kinect).

Noise is metric: it has as many millimetres on a lighter as on a wardrobe, so that small objects suffer more.

Sources
-------
[1] Orbbec, Femto Bolt Hardware Specifications (orbbec.com/documentation/femto-bolt-hardware-specifications): the
    1 Mpixel depth camera designed by Microsoft; NFOV unbinned 640 x 576 over 75 x 65 degrees, 0.5 to 3.86 m; WFOV from
    0.25 m; exposure 12.8 ms.
[2] Microsoft, Azure Kinect DK: gain is chosen for each pixel (depth camera page). From memory, not read again: at
    reflectivities of 15 to 95 % random error of standard deviation <= 17 mm and systematic error < 11 mm + 0.1 % of the
    distance; depth may be given beyond the operating range, by the object's reflectivity; pixels are invalid that are
    saturated, have too weak a signal, or mix foreground and background.
[3] Tölgyessy, Dekan, Chovanec, Hubinský, Evaluation of the Azure Kinect and Its Comparison to Kinect V1 and Kinect V2,
    Sensors 21(2):413, 2021: confirms <= 17 mm and < 11 mm up to 3.5 m; flying pixels at edges. From memory, not read
    again: standard deviation in NFOV unbinned 0.61 mm at 0.8 m, 0.89 mm at 1.5 m, 1.78 mm at 3 m.
[4] Kurillo, Hemingway, Cheng, Cheng, Evaluating the Accuracy of the Azure Kinect and Kinect v2, Sensors 22(7):2469,
    2022: random error grows with distance and towards the rim of the picture.
[5] Nguyen, Izadi, Lovell, Modeling Kinect Sensor Noise for Improved 3D Reconstruction and Tracking, 3DIMPVT 2012: axial
    noise grows with the angle of the surface, steeply beyond 60 degrees, and little is left beyond 80.
[6] Lange, 3D Time-of-Flight Distance Measurement, dissertation, Siegen 2000: noise follows the root of the collected
    light, then its inverse; amplitude-weighted mixing within a pixel's footprint makes flying pixels; a periodic
    distance error ('wiggling') comes from harmonics of the modulation.

Model
-----
The camera's light sits at the lens. A surface of infrared albedo a, gloss g and angle t to the ray, at range r, returns
    s = (a (1 - g) cos t + h) / (0.8 r^2)                    1 = a white wall at 1 m, facing the camera
- noise: variance 0.23 + 0.22 / s + 0.012 / s^2 mm^2, which goes through the three values of [3]. A surface of 15 % at
  3.86 m gets 9.6 mm, within [2].
- systematic error: 0.1 % of the distance at most, and two waves of 1.5 mm whose phases come from the seed (assumed: [2]
  bounds their sum, not their form).
- mixing: a pixel sees its neighbours through a Gaussian of 1.2 mrad (0.6 pixels of [1], assumed), and gives their mean
  depth weighted by signal. Outside the object it sees a room of albedo 0.5, one metre behind the object (assumed; the
  recordings have no room). Depth outside what is drawn stays empty.
- no depth: signal weaker than that of 17 mm noise; s above 45, a white wall at 0.15 m (assumed); angles from 78 to 86
  degrees (assumed, after [5]); half of the pixels whose mixture spreads over more than 20 mm (assumed, after [2]).
- highlight h: Blinn-Phong with the light at the lens, g (n + 2) / 8 cos^(n + 1) t, n = 230 g, about the exponents that
  `generator.model.SHINE` goes with.
- steps of 1 mm.
Infrared albedo is taken as the mean of the linear base colour, at least 3 % (assumed; many dyes are brighter there).
Not modelled: light that takes two bounces, motion within the exposure, warming up, the baseline to the colour camera.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numba
import numpy as np
from numpy.typing import NDArray

from freeart21.camera import Camera
from freeart21.se3 import Array

Map = NDArray[np.float32]
"""(height, width)."""

NOISE_MM2: tuple[float, float, float] = (0.23, 0.22, 0.012)
"""Variance, mm^2: constant, by 1 / signal, by 1 / signal^2."""
WHITE = 0.8
"""Albedo of a white wall, which has signal 1 at 1 m."""
DARKEST = 0.03
"""Least infrared albedo."""
WORST_NOISE_MM = 17.0
"""Pixels with more noise are invalid."""
SATURATION = 45.0
"""Pixels with more signal are invalid."""
GRAZING_DEGREES: tuple[float, float] = (78.0, 86.0)
"""Angles of incidence from which some pixels, and all pixels, are invalid."""
FOOTPRINT_RAD = 1.2e-3
"""Standard deviation of a pixel's footprint."""
ROOM_BEHIND_M = 1.0
"""Distance of the room's wall behind the object's farthest point."""
ROOM_ALBEDO = 0.5
"""Of the room's wall."""
MIXED_M = 0.02
"""Spread of depth within a footprint (standard deviation) above which half the pixels are invalid."""
STEP_M = 1e-3
"""Steps of the depth."""
WAVES: tuple[tuple[float, float], ...] = ((1.5e-3, 0.19), (1.5e-3, 1.5))
"""Systematic error: amplitude and period, metres."""
SCALE_ERROR = 1e-3
"""Systematic error: bound of its share of the depth."""


@dataclass(frozen=True)
class TimeOfFlight:
    """One time-of-flight camera; `seed` gives its specimen's constant systematic errors."""

    camera: Camera
    seed: int

    def measure(self, depth: Map, albedo: Map, gloss: Map, rng: np.random.Generator) -> Map:
        """The measured depth (height, width), metres; 0 for invalid pixels.

        Args:
            depth: true z-depth, metres; 0 for background.
            albedo: infrared albedo, 0 to 1.
            gloss: specular strength, 0 to 1.
            rng: random numbers of the frame.
        """
        seen = depth > 0
        if not seen.any():
            return np.zeros_like(depth)
        cosine = incidence_cosine(depth, self.rays)
        signal = returned_signal(depth, albedo, gloss, cosine, self.rays)
        mean, spread = (values[seen] for values in self.mix_footprints(depth, signal))
        cosine, signal = cosine[seen], signal[seen]
        weak, grazing, torn = rng.random((3, len(mean)), np.float32)
        sigma = noise_m(signal)
        lost = weak < _ramp(sigma * 1e3, WORST_NOISE_MM * 0.85, WORST_NOISE_MM * 1.15)
        lost |= signal > SATURATION
        lost |= grazing < _ramp(np.degrees(np.arccos(np.minimum(cosine, 1))), *GRAZING_DEGREES)
        lost |= (spread > MIXED_M) & (torn < 0.5)
        z = mean + self.systematic_error(mean) + sigma * rng.standard_normal(len(mean), np.float32)
        measured = np.zeros_like(depth)
        measured[seen] = np.where(lost, 0, np.maximum(np.rint(z / STEP_M) * STEP_M, 0))
        return measured

    @cached_property
    def rays(self) -> Array:
        """(height, width, 3) directions of the pixels, z = 1."""
        return self.camera.rays()

    def systematic_error(self, z: NDArray[Any]) -> NDArray[Any]:
        """Systematic error, metres, at depth `z`."""
        rng = np.random.default_rng([self.seed, 5])
        error = rng.uniform(-SCALE_ERROR, SCALE_ERROR) * z
        for (amplitude, period), phase in zip(WAVES, rng.uniform(0, 2 * np.pi, len(WAVES)), strict=True):
            error = error + amplitude * np.sin(2 * np.pi * z / period + phase)
        return error

    def mix_footprints(self, depth: Map, signal: Map) -> tuple[Map, Map]:
        """Mean and standard deviation of the depth in every footprint, weighted by signal; 0 off the object."""
        sigma_px = max(FOOTPRINT_RAD * float(self.camera.K[0, 0]), 0.2)
        reach = max(1, math.ceil(2.5 * sigma_px))
        taps = np.exp(-0.5 * (np.arange(-reach, reach + 1) / sigma_px) ** 2)
        room = float(depth.max()) + ROOM_BEHIND_M
        return _mix_footprints(
            depth, signal, (taps / taps.sum()).astype(np.float32), room, ROOM_ALBEDO / WHITE / room**2
        )


def infrared_albedo(linear_rgb: NDArray[np.float32]) -> Map:
    """Infrared albedo (height, width) from linear base colours (height, width, 3)."""
    return np.asarray(np.maximum(linear_rgb.mean(-1), np.float32(DARKEST)))


def noise_m(signal: NDArray[Any]) -> NDArray[Any]:
    """Standard deviation of the random error, metres, as a function of the signal."""
    a, b, c = NOISE_MM2
    signal = np.maximum(signal, 1e-6)
    return np.asarray(1e-3 * np.sqrt(a + (b + c / signal) / signal))


def _ramp(x: NDArray[Any], low: float, high: float) -> NDArray[Any]:
    return np.clip((x - low) / (high - low), 0, 1)


@numba.njit(cache=True)
def incidence_cosine(depth: Map, rays: Array) -> Map:
    """Cosine (height, width) of the angle between surface normal and ray; 1 for background.

    On a plane the inverse depth is linear in the picture. Each slope is the smaller of the two one-sided differences,
    so that normals at edges stay those of the surface. `rays` (height, width, 3) have z = 1.
    """
    height, width = depth.shape
    cosine = np.ones((height, width), np.float32)
    for v in range(height):
        for u in range(width):
            z = depth[v, u]
            if z <= 0:
                continue
            slope_u, slope_v = np.inf, np.inf
            for step in (-1, 1):
                if 0 <= u + step < width and depth[v, u + step] > 0:
                    slope = (1 / depth[v, u + step] - 1 / z) / (rays[v, u + step, 0] - rays[v, u, 0])
                    if abs(slope) < abs(slope_u):
                        slope_u = slope
                if 0 <= v + step < height and depth[v + step, u] > 0:
                    slope = (1 / depth[v + step, u] - 1 / z) / (rays[v + step, u, 1] - rays[v, u, 1])
                    if abs(slope) < abs(slope_v):
                        slope_v = slope
            if np.isinf(slope_u):
                slope_u = 0.0
            if np.isinf(slope_v):
                slope_v = 0.0
            x, y = rays[v, u, 0], rays[v, u, 1]
            n_z = 1 / z - slope_u * x - slope_v * y
            length = math.sqrt(slope_u**2 + slope_v**2 + n_z**2) * math.sqrt(x * x + y * y + 1)
            cosine[v, u] = 1 / z / length
    return cosine


@numba.njit(cache=True)
def returned_signal(depth: Map, albedo: Map, gloss: Map, cosine: Map, rays: Array) -> Map:
    """Returned signal (height, width); 0 for background."""
    height, width = depth.shape
    signal = np.zeros((height, width), np.float32)
    for v in range(height):
        for u in range(width):
            if depth[v, u] > 0:
                g, c = gloss[v, u], cosine[v, u]
                r2 = depth[v, u] ** 2 * (rays[v, u, 0] ** 2 + rays[v, u, 1] ** 2 + 1)
                highlight = g * (230 * g + 2) / 8 * c ** (230 * g) if g > 0 else 0.0
                signal[v, u] = (albedo[v, u] * (1 - g) + highlight) * c / (WHITE * max(r2, 1e-9))
    return signal


@numba.njit(cache=True)
def _mix_footprints(depth: Map, signal: Map, taps: Map, room: float, room_signal: float) -> tuple[Map, Map]:
    height, width = depth.shape
    reach = len(taps) // 2
    mean, spread = np.zeros((height, width), np.float32), np.zeros((height, width), np.float32)
    for v in range(height):
        for u in range(width):
            if depth[v, u] <= 0:
                continue
            total, first, second = 0.0, 0.0, 0.0
            centre = depth[v, u]
            for dv in range(-reach, reach + 1):
                row = min(max(v + dv, 0), height - 1)
                for du in range(-reach, reach + 1):
                    column = min(max(u + du, 0), width - 1)
                    z, s = depth[row, column], signal[row, column]
                    if z <= 0:
                        z, s = room, room_signal
                    w = taps[dv + reach] * taps[du + reach] * s
                    total += w
                    first += w * (z - centre)
                    second += w * (z - centre) ** 2
            if total > 0:
                first /= total
                mean[v, u] = centre + first
                spread[v, u] = math.sqrt(max(second / total - first * first, 0.0))
    return mean, spread
