"""A pendulum on the bench for tests of simgap: fine steps of its own, forms that no effect of the library has."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import zip_longest
from pathlib import Path

import numpy as np
from numba import njit

from freeart21.asset import Asset
from freeart21.files.asset import read_asset
from freeart21.measured import Interpolation, Measured, Run
from freeart21.mechanics import Actuator
from simgap.fit.problem import Problem, make_problem
from simgap.measure.data import FitRun, make_fit_runs
from simgap.models.surrogate import make_plant
from simgap.prove.comparison import ReplayComparison, compare_replays
from simgap.prove.replay import AssetOnDisk, Starts, asset_address, replay
from simgap.verdict import RunGap

MASS, ARM, G = 1.6, 0.5, 9.81
INERTIA = 0.01 + MASS * ARM**2
STEP, RATE = 1e-4, 100
SERVO = (60.0, 4.0)
WORLD = {
    "inertia": INERTIA, "weight": MASS * G * ARM, "lean": 0.0, "viscous": 0.0, "power": 1.0, "dry": 0.0,
    "drag": 0.0, "spring": 0.0, "rest": 0.0, "cog": 0.0, "count": 0.0, "lower": -3.0, "upper": 3.0, "bounce": 0.0,
    "gain": 1.0, "delay": 0.0, "warming": 0.0, "groove": 0.0, "centre": 0.0, "width": 1.0,
    "hardens": 0.05, "gears": 0.0,
}  # fmt: skip


@njit(cache=True)
def _course(q, v, n, command, inertia, weight, lean, viscous, power, dry, drag, spring, rest, cog, count, lower, upper,
            bounce, gain, delay, warming, groove, centre, width, hardens, gears):  # fmt: skip
    every = round(1 / (STEP * RATE))
    out = np.empty(n)
    for i in range(n * every):
        if i % every == 0:
            out[i // every] = q
        t = i * STEP
        q += 0.5 * STEP * v
        force = (
            -weight * np.sin(q + lean) - spring * (q - rest) * (1 + hardens * (q - rest) ** 2) + cog * np.sin(count * q)
        )
        away = (q - centre) / width
        if away**2 < 3:  # a groove with an end
            force -= 0.5 * groove * away * (3 - away**2)
        force -= viscous * (1 + warming * t) * np.sign(v) * abs(v) ** power + drag * v * abs(v)
        others, drive = force, 0.0
        if len(command) > 0:
            commanded = command[
                min(max(int((t + 0.5 * STEP - delay) * len(command) / (n / RATE)), 0), len(command) - 1)
            ]
            drive = gain * (60.0 * (commanded - q) - 4.0 * v)
        v += STEP * (others + drive) / inertia
        rubs = STEP * (dry + gears * abs(drive - others)) / inertia
        v = 0.0 if abs(v) <= rubs else v - np.sign(v) * rubs
        q += 0.5 * STEP * v
        if (q < lower and v < 0) or (q > upper and v > 0):
            q = min(max(q, lower), upper)
            v = -bounce * v
    return out


def asset_of(folder: Path, lower: float = -3.0, upper: float = 3.0) -> Path:
    """The URDF of the pendulum as it should be."""
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / "bob.urdf"
    path.write_text(f"""<robot name="bob"><link name="base"/><link name="bob"><inertial><origin xyz="0 0 {-ARM}"/>
        <mass value="{MASS}"/><inertia ixx="0.01" iyy="0.01" izz="0.01" ixy="0" ixz="0" iyz="0"/></inertial></link>
        <joint name="j" type="revolute"><parent link="base"/><child link="bob"/><origin xyz="0 0 1" rpy="0 0 0"/>
        <axis xyz="0 1 0"/><limit lower="{lower}" upper="{upper}"/></joint></robot>""")
    return path


def measured_of(
    seed: int, *, runs: int = 5, servo: bool = False, largest: float = 1.4, offset: float = 0.0, marked: bool = True,
    seconds: float = 2.0, exact: bool = False, smooth: int = 1, between: Interpolation = "held", **hidden: float,
) -> Measured:  # fmt: skip
    """Runs with nuisances (inertia 10 %, weight 5 %, base 0.3 degrees, quantised noise) and what is hidden.

    Commands change `smooth` times a row; `between` is what the set says of them.
    """
    rng = np.random.default_rng(seed)
    world = {**WORLD, "inertia": INERTIA * rng.uniform(0.9, 1.1), "weight": WORLD["weight"] * rng.uniform(0.95, 1.05)}
    world |= {
        "lean": rng.uniform(-5e-3, 5e-3),
        **({"inertia": INERTIA, "weight": WORLD["weight"]} if exact else {}),
        **hidden,
    }
    n = round(seconds * RATE)
    times, made = np.arange(n) / RATE, []
    for i in range(runs):
        q0, v0, command = (
            (-1) ** i * largest * rng.uniform(0.25, 1.0),
            rng.uniform(-0.3, 0.3) * min(1, largest),
            np.zeros(0),
        )
        if servo:
            fine = np.arange(n * smooth) / (RATE * smooth)
            waves = [
                rng.uniform(0.1, 0.4) * np.sin(2 * np.pi * rng.uniform(0.2, 1.8) * fine + rng.uniform(0, 6))
                for _ in range(3)
            ]
            command = np.sum(waves, axis=0)
            q0, v0 = command[0], 0.0
        q = _course(
            float(np.clip(q0, world["lower"] + 0.01, world["upper"] - 0.01)), float(v0), n, command, *world.values()
        )
        q = 1.5e-3 * np.round((q + offset + rng.normal(0, 5e-4, n)) / 1.5e-3)
        held_out = i >= runs - 2 if marked else None
        made.append(Run(f"run_{i}", times, q, None, command[::smooth] if servo else None, None, None, held_out))
    actuator = Actuator(None, *SERVO) if servo else None
    unsure = (0.0, 0.0) if exact else (0.1, 0.05)
    return Measured(
        "j", "revolute", np.array([0.0, 0.0, -G]), RATE, "recorded", None, actuator, *unsure, tuple(made), between
    )


def problem_of(folder: Path, measured: Measured) -> tuple[Problem, tuple[FitRun, ...]]:
    """What is fitted of the pendulum's asset to a measured set, and the runs."""
    plant = make_plant(read_asset(asset_of(folder)), measured)
    runs, noise = make_fit_runs(measured, plant)
    return make_problem(plant, measured, runs, noise), runs


def replay_both(
    before: Asset,
    after: Asset,
    measured: Measured,
    starts: Sequence[tuple[float, float]],
    noise: float = 1e-3,
    holding: float = 0.0,
    regimes: Sequence[str] = (),
) -> ReplayComparison:
    """What replays by both assets' files show, each run from the given state."""
    of = dict(zip([run.name for run in measured.runs], starts, strict=True))
    begin = Starts(of, dict.fromkeys(of, noise))
    files = [AssetOnDisk(asset_address(asset)) for asset in (before, after)]
    before_, after_ = replay(files, measured, list(of), starts=(begin, begin), holding=holding)
    gaps = [
        RunGap(name, 0, 0, 0, True, regime, "confirming") for name, regime in zip_longest(of, regimes, fillvalue="")
    ]
    return compare_replays(before_, after_, noise, gaps)
