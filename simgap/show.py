"""The gap that counts: a fresh process reloads both assets in SAPIEN and replays measured runs.

What the fits found is not believed here: nothing is taken from them but the start state of every run and how far the
asset's own inertia and gravity may be off, which both assets get alike. `python -m simgap.show FOLDER` is the fresh
process: it reads FOLDER/job.npz and writes FOLDER/replay.npz.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
import xml.etree.ElementTree as ET
from collections.abc import Iterable
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from freeart21 import se3
from freeart21.asset import Asset
from freeart21.effects.gravity_offset import GravityOffset
from freeart21.errors import FreeArtError
from freeart21.files import atomic, checked
from freeart21.files.asset import movable_joint, read_asset
from freeart21.measured import Measured, Run
from freeart21.mechanics import Actuator, held
from freeart21.se3 import Array
from generator import simulate
from simgap.placing import place
from simgap.track_geometry import at_point, displacement

_SECONDS = 120
"""A replay that takes longer is given up."""
_HALVINGS = 3


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
    held_out: bool = True


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
class Off:
    """How far an asset is off without anything missing, as its own fit has it."""

    inertia: float = 1.0
    """True inertia over the asset's."""
    gravity: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Torque of cos q and of sin q (N*m), or force (N): what true gravity has beyond the asset's."""


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
    held_out: bool


@dataclass(frozen=True)
class Shown:
    """The gap of all replayed runs, and whether the repair is one."""

    runs: tuple[ReplayGap, ...]
    numerics: float
    """Floors by which the last halving of the time step changed the replay of the longest run."""
    timestep_s: float
    helps: bool
    """Whether the repaired asset is nearer to what was measured, and in no regime further away."""
    poses: tuple[PoseGap, ...] = ()

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


def show(
    before: Asset,
    after: Asset,
    measured: Measured,
    replays: tuple[Replayed, ...],
    off: tuple[Off, Off] = (Off(), Off()),
    timestep_s: float = 2e-3,
    poses: tuple[PosesReplayed, ...] = (),
) -> Shown:
    """Replay runs in SAPIEN with both assets, in a process that knows neither fit nor surrogate.

    Args:
        before: the asset as it was, on disk.
        after: the repaired asset, on disk.
        measured: circumstances: gravity, actuator, what efforts are.
        replays: runs with start states.
        off: for each asset by how much it is off by its own fit.
        timestep_s: first choice; halved until that changes the longest run by less than a tenth of its floor.
        poses: runs of poses, whose geometry is compared too.

    Raises FreeArtError when there is nothing to replay, or the process fails: its last line says why.
    """
    if not replays and not poses:
        raise FreeArtError("no run to replay, expected one or more")
    with tempfile.TemporaryDirectory(prefix="freeart21-") as place_:
        folder = Path(place_)
        _write_job(folder, before, after, measured, replays, off, timestep_s, poses)
        root = str(Path(__file__).resolve().parents[1])
        paths = os.pathsep.join(p for p in (root, os.environ.get("PYTHONPATH", "")) if p)
        try:
            done = subprocess.run(
                [sys.executable, "-m", "simgap.show", str(folder)],
                capture_output=True,
                text=True,
                timeout=_SECONDS,
                env={**os.environ, "PYTHONPATH": paths},
                check=False,
            )
        except subprocess.TimeoutExpired as error:
            raise FreeArtError(f"the replay of {len(replays)} runs took more than {_SECONDS} s") from error
        if done.returncode:
            last = (done.stderr.strip().splitlines() or [f"exit status {done.returncode}"])[-1]
            raise FreeArtError(f"the replay in a fresh process failed: {last}")
        return _read_answer(folder, replays, poses)


def helps(runs: tuple[ReplayGap, ...], poses: tuple[PoseGap, ...] = ()) -> bool:
    """Whether the gap, in floors, is smaller in all, and in no regime (nor off the joint) wider by a quarter floor.

    Held-out runs are judged; all when there is none.
    """
    groups: dict[str, list[tuple[float, float]]] = {}
    for run in [r for r in runs if r.held_out] or runs:
        groups.setdefault(run.regime, []).append((run.gap_before / run.floor, run.gap_after / run.floor))
    for track in [p for p in poses if p.held_out] or poses:
        groups.setdefault(" off the joint", []).append((track.before / track.floor, track.after / track.floor))
    sizes = [np.sqrt(np.mean(np.square(group), axis=0)) for group in groups.values()]
    if not np.isfinite(sizes).all() or any(after > before + 0.25 for before, after in sizes):
        return False
    before, after = np.sum(np.square([pair for group in groups.values() for pair in group]), axis=0)
    return bool(after < before)


# ---------------------------------------------------------------- the two ends of the door


def _write_job(
    folder: Path,
    before: Asset,
    after: Asset,
    measured: Measured,
    replays: tuple[Replayed, ...],
    off: tuple[Off, Off],
    timestep_s: float,
    poses: tuple[PosesReplayed, ...],
) -> None:
    law = measured.actuator
    job: dict[str, Any] = {
        "assets": [_address(before), _address(after)],
        "joint": before.joint,
        "gravity": np.asarray(measured.gravity, float).tolist(),
        "actuator": None if law is None else [law.stiffness, law.damping],
        "effort": measured.effort_kind,
        "off": [asdict(o) for o in off],
        "timestep_s": timestep_s,
        "starts": [[list(r.start_before), list(r.start_after)] for r in replays],
        "floors": [r.floor for r in replays],
    }
    arrays: dict[str, Array] = {}
    for i, replay in enumerate(replays):
        known = np.isfinite(replay.run.q)
        arrays[f"times_{i}"], arrays[f"q_{i}"] = replay.run.times_s[known], replay.run.q[known]
        arrays[f"clock_{i}"] = replay.run.times_s
        for name in ("effort", "q_command"):
            values = getattr(replay.run, name)
            if values is not None:
                arrays[f"{name}_{i}"] = values
    for i, track in enumerate(poses):
        for k in (0, 1):
            arrays[f"poses_{k}_{i}"], arrays[f"states_{k}_{i}"] = track.poses[k], track.states[k]
        arrays[f"pose_times_{i}"] = track.times_s
    job["poses"] = [{"middle": np.asarray(t.middle).tolist(), "lever": t.lever} for t in poses]
    atomic.write_json(folder / "job.json", job)
    with (folder / "job.npz").open("wb") as file:
        np.savez(file, **arrays)  # type: ignore[arg-type]


def _address(asset: Asset) -> str:
    """What `read_asset` reads it from."""
    home = asset.urdf.parent
    return str((home if (home / "asset.json").is_file() else asset.urdf).resolve())


def _read_answer(folder: Path, replays: tuple[Replayed, ...], poses: tuple[PosesReplayed, ...]) -> Shown:
    said = checked.read_json(folder / "replay.json")
    with np.load(folder / "replay.npz") as data:
        runs = tuple(_gap(replay, data[f"before_{i}"], data[f"after_{i}"]) for i, replay in enumerate(replays))
    off = tuple(
        PoseGap(track.name, float(pair[0]), float(pair[1]), track.floor, track.held_out)
        for track, pair in zip(poses, said["poses"], strict=True)
    )
    return Shown(runs, float(said["numerics"]), float(said["timestep_s"]), helps(runs, off), off)


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
        replay.held_out,
    )


# ---------------------------------------------------------------- in the fresh process


class _Stage:
    """One asset in SAPIEN, ready to replay runs."""

    def __init__(self, path: Path, job: dict[str, Any], off: dict[str, Any], folder: Path):
        asset = read_asset(path, job["joint"])
        placed = place(asset, np.array(job["gravity"]))
        self.lower, self.upper = (getattr(movable_joint(asset.urdf, asset.joint), k) for k in ("lower", "upper"))
        revolute = placed.mechanics.joint.type == "revolute"
        cosine, sine, constant = off["gravity"]
        inertia = float(off["inertia"])
        # heavier links weigh more too; what gravity has beyond the asset's is counted from the asset's own masses
        if revolute:
            own = [float(placed.mechanics.gravity_force(q)) for q in (0.0, np.pi / 2)]
            offset = GravityOffset(cosine=cosine - (inertia - 1) * own[0], sine=sine - (inertia - 1) * own[1])
        else:
            own_force = float(placed.mechanics.gravity_force(0.0))
            offset = GravityOffset(constant=constant - (inertia - 1) * own_force)
        self.asset = _scaled(asset, inertia, folder)
        self.effects = (*asset.effects.get(asset.joint, ()), *((offset,) if any(offset.values()) else ()))
        self.gravity, self.job = placed.gravity, job

    def load(self, timestep_s: float) -> simulate.SimulatedAsset:
        """The asset with its effects, and with how it is off."""
        loaded = simulate.load(self.asset, timestep_s=timestep_s, gravity=self.gravity)
        loaded.set_effects(self.effects)
        return loaded

    def replay(self, loaded: simulate.SimulatedAsset, data: Any, i: int, start: tuple[float, float]) -> Array:
        """(n,) what the sensor reads at the times of run `i`; the state `start` is that of the first reading.

        A sensor that is late reads a state of before: the simulation begins by so much earlier.
        """
        times, clock = data[f"times_{i}"], data[f"clock_{i}"]
        sensing = [effect for effect in loaded.effects if effect.kind == "sensing"]
        first = float(times[0])
        begin = first - sum(effect.delay() for effect in sensing)
        effort, command = (data.get(f"{name}_{i}") for name in ("effort", "q_command"))
        law = self.job["actuator"]
        follows = held(clock - begin, command) if command is not None and law else None
        commanded = held(clock - begin, effort) if effort is not None and self.job["effort"] == "commanded" else None
        push = held(clock - begin, effort) if effort is not None and self.job["effort"] == "external" else None
        actuator = None
        if follows is not None or commanded is not None:
            stiffness, damping = law or (0.0, 0.0)
            actuator = Actuator(follows, stiffness, damping, commanded)
        q0 = float(np.clip(start[0], self.lower, self.upper))
        h = loaded.timestep_s
        seconds = float(np.ceil((times[-1] - first) / h) * h) + h
        rolled = simulate.roll_out(loaded, q0, start[1], duration_s=seconds, force=push, actuator=actuator)
        q = np.interp(times - first, rolled.times_s, rolled.q)
        return np.asarray(q + sum((effect.reading_error(q) for effect in sensing), np.zeros(len(q))))


def _scaled(asset: Asset, factor: float, folder: Path) -> Asset:
    """The asset with all its masses and inertias times `factor`, from a URDF in `folder`."""
    if factor == 1.0:
        return asset
    root = ET.fromstring(asset.urdf.read_bytes())
    for inertial in root.iter("inertial"):
        for element in (*inertial.findall("mass"), *inertial.findall("inertia")):
            for key, value in element.attrib.items():
                element.set(key, repr(float(value) * factor))
    for element in (*root.iter("mesh"), *root.iter("texture")):
        name = element.get("filename", "")
        if not Path(name).is_absolute() and "://" not in name:
            element.set("filename", str((asset.urdf.parent / name).resolve()))
    path = folder / f"scaled_{asset.urdf.parent.name}_{factor:.9g}.urdf"
    path.write_bytes(ET.tostring(root))
    return replace(asset, urdf=path)


def _replay(folder: Path) -> None:
    job = checked.read_json(folder / "job.json")
    data = dict(np.load(folder / "job.npz"))
    stages = [_Stage(Path(path), job, off, folder) for path, off in zip(job["assets"], job["off"], strict=True)]
    count = len(job["starts"])
    starts = [[(float(q), float(qd)) for q, qd in pair] for pair in job["starts"]]
    h, numerics = _timestep(stages[1], data, job, starts) if count else (float(job["timestep_s"]), 0.0)
    out: dict[str, Array] = {}
    for k, (name, stage) in enumerate(zip(("before", "after"), stages, strict=True)):
        loaded = stage.load(h)
        for i in range(count):
            out[f"{name}_{i}"] = stage.replay(loaded, data, i, starts[i][k])
    with (folder / "replay.npz").open("wb") as file:
        np.savez(file, **out)  # type: ignore[arg-type]
    off = [_pose_gaps(stages, data, i, said) for i, said in enumerate(job["poses"])]
    (folder / "replay.json").write_text(json.dumps({"numerics": numerics, "timestep_s": h, "poses": off}))


def _timestep(
    stage: _Stage, data: Any, job: dict[str, Any], starts: list[list[tuple[float, float]]]
) -> tuple[float, float]:
    """Time step, s, and by how many floors its halving changes the replay of the longest run."""
    i = max(range(len(starts)), key=lambda k: float(np.ptp(data[f"times_{k}"])))
    h, floor = float(job["timestep_s"]), float(job["floors"][i])
    coarse, numerics = stage.replay(stage.load(h), data, i, starts[i][1]), np.inf
    for _ in range(_HALVINGS):
        fine = stage.replay(stage.load(h / 2), data, i, starts[i][1])
        numerics = float(np.sqrt(np.mean((fine - coarse) ** 2))) / floor
        if numerics < 0.1:
            break
        h, coarse = h / 2, fine
    return h, numerics


def _pose_gaps(stages: list[_Stage], data: Any, i: int, said: dict[str, Any]) -> list[float]:
    """m: how far measured poses of run `i` are from where either asset has the part."""
    gaps = []
    for k, stage in enumerate(stages):
        motion = simulate.joint_motion(stage.asset, data[f"states_{k}_{i}"], data[f"pose_times_{i}"])
        off = se3.log_se3(se3.inverse(motion) @ data[f"poses_{k}_{i}"])
        gaps.append(displacement(at_point(np.array(said["middle"]), off), float(said["lever"])))
    return gaps


def _main() -> None:
    try:
        _replay(Path(sys.argv[1]))
    except FreeArtError as error:
        sys.exit(str(error))


if __name__ == "__main__":
    _main()
