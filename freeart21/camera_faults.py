"""Faults of a real RGB-D camera as a few numbers: found by `gap`, applied by the recorder.

Every number is zero for an ideal camera. The order of application is that of light: intrinsics, delay of the depth
picture, depth bias and noise, flying pixels at edges and holes, registration of depth to colour, colour response.
"""

from __future__ import annotations

from dataclasses import dataclass, field, fields, replace
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
"""Width, in brightness 0 to 1, over which dark surfaces lose depth. Not measured."""
SOFT_RAD = float(np.radians(3.0))
"""The same for grazing surfaces, radians; half of what `generator.tof` has after Nguyen 2012. Not measured."""
ROOM_M = 1.0
"""Distance of the room behind an object, with which flying pixels mix where nothing is drawn, as in `tof`."""
MOST_KNOTS, MOST_DRIFT = 100, 20.0
"""Knots of a drift, and its largest value, stops or 1."""


@dataclass(frozen=True)
class Fault:
    """Meaning of a field of `CameraFaults`."""

    low: float
    high: float
    """Between these it must lie: far beyond any camera, so that a damaged file is refused."""
    unit: str
    """SI, pixels or stops; 1 of a share or an exponent."""
    meaning: str


def _fault(low: float, high: float, unit: str, meaning: str, default: float | tuple[float, ...] = 0.0) -> Any:
    return field(default=default, metadata={"fault": Fault(low, high, unit, meaning)})


@dataclass(frozen=True)
class CameraFaults:
    """Deviations of a camera from an ideal pinhole with perfect depth.

    A depth z reads (1 + depth_scale) z + depth_offset + depth_curve z^2. Noise is given at the distance `noise_at` and
    normal incidence. Surfaces much darker than `dark_level` lose `dark_share` of their pixels, at it half as many;
    likewise at incidence beyond `grazing_angle`. Drifts are values at evenly spaced moments of the film, linear between
    them.
    """

    depth_scale: float = _fault(-0.5, 1.0, "1", "share of itself that depth reads too much")
    depth_offset: float = _fault(-1.0, 1.0, "m", "what depth reads too much at any distance")
    depth_curve: float = _fault(-1.0, 1.0, "1/m", "what depth reads too much, by the square of the distance")
    noise: float = _fault(0.0, 1.0, "m", "standard deviation of each pixel's depth")
    noise_at: float = _fault(1e-3, 1e3, "m", "distance at which it is that", 1.0)
    noise_growth: float = _fault(-4.0, 8.0, "1", "power of the distance that the noise grows by")
    noise_grazing: float = _fault(0.0, 8.0, "1", "power of 1 / cos(angle of incidence) that the noise grows by")
    holes: float = _fault(0.0, 1.0, "1", "share of all pixels without depth")
    dark_share: float = _fault(0.0, 1.0, "1", "share of their pixels that dark surfaces lose")
    dark_level: float = _fault(0.0, 1.0, "1", "brightness, 0 to 1, below which they do")
    grazing_share: float = _fault(0.0, 1.0, "1", "share of their pixels that surfaces seen flat lose")
    grazing_angle: float = _fault(0.0, np.pi / 2, "rad", "angle of incidence above which they do")
    flying_share: float = _fault(0.0, 1.0, "1", "share of the pixels at a depth edge that lie between both surfaces")
    flying_reach: float = _fault(0.0, 20.0, "px", "distance to the edge within which they do")
    depth_shift_u: float = _fault(-200.0, 200.0, "px", "of the depth picture, right of the colour picture")
    depth_shift_v: float = _fault(-200.0, 200.0, "px", "below it")
    depth_turn: float = _fault(-0.5, 0.5, "rad", "clockwise about the principal point")
    focal: float = _fault(-0.5, 1.0, "1", "share by which the focal length is longer than given")
    centre_u: float = _fault(-1000.0, 1000.0, "px", "of the principal point, right of where it is given")
    centre_v: float = _fault(-1000.0, 1000.0, "px", "below it")
    depth_delay: float = _fault(-5.0, 5.0, "s", "by which the depth picture is older than the colour picture")
    exposure: tuple[float, ...] = _fault(-MOST_DRIFT, MOST_DRIFT, "stops", "exposure", ())
    gamma: tuple[float, ...] = _fault(-MOST_DRIFT, MOST_DRIFT, "1", "exponent of the tone curve, less 1,", ())

    def __post_init__(self) -> None:
        for name, fault in FAULTS.items():
            value, low, high = getattr(self, name), fault.low, fault.high
            if name in ("exposure", "gamma"):
                knots = np.asarray(value, float)
                if knots.ndim != 1 or len(knots) > MOST_KNOTS or not (np.abs(knots) <= high).all():
                    raise FreeArtError(
                        f"camera faults: {name} is {value!r}, expected up to {MOST_KNOTS} numbers from {low:g} to "
                        f"{high:g}"
                    )
                if name == "gamma" and (knots <= -1).any():
                    raise FreeArtError(f"camera faults: gamma is {value!r}, expected numbers above -1")
                object.__setattr__(self, name, tuple(float(v) for v in knots))
            elif isinstance(value, bool) or not isinstance(value, int | float) or not low <= value <= high:
                raise FreeArtError(f"camera faults: {name} is {value!r}, expected {low:g} to {high:g}")

    @property
    def is_ideal(self) -> bool:
        """Whether the camera has no fault."""
        return replace(self, noise_at=1.0) == CameraFaults()

    def actual_camera(self, camera: Camera) -> Camera:
        """The true intrinsics of a camera with the nominal intrinsics `camera`."""
        if not (self.focal or self.centre_u or self.centre_v):
            return camera
        K = np.array(camera.K)
        K[[0, 1], [0, 1]] *= 1 + self.focal
        K[:2, 2] += self.centre_u, self.centre_v
        return Camera(K, camera.width, camera.height)

    def depth(
        self, depth: Map, brightness: Map, cosine: Map, camera: Camera, rng: np.random.Generator | None = None
    ) -> Map:
        """The depth picture (height, width), metres, 0 for none, that this camera makes of a true one.

        `brightness` is the mean of sRGB, 0 to 1, `cosine` that of the angle of incidence. Without `rng` nothing random
        is applied: no noise, holes or flying pixels.
        """
        seen = depth > 0
        z = depth.astype(np.float64)
        out = z * (1 + self.depth_scale) + self.depth_offset + self.depth_curve * z * z
        if rng is not None:
            noise = rng.standard_normal(z.shape)
            out = out + self.depth_noise(z, cosine) * noise if self.noise else out
            fly, share = rng.random((2, *z.shape))
            if self.flying_share and self.flying_reach:
                behind, distance = find_depth_edges(z)
                flying = (distance <= self.flying_reach) & (fly < self.flying_share)
                out = np.where(flying, out + share * (behind - z), out)
            out = np.where(rng.random(z.shape) < self.hole_probability(brightness, cosine), 0.0, out)
        out = np.where(seen, np.maximum(out, 0), 0)
        return self._shift_depth(out.astype(np.float32), camera)

    def hole_probability(self, brightness: NDArray[Any], cosine: NDArray[Any]) -> Array:
        """Probability that a pixel has no depth."""
        share = np.full(np.shape(brightness), 1 - self.holes)
        if self.dark_share:
            share = share * (1 - self.dark_share * logistic((self.dark_level - brightness) / SOFT))
        if self.grazing_share:
            angle = np.arccos(np.clip(cosine, 0, 1))
            share = share * (1 - self.grazing_share * logistic((angle - self.grazing_angle) / SOFT_RAD))
        return np.asarray(1 - share)

    def depth_noise(self, z: NDArray[Any], cosine: NDArray[Any]) -> Array:
        """Standard deviation of the depth, metres."""
        grown = (np.maximum(z, 1e-6) / self.noise_at) ** self.noise_growth
        return np.asarray(self.noise * grown / np.maximum(cosine, 0.05) ** self.noise_grazing)

    def colour(self, rgb: NDArray[np.uint8], share: float) -> NDArray[np.uint8]:
        """The colour picture at `share` (0 to 1) of the film."""
        stops, gamma = drift_at(self.exposure, share), drift_at(self.gamma, share)
        if not (stops or gamma):
            return rgb
        table = srgb_encode(2.0**stops * srgb_decode(np.arange(256) / 255.0) ** (1 + gamma))
        return np.asarray(np.rint(255 * table).astype(np.uint8)[rgb])

    def _shift_depth(self, depth: Map, camera: Camera) -> Map:
        """The depth picture with its registration error; nearest-neighbour."""
        if not (self.depth_shift_u or self.depth_shift_v or self.depth_turn):
            return depth
        c, s = np.cos(self.depth_turn), np.sin(self.depth_turn)
        centre = camera.K[:2, 2] - 0.5
        R = np.array([[c, -s], [s, c]])
        A = np.column_stack([R, centre + np.array([self.depth_shift_u, self.depth_shift_v]) - R @ centre])
        return np.asarray(cv2.warpAffine(depth, A, depth.shape[::-1], flags=cv2.INTER_NEAREST))


FAULTS: dict[str, Fault] = {each.name: each.metadata["fault"] for each in fields(CameraFaults)}
"""Field to its meaning."""


def logistic(x: NDArray[Any]) -> Array:
    """The logistic function, without overflow."""
    return np.asarray(0.5 * (1 + np.tanh(0.5 * np.asarray(x, float))))


def drift_at(knots: tuple[float, ...], share: float) -> float:
    """The value at `share` (0 to 1) of a film, linear between evenly spaced knots; 0 without any."""
    return float(np.interp(share, np.linspace(0, 1, len(knots)), knots)) if knots else 0.0


def srgb_encode(linear: NDArray[Any]) -> Array:
    """sRGB, 0 to 1, of linear light (IEC 61966-2-1)."""
    x = np.clip(linear, 0, 1)
    return np.where(x <= 0.0031308, 12.92 * x, 1.055 * x ** (1 / 2.4) - 0.055)


def srgb_decode(colours: NDArray[Any]) -> Array:
    """Linear light of sRGB, both 0 to 1."""
    x = np.clip(colours, 0, 1)
    return np.where(x <= 0.04045, x / 12.92, ((x + 0.055) / 1.055) ** 2.4)


def find_depth_edges(z: NDArray[Any]) -> tuple[Array, Array]:
    """Depth behind the nearest depth edge, metres, and the distance to that edge, pixels; inf far from any.

    An edge is where the depth in a 3 x 3 window changes by a twentieth or more, or where the object ends: there the
    room is `ROOM_M` behind.
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
