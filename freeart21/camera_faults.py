"""What a real RGB-D camera does to its pictures, as a few plain numbers: found by `gap`, taken by the recorder.

Every number is zero in a camera without fault. The order is that of light: where the lens really points, when the depth
picture was taken, what distance the sensor gives, what it mixes at edges and loses, where the depth picture is laid
upon the colour picture, and how the colours came out.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from freeart21.camera import Camera
from freeart21.errors import FreeArtError
from freeart21.se3 import Array

Map = NDArray[np.float32]
"""(height, width)."""

SOFT = 0.03
"""Width, in brightness 0 to 1, over which dark surfaces fade out of the depth picture. Not measured."""
SOFT_RAD = float(np.radians(3.0))
"""The same for grazing surfaces, radians; half of what `generator.tof` has after Nguyen 2012. Not measured."""
ROOM_M = 1.0
"""How far behind an object the room is that flying pixels are mixed with, where nothing is drawn, as in `tof`."""
BOUNDS: dict[str, tuple[float, float]] = {
    "depth_scale": (-0.5, 1.0),
    "depth_offset": (-1.0, 1.0),
    "depth_curve": (-1.0, 1.0),
    "noise": (0.0, 1.0),
    "noise_at": (1e-3, 1e3),
    "noise_growth": (-4.0, 8.0),
    "noise_grazing": (0.0, 8.0),
    "holes": (0.0, 1.0),
    "dark_share": (0.0, 1.0),
    "dark_level": (0.0, 1.0),
    "grazing_share": (0.0, 1.0),
    "grazing_angle": (0.0, np.pi / 2),
    "flying_share": (0.0, 1.0),
    "flying_reach": (0.0, 20.0),
    "depth_shift_u": (-200.0, 200.0),
    "depth_shift_v": (-200.0, 200.0),
    "depth_turn": (-0.5, 0.5),
    "focal": (-0.5, 1.0),
    "centre_u": (-1000.0, 1000.0),
    "centre_v": (-1000.0, 1000.0),
    "depth_delay": (-5.0, 5.0),
}
"""What each number may be at most: far beyond any camera, so that a damaged file is refused."""
MOST_KNOTS = 100


@dataclass(frozen=True)
class CameraFaults:
    """How a camera departs from an ideal pinhole with perfect depth."""

    depth_scale: float = 0.0
    """Share: a depth z reads (1 + share) z."""
    depth_offset: float = 0.0
    """Metres that every depth reads too much."""
    depth_curve: float = 0.0
    """1/m: a depth z reads curve z^2 too much."""
    noise: float = 0.0
    """Standard deviation of each pixel's depth, metres, at the distance `noise_at` and straight on."""
    noise_at: float = 1.0
    """Metres."""
    noise_growth: float = 0.0
    """Exponent of the distance that the noise grows by."""
    noise_grazing: float = 0.0
    """Exponent of 1 / cos(angle of incidence) that the noise grows by."""
    holes: float = 0.0
    """Share of the pixels, anywhere on the object, without depth."""
    dark_share: float = 0.0
    """Share of the pixels that surfaces lose which are much darker than `dark_level`."""
    dark_level: float = 0.0
    """Brightness (mean of sRGB, 0 to 1) of surfaces that lose half as much."""
    grazing_share: float = 0.0
    """Share of the pixels that surfaces lose which are seen much flatter than `grazing_angle`."""
    grazing_angle: float = 0.0
    """Angle of incidence, radians, at which they lose half as much."""
    flying_share: float = 0.0
    """Share of the pixels at a depth edge whose depth lies anywhere between the two surfaces."""
    flying_reach: float = 0.0
    """Pixels from the edge within which they do."""
    depth_shift_u: float = 0.0
    depth_shift_v: float = 0.0
    """Pixels to the right and down by which the depth picture lies off the colour picture."""
    depth_turn: float = 0.0
    """Radians, clockwise in the picture, by which it is turned about the principal point."""
    focal: float = 0.0
    """Share by which the focal length is larger than told."""
    centre_u: float = 0.0
    centre_v: float = 0.0
    """Pixels by which the principal point is right of, and below, where it is told."""
    depth_delay: float = 0.0
    """Seconds by which the depth picture shows an earlier moment than the colour picture."""
    exposure: tuple[float, ...] = ()
    """Stops (powers of two of linear light) of exposure at moments spread evenly over the film; straight between."""
    gamma: tuple[float, ...] = ()
    """The same of the exponent on linear light, less 1."""

    def __post_init__(self) -> None:
        for field in fields(self):
            value = getattr(self, field.name)
            if field.name in ("exposure", "gamma"):
                knots = np.asarray(value, float)
                if knots.ndim != 1 or len(knots) > MOST_KNOTS or not (np.abs(knots) <= 20).all():
                    raise FreeArtError(
                        f"camera faults: {field.name} is {value!r}, expected up to {MOST_KNOTS} numbers from -20 to 20"
                    )
                if field.name == "gamma" and (knots <= -1).any():
                    raise FreeArtError(f"camera faults: gamma is {value!r}, expected numbers above -1")
                object.__setattr__(self, field.name, tuple(float(v) for v in knots))
                continue
            low, high = BOUNDS[field.name]
            if isinstance(value, bool) or not isinstance(value, int | float) or not low <= value <= high:
                raise FreeArtError(f"camera faults: {field.name} is {value!r}, expected {low:g} to {high:g}")

    @property
    def none(self) -> bool:
        """Whether the camera has no fault."""
        return replace(self, noise_at=1.0) == CameraFaults()

    def seeing(self, camera: Camera) -> Camera:
        """The camera that really sees, where `camera` is what is told of it."""
        if not (self.focal or self.centre_u or self.centre_v):
            return camera
        K = np.array(camera.K)
        K[[0, 1], [0, 1]] *= 1 + self.focal
        K[:2, 2] += self.centre_u, self.centre_v
        return Camera(K, camera.width, camera.height)

    def depth(
        self, depth: Map, brightness: Map, cosine: Map, camera: Camera, rng: np.random.Generator | None = None
    ) -> Map:
        """The depth picture (height, width), metres, 0 where there is none, that this camera gives of a true one.

        `brightness` is the mean of sRGB, 0 to 1, `cosine` that of the angle of incidence. Without `rng` nothing is
        drawn: no noise, no holes, no flying pixels.
        """
        seen = depth > 0
        z = depth.astype(np.float64)
        out = z * (1 + self.depth_scale) + self.depth_offset + self.depth_curve * z * z
        if rng is not None:
            out = self._noisy(out, z, cosine, rng)
            out = self._flying(out, z, rng)
            out = np.where(rng.random(z.shape) < self.lost(brightness, cosine), 0.0, out)
        out = np.where(seen, np.maximum(out, 0), 0)
        return self._laid(out.astype(np.float32), camera)

    def lost(self, brightness: NDArray, cosine: NDArray) -> Array:
        """Probability that a pixel has no depth."""
        kept = np.full(np.shape(brightness), 1 - self.holes)
        if self.dark_share:
            kept = kept * (1 - self.dark_share * falling((self.dark_level - brightness) / SOFT))
        if self.grazing_share:
            angle = np.arccos(np.clip(cosine, 0, 1))
            kept = kept * (1 - self.grazing_share * falling((angle - self.grazing_angle) / SOFT_RAD))
        return np.asarray(1 - kept)

    def spread(self, z: NDArray, cosine: NDArray) -> Array:
        """Standard deviation of the depth, metres."""
        grown = (np.maximum(z, 1e-6) / self.noise_at) ** self.noise_growth
        return np.asarray(self.noise * grown / np.maximum(cosine, 0.05) ** self.noise_grazing)

    def colour(self, rgb: NDArray[np.uint8], share: float) -> NDArray[np.uint8]:
        """The colour picture at `share` (0 to 1) of the film."""
        stops, gamma = at_share(self.exposure, share), at_share(self.gamma, share)
        if not (stops or gamma):
            return rgb
        table = encoded(2.0**stops * decoded(np.arange(256) / 255.0) ** (1 + gamma))
        return np.asarray(np.rint(255 * table).astype(np.uint8)[rgb])

    def _noisy(self, out: Array, z: Array, cosine: Map, rng: np.random.Generator) -> Array:
        noise = rng.standard_normal(z.shape)
        return out + self.spread(z, cosine) * noise if self.noise else out

    def _flying(self, out: Array, z: Array, rng: np.random.Generator) -> Array:
        fly, share = rng.random((2, *z.shape))
        if not (self.flying_share and self.flying_reach):
            return out
        behind, distance = edges(z)
        flying = (distance <= self.flying_reach) & (fly < self.flying_share)
        return np.where(flying, out + share * (behind - z), out)

    def _laid(self, depth: Map, camera: Camera) -> Map:
        """The depth picture where it is laid upon the colour picture; every pixel takes its nearest."""
        if not (self.depth_shift_u or self.depth_shift_v or self.depth_turn):
            return depth
        c, s = np.cos(self.depth_turn), np.sin(self.depth_turn)
        centre = camera.K[:2, 2] - 0.5
        R = np.array([[c, -s], [s, c]])
        A = np.column_stack([R, centre + np.array([self.depth_shift_u, self.depth_shift_v]) - R @ centre])
        return np.asarray(cv2.warpAffine(depth, A, depth.shape[::-1], flags=cv2.INTER_NEAREST))


def with_values(faults: CameraFaults, values: Mapping[str, Any]) -> CameraFaults:
    """The faults with other values, by name."""
    return replace(faults, **values)


def falling(x: NDArray) -> Array:
    """The logistic function, without overflow."""
    return np.asarray(0.5 * (1 + np.tanh(0.5 * np.asarray(x, float))))


def at_share(knots: tuple[float, ...], share: float) -> float:
    """The value at `share` (0 to 1) of a film, straight between evenly spread knots; 0 without any."""
    return float(np.interp(share, np.linspace(0, 1, len(knots)), knots)) if knots else 0.0


def encoded(linear: NDArray) -> Array:
    """sRGB, 0 to 1, of linear light (IEC 61966-2-1)."""
    x = np.clip(linear, 0, 1)
    return np.where(x <= 0.0031308, 12.92 * x, 1.055 * x ** (1 / 2.4) - 0.055)


def decoded(colours: NDArray) -> Array:
    """Linear light of sRGB, both 0 to 1."""
    x = np.clip(colours, 0, 1)
    return np.where(x <= 0.04045, x / 12.92, ((x + 0.055) / 1.055) ** 2.4)


def incidence(depth: NDArray, camera: Camera) -> Map:
    """Cosine (height, width) of the angle of incidence by the depth picture alone; 1 where nothing is drawn.

    On a plane the inverse depth is linear in the picture; each slope is the smaller one of both sides'.
    """
    rays = camera.rays()
    w = np.where(depth > 0, 1 / np.maximum(depth, 1e-9), np.nan)
    slopes = []
    for axis, f in ((1, camera.K[0, 0]), (0, camera.K[1, 1])):
        step = np.diff(w, axis=axis) * f
        pad = np.full_like(np.take(w, [0], axis), np.nan)
        both = np.stack([np.concatenate([pad, step], axis), np.concatenate([step, pad], axis)])
        both = np.where(np.isfinite(both), both, np.inf)
        least = np.take_along_axis(both, np.abs(both).argmin(0)[None], 0)[0]
        slopes.append(np.where(np.isfinite(least), least, 0.0))
    n = np.stack([slopes[0], slopes[1], np.nan_to_num(w) - slopes[0] * rays[..., 0] - slopes[1] * rays[..., 1]], -1)
    length = np.linalg.norm(n, axis=-1) * np.linalg.norm(rays, axis=-1)
    return np.where(depth > 0, np.nan_to_num(w) / np.maximum(length, 1e-12), 1.0).astype(np.float32)


def edges(z: NDArray) -> tuple[Array, Array]:
    """Depth of what lies behind the nearest depth edge, metres, and the distance to it, pixels; inf far from any.

    An edge is where the depth in a 3 x 3 window changes by a twentieth or more, or where the object ends: there the
    room lies `ROOM_M` behind.
    """
    room = float(z.max()) + ROOM_M
    filled = np.where(z > 0, z, room).astype(np.float32)
    kernel = np.ones((3, 3), np.uint8)
    far = cv2.dilate(filled, kernel)
    jump = (far > 1.05 * filled) & (z > 0)
    distance = cv2.distanceTransform((~jump).astype(np.uint8), cv2.DIST_L2, 3) + 1.0
    behind = filled.copy()
    reach = cv2.dilate(np.where(jump, far, 0).astype(np.float32), np.ones((7, 7), np.uint8))
    behind = np.where(jump, far, np.maximum(reach, filled))
    return np.asarray(behind, float), np.where(z > 0, distance, np.inf)
