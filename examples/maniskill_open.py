"""Open a drawer in ManiSkill by the motor in its own joint, then hold a picture of it:
`python examples/maniskill_open.py OUT`. Needs freeart21[maniskill]."""

import sys
from pathlib import Path

import cv2
import gymnasium as gym
import numpy as np

import export.maniskill  # registers the environments


def main(out: Path, robot: str = "none") -> float:
    """Write OUT/opened.png, one picture a second. Returns how far the joint is from its target, in spans."""
    on_a_cpu = {"sim_backend": "cpu", "render_backend": "cpu", "render_mode": "rgb_array"}
    env = gym.make(export.maniskill.ENVIRONMENTS[0], asset="drawer_unit", robot_uids=robot, **on_a_cpu)
    env.reset(seed=0)
    pictures = [env.render()[0].numpy()]
    for step in range(1, 61):
        target = env.unwrapped.get_state_dict()["target"][0]
        _, reward, done, _, info = env.step(target.numpy() * min(1.0, step / 40))
        if step % 20 == 0:
            pictures.append(env.render()[0].numpy())
            print(f"step {step}: reward {reward.item():.2f}, success {bool(done)}")
    cv2.imwrite(str(out / "opened.png"), np.hstack(pictures)[..., ::-1])
    return float(info["joint_error"])


if __name__ == "__main__":
    main(Path(sys.argv[1]))
