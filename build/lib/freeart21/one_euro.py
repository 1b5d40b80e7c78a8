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
from freeart21.joint import JointType
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


def headset(joint_type: JointType) -> OneEuro:
    """What controllers held in the hand want, for a hinge's or a slide's joint.

    By `python -m benchmarks.headset_filter` a held controller's noise (assumed: .6 mm and .25 degrees, half of it a
    hand's tremor at 10 Hz) becomes 4.1 and 4.5 times less, and captured motion of eleven takes lags 3 and 4 ms where it
    is fastest (5 % of each take) and 6 ms elsewhere (places, turns). A joint's speed counts as a turn's or a place's.
    """
    place, turn = Band(1.0, 100.0), Band(1.0, 10.0)
    return OneEuro(place, turn, turn if joint_type == "revolute" else place)


class PoseFilter:
    """The filter, sample by sample.

    Each quantity asks for a cutoff by its own speed, and the largest is used for all of them: what is filtered goes one
    share of its way. So pose and joint are together what they were together some milliseconds ago, as somebody saw
    them, and not a pose of one moment with a joint of another: in one of the first takes such an object left the
    picture that it had been kept in.
    """

    def __init__(self, settings: OneEuro) -> None:
        self._settings = settings
        self._time = 0.0
        self._parts: tuple[_Filter, _Filter, _Filter] | None = None

    def step(self, time: float, position: Vector, quaternion: Vector, state: float) -> tuple[Vector, Vector, float]:
        """The filtered position (3,) m, unit quaternion (4,) wxyz and state of a sample at `time` s; times grow."""
        given, wanted = self._settings, (position, quaternion, (state,))
        if self._parts is None:
            self._parts = (
                _Filter(given.position, _minus, _plus, position),
                _Filter(given.rotation, _turn_to, _turned, quaternion),
                _Filter(given.state, _minus, _plus, (state,)),
            )
        else:
            dt, parts = time - self._time, self._parts
            a = _share(given.speed_cutoff_hz, dt)
            b = _share(max(part.cutoff(value, a, dt) for part, value in zip(parts, wanted, strict=True)), dt)
            for part, value in zip(parts, wanted, strict=True):
                part.go(value, b)
        self._time = time
        place, turn, joint = self._parts
        return place.at, turn.at, joint.at[0]


def filtered(settings: OneEuro, times: Array, Ts: Array, states: Array) -> tuple[Array, Array]:
    """Poses (n, 4, 4) and states (n,) at the same `times` (n,): what `PoseFilter` gives, sample by sample."""
    running = PoseFilter(settings)
    rows = zip(times.tolist(), Ts[:, :3, 3].tolist(), se3.wxyz(Ts).tolist(), states.tolist(), strict=True)
    out = [running.step(time, tuple(p), tuple(q), s) for time, p, q, s in rows]
    positions, quaternions, filtered_states = zip(*out, strict=True)
    return se3.pose_from_wxyz(np.array(positions), np.array(quaternions)), np.array(filtered_states)


class _Filter:
    """One quantity in the paper's Algorithm 1: anything with a difference (a vector) and a way to add one."""

    def __init__(
        self,
        band: Band | None,
        minus: Callable[[Vector, Vector], Vector],
        plus: Callable[[Vector, Vector], Vector],
        at: Vector,
    ) -> None:
        self.at = at
        """Where the filter stands."""
        self._band, self._minus, self._plus = band, minus, plus
        self._speed = minus(at, at)

    def cutoff(self, value: Vector, a: float, dt: float) -> float:
        """The cutoff that it asks for, Hz, once its speed has gone a share `a` to the one it needs to `value`."""
        if self._band is None:
            return 0.0
        away = self._minus(value, self.at)
        self._speed = tuple(v + a * (d / dt - v) for v, d in zip(self._speed, away, strict=True))
        return self._band.min_cutoff_hz + self._band.beta * math.hypot(*self._speed)

    def go(self, value: Vector, share: float) -> None:
        """Go so much of the way to `value`; all of it, where nothing is filtered."""
        if self._band is None:
            self.at = value
        else:
            self.at = self._plus(self.at, tuple(share * d for d in self._minus(value, self.at)))


def _share(cutoff_hz: float, dt: float) -> float:
    """How far a low pass goes to a new value in `dt` seconds, of 1."""
    return 1 / (1 + 1 / (2 * math.pi * cutoff_hz * dt)) if cutoff_hz > 0 else 0.0


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
