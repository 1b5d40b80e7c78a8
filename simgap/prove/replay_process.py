"""The fresh process of `simgap.prove.replay`, which is given a FOLDER and reads FOLDER/job.json and job.npz.

Results appear one by one, so that those in time count when the others are not: FOLDER/told.json (the engine's version,
and how far poses are off), then run_K_I.npz, run I by asset K, with the sensor's readings, the time step and what its
last halving changed, in sigmas.
"""

from __future__ import annotations

import sys
import tempfile
from abc import ABC, abstractmethod
from dataclasses import replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from freeart21 import se3
from freeart21.asset import Asset
from freeart21.errors import FreeArtError
from freeart21.files import atomic, checked
from freeart21.files.actuator_json import actuator_from_json
from freeart21.files.asset import movable_joint, read_asset
from freeart21.files.base_json import BASE
from freeart21.files.urdf import read_xml
from freeart21.measured import BaseAxis, BaseSeries
from freeart21.mechanics import Actuator, between
from freeart21.se3 import Array
from generator import simulate
from simgap.geometry.placing import place
from simgap.geometry.track_geometry import at_point, displacement
from simgap.prove.asset_files import copied, mjcf_beside

HALVINGS = 6
"""Of the first time step, at most."""
MOST_STEPS = 100_000
"""Of one simulation, from which on the time step is not halved any more: SAPIEN takes some four seconds for them. A
number, not a time, so that a replay is the same whenever it is repeated."""
ENOUGH, SMALL = 0.1, 0.005
"""Sigmas that a halving of the time step may change a replay by, and the part of what that replay is off by anyway: a
free swing far from the measured one may differ by more at any step, and tells the same."""


class _Stage(ABC):
    """One asset in an engine, as its files say, ready to replay runs."""

    def __init__(self, said: dict[str, Any], job: dict[str, Any]):
        root = None if said["root"] is None else Path(said["root"])
        self.asset = read_asset(Path(said["path"]), job["joint"], guesses=said["guesses"], root=root)
        self.placed = place(self.asset, np.array(job["gravity"]))
        self.lower, self.upper = (
            getattr(movable_joint(self.asset.urdf, self.asset.joint), k) for k in ("lower", "upper")
        )
        self.gravity, self.job = self.placed.gravity, job
        effects = self.asset.effects.get(self.asset.joint, ())
        self.sensing = [effect for effect in effects if effect.kind == "sensing"]

    @abstractmethod
    def load(self, timestep_s: float) -> Any:
        """The asset with its effects, to be stepped by `timestep_s`."""

    @abstractmethod
    def roll(
        self,
        loaded: Any,
        h: float,
        start: tuple[float, float],
        seconds: float,
        push: Any,
        actuator: Actuator | None,
        sway: simulate.Sway | None,
    ) -> tuple[Array, Array]:
        """Times and positions from `start` on, each (n,)."""

    def replay(self, loaded: Any, h: float, data: Any, i: int, start: tuple[float, float]) -> Array:
        """(n,) what the sensor reads at the times of run `i`; the state `start` is that of the first reading.

        A sensor that is late reads a state of before: the simulation begins by so much earlier.
        """
        times, clock = data[f"times_{i}"], data[f"clock_{i}"]
        first = float(times[0])
        begin = first - sum(effect.delay() for effect in self.sensing)

        def told(name: str, mean_s: float = h, how: str = self.job["interpolation"]) -> Any:
            values = data.get(f"{name}_{i}")
            return None if values is None else between(clock - begin, values, how, mean_s, self.job["holding"])

        effort = told("effort")
        push = effort if self.job["effort"] == "external" else None
        asked = None if push else effort
        actuator = self._driven(told("q_command"), asked, told("voltage"), told("enabled", 0.0, "held"))
        q0 = float(np.clip(start[0], self.lower, self.upper))
        seconds = float(np.ceil((times[-1] - first) / h) * h) + h
        sway = self._sway(data, i, begin)
        at, course = self.roll(loaded, h, (q0, start[1]), seconds, push, actuator, sway)
        q = np.interp(times - first, at, course)
        return np.asarray(q + sum((effect.reading_error(q) for effect in self.sensing), np.zeros(len(q))))

    def _sway(self, data: Any, i: int, begin: float) -> simulate.Sway | None:
        """What the joint feels in run `i` of a base that moves."""
        base = BaseSeries(*(data.get(f"base_{name}_{i}") for name in BASE))
        if all(getattr(base, name) is None for name in BASE):
            return None
        from simgap.measure.base_motion import sway_of  # most bases stand still, and it imports a second's worth

        turns = self.job["base"]
        axis = None if turns is None else BaseAxis(np.array(turns["axis"]), np.array(turns["point"]))
        placed = self.placed
        found = sway_of(data[f"clock_{i}"], base, axis, placed.mechanics, placed.T_parent_canonical, placed.child_moves)
        return found.function(begin)

    def _driven(self, command: Any, effort: Any, voltage: Any, enabled: Any) -> Actuator | None:
        """What drives the joint by these functions of time, each of which may be missing."""
        said = self.job["actuator"]
        law = Actuator() if said is None else actuator_from_json(said, "job.json")
        volts, asked = (voltage if law.motor else None), effort
        if volts is not None and law.motor is not None:
            per = law.motor.per_volt
            asked = (lambda t: per * volts(t)) if effort is None else (lambda t: per * volts(t) + effort(t))
        follows = command if said is not None else None
        if follows is None and asked is None:
            return None
        return replace(law, q_command=follows, effort=asked, enabled=enabled)


class _InSapien(_Stage):
    def load(self, timestep_s: float) -> simulate.SimulatedAsset:
        return simulate.load(self.asset, timestep_s=timestep_s, gravity=self.gravity)

    def roll(
        self,
        loaded: simulate.SimulatedAsset,
        h: float,
        start: tuple[float, float],
        seconds: float,
        push: Any,
        actuator: Actuator | None,
        sway: simulate.Sway | None,
    ) -> tuple[Array, Array]:
        rolled = simulate.roll_out(loaded, *start, duration_s=seconds, force=push, actuator=actuator, sway=sway)
        return rolled.times_s, rolled.q


class _InMujoco(_Stage):
    """By the MJCF beside the URDF; the drive and what the joint feels of a moved base are forces from outside."""

    def __init__(self, said: dict[str, Any], job: dict[str, Any]):
        super().__init__(said, job)
        effects = self.asset.effects.get(self.asset.joint, ())
        unsaid = [e.name for e in effects if e.kind != "kinematics" and not e.mjcf_joint()]
        if unsaid:
            raise FreeArtError(f"MuJoCo's format cannot say {', '.join(unsaid)} of joint '{self.asset.joint}'")

    @cached_property
    def model(self) -> Any:
        """The compiled model: one joint moves, and nothing touches anything."""
        import mujoco

        with tempfile.TemporaryDirectory() as place_:
            mjcf = mjcf_beside(self.asset.urdf)
            if not (mjcf.is_file() and read_xml(mjcf).tag == "mujoco"):
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
            said = ", ".join(names) or "none"
            raise FreeArtError(
                f"{mjcf.name} has joints {said}, expected '{self.asset.joint}' alone: MuJoCo holds no other"
            )
        model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONTACT | mujoco.mjtDisableBit.mjDSBL_AUTORESET
        model.opt.gravity = self._gravity(model)
        return model

    def _gravity(self, model: Any) -> Array:
        """(3,) in MuJoCo's world, so that the reference part feels what was measured."""
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
        return np.asarray(turn @ canonical @ np.array(self.job["gravity"]))

    def load(self, timestep_s: float) -> Any:
        self.model.opt.timestep = timestep_s
        return self.model

    def roll(
        self,
        loaded: Any,
        h: float,
        start: tuple[float, float],
        seconds: float,
        push: Any,
        actuator: Actuator | None,
        sway: simulate.Sway | None,
    ) -> tuple[Array, Array]:
        import mujoco

        data, n = mujoco.MjData(loaded), round(seconds / h)
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
    """The asset's URDF as MJCF, in a folder with the files that it names."""
    from export.mjcf_of_urdf import mjcf_of_urdf  # most have one, and it imports half a second's worth

    urdf = folder / asset.urdf.name
    atomic.write_bytes(urdf, copied(asset.urdf, folder, asset.root)[urdf.name])
    atomic.write_bytes(mjcf_beside(urdf), mjcf_of_urdf(replace(asset, urdf=urdf, root=folder)))
    return mjcf_beside(urdf)


_STAGES: dict[str, type[_Stage]] = {"sapien": _InSapien, "mujoco": _InMujoco}


def _version(engine: str) -> str:
    if engine == "mujoco":
        import mujoco

        return str(mujoco.__version__)
    import sapien

    return str(sapien.__version__)


def _replay(folder: Path) -> None:
    job = checked.read_json(folder / "job.json")
    data = checked.read_npz(folder / "job.npz")
    stages = [_STAGES[job["engine"]](said, job) for said in job["assets"]]
    off = [
        [_pose_gap(stage, data, k, i, said) for i, said in enumerate(tracks)]
        for k, (stage, tracks) in enumerate(zip(stages, job["poses"], strict=False))
    ]
    off += [[]] * (len(stages) - len(off))
    atomic.write_json(folder / "told.json", {"version": _version(job["engine"]), "poses": off})
    for i in range(len(job["starts"][0])):
        for k, stage in enumerate(stages):
            start, noise = job["starts"][k][i], float(job["noise"][k][i])
            q, *step = _converged(stage, data, i, (float(start[0]), float(start[1])), noise, float(job["timestep_s"]))
            aside = folder / f"aside_{k}_{i}.npz"
            np.savez(aside, q=q, step=np.array(step))
            aside.replace(folder / f"run_{k}_{i}.npz")


def _converged(
    stage: _Stage, data: Any, i: int, start: tuple[float, float], noise: float, h: float
) -> tuple[Array, float, float]:
    """Readings of one run, the time step that they needed, s, and by how many sigmas its last halving changed them.

    Each run with each asset by itself: what was added may be stiffer than all that was there, and a run that just
    passes a notch, or does not, needs far finer steps than one that only swings wider and faster.
    """
    times = data[f"times_{i}"]
    finest = h / 2**HALVINGS
    enough = max(finest, float(times[-1] - times[0]) / MOST_STEPS)
    coarse = None
    while coarse is None:
        try:
            coarse = stage.replay(stage.load(h), h, data, i, start)
        except FreeArtError:  # too stiff for such a step
            if h < 4 * finest:
                raise
            h /= 2
    while True:
        h /= 2
        fine = stage.replay(stage.load(h), h, data, i, start)
        change, off = (float(np.sqrt(np.mean((fine - q) ** 2))) / noise for q in (coarse, data[f"q_{i}"]))
        if change < max(ENOUGH, SMALL * off) or h / 2 < enough:
            return fine, h, change
        coarse = fine


def _pose_gap(stage: _Stage, data: Any, k: int, i: int, said: dict[str, Any]) -> float:
    """m: how far the measured poses `i` for asset `k` are from where that has the part."""
    states, times, poses = (data[f"{name}_{k}_{i}"] for name in ("states", "times_s", "poses"))
    motion = simulate.joint_motion(stage.asset, states, times, stage.gravity)
    off = se3.log_se3(se3.inverse(motion) @ poses)
    return displacement(at_point(np.array(said["middle"]), off), float(said["lever"]))


def main() -> None:
    """Replay what the folder that the command line names asks for."""
    try:
        _replay(Path(sys.argv[1]))
    except FreeArtError as error:
        sys.exit(str(error))
