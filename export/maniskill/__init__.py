"""Articulated objects as ManiSkill environments: `gymnasium.make("export.maniskill:FreeArt21-Open-v1")`.

The extra `freeart21[maniskill]` is imported by the first `make`, which names it where it is missing. Modules with an
underscore define subclasses of ManiSkill's classes, and import it.
"""

from __future__ import annotations

import importlib
import importlib.util
from functools import partial
from typing import Any

from freeart21.errors import FreeArtError

ENVIRONMENTS = ("FreeArt21-Open-v1", "FreeArt21-FreeMoving-v1")
EPISODE_STEPS = 200
"""Control steps of an episode: 10 s."""
CONTROL_HZ = 20
"""Default of the environments."""


def _make(uid: str, **settings: Any) -> Any:
    """The environment that ManiSkill makes of its registered class; FreeArtError when ManiSkill is not installed."""
    if importlib.util.find_spec("mani_skill") is None:
        raise FreeArtError("ManiSkill is not installed: pip install 'freeart21[maniskill]'")
    importlib.import_module("export.maniskill._environments")
    return importlib.import_module("mani_skill.utils.registration").make(uid, **settings)


def _register() -> None:
    """Register the environments with gymnasium as ManiSkill does its own, without an import of it."""
    from gymnasium.envs import registration

    limit = {"max_episode_steps": EPISODE_STEPS}
    wrapper = registration.WrapperSpec("MSTimeLimit", "mani_skill.utils.registration:TimeLimitWrapper", limit)
    for uid in ENVIRONMENTS:
        registration.register(
            uid,
            entry_point=partial(_make, uid),
            disable_env_checker=True,  # it cannot compare ManiSkill's tensors
            additional_wrappers=(wrapper,),
            **limit,
        )


if importlib.util.find_spec("gymnasium") is not None:
    _register()
