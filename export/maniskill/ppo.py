"""A PPO baseline for the pusher, by stable-baselines3 (`freeart21[ppo]`), on a CPU."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from export.maniskill import CONTROL_HZ, ENVIRONMENTS
from freeart21.errors import FreeArtError


@dataclass(frozen=True)
class PushTask:
    """What the ball is to do with a joint, in its own frame; see `_joint_frame.JointFrame`."""

    start: float = 0.8
    """Share of the joint's way at which an episode begins; 0 is shut."""
    target: float = 0.0
    """Share to come to rest at."""
    friction: float | None = None
    """Coulomb friction, N*m or N, in place of the asset's effects."""
    episode_steps: int = 100
    """Control steps of an episode, at 20 Hz."""
    sim_hz: int = 100
    """Physics steps a second: a fifth of the environment's own, for speed."""


@dataclass(frozen=True)
class PpoSettings:
    """PPO (Schulman et al. 2017), as stable-baselines3 has it."""

    steps: int = 8000
    """Control steps to train for."""
    seed: int = 0
    rollout: int = 400
    """Control steps between updates."""
    learning_rate: float = 2e-3
    gamma: float = 0.95
    """Discount a control step: a horizon of a second."""


@dataclass(frozen=True)
class Success:
    """What a policy did with an asset."""

    share: float
    """Of the episodes that came to rest at the target."""
    joint_error: float
    """Mean distance from the target at an episode's end, in spans."""
    steps: float
    """Mean control steps of an episode."""


def make_task(asset: str | Path, task: PushTask, training: bool = False, joint: str | None = None) -> Any:
    """The task with an asset, as a gymnasium environment of numpy arrays; in `training` success does not end it."""
    import gymnasium

    from export.maniskill._joint_frame import JointFrame

    settings = {"obs_mode": "state", "reward_mode": "dense", "sim_backend": "cpu", "render_backend": "none"}
    env = gymnasium.make(
        ENVIRONMENTS[0],
        asset=str(asset),
        joint=joint,
        robot_uids="pusher",
        max_episode_steps=task.episode_steps,
        sim_config={"sim_freq": task.sim_hz, "control_freq": CONTROL_HZ},
        **settings,
    )
    return JointFrame(env, task.start, task.target, task.friction, ignore_terminations=training)


def train(asset: str | Path, task: PushTask, settings: PpoSettings, joint: str | None = None) -> Any:
    """stable-baselines3's PPO, trained with an asset. Raises FreeArtError where it is not installed."""
    try:
        import stable_baselines3
    except ImportError as error:
        raise FreeArtError("stable-baselines3 is not installed: pip install 'freeart21[ppo]'") from error
    env = make_task(asset, task, True, joint)
    policy = stable_baselines3.PPO(
        "MlpPolicy",
        env,
        n_steps=settings.rollout,
        batch_size=100,
        learning_rate=settings.learning_rate,
        gamma=settings.gamma,
        seed=settings.seed,
        policy_kwargs={"log_std_init": -0.5},
        device="cpu",
    )
    policy.learn(settings.steps)
    env.close()
    return policy


def run(policy: Any, asset: str | Path, task: PushTask, episodes: int, joint: str | None = None) -> Success:
    """What `policy`, its most likely actions, does with an asset in episodes of seeds from 1000 on."""
    env = make_task(asset, task, joint=joint)
    rows = []
    for seed in range(1000, 1000 + episodes):
        obs, _ = env.reset(seed=seed)
        done, steps = False, 0
        while not done:
            obs, _, ended, cut, info = env.step(policy.predict(obs, deterministic=True)[0])
            done, steps = bool(ended or cut), steps + 1
        rows.append((float(info["success"]), float(info["joint_error"]), steps))
    env.close()
    return Success(*np.mean(rows, axis=0).tolist())
