"""What torque a joint took that its equation does not know: for motion that is prescribed while its force is read.

Where a drive holds the speed, positions tell nothing of friction: the force that it needed does. The residual is the
told force less that of the inverse dynamics; what is left of it beside a set of effects is in N*m or N, and its samples
are far from independent. Joints at rest are left out: friction there takes whatever it is given, up to its level
(`breakaways`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import product

import numpy as np
from numpy.typing import NDArray

from freeart21.base_motion import sway_force
from freeart21.effects import EFFECTS, Effect
from freeart21.effects.base import Parameter
from freeart21.joint import JointType
from freeart21.measured import Measured, Run
from freeart21.se3 import Array
from simgap.measure.floor import floor_of
from simgap.measure.inputs import base_sway, enabled_at, told_efforts
from simgap.motion.equation_error import known_forces, smoothed
from simgap.motion.surrogate import Plant

_SPEEDS = (0.003, 0.01, 0.03, 0.1, 0.3)
"""Parts of the largest speed that a law's own speed is tried at."""
_PLACES = 5
"""Places over the range that one with a place is tried at."""
_SAMPLES = 2000
"""Samples that a fit looks at."""
_RESTING = 0.02
"""Part of a run's median speed below which its joint turns back or rests, and tells no sliding friction."""


@dataclass(frozen=True)
class TorqueResidual:
    """Samples of all runs in a row, (n,) each, of a moving joint."""

    torque: Array
    """N*m or N: told force less that which the asset's motion needs; friction's has the sign of the speed."""
    q: Array
    qd: Array
    qdd: Array
    asked: Array
    """N*m or N that the actuator was told to give; 0 while it was off."""
    on: NDArray[np.bool_]
    """Whether the actuator was on."""
    gravity: Array
    """N*m or N of gravity, by the asset."""
    load: Array
    """N on the bearing."""
    time_s: Array
    """Since the start of the run."""
    run: NDArray[np.int64]
    """Number of the run."""
    run_names: tuple[str, ...]
    inertia: float
    """kg*m^2 or kg, by the asset and its effects."""
    doubts: tuple[float, float]
    """Parts by which inertia and gravity may be off."""
    joint_type: JointType


def torque_residual(
    measured: Measured, plant: Plant, effects: tuple[Effect, ...] = (), runs: Sequence[Run] | None = None
) -> TorqueResidual:
    """What torque the joint took beside what its equation with the asset's and these `effects` knows.

    Args:
        measured: circumstances, and the runs that are not held out.
        plant: the asset's joint.
        effects: those that are in the simulation besides the asset's own.
        runs: which to look at in place of those.
    """
    chosen = tuple(run for run in measured.runs if not run.held_out) if runs is None else tuple(runs)
    acting = (*plant.effects, *effects)
    inertia = plant.mechanics.inertia + float(np.sum([e.inertia() for e in acting]))
    told = [_of_run(measured, plant, run, acting, inertia, i) for i, run in enumerate(chosen)]
    rows = [row for row in told if row is not None]
    table = np.concatenate(rows, 1) if rows else np.zeros((10, 0))
    torque, q, qd, qdd, asked, on, gravity, load, time, run = table
    return TorqueResidual(
        torque, q, qd, qdd, asked, on > 0, gravity, load, time, run.astype(np.int64),
        tuple(r.name for r in chosen), inertia, (measured.inertia_relative, measured.gravity_relative),
        plant.joint_type,
    )  # fmt: skip


def _of_run(
    measured: Measured, plant: Plant, run: Run, effects: tuple[Effect, ...], inertia: float, number: int
) -> Array | None:
    smooth = smoothed(run)
    if smooth is None:
        return None
    t, _, q, qd, qdd, kernel = smooth
    if run.qd is not None:
        known = np.isfinite(run.qd)
        qd = np.interp(t, run.times_s[known], run.qd[known])
    given, gravity = known_forces(measured, plant.mechanics, run, effects, t, q, qd, qdd)
    if run.base is not None:
        given = given + sway_force(base_sway(run, measured, plant).at(t), q)
    effort, _ = told_efforts(run, measured)
    on = enabled_at(run, t, effort is not None)
    asked = np.zeros(len(t)) if effort is None else np.where(on, np.interp(t, *_known(run.times_s, effort)), 0.0)
    # all through the kernel that the acceleration is seen through
    given, gravity, qd, asked = (np.convolve(series, kernel, "same") for series in (given, gravity, qd, asked))
    load = plant.mechanics.load(q, qd, qdd)
    half = len(kernel) // 2 + 1
    sliding = np.abs(qd) > _RESTING * float(np.median(np.abs(qd)))
    near = np.convolve(~sliding, np.ones(2 * half + 1), "same") > 0
    keep = ~near & (np.arange(len(t)) >= half) & (np.arange(len(t)) < len(t) - half)
    torque = given + gravity - inertia * qdd
    columns = (torque, q, qd, qdd, asked, on, gravity, load, t - run.times_s[0], np.full(len(t), float(number)))
    return np.stack(columns)[:, keep]


def _known(times: Array, values: Array) -> tuple[Array, Array]:
    known = np.isfinite(values)
    return times[known], values[known]


def torque_of(effect: Effect, seen: TorqueResidual) -> Array:
    """(n,) N*m or N of the residual that an effect makes: minus its force, and its friction along the speed."""
    taken = seen.qdd * effect.inertia() - np.where(seen.on, effect.bias_force(), 0.0)
    taken = taken - (effect.gain() - 1.0) * seen.asked - effect.force(seen.q, seen.qd)
    return np.asarray(taken + np.sign(seen.qd) * effect.drive_limit(seen.q, seen.qd, seen.load))


@dataclass(frozen=True)
class TorqueExplained:
    """What a set of effects makes of a residual."""

    effects: tuple[Effect, ...]
    inertia: float
    """Factor of the asset's inertia."""
    gravity: float
    """Factor of the asset's weight."""
    before: float
    """N*m or N, root mean square, that the asset alone leaves within its doubts."""
    after: float
    """The same, with the effects."""
    left: Array
    """(n,) what they leave."""


def explained(seen: TorqueResidual, names: Sequence[str]) -> TorqueExplained:
    """The effects of these names that explain the residual best, within their bounds and the asset's doubts.

    Those that have neither force, friction, inertia, gain nor offset explain nothing of it.
    """
    classes = [EFFECTS[name] for name in names]
    before = _fit(seen, [], [np.zeros(0)])
    if not classes:
        return before
    grids = [_starts(cls, seen) for cls in classes]
    found = _fit(seen, classes, [np.concatenate(point) for point in product(*grids)])
    return TorqueExplained(found.effects, found.inertia, found.gravity, before.after, found.after, found.left)


def _fit(seen: TorqueResidual, classes: list[type[Effect]], points: list[Array]) -> TorqueExplained:
    """The best of the fits from these points."""
    from scipy.optimize import least_squares

    specs = [spec for cls in classes for spec in _own(cls, seen).values()]
    doubts = np.array([max(d, 1e-9) for d in seen.doubts])
    low = np.concatenate([1 - doubts, [spec.lower for spec in specs]])
    high = np.concatenate([1 + doubts, [spec.upper for spec in specs]])
    count = [len(_own(cls, seen)) for cls in classes]
    size = max(float(np.sqrt(np.mean(seen.torque**2))), 1e-12)

    def made(x: Array) -> tuple[Effect, ...]:
        parts = np.split(x[2:], np.cumsum(count)[:-1]) if classes else []
        return tuple(
            cls(**dict(zip(_own(cls, seen), map(float, np.clip(part, *_bounds(cls, seen))), strict=True)))
            for cls, part in zip(classes, parts, strict=True)
        )

    def left(x: Array, seen: TorqueResidual) -> Array:
        asset = (x[1] - 1) * seen.gravity - (x[0] - 1) * seen.inertia * seen.qdd
        return np.asarray(seen.torque + asset - sum((torque_of(e, seen) for e in made(x)), np.zeros(len(seen.q))))

    few = _thinned(seen)
    best = None
    for point in points:
        start = np.clip(np.concatenate([[1.0, 1.0], point]), low + 1e-12, high - 1e-12)
        scale = np.maximum(np.abs(start), 1e-6)
        found = least_squares(lambda x: left(x, few) / size, start, bounds=(low, high), x_scale=scale, max_nfev=60)
        if best is None or found.cost < best.cost:
            best = found
    assert best is not None
    rest = left(best.x, seen)
    rms = float(np.sqrt(np.mean(rest**2)))
    return TorqueExplained(made(best.x), float(best.x[0]), float(best.x[1]), rms, rms, rest)


def _thinned(seen: TorqueResidual) -> TorqueResidual:
    """Enough samples for a fit; neighbours tell the same."""
    every = max(1, -(-len(seen.q) // _SAMPLES))
    names = ("torque", "q", "qd", "qdd", "asked", "on", "gravity", "load", "time_s", "run")
    return replace(seen, **{name: getattr(seen, name)[::every] for name in names})


def _own(cls: type[Effect], seen: TorqueResidual) -> dict[str, Parameter]:
    """The parameters that the residual tells of: shafts that throw back are told by impacts."""
    return {n: s for n, s in cls.parameters(seen.joint_type).items() if n not in ("throw_back", "swing")}


def _bounds(cls: type[Effect], seen: TorqueResidual) -> tuple[Array, Array]:
    specs = _own(cls, seen).values()
    return np.array([s.lower for s in specs]), np.array([s.upper for s in specs])


def _starts(cls: type[Effect], seen: TorqueResidual) -> list[Array]:
    """Points to begin a fit from: sizes of a part of the residual, speeds and places over what was gone through."""
    size = 0.5 * max(float(np.sqrt(np.mean(seen.torque**2))), 1e-9)
    speed, low, high = float(np.abs(seen.qd).max()), float(seen.q.min()), float(seen.q.max())
    choices = []
    for spec in _own(cls, seen).values():
        unit = spec.revolute_unit or spec.prismatic_unit
        if unit == "rad/s":
            choices.append([part * speed for part in _SPEEDS])
        elif unit == "rad" and spec.lower < 0:
            choices.append(list(np.linspace(low, high, _PLACES)))
        elif unit == "rad":
            choices.append([0.1 * (high - low)])
        elif unit == "1":
            choices.append([1.0])
        else:
            usual = {"N*m": 1.0, "N*m*s/rad": speed, "N*m*s^2/rad^2": speed**2, "N*m/rad": 0.5 * (high - low)}
            choices.append([size / max(usual.get(unit or "", 1.0), 1e-9)])
    return [np.array(point) for point in product(*choices)]


@dataclass(frozen=True)
class Breakaway:
    """Where a joint that stood began to slide."""

    run: str
    time_s: float
    """Since the start of the run."""
    torque: float
    """N*m or N that it was given there beside gravity, either way."""
    bent: float
    """rad or m that it gave way by before."""


def breakaways(
    measured: Measured, plant: Plant, runs: Sequence[Run] | None = None, reach: float = 0.0
) -> list[Breakaway]:
    """Of every run that begins at rest and then slides: the largest torque up to where it does.

    Args:
        measured: circumstances and runs.
        plant: the asset's joint.
        runs: which to look at; all when None.
        reach: rad or m that a joint may give way by before it slides (its bristles bend: Armstrong-Helouvry 1994 has
            some .02 to .05 mm of contacts); 8 of the sensor's floors at least.
    """
    found = []
    for run in measured.runs if runs is None else runs:
        known = np.isfinite(run.q)
        t, q = run.times_s[known], run.q[known]
        floor = floor_of([(t, q)]).still
        away = np.abs(q - q[0]) > max(reach, 8 * floor)
        effort, push = told_efforts(run, measured)
        told = [_known(run.times_s, values) for values in (effort, push) if values is not None]
        if not told or not away.any() or away[: max(3, len(q) // 100)].any():
            continue
        first = int(np.argmax(away))
        before = t[: first + 1]
        torque = sum(np.interp(before, *series) for series in told) + plant.mechanics.gravity_force(q[: first + 1])
        most = int(np.argmax(np.abs(torque)))
        found.append(Breakaway(run.name, float(before[most] - t[0]), float(torque[most]), float(abs(q[most] - q[0]))))
    return found
