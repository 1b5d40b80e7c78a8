"""What no experimenter gets rid of: an object a little other than its asset, and an imperfect sensor. Always on.

The asset's inertia is off by up to 10 %, its centre of mass by 5 %, the base leans by 0.3 degrees. Readings are
quantised, noisy, taken at jittering instants with stamps that are a little off, and some are lost. Runs are recorded
from a moment after the release.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from benchmarks.hidden_world.body import Body
from benchmarks.hidden_world.ode import COMMANDED, EXTERNAL, NO_EFFORT, Drive, World, simulate
from benchmarks.hidden_world.rig import Plan, Servo

RATE = 100.0
"""Hz, nominal."""
SECONDS = 5.0
LEAD = 0.12
"""s between the release and the first reading."""
LOST = 0.02
"""Part of the readings that is lost: the same number in every run."""
TICK = 5
"""Samples from one change of a command or a push to the next; the readings in between may be lost, those not."""
INERTIA_RELATIVE = 0.1
GRAVITY_RELATIVE = {"pendulum": 0.06, "door": 0.06, "drawer": 0.1, "slope": 0.1}
"""What the measured set says of its asset: 5 % of the arm (and the tilt) of a hinge, 10 % of the mass of a slider. The
tilt of a base whose asset feels no gravity is a part of nothing: any mounting leans by 0.3 degrees."""
GRAVITY_VECTOR = {"pendulum": 0.06, "door": 0.007, "drawer": 0.007, "slope": 0.035}
"""Largest change of gravity's pull on the joint by all of that, over mass * g (* arm); slopes are up to 0.25 rad."""


@dataclass(frozen=True)
class Nuisance:
    """One draw of it."""

    inertia: float
    """True over the asset's; of a slider, its mass."""
    com: float
    """True over the asset's distance from the axis; of a hinge."""
    tilt: NDArray[np.float64]
    """(3,) rad, rotation vector of the base."""
    quantum: float
    noise: float
    """rad or m."""
    jitter: float
    """Part of a sampling interval by which an instant is off."""
    stamp: float
    """s, standard deviation of the stamps' errors."""


@dataclass(frozen=True)
class Reading:
    """What the position sensor does to the true course, apart from noise: nothing, by default."""

    late: float = 0.0
    """s."""
    window: float = 0.0
    """s, half of the time over which it averages."""
    offset: float = 0.0
    factor: float = 1.0
    curve: float = 0.0
    """Error of the scale per position squared, so of the reading per position cubed."""
    ripple: float = 0.0
    """Once-round error, rad or m."""
    ripple_count: float = 1.0


@dataclass(frozen=True)
class Recorded:
    """One run as it is written down."""

    times: NDArray[np.float64]
    q: NDArray[np.float64]
    command: NDArray[np.float64] | None
    effort: NDArray[np.float64] | None
    true: NDArray[np.float64]
    """What it was; never written down."""


def draw_nuisance(rng: np.random.Generator, body: Body) -> Nuisance:
    """All of it at once. An encoder of 4096 steps a turn, or 0.2 to 0.5 mm, and noise of the same size."""
    lean = rng.normal(size=3)
    lean = lean - (lean @ body.gravity) * body.gravity / (body.gravity @ body.gravity)
    quantum = 2 * np.pi / 4096 if body.revolute else 1e-4 * rng.uniform(2, 5)
    return Nuisance(
        float(rng.uniform(0.9, 1.1)), float(rng.uniform(0.95, 1.05)),
        np.deg2rad(0.3) * rng.uniform(0, 1) * lean / np.linalg.norm(lean),
        float(quantum), float(quantum * rng.uniform(0.3, 0.9)), float(rng.uniform(0.05, 0.3)), 2e-6,
    )  # fmt: skip


def true_world(body: Body, nuisance: Nuisance) -> World:
    """The joint as it is, with nothing missing but nuisance."""
    along = (body.com @ body.axis) * body.axis
    com = along + nuisance.com * (body.com - along)
    gravity = body.gravity + np.cross(nuisance.tilt, body.gravity)
    cosine, sine, constant = replace(body, com=com, gravity=gravity).gravity_terms()
    world = body.world()
    if not body.revolute:
        constant, axial = nuisance.inertia * constant, nuisance.inertia * world.load_axial
        return world._replace(
            inertia=nuisance.inertia * world.inertia, gravity_constant=constant, load_axial=axial,
            mass=nuisance.inertia * world.mass,
        )  # fmt: skip
    return world._replace(
        inertia=nuisance.inertia * world.inertia,
        gravity_cosine=cosine,
        gravity_sine=sine,
        gravity_constant=constant,
        arm=nuisance.com * world.arm,
    )


def drive_of(plan: Plan, instants: NDArray[np.float64], commanded: bool) -> Drive:
    """What drives a run whose samples are at `instants`: commands and pushes change at a sample, and hold."""
    still = np.zeros(len(instants))
    held = np.arange(len(instants)) // TICK * TICK
    kind = NO_EFFORT if plan.effort is None else COMMANDED if commanded else EXTERNAL
    return Drive(
        instants,
        still if plan.command is None else plan.command[held],
        plan.command is not None,
        still if plan.effort is None else plan.effort[held],
        kind,
    )


def with_servo(world: World, servo: Servo) -> World:
    """The world with this position law."""
    return world._replace(stiffness=servo.stiffness, damping=servo.damping)


def nominal_times() -> NDArray[np.float64]:
    """(n,) s."""
    return np.arange(round(RATE * SECONDS) + 1) / RATE


def record(
    world: World,
    plan: Plan,
    commanded: bool,
    reading: Reading,
    nuisance: Nuisance,
    rng: np.random.Generator,
    clock: float,
    solve=simulate,
) -> Recorded:
    """One run, as the sensor writes it down; `solve` is the engine."""
    nominal = nominal_times()
    n = len(nominal)
    instants = nominal + nuisance.jitter / RATE * rng.uniform(-1, 1, n)
    drive = drive_of(plan, instants, commanded)
    looks = np.sort((instants - reading.late)[:, None] + reading.window * np.array([-1.0, 0.0, 1.0]), axis=1)
    asked = np.concatenate([[min(-LEAD, looks.min() - 1e-3)], looks.ravel()])
    when, back = np.unique(asked, return_inverse=True)
    course = solve(world, plan.q0, plan.v0, when, drive, clock)[:, 0][back][1:].reshape(n, 3)
    true = course.mean(axis=1)
    q = reading.factor * true + reading.curve * true**3 + reading.offset
    q = q + reading.ripple * np.sin(reading.ripple_count * true)
    q = q + nuisance.noise * rng.normal(size=n)
    q = nuisance.quantum * np.round(q / nuisance.quantum)
    stamps = instants + nuisance.stamp * rng.normal(size=n)
    between = np.flatnonzero(np.arange(n) % TICK)
    keep = np.setdiff1d(np.arange(n), rng.choice(between, round(LOST * n), replace=False))
    return Recorded(
        stamps[keep],
        q[keep],
        None if plan.command is None else drive.command[keep],
        None if plan.effort is None else drive.effort[keep],
        true[keep],
    )


def repeats(world: World, plan: Plan, commanded: bool, reading: Reading, run: Recorded, clock: float) -> float:
    """How far the true course strays, rad or m, when what was written down is done again: root mean square.

    A part that all but touches a stop, or all but sticks, goes elsewhere for a millionth of a second.
    """
    still = np.zeros(len(run.times))
    kind = NO_EFFORT if run.effort is None else COMMANDED if commanded else EXTERNAL
    drive = Drive(
        run.times,
        still if run.command is None else run.command,
        run.command is not None,
        still if run.effort is None else run.effort,
        kind,
    )
    asked = run.times - reading.late
    begin = min(-LEAD, asked[0] - 1e-3)
    again = simulate(world, plan.q0, plan.v0, np.concatenate([[begin], asked]), drive, clock)[1:, 0]
    return float(np.sqrt(((again - run.true) ** 2).mean()))


def floor(nuisance: Nuisance, speed: float) -> float:
    """Root mean square error of a reading, rad or m, at a root mean square speed."""
    return float(np.sqrt(nuisance.noise**2 + nuisance.quantum**2 / 12 + (nuisance.stamp * speed) ** 2))
