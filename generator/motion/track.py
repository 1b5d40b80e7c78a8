"""Replays a take: a recorded motion of object and joint."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from freeart21 import one_euro, se3
from freeart21.camera import Camera
from freeart21.errors import FreeArtError
from freeart21.files.take import Take
from freeart21.formats.captured import ARCTIC_FORM, ARCTIC_SIZES_M
from freeart21.se3 import Array
from generator.motion.body import Body
from generator.motion.framing import image_extent, place_as_moved
from generator.motion.plan import Plan, Preset

MAX_FRAMES = 100_000
_ROUNDING = 1e-6  # tolerance, in frames and as a share of a range: numbers in files are rounded
_SAME_SIZE = 1e-3  # largest relative difference of sizes of one object: meshes in files are rounded
_FARTHER, _FARTHEST = 1.05, 4.0  # factors on the distance: of one step, and the largest


@dataclass(frozen=True)
class Stretch:
    """The recorded part of a take, resampled to the frames of the video."""

    Ts: Array
    """(n, 4, 4)."""
    states: Array
    """(n,) joint states of the take, rad or m."""
    begins_s: float
    """Seconds from the take's beginning."""


def count_frames(take: Take, fps: float) -> int:
    """Number of frames, `fps` a second, from the first sample of a take to its end."""
    frames = float(np.ptp(take.times)) * fps + _ROUNDING + 1
    if frames > MAX_FRAMES:
        raise FreeArtError(f"{take.name} lasts {np.ptp(take.times):.0f} s, expected at most {MAX_FRAMES / fps:.0f} s")
    return int(frames)


def resample_take(take: Take, fps: float, frames: int) -> Stretch:
    """The earliest `frames` frames of a take over which its joint moves most.

    Samples are smoothed by the take's filter, if it names one. Positions and states are interpolated
    linearly, rotations by slerp. Raises FreeArtError when the take is shorter.
    """
    count = count_frames(take, fps)
    if frames > count:
        raise FreeArtError(f"{take.name} lasts {count} frames at {fps:g} a second, fewer than {frames}")
    times = np.minimum(take.times[0] + np.arange(count) / fps, take.times[-1])
    Ts, taken = take.Ts, take.states
    if take.filter is not None:
        Ts, taken = one_euro.filter_motion(take.filter, take.times, Ts, taken)
    states = np.interp(times, take.times, taken)
    moved = np.ptp(np.lib.stride_tricks.sliding_window_view(states, frames), axis=1)
    first = int(np.argmax(moved >= (1 - _ROUNDING) * moved.max()))  # not by the last digits
    part = slice(first, first + frames)
    return Stretch(_interpolate_poses(take.times, Ts, times[part]), states[part], first / fps)


def fit_states(states: Array, take: Take, body: Body) -> tuple[Array, dict[str, Any]]:
    """The states (n,) of a take for the body's joint, and a record of the change.

    They are kept when the joint has the take's type and reaches all states; else the take's range is scaled to the
    joint's. Raises FreeArtError when it must be scaled and the take's joint does not move.
    """
    joint, low, high = body.joint, float(take.states.min()), float(take.states.max())
    if take.joint_type == joint.type and joint.lower <= low and high <= joint.upper:
        return states, {"states": "as taken"}
    if not high > low:
        raise FreeArtError(
            f"{take.name}: its joint ({take.joint_type}) stands still at {low:.4g}, where joint '{joint.name}' cannot "
            f"be: {joint.type}, {body.lower:.4g} to {body.upper:.4g}"
        )
    changes = {"states": "scaled", "from": [take.joint_type, low, high], "to": [joint.type, body.lower, body.upper]}
    shares = (states - low) / (high - low)
    return np.clip(body.state(shares), body.lower, body.upper), changes


def scale_translation(take: Take, diagonal: float) -> tuple[float, dict[str, Any]]:
    """The factor on a take's translation for an object of this `diagonal`, metres, and a record of the change.

    The translation is scaled by the ratio of the sizes of this object and of the take's. ARCTIC's tracks do not name
    the size: the factor is 1 where the object may have the size of one of theirs. A take of ours without a size has
    factor 1, too. For poses in the camera's frame the factor acts on the distance from the camera: an object of half
    the size comes twice as near.
    """
    if take.poses == "camera" and (take.size is None or abs(diagonal / take.size - 1) < _SAME_SIZE):
        return 1.0, {}
    if take.form != ARCTIC_FORM and take.size is None:
        return 1.0, {"carry": 1.0}
    size = float(np.clip(diagonal, *ARCTIC_SIZES_M)) if take.size is None else take.size
    return diagonal / size, {"carry": diagonal / size, "size": diagonal, "taken_with": size}


def describe_changes(source: dict[str, Any]) -> str:
    """The records of `scale_translation` and `fit_states` in words."""
    words = []
    if source.get("carry", 1.0) != 1.0:
        words.append(f"its translation scaled by {source['carry']:.2g}")
        if "size" in source:
            words[-1] += f" (an object of {source['size']:.2g} m for one of {source['taken_with']:.2g} m)"
    if source.get("states") == "scaled":
        words.append("its states scaled to the joint's range")
    return f"{source.get('name')}: {' and '.join(words) or 'as it was taken'}"


def object_poses(
    body: Body,
    stretch: Stretch,
    states: Array,
    take: Take,
    R_first: Array | None,
    camera: Camera,
    preset: Preset,
    carry: float = 1.0,
) -> Array:
    """(n, 4, 4) camera from object for a stretch of a take.

    Poses in the camera's frame are taken as they are. Poses that are changes since the first start with the rotation
    `R_first` (3, 3) and continue with the take's rotations and its translations times `carry`; the object is placed so
    that it stays in the picture with the size of `preset`.
    """
    if take.poses == "camera" or R_first is None:
        return se3.pose(stretch.Ts[:, :3, :3], carry * stretch.Ts[:, :3, 3]) if carry != 1 else stretch.Ts
    R, t = stretch.Ts[:, :3, :3], stretch.Ts[:, :3, 3]
    return place_as_moved(R @ R[0].T @ R_first, carry * (t - t[0]), states, body, camera, preset)


def move_away(Ts: Array, states: Array, body: Body, camera: Camera) -> tuple[Array, float]:
    """Poses (n, 4, 4) scaled away from the camera until the object is in every picture, and the factor.

    It is needed for another object than the take's, which may be wider. Its place in the picture stays the same.
    """
    factor, size = 1.0, np.array([camera.width, camera.height], float)
    while factor < _FARTHEST:
        candidate = se3.pose(Ts[:, :3, :3], factor * Ts[:, :3, 3])
        if (se3.transform(candidate, body.points(states))[..., 2] > 0).all():
            low, high = image_extent(candidate, states, body, camera)
            if (low >= 0).all() and (high <= size).all():
                return candidate, factor
        factor *= _FARTHER
    return Ts, 1.0


def check_in_view(name: str, plan: Plan, body: Body, camera: Camera, near: float, fps: float) -> None:
    """FreeArtError, with the first such frame, when the object is nearer than `near` metres or leaves the picture."""
    depth = se3.transform(plan.Ts_camera_object, body.points(plan.states))[..., 2].min(1)
    close = np.flatnonzero(depth <= near)
    if len(close):
        i = int(close[0])
        raise FreeArtError(
            f"{name}: the object is {depth[i]:.3g} m before the camera in frame {i} ({i / fps:.2f} s), expected more "
            f"than {near:.2g} m"
        )
    low, high = image_extent(plan.Ts_camera_object, plan.states, body, camera)
    size = np.array([camera.width, camera.height], float)
    beyond: Array = np.maximum(-low, high - size).max(1)
    out: NDArray[np.int64] = np.flatnonzero(beyond > 0)
    if len(out):
        i = int(out[0])
        raise FreeArtError(
            f"{name}: the object leaves the picture in frame {i} ({i / fps:.2f} s), by {beyond[i]:.0f} pixels, and is "
            f"outside in {len(out)} of {len(beyond)} frames; expected none"
        )


def _interpolate_poses(at: Array, Ts: Array, times: Array) -> Array:
    """Poses (m, 4, 4) at `times` (m,), interpolated from poses (n, 4, 4) at `at` (n,)."""
    k = np.clip(np.searchsorted(at, times, side="right") - 1, 0, len(at) - 2)
    u = ((times - at[k]) / (at[k + 1] - at[k]))[:, None]
    R, t = Ts[:, :3, :3], Ts[:, :3, 3]
    turn = se3.log_so3(np.swapaxes(R[k], 1, 2) @ R[k + 1])
    return se3.pose(R[k] @ se3.exp_so3(u * turn), (1 - u) * t[k] + u * t[k + 1])
