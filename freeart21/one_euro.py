"""The one-euro filter (Casiez, Roussel and Vogel, CHI 2012) for a pose and a joint state.

A first-order low pass whose cutoff grows with the low-passed speed: `min_cutoff + beta * |speed|`. A vector has one
cutoff, from the norm of its speed, so that paths are not bent. A rotation is filtered on SO(3): the filter moves along
the rotation vector from its estimate to the measurement; the speed is that vector over the time step.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from freeart21 import se3
from freeart21.joint import JointType
from freeart21.se3 import Array

Vector = tuple[float, ...]


@dataclass(frozen=True)
class Band:
    """Filter parameters of one quantity."""

    min_cutoff_hz: float
    """Cutoff at rest."""
    beta: float
    """Increase of the cutoff with speed: 1/m for positions and prismatic joints, 1/rad for rotations and hinges."""


@dataclass(frozen=True)
class OneEuro:
    """Settings of the filter; a quantity with None is not filtered."""

    position: Band | None
    rotation: Band | None
    state: Band | None
    speed_cutoff_hz: float = 1.0
    """Cutoff of the speed. The paper's value; its authors found that it needs no tuning."""


def headset_filter(joint_type: JointType) -> OneEuro:
    """Settings for hand-held controllers, for a revolute or prismatic joint.

    Measured: a held controller's noise (assumed: .6 mm and .25 degrees, half
    of it a tremor at 10 Hz) falls by 4.1 (position) and 4.5 (rotation). Captured motion of eleven takes lags 3 and 4 ms
    in its fastest 5 %, and 6 ms elsewhere. The joint state is filtered as a rotation or a position, by its type.
    """
    place, turn = Band(1.0, 100.0), Band(1.0, 10.0)
    return OneEuro(place, turn, turn if joint_type == "revolute" else place)


class PoseFilter:
    """The filter, sample by sample.

    Every quantity computes a cutoff from its own speed, and all use the largest one. So pose and joint state lag by the
    same time. With separate lags, an object left the picture that the operator had kept it in.
    """

    def __init__(self, settings: OneEuro) -> None:
        self._settings = settings
        self._time = 0.0
        self._parts: tuple[_Filter, _Filter, _Filter] | None = None

    def step(self, time: float, position: Vector, quaternion: Vector, state: float) -> tuple[Vector, Vector, float]:
        """The filtered position (3,) m, unit quaternion (4,) wxyz and state of a sample at `time` s; times increase."""
        given, measured = self._settings, (position, quaternion, (state,))
        if self._parts is None:
            self._parts = (
                _Filter(given.position, _minus, _plus, position),
                _Filter(given.rotation, _rotation_between, _rotate, quaternion),
                _Filter(given.state, _minus, _plus, (state,)),
            )
        else:
            dt, parts = time - self._time, self._parts
            a = _share(given.speed_cutoff_hz, dt)
            b = _share(max(part.cutoff(value, a, dt) for part, value in zip(parts, measured, strict=True)), dt)
            for part, value in zip(parts, measured, strict=True):
                part.update(value, b)
        self._time = time
        place, turn, joint = self._parts
        return place.value, turn.value, joint.value[0]


def filter_motion(settings: OneEuro, times: Array, Ts: Array, states: Array) -> tuple[Array, Array]:
    """Filter poses `Ts` (n, 4, 4) and states (n,) at `times` (n,), s, with `PoseFilter`."""
    running = PoseFilter(settings)
    rows = zip(times.tolist(), Ts[:, :3, 3].tolist(), se3.wxyz(Ts).tolist(), states.tolist(), strict=True)
    out = [running.step(time, tuple(p), tuple(q), s) for time, p, q, s in rows]
    positions, quaternions, filtered_states = zip(*out, strict=True)
    return se3.pose_from_wxyz(np.array(positions), np.array(quaternions)), np.array(filtered_states)


class _Filter:
    """One quantity in the paper's Algorithm 1: a value with a difference (a vector) and an addition."""

    def __init__(
        self,
        band: Band | None,
        minus: Callable[[Vector, Vector], Vector],
        plus: Callable[[Vector, Vector], Vector],
        at: Vector,
    ) -> None:
        self.value = at
        """The filtered value."""
        self._band, self._minus, self._plus = band, minus, plus
        self._speed = minus(at, at)

    def cutoff(self, value: Vector, a: float, dt: float) -> float:
        """Update the speed with weight `a` towards the new `value`; gives the cutoff, Hz."""
        if self._band is None:
            return 0.0
        away = self._minus(value, self.value)
        self._speed = tuple(v + a * (d / dt - v) for v, d in zip(self._speed, away, strict=True))
        return self._band.min_cutoff_hz + self._band.beta * math.hypot(*self._speed)

    def update(self, value: Vector, share: float) -> None:
        """Move by `share` of the difference to `value`; all of it without a filter."""
        if self._band is None:
            self.value = value
        else:
            self.value = self._plus(self.value, tuple(share * d for d in self._minus(value, self.value)))


def _share(cutoff_hz: float, dt: float) -> float:
    """Weight of a new value in a first-order low pass after `dt` seconds, 0 to 1."""
    return 1 / (1 + 1 / (2 * math.pi * cutoff_hz * dt)) if cutoff_hz > 0 else 0.0


def _minus(a: Vector, b: Vector) -> Vector:
    return tuple(x - y for x, y in zip(a, b, strict=True))


def _plus(a: Vector, b: Vector) -> Vector:
    return tuple(x + y for x, y in zip(a, b, strict=True))


def _rotation_between(to: Vector, at: Vector) -> Vector:
    """The shortest rotation vector (3,) from quaternion `at` to `to`."""
    w, x, y, z = _product(to, (at[0], -at[1], -at[2], -at[3]))
    if w < 0:
        w, x, y, z = -w, -x, -y, -z
    sine = math.hypot(x, y, z)
    scale = 2 * math.atan2(sine, w) / sine if sine > 1e-12 else 2.0
    return x * scale, y * scale, z * scale


def _rotate(at: Vector, by: Vector) -> Vector:
    """The unit quaternion `at` rotated by the rotation vector `by`."""
    angle = math.hypot(*by)
    scale = math.sin(angle / 2) / angle if angle > 1e-12 else 0.5
    q = _product((math.cos(angle / 2), by[0] * scale, by[1] * scale, by[2] * scale), at)
    length = math.hypot(*q)
    return tuple(c / length for c in q)


def _product(a: Vector, b: Vector) -> tuple[float, float, float, float]:
    return (
        a[0] * b[0] - a[1] * b[1] - a[2] * b[2] - a[3] * b[3],
        a[0] * b[1] + a[1] * b[0] + a[2] * b[3] - a[3] * b[2],
        a[0] * b[2] - a[1] * b[3] + a[2] * b[0] + a[3] * b[1],
        a[0] * b[3] + a[1] * b[2] - a[2] * b[1] + a[3] * b[0],
    )
