"""Measured sets under seal: what a predictor may see in one place, what is hidden in another.

    OUT/cases/ID/asset/object.urdf          OUT/cases/ID/measured/{measured.json, run_00.csv, ...}
    OUT/manifest.json                       SHA-256 of every case's salted label, published before anything is answered
    VAULT/labels.jsonl, VAULT/salt          outside of what a predictor is given
    LEDGER                                  SHA-256 of every verdict, written before labels open

Case ids are random. Files of one rig and one type of joint are all of one size, whatever is hidden in them.
"""

from __future__ import annotations

import hashlib
import io
import json
import secrets
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.hidden_world import mujoco_world, poses
from benchmarks.hidden_world.cases import Case
from benchmarks.hidden_world.nuisance import (
    GRAVITY_RELATIVE,
    INERTIA_RELATIVE,
    LEAD,
    RATE,
    SECONDS,
    Recorded,
    drive_of,
    record,
    repeats,
    true_world,
    with_servo,
)
from benchmarks.hidden_world.ode import simulate
from benchmarks.hidden_world.rig import OTHER, SAME
from benchmarks.hidden_world.strength import changed

LOST_FRAMES = 3


class SealBroken(Exception):
    """Labels were asked for before the verdicts were fixed, or a verdict was changed after."""


def runs_of(case: Case, solve=simulate) -> list[Recorded]:
    """The thirteen runs as the sensor wrote them down, in the order of the session.

    A run that would not repeat itself within the noise is made anew from a little beside: a careful experimenter's.
    """
    rng = np.random.default_rng([case.seed, 3])
    base = with_servo(true_world(case.body, case.nuisance), case.servo)
    world, reading = changed(base, case.body, case.hidden)
    if solve is mujoco_world.simulate:
        world = mujoco_world.sayable(world)
    commanded = case.wish.rig == "effort"
    most = float(np.hypot(case.nuisance.noise, case.nuisance.quantum / 3.5))
    found = []
    for i, plan in enumerate(case.plans):
        for _ in range(6):
            run = record(world, plan, commanded, reading, case.nuisance, rng, 8.0 * i, solve)
            if solve is not simulate or repeats(world, plan, commanded, reading, run, 8.0 * i) < most:
                break
            q0 = plan.q0 + 0.03 * case.body.range * rng.uniform(-1, 1)
            plan = replace(plan, q0=float(np.clip(q0, case.body.lower, case.body.upper)))
        found.append(run)
    return found


def pose_runs_of(case: Case) -> list[dict[str, np.ndarray]]:
    """The thirteen runs as a camera saw them: what stands in poses.npz."""
    rng = np.random.default_rng([case.seed, 4])
    world = true_world(case.body, case.nuisance)
    camera = poses.camera(rng)
    times = np.arange(round(poses.RATE * SECONDS) + 1) / poses.RATE
    found = []
    name, seed, size = None, 0, 0.0
    if case.hidden:
        name, seed, size = case.hidden[0].name, case.hidden[0].seed, case.hidden[0].size
    for i, plan in enumerate(case.plans):
        asked = np.concatenate([[-LEAD], times])
        q = simulate(world, plan.q0, plan.v0, asked, drive_of(plan, times, False))[1:, 0]
        moved = poses.seen_motion(name, seed, size, case.body, q, times + 8.0 * i)
        seen = np.ones((len(times), 2), bool)
        seen[rng.choice(np.arange(1, len(times) - 1), LOST_FRAMES, replace=False), 1] = False
        still = np.broadcast_to(np.eye(4), moved.shape)
        found.append(
            {
                "times_s": times,
                "T_camera_reference": poses.tracked(rng, camera @ still),
                "T_camera_moving": poses.tracked(rng, camera @ moved),
                "seen": seen,
            }
        )
    return found


def files_of(case: Case, solve=simulate) -> dict[str, bytes]:
    """Path to content of everything that a predictor gets."""
    files = {"asset/object.urdf": case.body.urdf().encode()}
    if case.wish.rig == "poses":
        for i, arrays in enumerate(pose_runs_of(case)):
            buffer = io.BytesIO()
            np.savez(buffer, **arrays)
            files[f"measured/run_{i:02d}/poses.npz"] = buffer.getvalue()
    else:
        for i, run in enumerate(runs_of(case, solve)):
            files[f"measured/run_{i:02d}.csv"] = _csv(run).encode()
    files["measured/measured.json"] = _measured_json(case).encode()
    return files


def _csv(run: Recorded) -> str:
    columns = {"t_s": run.times, "q": run.q, "effort": run.effort, "q_command": run.command}
    given = {name: values for name, values in columns.items() if values is not None}
    table = np.column_stack(list(given.values()))
    lines = [",".join(given), *(",".join(f"{v:+.8e}" for v in row) for row in table)]
    return "\n".join(lines) + "\n"


def _measured_json(case: Case) -> str:
    """Numbers of fixed width, so that the file is as long whatever it says."""
    body, rig = case.body, case.wish.rig
    length, force = ("rad", "N*m") if body.revolute else ("m", "N")
    poses_only = rig == "poses"
    units = {"t_s": "s", "q": length}
    data: dict[str, Any] = {"version": 1, "joint": "joint", "joint_type": body.kind}
    if any(plan.effort is not None for plan in case.plans):
        units["effort"] = force
        data["effort"] = "commanded" if rig == "effort" else "external"
    if any(plan.command is not None for plan in case.plans):
        units["q_command"] = length
        servo = {"stiffness": _Number(case.servo.stiffness), "damping": _Number(case.servo.damping)}
        data["actuator"] = {"type": "position", **servo}
    data["units"] = units
    data["gravity"] = [_Number(v) for v in body.gravity]
    data["base"] = "fixed"
    data["sampling"] = {"rate_hz": poses.RATE if poses_only else RATE, "timestamps": "recorded"}
    data["runs"] = [
        {
            "file": f"run_{i:02d}/poses.npz" if poses_only else f"run_{i:02d}.csv",
            "kind": "poses" if poses_only else "csv",
            "held_out": i in SAME + OTHER,
        }
        for i in range(len(case.plans))
    ]
    data["asset_uncertainty"] = {
        "inertia_relative": _Number(INERTIA_RELATIVE),
        "gravity_relative": _Number(GRAVITY_RELATIVE[body.family]),
    }
    numbers: list[str] = []

    def placed(value: Any) -> Any:
        if isinstance(value, _Number):
            numbers.append(f"{float(value): .9e}")
            return f"@{len(numbers) - 1:02d}@"
        if isinstance(value, dict):
            return {k: placed(v) for k, v in value.items()}
        return [placed(v) for v in value] if isinstance(value, list) else value

    text = json.dumps(placed(data), indent=1)
    for i, number in enumerate(numbers):
        text = text.replace(f'"@{i:02d}@"', number)
    return text + "\n"


class _Number(float):
    """A number that is written in fixed width."""


class Vault:
    """Labels under lock: nothing of them is in the folder of cases but their hashes."""

    def __init__(self, out: Path, vault: Path) -> None:
        self.out, self.vault = out, vault
        self.ledger = vault / "ledger.jsonl"

    def prepare(self) -> None:
        """Make the vault and its salt."""
        self.vault.mkdir(parents=True, exist_ok=True)
        salt = self.vault / "salt"
        if not salt.is_file():
            salt.write_text(secrets.token_hex(32))

    def seal(self, cases: dict[str, Case]) -> None:
        """Write all cases and labels; ids are the keys. Goes on where a killed run stopped."""
        self.prepare()
        for name, case in cases.items():
            self.add(name, case)
        self.publish()

    def add(self, name: str, case: Case) -> None:
        """One more case: its files appear last of all, its label before them. Some free swings are MuJoCo's."""
        folder = self.out / "cases" / name
        if folder.is_dir():
            return
        solve = engine_of(case)
        label = {"id": name, **case.label(), "engine": "ode" if solve is simulate else "mujoco"}
        with (self.vault / "labels.jsonl").open("a") as file:
            file.write(json.dumps(label, default=float) + "\n")
        aside = self.out / f".{name}.part"
        for path, content in files_of(case, solve).items():
            (aside / path).parent.mkdir(parents=True, exist_ok=True)
            (aside / path).write_bytes(content)
        folder.parent.mkdir(parents=True, exist_ok=True)
        aside.rename(folder)

    def _labels(self) -> dict[str, dict[str, Any]]:
        lines = (self.vault / "labels.jsonl").read_text().splitlines()
        return {label["id"]: label for label in map(json.loads, lines)}  # the last of a name counts

    def _hash(self, label: dict[str, Any]) -> str:
        text = (self.vault / "salt").read_text() + json.dumps(label, sort_keys=True)
        return hashlib.sha256(text.encode()).hexdigest()

    def publish(self) -> None:
        """Write the manifest."""
        hashes = {name: self._hash(label) for name, label in sorted(self._labels().items())}
        (self.out / "manifest.json").write_text(json.dumps(hashes, indent=1))

    def record(self, name: str, verdict: Path) -> None:
        """Fix a verdict, before labels open."""
        entry = {"id": name, "sha256": hashlib.sha256(verdict.read_bytes()).hexdigest()}
        with self.ledger.open("a") as file:
            file.write(json.dumps(entry) + "\n")

    def open(self, verdicts: dict[str, Path]) -> dict[str, dict[str, Any]]:
        """The labels of answered cases. SealBroken when a verdict was not fixed or was changed, or a label was."""
        fixed: dict[str, str] = {}
        for entry in map(json.loads, self.ledger.read_text().splitlines()) if self.ledger.is_file() else ():
            fixed.setdefault(entry["id"], entry["sha256"])  # the first one counts
        manifest = json.loads((self.out / "manifest.json").read_text())
        labels = self._labels()
        for name, path in verdicts.items():
            if fixed.get(name) is None:
                raise SealBroken(f"the verdict of case {name} was never recorded")
            if fixed[name] != hashlib.sha256(path.read_bytes()).hexdigest():
                raise SealBroken(f"the verdict of case {name} is not the one that was recorded")
            if manifest.get(name) != self._hash(labels[name]):
                raise SealBroken(f"the label of case {name} is not the one that was published")
        return {name: labels[name] for name in verdicts}


def engine_of(case: Case) -> Any:
    """MuJoCo for swings that never meet a stop, where it can say what is hidden; else our own equations."""
    world, _ = changed(with_servo(true_world(case.body, case.nuisance), case.servo), case.body, case.hidden)
    fit = case.wish.rig == "swing" and case.seed % 2 and mujoco_world.able(mujoco_world.sayable(world))
    return mujoco_world.simulate if fit else simulate


def case_id(seed: int, i: int) -> str:
    """A name that tells nothing."""
    return hashlib.sha256(f"{seed}/{i}/case".encode()).hexdigest()[:12]
