"""The gap that counts: a fresh process reloads both assets in SAPIEN and replays measured runs.

Both assets are read from their folders and are what their files say: nothing of a fit is known here. Only the start
state of every run is free, and is found for each asset by itself. `simgap.proof.replay` is the fresh process.
"""

from __future__ import annotations

import contextlib
import os
import subprocess
import tempfile
import time
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from freeart21 import child
from freeart21.asset import Asset
from freeart21.errors import FreeArtError
from freeart21.files import atomic, checked
from freeart21.files.actuator_json import actuator_to_json
from freeart21.files.base_json import BASE
from freeart21.files.measured import DRIVES
from freeart21.measured import Measured, Run
from freeart21.se3 import Array
from simgap.verdict import Use

SECONDS = 120.0
"""What is not replayed by then is given up."""
SURE, SURE_PART = 1.0, 0.05
"""Floors by which halving the finest time step may change a replay that tells something, and the part of its gap."""
WIDER, RUN_WIDER = 0.25, 0.5
"""Floors by which a repair may widen the gap of a regime, and of any one run in it."""
Progress = Callable[[int, int], None]
"""Called with the number of runs replayed and their total."""


class CannotReplay(FreeArtError):
    """The fresh process failed; its last line says why."""


@dataclass(frozen=True)
class Replayed:
    """One run to replay, from a state of its own for each of the two assets."""

    run: Run
    start_before: tuple[float, float]
    """Position and velocity, rad or m, at the first reading, that suit the asset as it was."""
    start_after: tuple[float, float]
    """The same for the repaired asset."""
    floor: float
    """rad or m: noise of the readings."""
    regime: str = ""
    use: Use = "confirming"


@dataclass(frozen=True)
class PosesReplayed:
    """Measured poses of one run to hold against where the assets put the part."""

    name: str
    poses: tuple[Array, Array]
    """(n, 4, 4) each, in the canonical frame, without the tracker's registration as found for either asset."""
    states: tuple[Array, Array]
    """(n,) canonical joint states each, as the poses say them, for either asset."""
    times_s: Array
    """(n,) on the clock of the asset's effects."""
    middle: Array
    """(3,) canonical, at state zero: the point of the moving part at which shifts are counted."""
    lever: float
    """m: how far points are from there, to count turns as shifts."""
    floor: float
    """m: noise of the poses."""
    held_out: bool = True


@dataclass(frozen=True)
class PoseGap:
    """How far the part is off the assets' joints, m: root mean square displacement."""

    run: str
    before: float
    after: float
    floor: float
    held_out: bool


@dataclass(frozen=True)
class ReplayGap:
    """What came out for one run."""

    run: str
    times_s: Array
    """(n,) s."""
    measured: Array
    """(n,) rad or m."""
    before: Array
    """(n,) readings of the asset as it was, in SAPIEN."""
    after: Array
    """(n,) of the repaired asset."""
    gap_before: float
    """Root mean square difference, rad or m."""
    gap_after: float
    floor: float
    regime: str
    use: Use


@dataclass(frozen=True)
class Shown:
    """The gap of all replayed runs, and whether the repair is one."""

    runs: tuple[ReplayGap, ...]
    numerics: float
    """Floors by which the last halving of the time step changed a replay at most; NaN when it was never reached."""
    timestep_s: float
    """The finest one of any run."""
    helps: bool | None
    """Whether the repaired asset is nearer to what was measured, and in no regime further away; None: not one run of
    these was replayed in time."""
    poses: tuple[PoseGap, ...] = ()
    given_up: tuple[str, ...] = ()
    """Runs that were not replayed in time."""
    unsure: tuple[str, ...] = ()
    """Runs whose replays hang on a hair: time steps however fine change them, so they tell nothing."""

    def closed(self, regimes: Iterable[str] | None = None) -> float | None:
        """Part of the gap beyond the floor that is closed in these regimes (all for None); None without any gap."""
        chosen = [r for r in self.runs if regimes is None or r.regime in set(regimes)]
        if not chosen:
            return None
        before, after, floor = (
            float(np.sqrt(np.mean([getattr(r, name) ** 2 for r in chosen])))
            for name in ("gap_before", "gap_after", "floor")
        )
        return (before - after) / (before - floor) if before > floor else None


def alike(shown: Shown, fitted: Iterable[str]) -> list[ReplayGap]:
    """The replayed runs that move as the `fitted` regimes do; all where none does."""
    of = set(fitted)
    return [run for run in shown.runs if run.regime in of] or list(shown.runs)


def closed_alike(shown: Shown, fitted: Iterable[str]) -> tuple[float | None, float | None]:
    """Closed part of the gap in motion of the `fitted` regimes (in all where none of those was replayed), and in other
    motion."""
    regimes = {r.regime for r in shown.runs}
    like = regimes & set(fitted)
    return shown.closed(like or regimes), shown.closed(regimes - like) if like and regimes - like else None


def show(
    before: Asset,
    after: Asset,
    measured: Measured,
    replays: tuple[Replayed, ...],
    holding: float = 0.0,
    timestep_s: float = 4e-3,
    poses: tuple[PosesReplayed, ...] = (),
    seconds: float = SECONDS,
    progress: Progress | None = None,
) -> Shown:
    """Replay runs in SAPIEN with both assets, in a process that knows neither fit nor surrogate.

    Args:
        before: the asset as it was, on disk.
        after: the repaired asset, on disk.
        measured: circumstances: gravity, actuator, what efforts are.
        replays: runs with start states.
        holding: where `measured` does not say how inputs go on between their rows: 0 smoothly, 1 held until the next.
        timestep_s: first choice; halved for every run and each asset by itself until that changes the run by less than
            a tenth of its floor, or by little of what it is off by.
        poses: runs of poses, whose geometry is compared too.
        seconds: when this is over, what was replayed counts and the rest is given up.
        progress: told how many runs are replayed.

    Raises FreeArtError when there is nothing to replay, and CannotReplay when the process fails.
    """
    if not replays and not poses:
        raise FreeArtError("no run to replay, expected one or more")
    with tempfile.TemporaryDirectory(prefix="freeart21-") as place_:
        folder = Path(place_)
        _write_job(folder, before, after, measured, replays, holding, timestep_s, seconds, poses)
        _run(folder, len(replays), seconds, progress)
        return _read_answer(folder, replays, poses, timestep_s)


def _run(folder: Path, count: int, seconds: float, progress: Progress | None) -> None:
    """Let the fresh process work for some seconds."""
    told, end = -1, time.monotonic() + seconds
    with (folder / "stderr").open("w") as stderr:
        process = subprocess.Popen(
            [*child.command("simgap.proof.replay"), str(folder)],
            stdout=subprocess.DEVNULL,
            stderr=stderr,
            cwd=folder,
            env={**os.environ, "TMPDIR": str(folder)},  # goes, however that process ends
        )
        try:
            while process.poll() is None and time.monotonic() < end:
                done = sum((folder / f"run_{i}.npz").is_file() for i in range(count))
                if progress is not None and done > told:
                    told = done
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
        last = (lines or [f"exit status {process.returncode}"])[-1]
        raise CannotReplay(f"the replay in a fresh process failed: {last}")
    if progress is not None:
        progress(count, count)


def helps(runs: Sequence[ReplayGap], poses: tuple[PoseGap, ...] = ()) -> bool:
    """Whether the gap, in floors, is smaller in all, in no regime (nor off the joint) wider by a quarter floor, and in
    no run by half a floor: runs of one regime may be of different kinds all the same."""
    groups: dict[str, list[tuple[float, float]]] = {}
    for run in runs:
        groups.setdefault(run.regime, []).append((run.gap_before / run.floor, run.gap_after / run.floor))
    for track in [p for p in poses if p.held_out] or poses:
        groups.setdefault(" off the joint", []).append((track.before / track.floor, track.after / track.floor))
    sizes = [np.sqrt(np.mean(np.square(group), axis=0)) for group in groups.values()]
    whole, left = np.sqrt(np.mean(np.square([pair for group in groups.values() for pair in group]), axis=0))
    if not np.isfinite(sizes).all() or any(after > before + WIDER for before, after in sizes):
        return False
    if any(after > before + RUN_WIDER for group in groups.values() for before, after in group):
        return False
    return bool(left < whole)


# ---------------------------------------------------------------- the two ends of the door


def _write_job(
    folder: Path,
    before: Asset,
    after: Asset,
    measured: Measured,
    replays: tuple[Replayed, ...],
    holding: float,
    timestep_s: float,
    seconds: float,
    poses: tuple[PosesReplayed, ...],
) -> None:
    law, turns = measured.actuator, measured.base_axis
    job: dict[str, Any] = {
        "assets": [str(address_of(asset)) for asset in (before, after)],
        "roots": [None if asset.root is None else str(asset.root.resolve()) for asset in (before, after)],
        "joint": before.joint,
        "gravity": np.asarray(measured.gravity, float).tolist(),
        "actuator": None if law is None else actuator_to_json(law),
        "effort": measured.effort_kind,
        "interpolation": measured.interpolation,
        "base": None if turns is None else {"axis": turns.axis.tolist(), "point": turns.point.tolist()},
        "holding": holding,
        "timestep_s": timestep_s,
        "seconds": seconds,
        "starts": [[list(r.start_before), list(r.start_after)] for r in replays],
        "floors": [r.floor for r in replays],
    }
    arrays: dict[str, Array] = {}
    for i, replay in enumerate(replays):
        known = np.isfinite(replay.run.q)
        arrays[f"times_{i}"], arrays[f"q_{i}"] = replay.run.times_s[known], replay.run.q[known]
        arrays[f"clock_{i}"] = replay.run.times_s
        for name in DRIVES:
            values = getattr(replay.run, name)
            if values is not None:
                arrays[f"{name}_{i}"] = values
        for name in BASE:
            values = getattr(replay.run.base, name, None)
            if values is not None:
                arrays[f"base_{name}_{i}"] = values
    for i, track in enumerate(poses):
        for k in (0, 1):
            arrays[f"poses_{k}_{i}"], arrays[f"states_{k}_{i}"] = track.poses[k], track.states[k]
        arrays[f"pose_times_{i}"] = track.times_s
    job["poses"] = [{"middle": np.asarray(t.middle).tolist(), "lever": t.lever} for t in poses]
    atomic.write_json(folder / "job.json", job)
    with (folder / "job.npz").open("wb") as file:
        np.savez(file, **arrays)  # type: ignore[arg-type]


def address_of(asset: Asset) -> Path:
    """The folder or the URDF that `read_asset` reads it from."""
    home = asset.urdf.parent
    return (home if (home / "asset.json").is_file() else asset.urdf).resolve()


def _read_answer(
    folder: Path, replays: tuple[Replayed, ...], poses: tuple[PosesReplayed, ...], timestep_s: float
) -> Shown:
    """What there is."""
    done = [i for i in range(len(replays)) if (folder / f"run_{i}.npz").is_file()]
    runs, steps = [], []
    for i in done:
        data = checked.read_npz(folder / f"run_{i}.npz", ("before", "after", "steps"))
        runs.append(_gap(replays[i], data["before"], data["after"]))
        steps.append(data["steps"])
    off = folder / "poses.json"
    pairs = checked.read_json(off)["poses"] if off.is_file() else []
    tracks = tuple(
        PoseGap(track.name, float(pair[0]), float(pair[1]), track.floor, track.held_out)
        for track, pair in zip(poses, pairs, strict=False)
    )
    sure = [k for k, run in enumerate(runs) if _is_sure(run, steps[k])] or list(range(len(runs)))
    told = tuple(runs[k] for k in sure)
    return Shown(
        told,
        max((float(steps[k][:, 1].max()) for k in sure), default=np.nan if replays else 0.0),
        min((float(steps[k][:, 0].min()) for k in sure), default=timestep_s),
        helps(told, tracks) if told or tracks else None,
        tracks,
        tuple(replay.run.name for i, replay in enumerate(replays) if i not in done),
        tuple(run.run for k, run in enumerate(runs) if k not in sure),
    )


def _is_sure(run: ReplayGap, steps: Array) -> bool:
    """Whether halving the time step changes neither replay by much."""
    gaps = (run.gap_before / run.floor, run.gap_after / run.floor)
    return all(change < max(SURE, SURE_PART * gap) for (_, change), gap in zip(steps, gaps, strict=True))


def _gap(replay: Replayed, before: Array, after: Array) -> ReplayGap:
    known = np.isfinite(replay.run.q)
    q = replay.run.q[known]
    gaps = [float(np.sqrt(np.mean((series - q) ** 2))) for series in (before, after)]
    return ReplayGap(
        replay.run.name,
        replay.run.times_s[known],
        q,
        before,
        after,
        gaps[0],
        gaps[1],
        replay.floor,
        replay.regime,
        replay.use,
    )
