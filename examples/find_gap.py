"""Find what a simulation lacks: `python examples/find_gap.py OUT`, after export_and_step.py with the same OUT.

What was measured is made here, by the asset itself with a damping that `find_gap` is not told of. Of a real joint it is
read from a folder: `freeart21.files.measured.read_measured`.
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


def main(out: Path) -> list[Verdict]:
    """Push the joint of every exported asset four times, its axis upright; ask what the runs tell."""
    verdicts, noise = [], np.random.default_rng(0)
    for folder in sorted((out / "results" / "ours").glob("*/asset")):
        asset = read_asset(folder)
        joint = load(asset)
        gravity = -9.81 * joint.world_joint.axis
        hidden = ViscousDamping(4.0 * joint.joint_inertia)  # N m s/rad: a push dies away in a quarter of a second
        real = load(replace(asset, effects={asset.joint: (hidden,)}), gravity=gravity)
        runs = []
        for i, (start, push) in enumerate([(0.1, 2.0), (0.9, -2.5), (0.2, 2.2), (0.8, -1.8)]):  # of the joint's range
            span = joint.upper - joint.lower
            moved = roll_out(real, joint.lower + start * span, push * span, duration_s=1.0)
            q = moved.q_measured[::10] + noise.normal(0, 1e-3 * span, len(moved.q[::10]))
            runs.append(Run(f"run_{i}", moved.times_s[::10], q, held_out=i == 3))
        gravity_canonical = asset.T_canonical_reference[:3, :3] @ gravity  # the reference link is the base: the world
        measured = Measured(asset.joint, joint.world_joint.type, gravity_canonical, 100.0, "recorded", runs=tuple(runs))
        verdicts.append(find_gap(asset, measured))
        print(f"{asset.urdf.name}, in which {hidden} was hidden: {verdicts[-1].verdict}. {verdicts[-1].sentence}")
    return verdicts


if __name__ == "__main__":
    main(Path(sys.argv[1]))
