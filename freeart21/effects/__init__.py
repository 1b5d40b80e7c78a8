"""The effect library: every physical effect the product knows by name."""

from __future__ import annotations

from typing import Any

from freeart21.effects.base import Effect
from freeart21.effects.coulomb_friction import CoulombFriction
from freeart21.effects.return_spring import ReturnSpring
from freeart21.effects.viscous_damping import ViscousDamping
from freeart21.errors import FreeArtError
from freeart21.joint import JointType

EFFECTS: dict[str, type[Effect]] = {cls.name: cls for cls in (ViscousDamping, CoulombFriction, ReturnSpring)}


def effect_from_json(data: Any, joint_type: JointType, where: str) -> Effect:
    """The effect of one effects.json entry; FreeArtError names `where` and lists the known effects."""
    name = data.get("effect") if isinstance(data, dict) else None
    if name not in EFFECTS:
        raise FreeArtError(f"{where}: unknown effect '{name}'; effects: {', '.join(sorted(EFFECTS))}")
    return EFFECTS[name].from_json(data, joint_type, where)


def effects_from_urdf_dynamics(damping: float, friction: float) -> tuple[Effect, ...]:
    """The meaning of URDF `<dynamics>`: viscous damping (N*m*s/rad or N*s/m) and Coulomb friction (N*m or N)."""
    effects: list[Effect] = []
    if damping:
        effects.append(ViscousDamping(damping))
    if friction:
        effects.append(CoulombFriction(friction))
    return tuple(effects)
