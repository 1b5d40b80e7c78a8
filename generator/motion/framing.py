"""Distance of the object from the camera: it fills the picture as wanted and stays inside it."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from freeart21 import se3
from freeart21.camera import Camera
from freeart21.se3 import Array
from generator.motion.body import Body
from generator.motion.plan import Preset

MARGIN = 0.02
"""Strip along the picture's border, as a share of its height, that the object never enters."""
_NEAREST = 1.35  # times the furthest point towards the camera: nothing comes closer to the lens
_WINDOW = 30.0  # frames of the hand's clock over which distances are smoothed
_FOLLOW = 0.5  # how far the distance follows what fills the picture (1) rather than being the same all along (0)


def place_object(
    Rs: Array, offsets: Array, clock: Array, states: Array, body: Body, camera: Camera, preset: Preset, still: bool
) -> Array:
    """(n, 4, 4) camera from object: rotations `Rs` (n, 3, 3) at distances that fill the picture as `preset` says.

    Args:
        Rs: rotations camera from object.
        offsets: (n, 3) shift of the object right, down and away from the camera, as shares of the distance.
        clock: (n,) frames, the hand's time: distance and aim are smooth in it, so that they rest when the hand rests.
        states: (n,) joint states, rad or m.
        body: what is placed.
        camera: its picture is to be filled.
        preset: size in the picture, or distance.
        still: keep distance and aim constant.
    """
    window = np.abs(clock[:, None] - clock) / _WINDOW
    window = np.zeros_like(window) if still else window
    weights = np.maximum(1 - window**2, 0) ** 3
    weights /= weights.sum(1, keepdims=True)
    centres = weights @ body.centres(states) if not still else np.broadcast_to(body.centre, (len(states), 3))
    points = np.einsum("nij,nkj->nki", Rs, body.points(states) - centres[:, None])
    nearest = _nearest_distances(points, offsets, camera)

    def distances(wanted: Array) -> Array:
        least = np.maximum(nearest, wanted)
        envelope = np.where(window <= 1, least, 0.0).max(1)
        return np.asarray(weights @ envelope)

    if preset.distance_m is not None:
        far = distances(preset.distance_m * (1 + offsets[:, 2]) * np.ones(len(states)))
    else:
        far = _distances_for_fill(points, offsets, camera, preset.fill or 0.6, distances)
    far = np.full(len(states), far.max()) if still else far
    rays = np.stack([offsets[:, 0], offsets[:, 1], np.ones(len(far))], 1)
    return se3.pose(Rs, far[:, None] * rays - np.einsum("nij,nj->ni", Rs, centres))


def place_as_moved(Rs: Array, shifts: Array, states: Array, body: Body, camera: Camera, preset: Preset) -> Array:
    """(n, 4, 4) camera from object: rotations `Rs` (n, 3, 3) and `shifts` (n, 3) of its origin, m, in camera axes.

    All frames are shifted by one more vector, which puts the object where `preset` wants it, wholly inside the picture
    in every frame.
    """
    points = np.einsum("nij,nkj->nki", Rs, body.points(states)) + shifts[:, None]
    place = np.zeros(3)
    strip, nearest = MARGIN * camera.height, _NEAREST * max(-points[..., 2].min(), 0.0)
    for axis, size in ((0, camera.width), (1, camera.height)):
        f, c = camera.K[axis, axis], camera.K[axis, 2]
        # a point (x, z) at the place (a, d) is inside when f (x + a) <= high (d + z) and -f (x + a) <= low (d + z)
        high, low = size - strip - c, c - strip
        right = (f * points[..., axis] / high - points[..., 2]).max()
        left = (-f * points[..., axis] / low - points[..., 2]).max()
        place[axis] = (left - right) / (f / high + f / low)  # where the least distance is least
        nearest = max(nearest, right + f / high * place[axis])
    tall = np.ptp(points[..., 1], axis=1).mean() * camera.K[1, 1] / ((preset.fill or 0.6) * camera.height)
    place[2] = max(nearest, (preset.distance_m or tall) - points[..., 2].mean())
    return se3.pose(Rs, shifts + place)


def image_extent(Ts: Array, states: Array, body: Body, camera: Camera) -> tuple[Array, Array]:
    """Lowest and highest image coordinates (n, 2) of the object in every frame."""
    uv = camera.project(se3.transform(Ts, body.points(states)))
    return uv.min(1), uv.max(1)


def _nearest_distances(points: Array, offsets: Array, camera: Camera) -> Array:
    """(n,) least distance at which `points` (n, k, 3) about the object's middle, with `offsets`, are in the picture.

    The middle is at (s d, d), d its distance and s the offset. A point (x, z) from it is inside the half width w when
    f (|x| + s d) <= w (d + z), which is linear in d.
    """
    strip = MARGIN * camera.height
    need = _NEAREST * np.maximum(-points[..., 2].min(1), 0)
    for axis, size in ((0, camera.width), (1, camera.height)):
        f, c = camera.K[axis, axis], camera.K[axis, 2]
        for sign, room in ((1, size - strip - c), (-1, c - strip)):
            slope = np.maximum(room - sign * f * offsets[:, axis], 0.05 * room)
            need = np.maximum(need, ((sign * f * points[..., axis] - room * points[..., 2]) / slope[:, None]).max(1))
    return np.asarray(need)


def _distances_for_fill(
    points: Array, offsets: Array, camera: Camera, fill: float, distances: Callable[[Array], Array]
) -> Array:
    """(n,) distances at which the object is `fill` of the picture high, on average over the frames, or the nearest."""
    f, height = camera.K[1, 1], camera.height

    def mean_fill(far: Array) -> float:
        v = points[..., 1] / (points[..., 2] + far[:, None])
        return float(np.ptp(v, axis=1).mean() * f / height)

    tall = np.ptp(points[..., 1], axis=1) * f / (fill * height) - np.minimum(points[..., 2].min(1), 0) * 0.5
    shape = np.exp(_FOLLOW * (np.log(tall) - np.log(tall).mean())) * (1 + offsets[:, 2])
    near, far = 0.05 * tall.max(), 20 * tall.max()
    for _ in range(18):
        middle = float(np.sqrt(near * far))
        near, far = (middle, far) if mean_fill(distances(middle * shape)) > fill else (near, middle)
    return distances(far * shape)
