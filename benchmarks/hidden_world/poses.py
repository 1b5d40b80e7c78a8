"""Part poses as a camera sees them, and six ways in which a joint is not the ideal one; own SE(3) algebra.

Both parts are at home in the base's frame: poses are camera from base, and camera from base after the part's
displacement. They carry errors that last for a while, as a tracker's do.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.signal import lfilter
from scipy.spatial.transform import Rotation

from benchmarks.hidden_world.body import Body

Array = NDArray[np.float64]
RATE = 30.0
"""Frames a second."""
KINEMATIC: dict[str, tuple[float, float]] = {
    "axis_tilt": (0.02, 0.08),
    "pivot_offset": (0.004, 0.02),
    "screw_pitch": (0.005, 0.03),
    "wobble": (0.01, 0.04),
    "sag": (0.01, 0.05),
    "eccentricity": (0.003, 0.012),
}
"""Sizes of clear ones: rad of tilt, m of offset, m (or rad per m) of pitch, rad of wobble and of sag, m."""
REVOLUTE_ONLY = ("pivot_offset", "eccentricity")
NOISE_TURN, NOISE_SHIFT = 2e-3, 4e-4
"""rad and m: standard deviations of a pose; half of it white, half lasting a third of a second."""


def pose(R: Array, p: Array) -> Array:
    """(n, 4, 4) from (n, 3, 3) and (n, 3)."""
    T = np.zeros((len(R), 4, 4))
    T[:, :3, :3], T[:, :3, 3], T[:, 3, 3] = R, p, 1.0
    return T


def _turn(vectors: Array) -> Array:
    return Rotation.from_rotvec(vectors).as_matrix()


def _about(R: Array, point: Array) -> Array:
    """(n, 4, 4) turns about a point."""
    return pose(R, point - R @ point)


def motion(body: Body, q: Array, axis: Array | None = None, origin: Array | None = None) -> Array:
    """(n, 4, 4) displacements of the part by the ideal joint, base frame; the identity at q = 0."""
    axis = body.axis if axis is None else axis
    origin = body.origin if origin is None else origin
    if body.revolute:
        return _about(_turn(q[:, None] * axis), origin)
    return pose(np.broadcast_to(np.eye(3), (len(q), 3, 3)), q[:, None] * axis)


def _bending(body: Body, displaced: Array) -> Array:
    """(n, 3) gravity's moment about the origin, its part along the axis left out, at `displaced` (n, 4, 4)."""
    arm = displaced[:, :3, :3] @ (body.origin + body.com) + displaced[:, :3, 3] - body.origin
    moment = np.cross(body.mass * arm, body.gravity)
    return moment - (moment @ body.axis)[:, None] * body.axis


def seen_motion(name: str | None, seed: int, size: float, body: Body, q: Array, t: Array) -> Array:
    """(n, 4, 4) displacements of the part, base frame, with the kinematic effect `name` of that size."""
    rng = np.random.default_rng([seed, 78])
    first = np.cross(body.axis, np.eye(3)[int(np.argmin(np.abs(body.axis)))])
    first /= np.linalg.norm(first)
    second = np.cross(body.axis, first)
    angle = rng.uniform(0, 2 * np.pi)
    across = np.cos(angle) * first + np.sin(angle) * second
    beside = np.cross(body.axis, across)
    ideal = motion(body, q)
    if name is None:
        return ideal
    if name == "axis_tilt":  # mounted askew in two steps, not by one turn
        tilted = Rotation.from_rotvec(0.8 * size * across) * Rotation.from_rotvec(0.6 * size * beside)
        return motion(body, q, axis=tilted.apply(body.axis))
    if name == "pivot_offset":
        moved = motion(body, q, origin=body.origin + size * across)
        moved[:, :3, 3] += 0.03 * size * np.sin(q)[:, None] * body.axis  # the pin is not quite smooth, either
        return moved
    if name == "screw_pitch":
        reach = max(abs(body.lower), abs(body.upper))
        turn = size * q * (1 + 0.06 * (q / reach) ** 2)
        if body.revolute:
            ideal[:, :3, 3] += turn[:, None] * body.axis
            return ideal
        return _about(_turn(20 * turn[:, None] * body.axis), body.origin) @ ideal
    if name == "wobble":  # rounder than a triangle, not quite a sine
        hertz = rng.uniform(0.8, 3.0)
        phase = 2 * np.pi * hertz * t + rng.uniform(0, 6)
        angle = size * (np.sin(phase) - 0.08 * np.sin(3 * phase))
        return _about(_turn(angle[:, None] * across), body.origin) @ ideal
    if name == "sag":  # softer one way than the other
        moment = _bending(body, ideal)
        about = motion(body, np.linspace(max(body.lower, -1.0), min(body.upper, 1.0), 3))
        usual = float(np.linalg.norm(_bending(body, about), axis=1).max())  # of the body, the same in every run
        soft = moment + 0.1 * (moment @ across)[:, None] * across
        return _about(_turn(size / usual * soft), body.origin) @ ideal
    if name == "eccentricity":
        angle = 2 * q + rng.uniform(0, 6)
        shift = size * (np.cos(angle)[:, None] * first + np.sin(angle)[:, None] * second)
        ideal[:, :3, 3] += shift + 0.06 * size * np.cos(3 * q)[:, None] * first
        return ideal
    raise KeyError(name)


def camera(rng: np.random.Generator) -> Array:
    """(4, 4) T_camera_base: it looks from half a metre to a metre and a half."""
    T = np.eye(4)
    T[:3, :3] = Rotation.random(random_state=int(rng.integers(1 << 30))).as_matrix()
    T[:3, 3] = [*rng.uniform(-0.2, 0.2, 2), rng.uniform(0.5, 1.5)]
    return T


def tracked(rng: np.random.Generator, T: Array) -> Array:
    """Poses (n, 4, 4) with a tracker's errors."""
    n = len(T)
    keep = np.exp(-3 / RATE)

    def errors(size: float) -> Array:
        lasting = lfilter([np.sqrt(1 - keep**2)], [1, -keep], rng.normal(size=(n + 60, 3)), axis=0)[60:]
        return np.asarray(size / np.sqrt(2) * (lasting + rng.normal(size=(n, 3))))

    R = T[:, :3, :3] @ _turn(errors(NOISE_TURN))
    return pose(R, T[:, :3, 3] + errors(NOISE_SHIFT))
