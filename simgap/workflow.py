"""The five steps, from an asset and what was measured of it to a verdict."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from freeart21.asset import Asset
from freeart21.errors import FreeArtError
from freeart21.files.asset import movable_joint
from freeart21.measured import Measured
from simgap.data import FitRun, fit_runs
from simgap.fit import Problem, Theory, fitted
from simgap.floor import Floor
from simgap.settings import GapSettings
from simgap.surrogate import Plant, plant_of
from simgap.verdict import RunGap, Verdict

DEFAULTS = GapSettings()


def find_gap(asset: Asset, measured: Measured, settings: GapSettings = DEFAULTS) -> Verdict:
    """What the simulation of `asset` lacks, by what was measured of it.

    Raises FreeArtError when the measurement is not of this asset's joint, or its units cannot be right.
    """
    check_match(asset, measured)
    plant = plant_of(asset, measured)
    runs, floor = fit_runs(measured, plant)
    problem = problem_of(plant, measured, runs, floor, settings)
    fit = fitted(Theory(problem, ()), runs)
    gaps = tuple(
        RunGap(run.name, fit.floors(run.name) * floor.still, np.nan, floor.still, bool(run.held_out), run.regime)
        for run in runs
    )
    apart = max(fit.floors(run.name) for run in runs) > 1 + settings.choice.least_gap
    said = "Simulation and measurement differ." if apart else "Simulation and measurement agree."
    return Verdict("unexplained" if apart else "no_gap", (), (), gaps, (), None, said)


def check_match(asset: Asset, measured: Measured) -> None:
    """Raise FreeArtError when the measured joint is not the asset's."""
    joint = movable_joint(asset.urdf, measured.joint)
    if joint.joint_type != measured.joint_type:
        raise FreeArtError(
            f"{asset.urdf}: joint '{joint.name}' is {joint.joint_type}, but the measurement says {measured.joint_type}"
        )


def problem_of(
    plant: Plant, measured: Measured, runs: tuple[FitRun, ...], floor: Floor, settings: GapSettings
) -> Problem:
    """What all fits share."""
    motion = np.concatenate([run.q for run in runs])
    speed = np.concatenate([run.speed for run in runs])
    load = plant.mechanics.load(motion, speed, np.zeros(len(speed)))
    return Problem(
        plant,
        measured.inertia_relative,
        measured.gravity_relative,
        float(min(run.q.min() for run in runs)),
        float(max(run.q.max() for run in runs)),
        float(max(np.quantile(np.abs(run.speed), 0.99) for run in runs)),
        floor.still,
        force_at_work(plant, runs),
        float(np.sqrt(np.mean(load**2))),
        settings.fit,
        settings.surrogate,
    )


def force_at_work(plant: Plant, runs: tuple[FitRun, ...]) -> float:
    """Root mean square of inertia times acceleration, N*m or N, roughly: from the slopes of speeds."""
    squares = [np.mean(np.gradient(run.speed, run.times_s) ** 2) for run in runs]
    return max(float(plant.mechanics.inertia * np.sqrt(np.mean(squares))), 1e-9)


def gap_folder(asset: Path, measured: Path, out: Path, settings: GapSettings = DEFAULTS) -> Verdict:
    """`find_gap` from folders to a folder, which appears whole or not at all."""
    from freeart21.files.asset import read_asset
    from freeart21.files.atomic import new_folder
    from freeart21.files.measured import read_measured

    runs = read_measured(measured)
    loaded = read_asset(asset, runs.joint)
    with new_folder(out, replace=True) as aside:
        verdict = find_gap(loaded, runs, settings)
        verdict.write(aside / "verdict.json", runs.joint_type)
    return verdict
