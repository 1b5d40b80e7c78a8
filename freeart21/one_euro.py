"""The one-euro filter (Casiez, Roussel and Vogel, CHI 2012) of a pose and a joint's state: steady yet prompt.

A first-order low pass whose cutoff grows with speed, `min_cutoff + beta * |speed|`, the speed itself low-passed. A
vector has one cutoff, by the length of its speed, so that no path is bent. A rotation is filtered on SO(3): the
filter goes a share of the rotation vector from where it stands to what was measured; the speed is that vector over
the time.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from freeart21 import se3
from freeart21.se3 import Array

Vector = tuple[float, ...]


@dataclass(frozen=True)
class Band:
    """How one quantity is filtered."""

    min_cutoff_hz: float
    """Cutoff of what stands still."""
    beta: float
    """Hz of cutoff more for each unit of speed: 1/m for positions and sliding joints, 1/rad for turns and hinges."""


@dataclass(frozen=True)
class OneEuro:
    """Settings of the filter; None leaves a quantity as it is."""

    position: Band | None
    rotation: Band | None
    state: Band | None
    speed_cutoff_hz: float = 1.0
    """Of the speed: the paper's value, which its authors found to need no tuning."""


HEADSET = OneEuro(position=Band(1.0, 100.0), rotation=Band(1.0, 10.0), state=None)
"""Of controllers held in the hand. By `python -m benchmarks.headset_filter` a held controller's noise (assumed: .6 mm
and .25 degrees, half of it a hand's tremor at 10 Hz) becomes 4.1 and 4.7 times less; captured motion of eleven takes
lags 3 and 5 ms where it is fastest (5 % of each take) and 10 and 13 ms elsewhere (places, turns). The joint's state
is a stick's, summed over time: it has no noise to take away."""


class PoseFilter:
    """The filter, sample by sample."""

    def __init__(self, settings: OneEuro) -> None:
        hz = settings.speed_cutoff_hz
        self._position = None if settings.position is None else _Filter(settings.position, hz, _minus, _plus)
        self._rotation = None if settings.rotation is None else _Filter(settings.rotation, hz, _turn_to, _turned)
        self._state = None if settings.state is None else _Filter(settings.state, hz, _minus, _plus)

    def step(self, time: float, position: Vector, quaternion: Vector, state: float) -> tuple[Vector, Vector, float]:
        """The filtered position (3,) m, unit quaternion (4,) wxyz and state of a sample at `time` s; times grow."""
        if self._position is not None:
            position = self._position.step(time, position)
        if self._rotation is not None:
            quaternion = self._rotation.step(time, quaternion)
        if self._state is not None:
            (state,) = self._state.step(time, (state,))
        return position, quaternion, state


def filtered(settings: OneEuro, times: Array, Ts: Array, states: Array) -> tuple[Array, Array]:
    """Poses (n, 4, 4) and states (n,) at the same `times` (n,): what `PoseFilter` gives, sample by sample."""
    running = PoseFilter(settings)
    rows = zip(times.tolist(), Ts[:, :3, 3].tolist(), se3.wxyz(Ts).tolist(), states.tolist(), strict=True)
    out = [running.step(time, tuple(p), tuple(q), s) for time, p, q, s in rows]
    positions, quaternions, filtered_states = zip(*out, strict=True)
    return se3.pose_from_wxyz(np.array(positions), np.array(quaternions)), np.array(filtered_states)


class _Filter:
    """The paper's Algorithm 1, for anything with a difference (a vector) and a way to add one."""

    def __init__(
        self,
        band: Band,
        speed_cutoff_hz: float,
        minus: Callable[[Vector, Vector], Vector],
        plus: Callable[[Vector, Vector], Vector],
    ) -> None:
        self._band, self._speed_hz, self._minus, self._plus = band, speed_cutoff_hz, minus, plus
        self._time = 0.0
        self._at: Vector | None = None
        self._speed: Vector = ()

    def step(self, time: float, value: Vector) -> Vector:
        if self._at is None:
            self._time, self._at, self._speed = time, value, self._minus(value, value)
            return value
        dt, away = time - self._time, self._minus(value, self._at)
        a = _share(self._speed_hz, dt)
        self._speed = tuple(v + a * (d / dt - v) for v, d in zip(self._speed, away, strict=True))
        b = _share(self._band.min_cutoff_hz + self._band.beta * math.hypot(*self._speed), dt)
        self._at, self._time = self._plus(self._at, tuple(b * d for d in away)), time
        return self._at


def _share(cutoff_hz: float, dt: float) -> float:
    """How far a low pass goes to a new value in `dt` seconds, of 1."""
    return 1 / (1 + 1 / (2 * math.pi * cutoff_hz * dt))


def _minus(a: Vector, b: Vector) -> Vector:
    return tuple(x - y for x, y in zip(a, b, strict=True))


def _plus(a: Vector, b: Vector) -> Vector:
    return tuple(x + y for x, y in zip(a, b, strict=True))


def _turn_to(to: Vector, at: Vector) -> Vector:
    """The rotation vector (3,) that turns `at` to `to`, the shorter way."""
    w, x, y, z = _product(to, (at[0], -at[1], -at[2], -at[3]))
    if w < 0:
        w, x, y, z = -w, -x, -y, -z
    sine = math.hypot(x, y, z)
    scale = 2 * math.atan2(sine, w) / sine if sine > 1e-12 else 2.0
    return x * scale, y * scale, z * scale


def _turned(at: Vector, by: Vector) -> Vector:
    """`at` turned by the rotation vector `by`, of length 1, w >= 0 or not as `at`."""
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
