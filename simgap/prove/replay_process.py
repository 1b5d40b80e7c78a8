"""The fresh process of `simgap.prove.replay`. Its argument is FOLDER, its standard input a pickled `Job`.

Results are written one by one, so that a stopped process leaves the finished ones: FOLDER/status.json (the engine's
version, and how far poses are off), then run_K_I.npz for run I by asset K: the sensor's readings, the time step (s),
and what the last halving of the step changed (sigmas).
"""

from __future__ import annotations

import pickle
import sys
import tempfile
from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from importlib import import_module
from pathlib import Path
from typing import Any, Literal

import numpy as np

from freeart21 import se3
from freeart21.asset import Asset
from freeart21.errors import FreeArtError
from freeart21.files import atomic
from freeart21.files.asset import check_no_mimics, find_movable_joint, read_asset
from freeart21.files.asset_copy import copy_asset_files, mjcf_path, write_xml
from freeart21.files.urdf import read_root_tag
from freeart21.measured import Measured, Run
from freeart21.mechanics import Actuator, interpolate_series
from freeart21.se3 import Array
from generator import simulate
from simgap.geometry.placing import place
from simgap.geometry.track_geometry import move_twists, rms_displacement
from simgap.verdict import root_mean_square

Engine = Literal["sapien", "mujoco"]
State = tuple[float, float]
"""Position, rad or m, and velocity."""
TIMESTEPS_S: dict[Engine, float] = {"sapien": 4e-3, "mujoco": 1e-3}
"""First choice; halved for every run until that changes it little."""
HALVINGS = 6
"""Of the first time step, at most."""
MOST_STEPS = 100_000
"""Steps of one simulation above which the time step is not halved. A number, not a time, so that replays are
repeatable."""
ENOUGH, SMALL = 0.1, 0.005
"""Largest change by a halving of the time step: sigmas, and share of the replay's error; a simulation far from the
measurement may differ more at any step."""


@dataclass(frozen=True)
class AssetOnDisk:
    """An asset as `read_asset` reads it."""

    path: Path
    """Its folder, or its URDF."""
    root: Path | None = None
    """Folder that referenced files must be in (`Asset.root`)."""
    guesses: bool = True
    """Whether effects that asset.json marks as guessed act."""

    def read(self, measured: Measured) -> Asset:
        """The asset; FreeArtError when it lacks the measured joint, or others mimic that one."""
        asset = read_asset(self.path, measured.joint, guesses=self.guesses, root=self.root)
        check_match(asset, measured)
        return asset

    def resolved(self) -> AssetOnDisk:
        """The same with absolute paths."""
        return replace(self, path=self.path.resolve(), root=None if self.root is None else self.root.resolve())


def check_match(asset: Asset, measured: Measured, what: str = "a replay") -> None:
    """Raise FreeArtError when the measured joint is not the asset's, or others mimic it, which `what` does not
    support."""
    joint = find_movable_joint(asset.urdf, measured.joint)
    check_no_mimics(asset.urdf, joint.name, what)
    if joint.joint_type != measured.joint_type:
        raise FreeArtError(
            f"{asset.urdf}: joint '{joint.name}' is {joint.joint_type}, but the measurement says {measured.joint_type}"
        )


@dataclass(frozen=True)
class Starts:
    """Start states of runs, and their sensor noise."""

    states: Mapping[str, State]
    """Run name to the state at its first reading."""
    noise: Mapping[str, float]
    """Run name to rad or m."""


@dataclass(frozen=True)
class PosesToReplay:
    """Measured poses of one run, to compare with the part's pose in an asset."""

    poses: Array
    """(n, 4, 4) in the canonical frame, without the tracker's registration."""
    states: Array
    """(n,) canonical joint states, from the poses."""
    times_s: Array
    """(n,) on the clock of the asset's effects."""
    middle: Array
    """(3,) canonical, at state zero: the point of the moving part at which displacements are counted."""
    lever: float
    """m: distance of points from there, to count rotations as displacements."""


@dataclass(frozen=True)
class Job:
    """The task of the process."""

    assets: tuple[AssetOnDisk, ...]
    measured: Measured
    """Only the runs to replay."""
    starts: tuple[Starts, ...]
    """For each asset."""
    engine: Engine
    holding: float
    """Interpolation of inputs where it is unknown: 0 smooth, 1 zero-order hold."""
    poses: tuple[tuple[PosesToReplay, ...], ...]
    """For each asset, or none."""


class _AssetInEngine(ABC):
    """One asset's files in an engine, ready to replay runs."""

    def __init__(self, on_disk: AssetOnDisk, job: Job):
        self.job, measured = job, job.measured
        self.asset = on_disk.read(measured)
        self.placed = place(self.asset, measured.gravity)
        joint = find_movable_joint(self.asset.urdf, self.asset.joint)
        self.lower, self.upper = joint.lower, joint.upper
        self.effects = self.asset.effects.get(self.asset.joint, ())
        self.sensing = [effect for effect in self.effects if effect.kind == "sensing"]

    @abstractmethod
    def load(self, timestep_s: float) -> Any:
        """The asset with its effects, for steps of `timestep_s`."""

    @abstractmethod
    def roll(self, loaded: Any, h: float, start: State, seconds: float, **forces: Any) -> tuple[Array, Array]:
        """Times and positions (n,) from `start` on; `forces` as for `simulate.roll_out`: `force`, `actuator`,
        `base_force`."""

    def replay(self, loaded: Any, h: float, run: Run, start: State) -> Array:
        """(n,) simulated readings at the known readings of `run`; `start` is the state at the first one.

        With a delayed sensor the simulation begins earlier by that delay.
        """
        times, measured = run.times_s[np.isfinite(run.q)], self.job.measured
        first = float(times[0])
        begin = first - sum(effect.delay() for effect in self.sensing)

        def function_of(values: Array | None, mean_s: float = h, how: str = measured.interpolation) -> Any:
            return (
                None
                if values is None
                else interpolate_series(run.times_s - begin, values, how, mean_s, self.job.holding)
            )

        effort = function_of(run.effort)
        push = effort if measured.effort_kind == "external" else None
        commanded = None if push else effort
        actuator = self._make_actuator(
            function_of(run.q_command), commanded, function_of(run.voltage), function_of(run.enabled, 0.0, "held")
        )
        q0 = float(np.clip(start[0], self.lower, self.upper))
        seconds = float(np.ceil((times[-1] - first) / h) * h) + h
        base_force = self._base_force(run, begin)
        at, course = self.roll(loaded, h, (q0, start[1]), seconds, force=push, actuator=actuator, base_force=base_force)
        q = np.interp(times - first, at, course)
        return np.asarray(q + sum((effect.reading_error(q) for effect in self.sensing), np.zeros(len(q))))

    def _base_force(self, run: Run, begin: float) -> simulate.BaseForce | None:
        """Force of a moving base; None at rest."""
        if run.base is None:
            return None
        from simgap.measure.base_motion import make_base_force  # rarely needed, and takes a second to import

        placed, turns = self.placed, self.job.measured.base_axis
        found = make_base_force(
            run.times_s, run.base, turns, placed.mechanics, placed.T_parent_canonical, placed.child_moves
        )
        return found.function(begin)

    def _make_actuator(self, command: Any, effort: Any, voltage: Any, enabled: Any) -> Actuator | None:
        """The actuator with these functions of time; each may be None."""
        known = self.job.measured.actuator
        law = known or Actuator()
        volts, commanded = (voltage if law.motor else None), effort
        if volts is not None and law.motor is not None:
            per = law.motor.per_volt
            commanded = (lambda t: per * volts(t)) if effort is None else (lambda t: per * volts(t) + effort(t))
        follows = command if known is not None else None
        if follows is None and commanded is None:
            return None
        return replace(law, q_command=follows, effort=commanded, enabled=enabled)


class _AssetInSapien(_AssetInEngine):
    def load(self, timestep_s: float) -> simulate.SimulatedAsset:
        return simulate.load(self.asset, timestep_s=timestep_s, gravity=self.placed.gravity)

    def roll(self, loaded: Any, h: float, start: State, seconds: float, **forces: Any) -> tuple[Array, Array]:
        rolled = simulate.roll_out(loaded, *start, duration_s=seconds, **forces)
        return rolled.times_s, rolled.q


class _AssetInMujoco(_AssetInEngine):
    """In MuJoCo, by the MJCF beside the URDF; the drive and a moving base are external forces."""

    def __init__(self, on_disk: AssetOnDisk, job: Job):
        super().__init__(on_disk, job)
        unsaid = [e.name for e in self.effects if e.kind != "kinematics" and not e.mjcf_joint()]
        if unsaid:
            raise FreeArtError(f"MuJoCo's format cannot say {', '.join(unsaid)} of joint '{self.asset.joint}'")

    @cached_property
    def model(self) -> Any:
        """The compiled model with one moving joint and without contacts."""
        import mujoco

        with tempfile.TemporaryDirectory() as place_:
            mjcf = mjcf_path(self.asset.urdf)
            if not (mjcf.is_file() and read_root_tag(mjcf) == "mujoco"):
                mjcf = _convert_to_mjcf(self.asset, Path(place_))
            try:
                spec = mujoco.MjSpec.from_file(str(mjcf))
                for joint in [j for j in spec.joints if j.type == mujoco.mjtJoint.mjJNT_FREE]:
                    spec.delete(joint)
                model = spec.compile()
            except ValueError as error:
                raise FreeArtError(f"{mjcf.name} cannot be loaded by MuJoCo: {str(error).splitlines()[0]}") from error
        names = [model.joint(i).name for i in range(model.njnt)]
        if names != [self.asset.joint]:
            listed = ", ".join(names) or "none"
            raise FreeArtError(
                f"{mjcf.name} has joints {listed}, expected '{self.asset.joint}' alone: MuJoCo holds no other"
            )
        model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONTACT | mujoco.mjtDisableBit.mjDSBL_AUTORESET
        model.opt.gravity = self._gravity(model)
        return model

    def _gravity(self, model: Any) -> Array:
        """(3,) in MuJoCo's world, such that the reference part feels the measured one."""
        import mujoco

        data = mujoco.MjData(model)
        data.qpos[0] = self.asset.state_zero
        mujoco.mj_kinematics(model, data)
        name = self.asset.reference_link
        turn = np.eye(3)
        if name in [model.body(i).name for i in range(model.nbody)]:
            turn = data.body(name).xmat.reshape(3, 3)
        elif name != "world":
            raise FreeArtError(f"the MJCF of {self.asset.urdf.name} has no body '{name}'")
        canonical = se3.inverse(self.asset.T_canonical_reference)[:3, :3]
        return np.asarray(turn @ canonical @ self.job.measured.gravity)

    def load(self, timestep_s: float) -> Any:
        self.model.opt.timestep = timestep_s
        return self.model

    def roll(self, loaded: Any, h: float, start: State, seconds: float, **forces: Any) -> tuple[Array, Array]:
        import mujoco

        data, n = mujoco.MjData(loaded), round(seconds / h)
        push, actuator, sway = (forces[name] for name in ("force", "actuator", "base_force"))
        data.qpos[0], data.qvel[0] = start
        q = np.empty(n + 1)
        q[0] = start[0]
        for k in range(n):
            t, at, speed = (k + 0.5) * h, float(data.qpos[0]), float(data.qvel[0])
            force = 0.0 if push is None else push(t)
            force += 0.0 if actuator is None else actuator.force(at, speed, t)
            data.qfrc_applied[0] = force + (0.0 if sway is None else sway(at, t))
            mujoco.mj_step(loaded, data)
            q[k + 1] = data.qpos[0]
        if not np.isfinite(q).all():
            raise FreeArtError(
                f"MuJoCo loses joint '{self.asset.joint}' at a time step of {h:g} s: its state is not a number"
            )
        return np.arange(n + 1, dtype=float) * h, q


def _convert_to_mjcf(asset: Asset, folder: Path) -> Path:
    """The asset's URDF as MJCF, in a folder with its files."""
    from export.mjcf import urdf_to_mjcf  # rarely needed, and takes half a second to import

    urdf = folder / asset.urdf.name
    write_xml(urdf, copy_asset_files(asset.urdf, folder, asset.root)[urdf.name])
    atomic.write_bytes(mjcf_path(urdf), urdf_to_mjcf(replace(asset, urdf=urdf, root=folder)))
    return mjcf_path(urdf)


def _replay(folder: Path, job: Job) -> None:
    loaded_assets = [
        (_AssetInMujoco if job.engine == "mujoco" else _AssetInSapien)(on_disk, job) for on_disk in job.assets
    ]
    off = [
        [_pose_gap(asset_in_engine, one) for one in tracks]
        for asset_in_engine, tracks in zip(loaded_assets, job.poses, strict=False)
    ]
    off += [[]] * (len(loaded_assets) - len(off))
    atomic.write_json(folder / "status.json", {"version": str(import_module(job.engine).__version__), "poses": off})
    for i, run in enumerate(job.measured.runs):
        for k, (asset_in_engine, begin) in enumerate(zip(loaded_assets, job.starts, strict=True)):
            h = TIMESTEPS_S[job.engine]
            q, *step = _replay_converged(asset_in_engine, run, begin.states[run.name], begin.noise[run.name], h)
            aside = folder / f"aside_{k}_{i}.npz"
            np.savez(aside, q=q, step=np.array(step))
            aside.replace(folder / f"run_{k}_{i}.npz")


def _replay_converged(
    asset_in_engine: _AssetInEngine, run: Run, start: State, noise: float, h: float
) -> tuple[Array, float, float]:
    """Readings of one run, the time step that they needed, s, and the change by its last halving, sigmas.

    For each run and asset separately: an added effect may be stiffer than all others, and a run that just passes a
    notch needs far finer steps than a smooth one.
    """
    known = np.isfinite(run.q)
    times, measured = run.times_s[known], run.q[known]
    finest = h / 2**HALVINGS
    enough = max(finest, float(times[-1] - times[0]) / MOST_STEPS)
    coarse = None
    while coarse is None:
        try:
            coarse = asset_in_engine.replay(asset_in_engine.load(h), h, run, start)
        except FreeArtError:  # too stiff for such a step
            if h < 4 * finest:
                raise
            h /= 2
    while True:
        h /= 2
        fine = asset_in_engine.replay(asset_in_engine.load(h), h, run, start)
        change, off = (root_mean_square(fine - q) / noise for q in (coarse, measured))
        if change < max(ENOUGH, SMALL * off) or h / 2 < enough:
            return fine, h, change
        coarse = fine


def _pose_gap(asset_in_engine: _AssetInEngine, track: PosesToReplay) -> float:
    """m: displacement of measured poses from the part in the asset."""
    motion = simulate.joint_motion(asset_in_engine.asset, track.states, track.times_s, asset_in_engine.placed.gravity)
    off = se3.log_se3(se3.inverse(motion) @ track.poses)
    return rms_displacement(move_twists(track.middle, off), track.lever)


def main() -> None:
    """Replay the job of standard input into the folder of the command line."""
    try:
        _replay(Path(sys.argv[1]), pickle.load(sys.stdin.buffer))
    except FreeArtError as error:
        sys.exit(str(error))
