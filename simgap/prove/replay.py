"""Measured runs, simulated by the files of assets alone: nothing of how an asset was made is known here.

Only the state in which a run starts is free; it is fitted to the run, for each asset by itself. A fresh process
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

from freeart21 import child
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
from simgap.settings import GapSettings
from simgap.verdict import root_mean_square

ENGINES: tuple[str, ...] = get_args(Engine)
SECONDS = 120.0
"""What is not replayed by then is given up."""
SURE, SURE_PART = 1.0, 0.05
"""Sigmas by which halving the finest time step may change a replay that tells something, and the part of its error."""
_MIN_SCALE = 1e-3
"""rad or m, and a second: at which sizes starts are looked for where nothing moved."""
Progress = Callable[[int, int], None]
"""Called with the number of runs replayed and their total."""


class CannotReplay(FreeArtError):
    """The fresh process failed; its last line says why."""


@dataclass(frozen=True, eq=False)
class RunReplay:
    """One run, as the files of one asset have it; the same only as itself."""

    run: str
    times_s: Array
    """(n,) s, of the readings."""
    measured: Array
    """(n,) rad or m."""
    simulated: Array
    """(n,) rad or m: what the sensor would read."""
    noise: float
    """rad or m: sigma of the run's readings, estimated on all runs of the set."""
    start: State
    """At the first reading: fitted to the run."""
    timestep_s: float
    """The finest."""
    change: float
    """Sigmas by which the last halving of the time step changed it."""

    @property
    def error(self) -> float:
        """Root mean square of simulated less measured, rad or m."""
        return root_mean_square(self.simulated - self.measured)

    @property
    def sigmas(self) -> float:
        """The error in sigmas of the readings."""
        return self.error / self.noise

    @property
    def is_converged(self) -> bool:
        """Whether halving the time step changes it by little: else it hangs on a hair, and tells nothing."""
        return self.change < max(SURE, SURE_PART * self.sigmas)


@dataclass(frozen=True)
class Replay:
    """The runs that were replayed in time by one asset's files."""

    engine: Engine
    version: str
    """Of the engine."""
    runs: tuple[RunReplay, ...]
    poses: tuple[float, ...] = ()
    """m: how far each run of poses is off where the files have the part, root mean square displacement."""
    given_up: tuple[str, ...] = ()
    """Runs that were not replayed in time."""


def asset_address(asset: Asset) -> Path:
    """The folder or the URDF that `read_asset` reads it from."""
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
    """Simulate runs of a measured set with each of the assets, as their files say.

    Args:
        assets: what is on disk.
        measured: all runs of the set (noise is estimated on all), and their circumstances.
        names: of the runs to replay; None for all.
        starts: for each asset where runs start; None fits them to the runs.
        engine: MuJoCo takes the MJCF beside the URDF, or the URDF as MJCF where there is none.
        holding: of inputs of which `measured` does not say how they go on between their rows: 0 smoothly, 1 held until
            the next.
        poses: for each asset, runs of poses.
        seconds: when these are over, runs that all assets have done count, and the rest is given up.
        progress: called with the number of replays done and their total.

    Raises FreeArtError when an asset cannot be read or there is nothing to replay, and CannotReplay when the fresh
    process fails, as where MuJoCo's format cannot say an effect.
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
    """From where the asset follows each run best, for runs that are reached before time.monotonic() is `end`."""
    if not names:
        return Starts({}, {})
    plant = make_plant(asset, measured)
    runs, noise = make_fit_runs(measured, plant)
    problem = without_asset_error(make_problem(plant, measured, runs, noise, GapSettings()))
    speed, high = max(problem.speed, _MIN_SCALE), max(problem.q_high, problem.q_low + _MIN_SCALE)
    model = Model(replace(problem, speed=speed, q_high=high), (), instant_friction=True)
    theta = np.full(len(model.ranges()), holding)  # nothing else is left to fit
    states: dict[str, State] = {}
    of = {run.name: run for run in runs}
    for name in names:
        if time.monotonic() > end:
            break
        states |= fit_starts(model, theta, (of[name],)).starts  # each by itself: it hangs on no other run
    return Starts(states, {run.name: root_mean_square(run.sigma) for run in runs})


def _answer_path(folder: Path, asset: int, run: int) -> Path:
    """Where the fresh process puts the replay of a run by an asset."""
    return folder / f"run_{asset}_{run}.npz"


def _read_status(folder: Path, count: int) -> tuple[str, list[tuple[float, ...]]]:
    """The engine's version, and for each of `count` assets how far poses are off, as far as this is known."""
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
    """Let the fresh process work for some seconds."""
    reported, end, count = -1, time.monotonic() + seconds, len(job.measured.runs) * len(job.assets)
    with (folder / "stderr").open("w") as stderr, tempfile.TemporaryFile() as stdin:
        pickle.dump(job, stdin)
        stdin.seek(0)
        process = subprocess.Popen(
            [*child.command("simgap.prove.replay_process"), str(folder)],
            stdin=stdin,
            stdout=subprocess.DEVNULL,
            stderr=stderr,
            cwd=folder,
            env={**os.environ, "TMPDIR": str(folder)},  # goes, however that process ends
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
