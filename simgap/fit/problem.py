"""The problem that all fits to one measured set share, and the same without errors of the asset."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from freeart21.measured import Measured
from simgap.fit.model import Problem
from simgap.measure.data import FitRun
from simgap.measure.noise import SensorNoise
from simgap.models.surrogate import Plant


def make_problem(plant: Plant, measured: Measured, runs: tuple[FitRun, ...], noise: SensorNoise) -> Problem:
    """The problem of some runs."""
    motion = np.concatenate([run.q for run in runs])
    speed = np.concatenate([run.speed for run in runs])
    driven = any(len(run.inputs.times_s) for run in runs)
    load = plant.mechanics.load(motion, speed, np.zeros(len(speed)))
    force = rms_inertial_force(plant, runs)
    weight = plant.mechanics.gravity_force(motion)
    return Problem(
        plant,
        measured.inertia_relative,
        measured.gravity_relative,
        float(min(run.q.min() for run in runs)),
        float(max(run.q.max() for run in runs)),
        float(max(np.quantile(np.abs(run.speed), 0.99) for run in runs)),
        noise.sigma_at_rest,
        force,
        float(np.sqrt(np.mean(load**2))),
        float(np.sqrt(force**2 + 4 * np.mean(weight**2))),  # a drive moves the part and carries its weight
        driven and measured.interpolation == "unknown",
    )


def rms_inertial_force(plant: Plant, runs: tuple[FitRun, ...]) -> float:
    """RMS of inertia times acceleration, N*m or N, from slopes of the speed."""
    squares = [np.mean(np.gradient(run.speed, run.times_s) ** 2) for run in runs]
    return max(float(plant.mechanics.inertia * np.sqrt(np.mean(squares))), 1e-9)


def without_asset_error(problem: Problem, plant: Plant | None = None) -> Problem:
    """The problem with inertia, weight and tilt fixed as in the files; `plant` is that of other files."""
    plant = problem.plant if plant is None else plant
    return replace(problem, plant=plant, inertia_relative=0.0, gravity_relative=0.0, tilt_rad=0.0)
