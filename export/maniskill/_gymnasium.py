"""Parts of gymnasium's interface that ManiSkill's wrappers lack: recreation from `spec`, and data without a batch."""

from __future__ import annotations

import os
import sys
from copy import deepcopy
from typing import Any

import gymnasium
import torch
from gymnasium.envs.registration import EnvSpec
from gymnasium.utils import RecordConstructorArgs
from mani_skill.utils.wrappers.gymnasium import CPUGymWrapper
from mani_skill.utils.wrappers.record import RecordEpisode


class StepLimit(gymnasium.Wrapper, RecordConstructorArgs):
    """Replaces gymnasium's `TimeLimit`, with ManiSkill's truncation, a tensor of (1,).

    ManiSkill's own wrapper inspects its caller and cannot be recreated. This one has no arguments: it takes the limit
    of the `TimeLimit` that `gymnasium.make` added, or none.
    """

    def __init__(self, env: Any):
        limited = isinstance(env, gymnasium.wrappers.TimeLimit)
        RecordConstructorArgs.__init__(self)
        gymnasium.Wrapper.__init__(self, env.env if limited else env)
        self._max_episode_steps = env._max_episode_steps if limited else None  # ManiSkill looks for this name

    @property
    def spec(self) -> EnvSpec | None:
        """The wrapper's spec, with the limit."""
        found = super().spec
        if found is not None and found.max_episode_steps != self._max_episode_steps:
            found = deepcopy(found)
            found.max_episode_steps = self._max_episode_steps
        return found

    def step(self, action: Any) -> Any:
        """One step, truncated once the number of steps reaches the limit."""
        obs, reward, terminated, _, info = self.env.step(action)
        steps = self.unwrapped.elapsed_steps
        if self._max_episode_steps is None:
            return obs, reward, terminated, torch.zeros_like(steps, dtype=torch.bool), info
        return obs, reward, terminated, steps >= self._max_episode_steps, info


class GymnasiumWrapper(CPUGymWrapper, RecordConstructorArgs):
    """ManiSkill's `CPUGymWrapper` (numpy arrays without a batch), which `gymnasium.make(env.spec)` can recreate."""

    def __init__(self, env: Any, ignore_terminations: bool = False, record_metrics: bool = False):
        options = {"ignore_terminations": ignore_terminations, "record_metrics": record_metrics}
        RecordConstructorArgs.__init__(self, **options)
        CPUGymWrapper.__init__(self, env, **options)


class Recorder(RecordEpisode):
    """ManiSkill's `RecordEpisode`, whose files name the environment by module, so that `replay_trajectory` finds it."""

    def __init__(self, env: Any, output_dir: Any, **options: Any):
        super().__init__(env, str(output_dir), **options)
        if self.save_trajectory:
            self._json_data["env_info"]["env_id"] = f"export.maniskill:{env.unwrapped.spec.id}"


def render_modes(modes: tuple[str, ...], can_render: bool) -> list[str]:
    """Those of `modes` that work here: none without a renderer, no window without a screen."""
    screen = sys.platform in ("darwin", "win32") or any(os.environ.get(k) for k in ("DISPLAY", "WAYLAND_DISPLAY"))
    return [mode for mode in modes if can_render and (mode != "human" or screen)]
