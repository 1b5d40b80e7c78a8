"""Timing: the joint's course, and the pauses of the hand that holds the object."""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from freeart21.se3 import Array

_SECOND = 30.0  # frames: durations below are in frames at this rate, and shrink with a short video
_LONG = 300.0


@dataclass(frozen=True)
class Hold:
    """A long rest of the joint."""

    share: float
    """Position, as a share of the range."""
    length: float
    """Share of the frames, below 1."""


@dataclass(frozen=True)
class JointCourse:
    """The joint's opening over time."""

    shares: Array
    """(n,) share of the range, 0 to 1."""
    moves: tuple[tuple[float, float], ...]
    """First and last frame of every move."""
    rests: tuple[tuple[float, float], ...]
    """First and last frame of every rest."""
    held: tuple[float, float] | None
    """First and last frame of the long rest, when there is one."""


def ease(u: Array) -> Array:
    """From 0 to 1 along a minimum-jerk course (Flash and Hogan 1985) as `u` goes from 0 to 1, at rest beyond."""
    u = np.clip(u, 0, 1)
    return u**3 * (10 - 15 * u + 6 * u**2)


def glide(u: Array) -> Array:
    """From 0 to 1 as `u` does, at rest beyond: three tenths of the time to gain speed, as much to lose it."""
    r = 0.3

    def ramp(x: Array) -> Array:  # the integral of `ease`
        x = np.clip(x, 0, 1)
        return x**4 * (2.5 - 3 * x + x**2)

    u = np.clip(u, 0, 1)
    steady = np.clip(u - r, 0, 1 - 2 * r)
    return (r * ramp(u / r) + steady + r * (0.5 - ramp(np.minimum((1 - u) / r, 1)))) / (1 - r)


def joint_course(frames: int, rng: np.random.Generator, hold: Hold | None = None) -> JointCourse:
    """Partly open, then fully open, closed and open again, then random positions, with rests in between.

    Every move has minimum jerk. A `hold` is inserted at a random place after the first move.
    """
    stops = [float(rng.uniform(0.12, 0.3)), 1.0, 0.0, 1.0]
    while len(stops) < frames // 65:
        stops.append(float(rng.uniform(0.0, 0.5) if stops[-1] > 0.5 else rng.uniform(0.5, 1.0)))
    at = None
    if hold is not None:
        near = [k for k in range(1, len(stops)) if abs(stops[k] - hold.share) < 0.05]
        at = int(rng.choice(near)) if near else int(rng.integers(2, len(stops) + 1))
        if not near:
            stops.insert(at, hold.share)
    rests = rng.uniform(9.0, 24.0, len(stops))
    moves = 12.0 + 44.0 * np.abs(np.diff(stops)) * rng.uniform(0.85, 1.15, len(stops) - 1)
    if at is not None and hold is not None:
        rests[at] = 0.0
        rests[at] = hold.length / (1 - hold.length) * (rests.sum() + moves.sum())
    knots = np.cumsum(np.concatenate([[0.0], np.stack([rests[:-1], moves], 1).reshape(-1), rests[-1:]]))
    knots *= (frames - 1) / knots[-1]
    t, shares = np.arange(frames, dtype=float), np.full(frames, stops[0])
    for k, (a, b) in enumerate(itertools.pairwise(stops)):
        shares += (b - a) * ease((t - knots[2 * k + 1]) / max(knots[2 * k + 2] - knots[2 * k + 1], 1e-9))
    spans = list(itertools.pairwise(knots.tolist()))
    return JointCourse(
        np.clip(shares, 0.0, 1.0), tuple(spans[1::2]), tuple(spans[0::2]), None if at is None else spans[2 * at]
    )


def pose_rate(frames: int, course: JointCourse, rng: np.random.Generator, linger: float = 1.0) -> Array:
    """(frames,) speed of the hand, 1 at the median: uneven, with pauses.

    In some pauses the joint moves, in others it rests; in some rests of the joint the hand moves. During the joint's
    long rest the hand is slower by the factor `linger`.
    """
    t = np.arange(frames, dtype=float)
    scale = min(frames / _LONG, 1.0)
    ramp = max(9.0 * scale, 2.0)
    rate = 1 + 0.3 * wander(t / _SECOND, rng, 0.5)
    moves = [m for m in course.moves if m[1] - m[0] > 26 * scale]
    for a, b in _some(moves, max(round(frames / 170), 1), rng):
        length = min(0.5 * (b - a), rng.uniform(16, 26) * scale)
        start = rng.uniform(a + 0.1 * (b - a), b - 0.1 * (b - a) - length)
        rate *= 1 - _window(t, start, start + length, ramp)
    rests = [r for r in course.rests[1:] if r != course.held]
    for a, b in _some(rests, max(round(frames / 220), 1), rng):
        rate *= 1 - _window(t, a, b, ramp)
    if course.held is not None:
        rate *= 1 - (1 - linger) * _window(t, *course.held, ramp)
    return rate / max(float(np.median(rate)), 0.3)


def clock(rate: Array) -> Array:
    """(n,) time, from 0, of a clock that runs at `rate` (n,): it stops while the hand rests."""
    return np.concatenate([[0.0], np.cumsum((rate[1:] + rate[:-1]) / 2)])


def wander(t: Array, rng: np.random.Generator, hz: float, parts: int = 3) -> Array:
    """(n,) a smooth random course in about -1 to 1 at times `t` (n,), of frequencies from half of `hz` to `hz`."""
    rates, phases = hz * rng.uniform(0.5, 1.0, parts), rng.uniform(0, 2 * np.pi, parts)
    weights = rng.uniform(0.5, 1.0, parts)
    return np.sin(2 * np.pi * t[:, None] * rates + phases) @ (weights / np.linalg.norm(weights) / 1.2)


def tremor(frames: int, fps: float, rng: np.random.Generator) -> Array:
    """(frames, 3) tremor of a hand at rest, radians (or metres per metre): a tenth of a degree."""
    t = np.arange(frames) / fps
    return np.asarray(np.radians(0.1) * np.stack([wander(t, rng, 1.2) for _ in range(3)], -1))


def _window(t: Array, start: float, stop: float, ramp: float) -> Array:
    """1 from `start` to `stop`, smoothly to 0 at a distance of `ramp`."""
    return ease((t - start + ramp) / ramp) * ease((stop + ramp - t) / ramp)


def _some(
    spans: list[tuple[float, float]] | tuple[tuple[float, float], ...], n: int, rng: np.random.Generator
) -> list[tuple[float, float]]:
    picked: NDArray[np.int64] = rng.permutation(len(spans))[:n]
    return [spans[k] for k in picked]
