"""Demonstrations of a ball that pushes things shut, as ManiSkill's trajectories:
`python examples/maniskill_push.py OUT [OBJECT ...]`.

Writes OUT/OBJECT.h5 and .json, which ManiSkill's `replay_trajectory` plays. Needs freeart21[maniskill]."""

import sys
from pathlib import Path

import gymnasium as gym

from export.maniskill import ENVIRONMENTS, PushPolicy, Recorder

EPISODES = 2  # of each object


def main(out: Path, objects: list[str]) -> float:
    """Share of the recorded episodes that succeeded."""
    shut = {"robot_uids": "pusher", "start": 0.8, "target": 0.0, "reward_mode": "dense"}
    good = []
    for name in objects:
        env = gym.make(ENVIRONMENTS[0], asset=name, obs_mode="state", sim_backend="cpu", render_backend="none", **shut)
        kind = {"source_type": "scripted", "source_desc": "a ball pushes a face that moves the joint"}
        env = Recorder(env, out, trajectory_name=Path(name).name, save_video=False, **kind)
        for seed in range(EPISODES):
            env.reset(seed=seed)
            policy, done = PushPolicy(env), False
            while not done:
                _, _, ended, cut, info = env.step(policy())
                done = bool(ended) or bool(cut)
            good.append(bool(info["success"]))
            print(f"{name} {seed}: success {good[-1]} after {int(info['elapsed_steps'])} steps")
        env.close()
    return sum(good) / len(good)


if __name__ == "__main__":
    main(Path(sys.argv[1]), sys.argv[2:] or ["drawer_unit"])
