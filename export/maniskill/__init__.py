"""Articulated objects as ManiSkill environments: `import export.maniskill`, then `gym.make("FreeArt21-Open-v1")`.

Needs the extra `freeart21[maniskill]`; without it nothing is registered, and `register` says what to install. Modules
whose names begin with an underscore hold classes of ManiSkill's own kind, and import it.
"""

from __future__ import annotations

import importlib
import importlib.util

from freeart21.errors import FreeArtError

__all__ = ["ENVIRONMENTS", "register"]

ENVIRONMENTS = ("FreeArt21-Open-v1", "FreeArt21-FreeMoving-v1")


def register() -> tuple[str, ...]:
    """Make the environments known to gymnasium and ManiSkill; gives their names.

    Raises FreeArtError when ManiSkill is not installed.
    """
    if importlib.util.find_spec("mani_skill") is None:
        raise FreeArtError("ManiSkill is not installed: pip install 'freeart21[maniskill]'")
    importlib.import_module("export.maniskill._environments")
    return ENVIRONMENTS


if importlib.util.find_spec("mani_skill") is not None:
    register()
    from export.maniskill._gymnasium import GymnasiumWrapper as GymnasiumWrapper
