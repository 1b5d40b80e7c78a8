"""The fresh process of `simgap.proof.show`, which is given a FOLDER and reads FOLDER/job.json and job.npz.

Results appear one by one, so that those in time count when the others are not: FOLDER/poses.json, then run_0.npz,
run_1.npz, ... with the readings of both assets, the time step of each and what its last halving changed, in floors.
"""

from __future__ import annotations

import sys
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from freeart21 import se3
from freeart21.errors import FreeArtError
from freeart21.files import atomic, checked
from freeart21.files.actuator_json import actuator_from_json
from freeart21.files.asset import movable_joint, read_asset
from freeart21.files.base_json import BASE
from freeart21.measured import BaseAxis, BaseSeries
from freeart21.mechanics import Actuator, between
from freeart21.se3 import Array
from generator import simulate
from simgap.geometry.placing import place
from simgap.geometry.track_geometry import at_point, displacement
from simgap.measure.base_motion import sway_of

HALVINGS = 6
SHARE = 0.4
"""Of the seconds that there are, beyond which no time step is halved twice."""
ENOUGH, SMALL = 0.1, 0.005
"""Floors that a halving of the time step may change a replay by, and the part of what that replay is off by anyway: a
free swing far from the measured one may differ by more at any step, and tells the same."""


class _Stage:
    """One asset in SAPIEN, as its files say, ready to replay runs."""

    def __init__(self, path: Path, root: Path | None, job: dict[str, Any]):
        self.asset = read_asset(path, job["joint"], guesses=False, root=root)
        self.placed = place(self.asset, np.array(job["gravity"]))
        self.lower, self.upper = (
            getattr(movable_joint(self.asset.urdf, self.asset.joint), k) for k in ("lower", "upper")
        )
        self.gravity, self.job = self.placed.gravity, job

    def load(self, timestep_s: float) -> simulate.SimulatedAsset:
        """The asset with its effects."""
        return simulate.load(self.asset, timestep_s=timestep_s, gravity=self.gravity)

    def replay(self, loaded: simulate.SimulatedAsset, data: Any, i: int, start: tuple[float, float]) -> Array:
        """(n,) what the sensor reads at the times of run `i`; the state `start` is that of the first reading.

        A sensor that is late reads a state of before: the simulation begins by so much earlier.
        """
        times, clock = data[f"times_{i}"], data[f"clock_{i}"]
        sensing = [effect for effect in loaded.effects if effect.kind == "sensing"]
        first = float(times[0])
        begin = first - sum(effect.delay() for effect in sensing)
        h = loaded.timestep_s

        def told(name: str, mean_s: float = h, how: str = self.job["interpolation"]) -> Any:
            values = data.get(f"{name}_{i}")
            return None if values is None else between(clock - begin, values, how, mean_s, self.job["holding"])

        effort = told("effort")
        push = effort if self.job["effort"] == "external" else None
        asked = None if push else effort
        actuator = self._driven(told("q_command"), asked, told("voltage"), told("enabled", 0.0, "held"))
        sway = self._sway(data, i, begin)
        q0 = float(np.clip(start[0], self.lower, self.upper))
        seconds = float(np.ceil((times[-1] - first) / h) * h) + h
        rolled = simulate.roll_out(loaded, q0, start[1], duration_s=seconds, force=push, actuator=actuator, sway=sway)
        q = np.interp(times - first, rolled.times_s, rolled.q)
        return np.asarray(q + sum((effect.reading_error(q) for effect in sensing), np.zeros(len(q))))

    def _sway(self, data: Any, i: int, begin: float) -> simulate.Sway | None:
        """What the joint feels in run `i` of a base that moves."""
        base = BaseSeries(*(data.get(f"base_{name}_{i}") for name in BASE))
        if all(getattr(base, name) is None for name in BASE):
            return None
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


def _replay(folder: Path) -> None:
    job = checked.read_json(folder / "job.json")
    data = checked.read_npz(folder / "job.npz")
    pairs = zip(job["assets"], job["roots"], strict=True)
    stages = [_Stage(Path(path), None if root is None else Path(root), job) for path, root in pairs]
    off = [_pose_gaps(stages, data, i, said) for i, said in enumerate(job["poses"])]
    atomic.write_json(folder / "poses.json", {"poses": off})
    starts = [[(float(q), float(qd)) for q, qd in pair] for pair in job["starts"]]
    end = time.monotonic() + SHARE * float(job["seconds"])
    for i in range(len(starts)):
        told = [_converged(stage, data, job, i, starts[i][k], end) for k, stage in enumerate(stages)]
        aside = folder / f"aside_{i}.npz"
        (before, *first), (after, *second) = told
        np.savez(aside, before=before, after=after, steps=np.array([first, second]))
        aside.replace(folder / f"run_{i}.npz")


def _converged(
    stage: _Stage, data: Any, job: dict[str, Any], i: int, start: tuple[float, float], end: float
) -> tuple[Array, float, float]:
    """Readings of one run, the time step that they needed, s, and by how many floors its last halving changed them.

    Each run with each asset by itself: what was added may be stiffer than all that was there, and a run that just
    passes a notch, or does not, needs far finer steps than one that only swings wider and faster.
    """
    floor, h = float(job["floors"][i]), float(job["timestep_s"])
    least, coarse = h / 2**HALVINGS, None
    while coarse is None:
        try:
            coarse = stage.replay(stage.load(h), data, i, start)
        except FreeArtError:  # too stiff for such a step
            if h < 4 * least:
                raise
            h /= 2
    while True:
        h /= 2
        fine = stage.replay(stage.load(h), data, i, start)
        numerics, gap = (float(np.sqrt(np.mean((fine - q) ** 2))) / floor for q in (coarse, data[f"q_{i}"]))
        if numerics < max(ENOUGH, SMALL * gap) or h <= least or time.monotonic() > end:
            return fine, h, numerics
        coarse = fine


def _pose_gaps(stages: list[_Stage], data: Any, i: int, said: dict[str, Any]) -> list[float]:
    """m: how far measured poses of run `i` are from where either asset has the part."""
    gaps = []
    for k, stage in enumerate(stages):
        motion = simulate.joint_motion(stage.asset, data[f"states_{k}_{i}"], data[f"pose_times_{i}"], stage.gravity)
        off = se3.log_se3(se3.inverse(motion) @ data[f"poses_{k}_{i}"])
        gaps.append(displacement(at_point(np.array(said["middle"]), off), float(said["lever"])))
    return gaps


def main() -> None:
    """Replay what the folder that the command line names asks for."""
    try:
        _replay(Path(sys.argv[1]))
    except FreeArtError as error:
        sys.exit(str(error))
