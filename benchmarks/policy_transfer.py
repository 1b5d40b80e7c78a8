"""How good an asset is to learn on: a pusher's policy trained on an answer's asset, and run on the truth's.

    python -m benchmarks.policy_transfer --settings.answers DIR --settings.objects drawer_unit --settings.seeds 3

DIR/NAME, or DIR/NAME-s0, is the exported asset of the catalog's object NAME. A ball is to push the joint from 80 % open
to shut, which PPO learns (`export.maniskill.ppo`). Compared with a policy trained and run on the truth's asset, by the
same settings and seeds. Both joints have the same Coulomb friction, which holds the part wherever it stands: neither
gravity nor a push that is let go shuts it.
"""

from __future__ import annotations

import time
from dataclasses import asdict, dataclass, field
from pathlib import Path

import numpy as np

from benchmarks.common import RESULTS, digest_of, make_table, run_cli, wide_console, write_report
from export.maniskill.assets import find_asset
from export.maniskill.ppo import PpoSettings, PushTask, run, train
from freeart21.errors import FreeArtError
from generator.simulate import load

HOLDING = 1.5
"""Friction over the largest force of gravity on the joint, set by hand: it holds wherever it is left."""
LEAST = 0.1
"""Least friction over the part's weight, times its lever on a hinge: what nothing pulls at is not free of it either."""


@dataclass(frozen=True)
class Settings:
    """What is run."""

    answers: Path
    """Folder of the answers' assets."""
    objects: tuple[str, ...] = ("drawer_unit", "stapler")
    seeds: int = 1
    """Policies trained on each asset."""
    episodes: int = 5
    """Episodes that each policy is run for, on each asset."""
    ppo: PpoSettings = field(default_factory=PpoSettings)
    task: PushTask = field(default_factory=PushTask)
    out: Path = RESULTS / "policy_transfer.json"


def main(settings: Settings) -> None:
    """Train on each asset, run on both, write the report after each policy."""
    rows: list[dict[str, object]] = []
    for name in settings.objects:
        answer = next((path for end in ("", "-s0") if (path := settings.answers / f"{name}{end}").is_dir()), None)
        if answer is None:
            raise FreeArtError(f"{settings.answers} has no asset of {name}, expected {name} or {name}-s0")
        friction = holding_friction(name)
        task = PushTask(**{**asdict(settings.task), "friction": friction})
        key = digest_of(files=[find_asset(answer).urdf])[:12]
        assets = {"truth": name, "answer": answer}
        for seed in range(settings.seeds):
            for trained_on, asset in assets.items():
                start_s = time.process_time()
                policy = train(asset, task, PpoSettings(**{**asdict(settings.ppo), "seed": seed}))
                spent = time.process_time() - start_s
                for run_on, other in assets.items():
                    result = asdict(run(policy, other, task, settings.episodes))
                    what = {"object": name, "seed": seed, "trained_on": trained_on, "run_on": run_on}
                    rows.append(
                        {**what, **result, "training_cpu_s": round(spent, 1), "friction": friction, "answer": key}
                    )
                stated = {**asdict(settings), "answers": settings.answers.name, "out": None}
                write_report(settings.out, stated, rows=rows)
    head = ("object", "trained on", "run on", "success", "error, spans", "steps")
    table = []
    for name in settings.objects:
        for trained_on in ("truth", "answer"):
            for run_on in ("truth", "answer"):
                which = {"object": name, "trained_on": trained_on, "run_on": run_on}
                these = [row for row in rows if which.items() <= row.items()]
                columns = ("share", "joint_error", "steps")
                share, error, steps = (np.mean([float(str(row[what])) for row in these]) for what in columns)
                table.append((name, trained_on, run_on, f"{share:.2f}", f"{error:.3f}", f"{steps:.0f}"))
    wide_console().print(make_table("Policies", head, table, texts=("trained on", "run on")))


def holding_friction(name: str) -> float:
    """Coulomb friction, N*m or N, that holds the moving part of a catalog object at any position."""
    simulated = load(find_asset(name))
    mechanics = simulated.mechanics
    low, high = (np.clip(end, -np.pi, np.pi) for end in (simulated.lower, simulated.upper))
    pull = float(np.abs(mechanics.gravity_force(np.linspace(low, high, 50))).max())
    lever = mechanics.mass
    if mechanics.joint.type == "revolute":
        arm = mechanics.moment_zero - mechanics.mass * mechanics.joint.pivot
        lever = float(np.linalg.norm(np.cross(mechanics.joint.axis, arm)))
    return max(HOLDING * pull, LEAST * 9.81 * lever)


if __name__ == "__main__":
    run_cli(main)
