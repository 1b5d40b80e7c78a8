"""The effect library: every physical effect that the product knows by name, one module with one class each."""

from __future__ import annotations

from typing import Any

from freeart21.effects.base import AssetError, Effect, perpendiculars, readings
from freeart21.effects.coulomb_friction import CoulombFriction
from freeart21.effects.gravity_offset import GravityOffset
from freeart21.effects.return_spring import ReturnSpring
from freeart21.effects.viscous_damping import ViscousDamping
from freeart21.errors import FreeArtError
from freeart21.joint import JointType
from freeart21.registry import find_classes

__all__ = [
    "ASSET_ERRORS",
    "EFFECTS",
    "AssetError",
    "CoulombFriction",
    "Effect",
    "ReturnSpring",
    "ViscousDamping",
    "effect_from_json",
    "effects_from_urdf_dynamics",
    "gravity_change",
    "perpendiculars",
    "readings",
]


ASSET_ERRORS: dict[str, type[AssetError]] = find_classes(__name__, AssetError)
"""Name to class of what an asset's own files may be wrong about."""
EFFECTS: dict[str, type[Effect]] = {n: c for n, c in find_classes(__name__, Effect).items() if n not in ASSET_ERRORS}
"""Name to class of all others: the modules of this folder, and entry points of others (`freeart21.registry`)."""


def effect_from_json(data: Any, joint_type: JointType, where: str) -> Effect:
    """The effect of one effects.json entry; FreeArtError names `where` and lists the known effects."""
    name = data.get("effect") if isinstance(data, dict) else None
    if not isinstance(name, str) or name not in EFFECTS:
        raise FreeArtError(f"{where}: unknown effect '{name}'; effects: {', '.join(sorted(EFFECTS))}")
    return EFFECTS[name].from_json(data, joint_type, where)


def gravity_change(cosine: float, sine: float, constant: float) -> Effect:
    """A change of gravity's force: of cos q and sin q of a hinge, N*m, or the constant of a slider, N."""
    return GravityOffset(cosine, sine, constant)


def effects_from_urdf_dynamics(damping: float, friction: float) -> tuple[Effect, ...]:
    """The meaning of URDF `<dynamics>`: viscous damping (N*m*s/rad or N*s/m) and Coulomb friction (N*m or N)."""
    effects: list[Effect] = []
    if damping:
        effects.append(ViscousDamping(damping))
    if friction:
        effects.append(CoulombFriction(friction))
    return tuple(effects)
