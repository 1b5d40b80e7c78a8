"""From the joint's motion to a measured set on disk, as docs/formats.md has it: quantised, noisy, with stamps that are
a little off."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from benchmarks.second_world import protocols
from benchmarks.second_world.hidden import Sensing, longest
from benchmarks.second_world.machines import Machine, urdf
from benchmarks.second_world.protocols import LEAD, Plan, Run

STAMP = 1.5e-4  # s, standard deviation of a stamp's own error; a thirtieth of a servo's interval of 4.5 ms
JITTER = 0.15  # of a delay, from one command to the next


@dataclass(frozen=True)
class Encoder:
    """Quantum and standard deviation of its noise, rad or m. 1.5 mrad is a small servo's encoder (facts, section 6)."""

    quantum: float
    noise: float

    @property
    def sigma(self) -> float:
        return float(np.hypot(self.noise, self.quantum / np.sqrt(12)))


def draw_encoder(machine: Machine, rng: np.random.Generator) -> Encoder:
    """1.5 mrad; of a slide what that is on a wheel of .2 m radius, .3 mm."""
    unit = 0.2 if machine.slides else 1.0
    return Encoder(1.5e-3 * unit, float(rng.uniform(3e-4, 9e-4)) * unit)


def clean(
    p: np.ndarray, sensing: Sensing, run: Run, plan: Plan, jitter: np.ndarray, finest: float
) -> tuple[np.ndarray, np.ndarray]:
    """What an encoder without noise reads (n,), and the joint's speed there. `jitter` (m,) in shares, one a corner of
    the command."""
    late = sensing.delay * (1 + JITTER * jitter) if sensing.delay else 0.0
    states = protocols.simulate(p, run, late, sensing.late, finest, plan.effort_kind == "commanded")
    return sensing.scale * states[:, 0] + sensing.offset, states[:, 1]


def delay_jitter(run: Run, rng: np.random.Generator) -> np.ndarray:
    """(m,) of unit size: each tick's own of held commands, slow of smooth ones."""
    own = rng.uniform(-1, 1, len(run.times))
    return own if run.held else np.sin(2 * np.pi * (run.times * rng.uniform(0.5, 1.5) + own[0]))


def read(p: np.ndarray, sensing: Sensing, plan: Plan, encoder: Encoder, rng: np.random.Generator) -> list[np.ndarray]:
    """Readings (n,) a run, NaN where one is lost."""
    out = []
    for run in plan.runs:
        q, v = clean(p, sensing, run, plan, delay_jitter(run, rng), longest(p))
        q = q + sensing.scale * v * rng.normal(0, STAMP, len(q)) + rng.normal(0, encoder.noise, len(q))
        q = encoder.quantum * np.round(q / encoder.quantum)
        q[run.lost] = np.nan
        out.append(q)
    return out


def rows(run: Run, q: np.ndarray) -> str:
    """A run as CSV. Widths are fixed, so a file's length tells nothing of the motion."""
    column = "" if run.role == "free" else "," + run.role
    lines = ["t_s,q" + column]
    command = run.at(run.stamps)
    for t, x, c in zip(run.stamps - LEAD, q, command, strict=True):
        lines.append(
            f"{t:09.6f}," + ("" if np.isnan(x) else f"{x:+.6f}") + ("" if run.role == "free" else f",{c:+.6f}")
        )
    return "\n".join(lines) + "\n"


def size_of(run: Run) -> int:
    """Bytes of its file: known before anything has moved."""
    each = 9 + 1 + 1 + (0 if run.role == "free" else 1 + 9)
    cells = 9 * int((~run.lost).sum())
    extra = sum(len(f"{c:+.6f}") - 9 for c in run.at(run.stamps)) if run.role != "free" else 0
    return len("t_s,q\n") + (0 if run.role == "free" else 1 + len(run.role)) + each * len(run.stamps) + cells + extra


def description(machine: Machine, plan: Plan) -> dict:
    """measured.json."""
    slides = machine.slides
    units = {"t_s": "s", "q": "m" if slides else "rad"}
    doc = {
        "version": 1,
        "joint": "joint",
        "joint_type": "prismatic" if slides else "revolute",
        "units": units,
        "gravity": [round(float(g), 6) for g in machine.gravity],
        "base": "fixed",
        "sampling": {"rate_hz": round(plan.rate, 3), "timestamps": "recorded"},
    }
    if plan.has_effort:
        units["effort"] = "N" if slides else "N*m"
        doc["effort"] = plan.effort_kind
    if plan.has_command:
        units["q_command"] = units["q"]
        doc["actuator"] = {"type": "position", "stiffness": machine.stiffness, "damping": machine.damping}
    if plan.has_effort or plan.has_command:
        doc["interpolation"] = plan.interpolation
    doc["asset_uncertainty"] = {"inertia_relative": 0.05 if slides else 0.1, "gravity_relative": 0.05}
    doc["runs"] = [
        {"file": f"run{i}.csv", **({"held_out": True} if run.held_out else {})} for i, run in enumerate(plan.runs)
    ]
    return doc


def write(folder: Path, machine: Machine, plan: Plan, readings: list[np.ndarray]) -> None:
    """A case as `freeart21 gap` takes it: machine.urdf and measured/. Nothing in it says what is hidden."""
    (folder / "measured").mkdir(parents=True)
    (folder / "machine.urdf").write_text(urdf(machine))
    for i, (run, q) in enumerate(zip(plan.runs, readings, strict=True)):
        (folder / "measured" / f"run{i}.csv").write_text(rows(run, q))
    (folder / "measured" / "measured.json").write_text(json.dumps(description(machine, plan), indent=1) + "\n")
