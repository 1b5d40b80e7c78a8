"""What gymnasium asks of an environment and ManiSkill's wrappers leave out: to be made again by its `spec`, and data
that are not batched."""

from __future__ import annotations

import os
import sys
from collections.abc import Callable
from copy import deepcopy
from typing import Any

import gymnasium
import torch
from gymnasium.envs.registration import EnvSpec, WrapperSpec
from gymnasium.utils import RecordConstructorArgs
from mani_skill.utils.registration import register_env
from mani_skill.utils.wrappers.gymnasium import CPUGymWrapper


class StepLimit(gymnasium.Wrapper, RecordConstructorArgs):
    """Takes the place of gymnasium's `TimeLimit`, with ManiSkill's truncation, a tensor of (1,).

    ManiSkill's own wrapper does so by looking at who calls it, and cannot be made again. This one has no arguments: its
    limit is that of the `TimeLimit` that `gymnasium.make` put there, or none.
    """

    def __init__(self, env: Any):
        limited = isinstance(env, gymnasium.wrappers.TimeLimit)
        RecordConstructorArgs.__init__(self)
        gymnasium.Wrapper.__init__(self, env.env if limited else env)
        self._max_episode_steps = env._max_episode_steps if limited else None  # ManiSkill looks for this name

    @property
    def spec(self) -> EnvSpec | None:
        """As any wrapper's, with the limit."""
        found = super().spec
        if found is not None and found.max_episode_steps != self._max_episode_steps:
            found = deepcopy(found)
            found.max_episode_steps = self._max_episode_steps
        return found

    def step(self, action: Any) -> Any:
        """The step, truncated once its number reaches the limit."""
        obs, reward, terminated, _, info = self.env.step(action)
        steps = self.unwrapped.elapsed_steps
        if self._max_episode_steps is None:
            return obs, reward, terminated, torch.zeros_like(steps, dtype=torch.bool), info
        return obs, reward, terminated, steps >= self._max_episode_steps, info


class GymnasiumWrapper(CPUGymWrapper, RecordConstructorArgs):
    """ManiSkill's `CPUGymWrapper`, numpy arrays without a batch, which `gymnasium.make(env.spec)` can make again."""

    def __init__(self, env: Any, ignore_terminations: bool = False, record_metrics: bool = False):
        told = {"ignore_terminations": ignore_terminations, "record_metrics": record_metrics}
        RecordConstructorArgs.__init__(self, **told)
        CPUGymWrapper.__init__(self, env, **told)


def registered(uid: str, max_episode_steps: int) -> Callable[[type], type]:
    """ManiSkill's registration of an environment, with `StepLimit` for its wrapper."""

    def register(cls: type) -> type:
        cls = register_env(uid, max_episode_steps=max_episode_steps)(cls)
        wrapper = WrapperSpec("StepLimit", f"{StepLimit.__module__}:{StepLimit.__name__}", {})
        gymnasium.registry[uid].additional_wrappers = (wrapper,)
        return cls

    return register


def render_modes(modes: tuple[str, ...], can_render: bool) -> list[str]:
    """Those of `modes` that work here: none without a renderer, and no window where there is no screen."""
    screen = sys.platform in ("darwin", "win32") or any(os.environ.get(k) for k in ("DISPLAY", "WAYLAND_DISPLAY"))
    return [mode for mode in modes if can_render and (mode != "human" or screen)]
