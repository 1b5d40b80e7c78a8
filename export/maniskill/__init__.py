"""Articulated objects as ManiSkill environments: `import export.maniskill`, then `gym.make("FreeArt21-Open-v1")`.

Needs the extra `freeart21[maniskill]`; without it nothing is registered, and `register` names what to install. Modules
with an underscore define subclasses of ManiSkill's classes, and import it.
"""

from __future__ import annotations

import importlib
import importlib.util

from freeart21.errors import FreeArtError

__all__ = ["ENVIRONMENTS", "register"]

ENVIRONMENTS = ("FreeArt21-Open-v1", "FreeArt21-FreeMoving-v1")


def register() -> tuple[str, ...]:
    """Register the environments with gymnasium and ManiSkill; returns their names.

    Raises FreeArtError when ManiSkill is not installed.
    """
    if importlib.util.find_spec("mani_skill") is None:
        raise FreeArtError("ManiSkill is not installed: pip install 'freeart21[maniskill]'")
    importlib.import_module("export.maniskill._environments")
    return ENVIRONMENTS


if importlib.util.find_spec("mani_skill") is not None:
    register()
    from export.maniskill._gymnasium import GymnasiumWrapper as GymnasiumWrapper
