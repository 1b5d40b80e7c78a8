"""Articulated objects as ManiSkill environments: `gymnasium.make("export.maniskill:FreeArt21-Open-v1")`.

gymnasium before 1.0 finds the plain name, too, by this package's entry point `gymnasium.envs`; later ones have dropped
that. The extra `freeart21[maniskill]` is imported by the first `make`, which names it where it is missing. Modules with
an underscore define subclasses of ManiSkill's classes, and import it.
"""

from __future__ import annotations

import importlib
import importlib.util
from functools import partial
from typing import Any

from freeart21.errors import FreeArtError

__all__ = ["ENVIRONMENTS", "register"]

ENVIRONMENTS = ("FreeArt21-Open-v1", "FreeArt21-FreeMoving-v1")
EPISODE_STEPS = 200
"""Control steps of an episode: 10 s."""
CONTROL_HZ = 20
"""Default of the environments."""


def register() -> tuple[str, ...]:
    """Register the environments with gymnasium, without an import of ManiSkill; returns their names."""
    from gymnasium.envs import registration

    limit = registration.WrapperSpec("StepLimit", "export.maniskill._gymnasium:StepLimit", {})
    for uid in ENVIRONMENTS:
        if uid not in registration.registry:
            registration.register(
                uid,
                entry_point=partial(_make, "make", uid),
                vector_entry_point=partial(_make, "make_vec", uid),
                max_episode_steps=EPISODE_STEPS,
                disable_env_checker=True,  # it cannot compare ManiSkill's tensors
                additional_wrappers=(limit,),
            )
    return ENVIRONMENTS


def _make(function: str, uid: str, **settings: Any) -> Any:
    """The environment or vector of environments that ManiSkill's `function` makes of its registered class.

    Raises FreeArtError when ManiSkill is not installed.
    """
    if importlib.util.find_spec("mani_skill") is None:
        raise FreeArtError("ManiSkill is not installed: pip install 'freeart21[maniskill]'")
    importlib.import_module("export.maniskill._environments")
    return getattr(importlib.import_module("mani_skill.utils.registration"), function)(uid, **settings)


_NEEDING_MANISKILL = {"GymnasiumWrapper": "_gymnasium", "Recorder": "_gymnasium", "PushPolicy": "_push"}


def __getattr__(name: str) -> Any:
    """`GymnasiumWrapper`, `Recorder` and `PushPolicy`, which need ManiSkill."""
    if name not in _NEEDING_MANISKILL:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(importlib.import_module(f"export.maniskill.{_NEEDING_MANISKILL[name]}"), name)


if importlib.util.find_spec("gymnasium") is not None:
    register()
