"""Replay of measured runs with the files of assets alone.

Only the start state of a run is free; it is fitted to the run, for each asset separately. A fresh process
(`simgap.prove.replay_process`) reads the files and simulates.
"""

from __future__ import annotations

import contextlib
import importlib.util
import os
import pickle
import subprocess
import tempfile
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import get_args

import numpy as np

from freeart21 import processes
from freeart21.asset import Asset
from freeart21.errors import FreeArtError
from freeart21.files import checked
from freeart21.measured import Measured, Run
from freeart21.se3 import Array
from simgap.fit.fit import Model, fit_starts
from simgap.fit.problem import make_problem, without_asset_error
from simgap.measure.data import make_fit_runs
from simgap.models.surrogate import make_plant
from simgap.prove.replay_process import AssetOnDisk, Engine, Job, PosesToReplay, Starts, State
from simgap.verdict import root_mean_square

ENGINES: tuple[str, ...] = get_args(Engine)
SECONDS = 120.0
"""Time limit; the rest is not replayed."""
SURE, SURE_PART = 1.0, 0.05
"""Largest change of a conclusive replay by the last halving of the time step: sigmas, and share of its error."""
_MIN_SCALE = 1e-3
"""rad or m, and per second: scale of the search of start states where nothing moved."""
Progress = Callable[[int, int], None]
"""Called with the number of replayed runs and their total."""


class CannotReplay(FreeArtError):
    """The fresh process failed; the message is its last line."""


@dataclass(frozen=True, eq=False)
class RunReplay:
    """One run simulated with the files of one asset; compared by identity."""

    run: str
    times_s: Array
    """(n,) s, of the readings."""
    measured: Array
    """(n,) rad or m."""
    simulated: Array
    """(n,) rad or m: simulated readings."""
    noise: float
    """rad or m: RMS sigma of the run's readings."""
    start: State
    """At the first reading; fitted to the run."""
    timestep_s: float
    """The finest."""
    change: float
    """Change by the last halving of the time step, sigmas."""

    @property
    def error(self) -> float:
        """RMS of simulated less measured, rad or m."""
        return root_mean_square(self.simulated - self.measured)

    @property
    def sigmas(self) -> float:
        """The error in sigmas of the readings."""
        return self.error / self.noise

    @property
    def is_converged(self) -> bool:
        """Whether the last halving of the time step changed it little; else it is ill-conditioned and shows nothing."""
        return self.change < max(SURE, SURE_PART * self.sigmas)


@dataclass(frozen=True)
class Replay:
    """The runs replayed in time with one asset's files."""

    engine: Engine
    version: str
    """Of the engine."""
    runs: tuple[RunReplay, ...]
    poses: tuple[float, ...] = ()
    """m: RMS displacement of each run of poses from the part in the files."""
    given_up: tuple[str, ...] = ()
    """Runs that were not replayed in time."""


def asset_address(asset: Asset) -> Path:
    """The folder or URDF from which `read_asset` reads it."""
    home = asset.urdf.parent
    return home if (home / "asset.json").is_file() else asset.urdf


def replay(
    assets: Sequence[AssetOnDisk],
    measured: Measured,
    names: Sequence[str] | None = None,
    *,
    starts: Sequence[Starts] | None = None,
    engine: Engine = "sapien",
    holding: float = 0.0,
    poses: Sequence[Sequence[PosesToReplay]] = (),
    seconds: float = SECONDS,
    progress: Progress | None = None,
) -> tuple[Replay, ...]:
    """Simulate runs of a measured set with the files of each of the assets.

    Args:
        assets: on disk.
        measured: all runs of the set (noise is estimated on all), and their circumstances.
        names: of the runs to replay; None for all.
        starts: start states for each asset; None fits them to the runs.
        engine: MuJoCo takes the MJCF beside the URDF, or the converted URDF without one.
        holding: interpolation of inputs where `measured` does not specify it: 0 smooth, 1 zero-order hold.
        poses: for each asset, runs of poses.
        seconds: time limit; runs that all assets have finished count.
        progress: called with the number of replays done and their total.

    Raises FreeArtError when an asset cannot be read or there is nothing to replay, and CannotReplay when the fresh
    process fails, for example where MuJoCo's format cannot express an effect.
    """
    end = time.monotonic() + seconds
    names = [run.name for run in measured.runs] if names is None else names
    if starts is None:
        starts = [fit_start_states(asset.read(measured), measured, names, holding, end) for asset in assets]
    if not names and not any(poses):
        raise FreeArtError("no run to replay, expected one or more")
    if engine == "mujoco" and importlib.util.find_spec("mujoco") is None:
        raise CannotReplay("MuJoCo is not installed: pip install 'freeart21[engines]'")
    of = {run.name: run for run in measured.runs}
    runs = tuple(of[name] for name in names if all(name in begin.states for begin in starts))
    files, tracks = tuple(asset.resolved() for asset in assets), tuple(map(tuple, poses))
    job = Job(files, replace(measured, runs=runs), tuple(starts), engine, holding, tracks)
    with tempfile.TemporaryDirectory(prefix="freeart21-") as place:
        folder = Path(place)
        _run(folder, job, max(end - time.monotonic(), 0.0), progress)
        version, off = _read_status(folder, len(assets))
        done = [i for i in range(len(runs)) if all(_answer_path(folder, k, i).is_file() for k in range(len(assets)))]
        late = tuple(name for name in names if name not in {runs[i].name for i in done})
        return tuple(
            Replay(engine, version, tuple(_read_run(folder, k, i, runs[i], begin) for i in done), off[k], late)
            for k, begin in enumerate(starts)
        )


def fit_start_states(
    asset: Asset, measured: Measured, names: Sequence[str], holding: float = 0.0, end: float = np.inf
) -> Starts:
    """Start states from which the asset follows each run best, for runs reached before time.monotonic() is `end`."""
    if not names:
        return Starts({}, {})
    plant = make_plant(asset, measured)
    runs, noise = make_fit_runs(measured, plant)
    problem = without_asset_error(make_problem(plant, measured, runs, noise))
    speed, high = max(problem.speed, _MIN_SCALE), max(problem.q_high, problem.q_low + _MIN_SCALE)
    model = Model(replace(problem, speed=speed, q_high=high), (), instant_friction=True)
    theta = np.full(len(model.ranges()), holding)
    states: dict[str, State] = {}
    of = {run.name: run for run in runs}
    for name in names:
        if time.monotonic() > end:
            break
        states |= fit_starts(model, theta, (of[name],)).starts  # separately, so independent of other runs
    return Starts(states, {run.name: root_mean_square(run.sigma) for run in runs})


def _answer_path(folder: Path, asset: int, run: int) -> Path:
    """File of the replay of a run by an asset."""
    return folder / f"run_{asset}_{run}.npz"


def _read_status(folder: Path, count: int) -> tuple[str, list[tuple[float, ...]]]:
    """The engine's version, and the displacements of poses for each of `count` assets, as far as known."""
    path = folder / "status.json"
    if not path.is_file():
        return "", [()] * count
    status = checked.read_json(path)
    return str(status["version"]), [tuple(map(float, off)) for off in status["poses"]]


def _read_run(folder: Path, asset: int, i: int, run: Run, starts: Starts) -> RunReplay:
    data = checked.read_npz(_answer_path(folder, asset, i), ("q", "step"))
    known = np.isfinite(run.q)
    step, change = map(float, data["step"])
    return RunReplay(
        run.name,
        run.times_s[known],
        run.q[known],
        data["q"],
        starts.noise[run.name],
        starts.states[run.name],
        step,
        change,
    )


def _run(folder: Path, job: Job, seconds: float, progress: Progress | None) -> None:
    """Run the fresh process for at most `seconds`."""
    reported, end, count = -1, time.monotonic() + seconds, len(job.measured.runs) * len(job.assets)
    with (folder / "stderr").open("w") as stderr, tempfile.TemporaryFile() as stdin:
        pickle.dump(job, stdin)
        stdin.seek(0)
        process = subprocess.Popen(
            [*processes.command("simgap.prove.replay_process"), str(folder)],
            stdin=stdin,
            stdout=subprocess.DEVNULL,
            stderr=stderr,
            cwd=folder,
            env={**os.environ, "TMPDIR": str(folder)},  # removed with the folder
        )
        try:
            while process.poll() is None and time.monotonic() < end:
                done = sum(1 for _ in folder.glob("run_*.npz"))
                if progress is not None and done > reported:
                    reported = done
                    progress(done, count)
                with contextlib.suppress(subprocess.TimeoutExpired):
                    process.wait(0.05)
        finally:
            late = process.poll() is None
            if late:
                process.kill()
                process.wait()
    if process.returncode and not late:
        lines = (folder / "stderr").read_text(errors="replace").strip().splitlines()
        raise CannotReplay((lines or [f"the replay in a fresh process failed: exit status {process.returncode}"])[-1])
    if progress is not None:
        progress(count, count)
