"""False alarms of how a command goes on between the rows of its log, where nothing is missing.

    .venv/bin/python -m benchmarks.gap_rows

moves a pendulum by a position servo, in an integration of its own at a tenth of a millisecond, under commands that are
smooth or held until their next row; logs both at 20 to 100 Hz; asks `gap`; the set states that
the commands are held, or nothing. Prints the table and writes benchmarks/results/gap_rows.json. Some minutes.
"""

from __future__ import annotations

import tempfile
from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np
from numba import njit
from rich.console import Console

from benchmarks.common import RESULTS, make_table, run_cli, write_report
from export.joint_asset import JointNumbers, write_joint_asset
from freeart21.files.asset import read_asset
from freeart21.measured import Interpolation, Measured, Run
from freeart21.mechanics import Actuator
from freeart21.se3 import Array
from simgap.workflow import find_gap

MASS, LENGTH, INERTIA, G = 1.6, 0.5, 0.41, 9.81
SERVO = (60.0, 4.0)
"""N*m/rad and N*m*s/rad: 2 Hz, well damped."""
FINE = 10_000
"""Steps a second: a hundred in the shortest row that is tried."""
SECONDS, RUNS = 4.0, 5
CASES: tuple[tuple[int, bool, Interpolation], ...] = (
    *((rate, smooth, "unknown") for rate in (100, 50, 20) for smooth in (True, False)),
    (100, True, "held"),
)
"""Rows a second, whether the command is smooth between them, and what the measured set states of it."""


def main(seeds: int = 12, out: Path = RESULTS / "gap_rows.json") -> None:
    """Ask and count.

    Args:
        seeds: Draws of each case.
        out: The JSON file.
    """
    rows: list[dict[str, Any]] = []
    with tempfile.TemporaryDirectory(prefix="freeart21-") as folder:
        urdf = Path(folder) / "pendulum.urdf"
        write_joint_asset(urdf, JointNumbers("pendulum", MASS, LENGTH, INERTIA))
        asset = read_asset(urdf)
        for rate, smooth, interpolation in CASES:
            verdicts = [find_gap(asset, make_measured(seed, rate, smooth, interpolation)) for seed in range(seeds)]
            verdict_counts = Counter(" ".join((v.verdict, *(n.effect.name for n in v.effects))) for v in verdicts)
            rows.append(
                {
                    "rate_hz": rate,
                    "smooth": smooth,
                    "interpolation": interpolation,
                    "cases": seeds,
                    "verdicts": dict(verdict_counts),
                }
            )
            print(rows[-1], flush=True)
    head = ("rows a second", "command between them", "given", "verdicts")
    cells = [
        (
            row["rate_hz"],
            "smooth" if row["smooth"] else "held",
            row["interpolation"],
            ", ".join(f"{count} {what}" for what, count in row["verdicts"].items()),
        )
        for row in rows
    ]
    Console(width=120).print(make_table("", head, cells, texts=head[1:]))
    write_report(out, {"seeds": seeds}, rows=rows)


def make_measured(seed: int, rate: int, smooth: bool, interpolation: Interpolation) -> Measured:
    """Runs of one draw, the last two held out; the asset is off within tolerance, the encoder has 1.5 mrad steps."""
    rng = np.random.default_rng([seed, rate])
    inertia, weight = INERTIA * rng.uniform(0.9, 1.1), MASS * G * LENGTH * rng.uniform(0.95, 1.05)
    times, every = np.arange(round(SECONDS * rate)) / rate, FINE // rate
    runs = []
    for k in range(RUNS):
        clock = np.arange(len(times) * every) / FINE
        command = np.zeros(len(clock))
        for _ in range(3):
            size, hertz, phase = rng.uniform(0.1, 0.4), rng.uniform(0.2, 1.8), rng.uniform(0, 6)
            command += size * np.sin(2 * np.pi * hertz * clock + phase)
        acting = command if smooth else np.repeat(command[::every], every)
        q = _integrate(command[0], acting, inertia, weight)[::every] + rng.normal(0, 5e-4, len(times))
        runs.append(
            Run(f"run_{k}", times, 1.5e-3 * np.round(q / 1.5e-3), None, command[::every], held_out=k >= RUNS - 2)
        )
    gravity, law = np.array([0, 0, -G]), Actuator(None, *SERVO)
    return Measured("hinge", "revolute", gravity, rate, "recorded", None, law, 0.1, 0.05, tuple(runs), interpolation)


@njit(cache=True)
def _integrate(q: float, command: Array, inertia: float, weight: float) -> Array:  # pragma: no cover
    """(n,) positions from rest, by the leapfrog."""
    out, v, h = np.empty(len(command)), 0.0, 1 / FINE
    for i in range(len(command)):
        out[i] = q
        q += 0.5 * h * v
        v += h * (SERVO[0] * (command[i] - q) - SERVO[1] * v - weight * np.sin(q)) / inertia
        q += 0.5 * h * v
    return out


if __name__ == "__main__":
    run_cli(main)
