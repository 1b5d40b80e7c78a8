"""The gap of assets on disk: nothing of how they were made is known here, and only where a run starts is free."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from freeart21.asset import Asset
from freeart21.files.asset import read_asset
from freeart21.measured import Measured
from simgap.fitting.fit import Theory, fit_starts
from simgap.fitting.problem import as_delivered, problem_of
from simgap.measure.data import fit_runs
from simgap.motion.surrogate import plant_of
from simgap.proof.show import SECONDS, PosesReplayed, Progress, Replayed, Shown, show
from simgap.settings import GapSettings
from simgap.verdict import Use


@dataclass(frozen=True)
class Chosen:
    """A run to replay, by its name in the measured set."""

    name: str
    floor: float
    """rad or m: noise of the readings."""
    regime: str = ""
    use: Use = "confirming"


def replay_files(
    before: Path,
    after: Path,
    measured: Measured,
    chosen: Sequence[Chosen],
    holding: float = 0.0,
    poses: tuple[PosesReplayed, ...] = (),
    seconds: float = SECONDS,
    progress: Progress | None = None,
    root: Path | None = None,
) -> Shown:
    """Replay measured runs in SAPIEN with the assets in two folders (or URDF files), as these files say.

    Every run starts, with each asset, from the state that suits its readings best. `holding` is of inputs of which
    `measured` does not say how they go on between their rows: 0 smoothly, 1 held until the next. `root` bounds what the
    first asset's URDF may name (`Asset.root`). Raises FreeArtError when an asset cannot be read or there is nothing to
    replay, and CannotReplay when the fresh process fails.
    """
    pair = (before, root), (after, None)
    assets = [read_asset(path, measured.joint, guesses=False, root=within) for path, within in pair]
    of = {run.name: run for run in measured.runs}
    runs = tuple(of[each.name] for each in chosen)
    first, second = (start_states(asset, measured, [run.name for run in runs], holding) for asset in assets)
    replays = tuple(
        Replayed(run, first[run.name], second[run.name], each.floor, each.regime, each.use)
        for run, each in zip(runs, chosen, strict=True)
    )
    return show(assets[0], assets[1], measured, replays, holding, poses=poses, seconds=seconds, progress=progress)


def start_states(
    asset: Asset, measured: Measured, names: Sequence[str], holding: float = 0.0
) -> dict[str, tuple[float, float]]:
    """Run name to the state (rad or m, and a second) at its first reading from which the asset follows it best."""
    if not names:
        return {}
    plant = plant_of(asset, measured)
    runs, floor = fit_runs(measured, plant)
    problem = as_delivered(problem_of(plant, measured, runs, floor, GapSettings()))
    theory = Theory(problem, (), prompt=True)
    theta = np.full(len(theory.ranges()), holding)  # nothing else is left to fit
    of = tuple(run for run in runs if run.name in set(names))
    return fit_starts(theory, theta, of).starts
