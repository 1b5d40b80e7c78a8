"""Find what a simulation lacks: `python examples/find_gap.py OUT`, after export_and_step.py with the same OUT.

The runs are made here, by the asset itself with a damping that `find_gap` does not know.
"""

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np

from freeart21.effects import ViscousDamping
from freeart21.files.asset import read_asset
from freeart21.measured import Measured, Run
from generator.simulate import load, roll_out
from simgap.verdict import Verdict
from simgap.workflow import find_gap


def main(out: Path) -> Verdict:
    """Push the joint of the exported asset four times, without weight; ask what the runs tell."""
    asset = read_asset(next((out / "results" / "ours").glob("*/asset")), guesses=False)  # the exporter's damping
    joint, runs = load(asset), []
    hidden = ViscousDamping(4.0 * joint.joint_inertia)  # N m s/rad: a push dies away in a quarter of a second
    real = load(replace(asset, effects={asset.joint: (hidden,)}), gravity=(0.0, 0.0, 0.0))
    for i, (start, push) in enumerate([(0.1, 2.0), (0.9, -2.5), (0.2, 2.2), (0.8, -1.8)]):  # parts of the range, 1/s
        span = joint.upper - joint.lower
        moved = roll_out(real, joint.lower + start * span, push * span, duration_s=1.0)
        runs.append(Run(f"run_{i}", moved.times_s[::10], moved.q_measured[::10], held_out=i == 3))
    measured = Measured(asset.joint, "revolute", np.zeros(3), 100.0, "recorded", runs=tuple(runs))
    verdict = find_gap(asset, measured)
    print(f"{hidden} was hidden: {verdict.verdict}. {verdict.sentence}")
    return verdict


if __name__ == "__main__":
    main(Path(sys.argv[1]))
