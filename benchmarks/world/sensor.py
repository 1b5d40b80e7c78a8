"""From the joint's motion to a measured set on disk, as docs/formats.md has it: quantised, noisy, with stamps that are
a little off."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from benchmarks.world import laws as w
from benchmarks.world.machines import Machine, Nuisance, urdf
from benchmarks.world.protocols import LEAD, Plan, Run, simulate

STAMP = 1.5e-4  # s, standard deviation of a stamp's own error; a thirtieth of a servo's interval of 4.5 ms
JITTER = 0.15  # of a delay, from one command to the next


@dataclass(frozen=True)
class Encoder:
    """Quantum and standard deviation of its noise, rad or m. 1.5 mrad is a small servo's encoder (facts, section 6)."""

    quantum: float
    noise: float


@dataclass(frozen=True)
class Rig:
    """A machine as given, how it really is, what is done with it, and what reads it."""

    machine: Machine
    nuisance: Nuisance
    plan: Plan
    encoder: Encoder


def draw_encoder(machine: Machine, rng: np.random.Generator) -> Encoder:
    """1.5 mrad; of a slide what that is on a wheel of .2 m radius, .3 mm."""
    unit = 0.2 if machine.slides else 1.0
    return Encoder(1.5e-3 * unit, float(rng.uniform(3e-4, 9e-4)) * unit)


def read_exactly(p: np.ndarray, run: Run, plan: Plan, jitter: np.ndarray, longest: float) -> list[np.ndarray]:
    """What an encoder without noise reads (n,), and the joint's speed there. `jitter` (m,) in shares, one a corner of
    the command."""
    late = p[w.DELAY] * (1 + JITTER * jitter) if p[w.DELAY] else 0.0
    states = simulate(p, run, late, longest, plan.effort_kind == "commanded")
    return [p[w.STRETCH] * states[:, 0] + p[w.ZERO], states[:, 1]]


def read(p: np.ndarray, rig: Rig, rng: np.random.Generator) -> list[np.ndarray]:
    """Readings (n,) a run, NaN where one is lost."""
    encoder, out = rig.encoder, []
    for run in rig.plan.runs:
        jitter = rng.uniform(-1, 1, len(run.times))  # each tick's own of held commands, slow of smooth ones
        if not run.held:
            jitter = np.sin(2 * np.pi * (run.times * rng.uniform(0.5, 1.5) + jitter[0]))
        q, v = read_exactly(p, run, rig.plan, jitter, w.longest_step(p))
        q = q + p[w.STRETCH] * v * rng.normal(0, STAMP, len(q)) + rng.normal(0, encoder.noise, len(q))
        q = encoder.quantum * np.round(q / encoder.quantum)
        q[run.lost] = np.nan
        out.append(q)
    return out


def rows(run: Run, q: np.ndarray) -> str:
    """A run as CSV. Widths are fixed, so a file's length tells nothing of the motion."""
    free = run.role == "free"
    lines = ["t_s,q" + ("" if free else "," + run.role)]
    for t, x, c in zip(run.stamps - LEAD, q, run.at(run.stamps), strict=True):
        reading = "" if np.isnan(x) else f"{x:+.6f}"
        lines.append(f"{t:09.6f},{reading}" + ("" if free else f",{c:+.6f}"))
    return "\n".join(lines) + "\n"


def description(machine: Machine, plan: Plan) -> dict:
    """measured.json."""
    slides = machine.slides
    units = {"t_s": "s", "q": "m" if slides else "rad"}
    doc = {"version": 1, "joint": "joint", "joint_type": "prismatic" if slides else "revolute", "units": units}
    doc |= {"gravity": [round(float(g), 6) for g in machine.gravity], "base": "fixed"}
    doc["sampling"] = {"rate_hz": round(plan.rate, 3), "timestamps": "recorded"}
    if plan.has_effort:
        units["effort"] = "N" if slides else "N*m"
        doc["effort"] = plan.effort_kind
    if plan.has_command:
        units["q_command"] = units["q"]
        doc["actuator"] = {"type": "position", "stiffness": machine.stiffness, "damping": machine.damping}
    if plan.has_effort or plan.has_command:
        doc["interpolation"] = plan.interpolation
    doc["asset_uncertainty"] = {"inertia_relative": 0.05 if slides else 0.1, "gravity_relative": 0.05}
    held_out = [{"held_out": True} if run.held_out else {} for run in plan.runs]
    doc["runs"] = [{"file": f"run{i}.csv", **more} for i, more in enumerate(held_out)]
    return doc


def write(folder: Path, rig: Rig, readings: list[np.ndarray]) -> None:
    """A case as `freeart21 gap` takes it: machine.urdf and measured/. Nothing in it says what is hidden."""
    (folder / "measured").mkdir(parents=True)
    (folder / "machine.urdf").write_text(urdf(rig.machine))
    for i, (run, q) in enumerate(zip(rig.plan.runs, readings, strict=True)):
        (folder / "measured" / f"run{i}.csv").write_text(rows(run, q))
    (folder / "measured" / "measured.json").write_text(json.dumps(description(rig.machine, rig.plan), indent=1) + "\n")
