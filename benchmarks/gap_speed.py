"""How long `gap` takes for long runs, and how much memory.

    .venv/bin/python -m benchmarks.gap_speed

Ten runs of a pendulum with dry friction (Dahl's, with pre-sliding) and viscous damping that the asset lacks, five
swinging freely and five pushed by known torques, at 200 readings a second, from an integrator of its own; `find_gap` in
a process of its own for each length of the runs. Seconds are of processor time, without those in which formulas are
compiled once. Prints the table and writes benchmarks/results/gap_speed.json.
"""

from __future__ import annotations

import multiprocessing
import resource
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np
import tyro
from numba import njit
from rich.console import Console
from rich.table import Table

from benchmarks.common import RESULTS, commit, machine
from freeart21.files import atomic
from freeart21.measured import Measured, Run
from freeart21.se3 import Array

RUNS, RATE, STEPS = 10, 200, 50
"""Runs of a set, readings a second, steps between two readings."""
MASS, ARM, OWN, G = 1.6, 0.5, 0.01, 9.81
DRY, VISCOUS = 0.04, 0.05
"""N m and N m s/rad that the asset lacks."""
TRAVEL = 8e-3
"""rad over which dry friction builds up."""
NOISE, TICK = 3e-4, 1e-4
"""rad of the sensor."""
LIMIT_S, LIMIT_MB = 60.0, 1024.0
"""Reach, for the longest set."""


@njit
def _course(q: float, torque: Array, step: float, inertia: float, weight: float) -> Array:  # pragma: no cover
    """(n,) positions of a pendulum let go at `q` under torques (n,), each held until the next reading."""
    out, v, bent = np.empty(len(torque)), 0.0, 0.0
    for i in range(len(torque)):
        out[i] = q
        for _ in range(STEPS):
            q += 0.5 * step * v
            way = step * v / TRAVEL
            bent = (bent + way) / (1 + abs(way))
            v += step * (torque[i] - weight * np.sin(q) - VISCOUS * v - DRY * bent) / inertia
            q += 0.5 * step * v
    return out


def long_runs(seconds: float, seed: int = 5) -> Measured:
    """The set; the true inertia is 4 % more and the weight 2 % less than the asset's."""
    rng = np.random.default_rng(seed)
    times, runs = np.arange(round(seconds * RATE)) / RATE, []
    for k in range(RUNS):
        rates, phases = rng.uniform(0.2, 0.6, (3, 1)), rng.uniform(0, 2 * np.pi, (3, 1))
        torque = (k % 2) * rng.uniform(0.1, 0.3) * np.sin(2 * np.pi * rates * times + phases).sum(0)
        begin = rng.uniform(0.4, 1.4) * rng.choice([-1.0, 1.0])
        q = _course(begin, torque, 1 / RATE / STEPS, 1.04 * (OWN + MASS * ARM**2), 0.98 * MASS * G * ARM)
        read = np.round((q + rng.normal(0, NOISE, len(q))) / TICK) * TICK
        runs.append(Run(f"run{k}", times, read, effort=torque))
    return Measured(
        joint="j",
        joint_type="revolute",
        gravity=np.array([0.0, 0.0, -G]),
        rate_hz=float(RATE),
        timestamps="nominal",
        runs=tuple(runs),
        effort_kind="external",
        inertia_relative=0.1,
        gravity_relative=0.05,
    )


def asset_in(folder: Path) -> Path:
    """The pendulum as it should be."""
    path = folder / "bob.urdf"
    path.write_text(f"""<robot name="bob"><link name="base"/><link name="bob"><inertial><origin xyz="0 0 {-ARM}"/>
        <mass value="{MASS}"/><inertia ixx="{OWN}" iyy="{OWN}" izz="{OWN}" ixy="0" ixz="0" iyz="0"/></inertial></link>
        <joint name="j" type="revolute"><parent link="base"/><child link="bob"/><origin xyz="0 0 1" rpy="0 0 0"/>
        <axis xyz="0 1 0"/><limit lower="-3" upper="3"/></joint></robot>""")
    return path


def _asked(seconds: float, out: Any) -> None:
    from freeart21.files.asset import read_asset
    from simgap.workflow import find_gap

    with tempfile.TemporaryDirectory() as folder:
        asset = read_asset(asset_in(Path(folder)))
        find_gap(asset, long_runs(2.0))  # compiles
        measured = long_runs(seconds)
        began = time.process_time()
        verdict = find_gap(asset, measured)
        used = time.process_time() - began
    values = {e.effect.name: [float(x) for x in e.effect.values()] for e in verdict.effects}
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    row = {"length": seconds, "seconds": round(used, 1), "MB": round(peak), "verdict": verdict.verdict}
    out.put({**row, "effects": values, "rivals": [list(names) for names in verdict.rivals]})


def main(lengths: tuple[float, ...] = (6.0, 20.0, 60.0), out: Path = RESULTS / "gap_speed.json") -> None:
    """Ask and write down.

    Args:
        lengths: Seconds that every run of a set lasts for.
        out: The JSON file.
    """
    context, rows = multiprocessing.get_context("spawn"), []
    for seconds in lengths:
        answers = context.Queue()
        process = context.Process(target=_asked, args=(seconds, answers))
        process.start()
        rows.append(answers.get(timeout=3600))
        process.join()
    table = Table("runs", "processor s", "MB", "verdict", "names")
    for row in rows:
        names = " or ".join("+".join(names) for names in row["rivals"]) or "+".join(row["effects"]) or "-"
        table.add_row(f"{RUNS} x {row['length']:g} s", f"{row['seconds']}", f"{row['MB']}", row["verdict"], names)
    Console(width=140).print(table)
    about = {"commit": commit(), "machine": machine()}
    settings = {"runs": RUNS, "rate_hz": RATE, "reach": {"seconds": LIMIT_S, "MB": LIMIT_MB}}
    atomic.write_json(out, {**about, "settings": settings, "rows": rows})
    print(out)


if __name__ == "__main__":
    tyro.cli(main)
