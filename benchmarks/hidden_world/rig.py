"""Experiments: which runs are made with an object, and what drives each of them. The same for every hidden effect.

    full    free swings from both sides and of several sizes, a slow ramp and waves of a known push, a position servo
    free    free swings only                push    free swings and known pushes
    swing   free swings that never meet a stop (of a hinge that lies)
    servo   the position servo only         effort  known commanded forces, no feedback
    poses   free swings, part poses as a camera sees them
    still   as full, but so small that next to nothing moves

Thirteen runs each: eight to fit, three held out of the same regime, two of a wilder one.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from benchmarks.hidden_world.body import Body

RIGS = ("full", "free", "swing", "push", "servo", "effort", "poses", "still")
SAME, OTHER = (8, 9, 10), (11, 12)
"""Held-out runs: of the same regime as the fitted ones, and of another."""
RUNS = 13


@dataclass(frozen=True)
class Servo:
    """force = stiffness * (command - q) - damping * q'."""

    stiffness: float
    damping: float


@dataclass(frozen=True)
class Plan:
    """One run as it is meant: where it starts, and what drives it at which sample."""

    q0: float
    v0: float
    command: NDArray[np.float64] | None
    """(n,) commanded position at the nominal sample times, or None with the servo off."""
    effort: NDArray[np.float64] | None
    """(n,) N*m or N."""


def draw_servo(rng: np.random.Generator, body: Body) -> Servo:
    """A soft servo that rings a little."""
    rate = rng.uniform(9, 14) if body.revolute else rng.uniform(8, 12)
    return Servo(float(body.inertia * rate**2), float(2 * rng.uniform(0.25, 0.45) * rate * body.inertia))


def draw_plans(rng: np.random.Generator, body: Body, rig: str, servo: Servo, times: NDArray[np.float64]) -> list[Plan]:
    """The thirteen runs of a rig, in the order of the session; `times` (n,) are nominal, s from 0."""
    kinds = {
        "full": "FFFFRPSCFPSFX", "free": "FFFFFFFFFFFFF", "swing": "WWWWWWWWWWWWW", "push": "FFFRPPPFFPPFP",
        "servo": "SCSCSCSCSCSXX", "effort": "EEEEEEEEEEEEE", "poses": "FFFFFFFFFFFFF", "still": "FFFFRPSCFPSFX",
    }[rig]  # fmt: skip
    small = 8e-4 if rig == "still" else 1.0
    return [_plan(rng, body, kind, i, servo, times, small) for i, kind in enumerate(kinds)]


def _plan(
    rng: np.random.Generator, body: Body, kind: str, i: int, servo: Servo, times: NDArray[np.float64], small: float
) -> Plan:
    wild = 1.0 if i in OTHER else 0.0
    if kind == "W":
        size = (0.9, 0.75, 0.5, 0.3, 0.12, 0.6, 0.4, 0.8, 0.7, 0.45, 0.2, 0.97, 0.96)[i]
        # no sensor's zero that is off puts a reading beyond a stop: that would tell it from a leaning base
        room = min(body.upper - body.rest, body.rest - body.lower) - 0.09 * body.range
        return Plan(body.rest + (-1) ** i * size * room * rng.uniform(0.97, 1), 0.0, None, None)
    if kind == "F":
        q0, v0 = _release(rng, body, i, wild)
        if small < 1:
            at = body.rest if body.family != "slope" else body.lower + 0.5 * body.range
            q0, v0 = at + small * (q0 - at), small * v0
        return Plan(q0, v0, None, None)
    if kind in "RPE":
        q0, v0, effort = _push(rng, body, kind, i, wild, times)
        q0 = q0 if small == 1 else body.rest + small * (q0 - body.rest)
        return Plan(q0, small * v0, None, small * effort)
    command = _command(rng, body, kind, wild, times, small)
    q0 = command[0] + small * 0.05 * body.range * rng.uniform(-1, 1)
    return Plan(float(np.clip(q0, body.lower, body.upper)), 0.0, command, None)


def _release(rng: np.random.Generator, body: Body, i: int, wild: float) -> tuple[float, float]:
    """Start of a free run: all sizes, both sides; wilder ones are larger and faster than any that is fitted."""
    about = rng.uniform(0.93, 1.07)
    R = body.range
    if body.family == "pendulum":
        up, down = body.upper - body.rest, body.rest - body.lower
        parts = (0.75 * up, -0.85 * down, 0.12, 0.4 * up, -0.5 * down, 0.25, 0.6 * up, -0.3 * down,
                 0.55 * up, -0.65 * down, 0.2, 0.95 * up, 0.95 * up)  # fmt: skip
        q0 = body.rest + (parts[i] * about if not wild else 0.95 * up * rng.uniform(0.97, 1.0))
        return float(np.clip(q0, body.lower, body.upper)), (-0.3 * body.speed * about if i == 3 else 0.0)
    if body.family == "slope":
        constant = body.gravity_terms()[2]
        pull = abs(constant) / body.mass
        heights = (0.6, 0.4, 0.15, 0.75, 0.3, 0.5, 0.2, 0.65, 0.45, 0.55, 0.25, 0.93, 0.88)
        falls = i in (3, 7)
        if constant < 0:
            foot, way = body.lower, 1.0
        else:
            foot, way = body.upper, -1.0
        if falls:
            return foot + way * heights[i] * about * R, 0.0
        return foot + way * 0.03 * R, way * float(np.sqrt(2 * pull * heights[i] * R) * about)
    starts = (0.1, 0.9, 0.5, 0.55, 0.2, 0.85, 0.5, 0.3, 0.8, 0.15, 0.45, 0.05, 0.95)
    speeds = (0.45, -0.3, 0.08, -0.9, 0.2, -0.6, 0.04, 0.15, -0.45, 0.35, -0.1, 1.6, -1.5)
    return body.lower + starts[i] * R, speeds[i] * R * float(about)


def _push(
    rng: np.random.Generator, body: Body, kind: str, i: int, wild: float, times: NDArray[np.float64]
) -> tuple[float, float, NDArray[np.float64]]:
    """Start and force of a pushed run: a slow triangle from rest, or a wave; both sides of what it has to overcome."""
    end = times[-1]
    constant = body.gravity_terms()[2]
    if kind == "R":
        size = 0.55 * body.force * rng.uniform(0.9, 1.1)
        corners = np.interp(times, [0, 0.3 * end, 0.8 * end, end], [0, size, -0.8 * size, 0]) - constant
        q0 = body.rest
        return float(q0), 0.0, np.asarray(corners)
    if body.family == "pendulum":  # well below its own rate: without losses it would climb into the stops
        omega = rng.uniform(0.3, 0.55) * np.sqrt(body.force / body.inertia)
        size = (0.55 if wild else (0.15, 0.25, 0.35)[i % 3]) * body.force
        return body.rest + 0.1 * float(rng.normal()), 0.0, size * np.sin(omega * times + rng.uniform(0, 6))
    omega = 2 * np.pi * rng.uniform(0.45, 1.1) * (1.4 if wild else 1.0)
    swing = (0.4 if wild else (0.12, 0.2, 0.28)[i % 3]) * body.range
    size = swing * omega**2 * body.inertia / 2
    ripple = 0.25 * size * np.sin(2.7 * omega * times)
    v0 = -0.25 * size / (2.7 * omega * body.inertia)
    return float(body.rest - 0.5 * swing), v0, size * np.cos(omega * times) + ripple - constant


def _command(
    rng: np.random.Generator, body: Body, kind: str, wild: float, times: NDArray[np.float64], small: float
) -> NDArray[np.float64]:
    """Commanded positions: S steps, C a chirp, X a fast and wide chirp."""
    centre = body.lower + 0.5 * body.range
    if body.family == "pendulum":
        centre = body.rest + (0.15 * body.range if small == 1 else 0.0)
    if kind == "S":
        levels = centre + small * 0.24 * body.range * rng.uniform(0.5, 1, 5) * np.array([-1, 1, -1, 1, -1])
        return levels[np.minimum((times / times[-1] * 5).astype(int), 4)]
    low, high = (0.8, 2.6) if wild else (0.3, 1.9)
    phase = 2 * np.pi * (low * times + 0.5 * (high - low) * times**2 / times[-1])
    size = (0.25 if wild else 0.15) * body.range * rng.uniform(0.85, 1)
    return centre + small * size * np.sin(phase)
