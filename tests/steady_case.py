"""A joint whose speed a controller holds, for tests of simgap: its own fine integrator, its friction by bristles."""

from __future__ import annotations

import numpy as np
from gap_case import ARM, INERTIA, MASS, G
from numba import njit

from freeart21.measured import Measured, Run

STEP = 1e-4
SPEEDS = (0.003, 0.006, 0.01, 0.02, 0.03, 0.05, 0.08, 0.13, 0.2, 0.4, 0.7, 1.0)
"""rad/s, each both ways."""
BRISTLE = 3e-4
"""rad that contacts bend by before they slide."""


@njit
def _integrate_held(q, speed, n, every, inertia, weight, dry, rise, curve, viscous, bias):
    """(n,) position and the drive's torque of a joint that is brought to `speed`, rad/s, and held there."""
    at, torque = np.empty(n), np.empty(n)
    v, z, summed, push = 0.0, 0.0, 0.0, 0.0
    for i in range(n * every):
        if i % every == 0:
            at[i // every], torque[i // every] = q, push
        error = speed * min(i * 1e-4 / 0.3, 1.0) - v
        summed += error * 1e-4
        push = 60.0 * error + 600.0 * summed + weight * np.sin(q)
        level = dry + rise * np.exp(-((v / curve) ** 2))
        stiff = level / 3e-4
        slip = v - (abs(v) * stiff / max(level, 1e-12)) * z
        z += slip * 1e-4
        force = push + bias - weight * np.sin(q) - stiff * z - viscous * v
        if dry + rise > 0:
            force -= 2 * np.sqrt(stiff * inertia) * 0.3 * slip
        v += force / inertia * 1e-4
        q += v * 1e-4
    return at, torque


def steady_of(
    seed: int, rate: int = 100, seconds: float = 4.0, noise: float = 0.05, one_way: bool = False,
    dry: float = 0.0, rise: float = 0.0, curve: float = 0.03, viscous: float = 0.0, bias: float = 0.0,
    exact: bool = False, marked: bool = False, prescribed: bool | None = None, speeds: tuple[float, ...] = SPEEDS,
) -> Measured:  # fmt: skip
    """Turns at steady speeds, both ways over the same places (or one way alone); inertia is 5 %, weight 3 % unsure."""
    rng, runs = np.random.default_rng(seed), []
    off = (1.0, 1.0) if exact else (rng.uniform(0.95, 1.05), rng.uniform(0.97, 1.03))
    for i, speed in enumerate(speeds):
        for way in (1.0,) if one_way else (1.0, -1.0):
            begin = 0.3 - 0.5 * way * speed * seconds
            world = (INERTIA * off[0], MASS * G * ARM * off[1], dry, rise, curve, viscous, bias)
            n = round(seconds * rate)
            q, torque = _integrate_held(begin, way * speed, n, round(1 / (STEP * rate)), *world)
            q = 1e-5 * np.round(q / 1e-5 + rng.normal(0, 0.5, n))
            name = f"{'up' if way > 0 else 'down'}_{speed:g}"
            held_out = i % 3 == 1 if marked else None
            readings = torque + rng.normal(0, noise, n)
            runs.append(Run(name, np.arange(n) / rate, q, readings, held_out=held_out, prescribed=prescribed))
    unsure = (0.05, 0.03)
    gravity = np.array([0.0, 0.0, -G])
    return Measured("j", "revolute", gravity, rate, "recorded", "commanded", None, *unsure, tuple(runs), "unknown")
