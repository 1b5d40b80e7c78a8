"""The data that URDF and MJCF files are written from: two links and a joint, SI units."""

from __future__ import annotations

from dataclasses import dataclass

from export.materials import Material
from export.primitives import Primitive
from export.settings import Base
from freeart21.effects.base import Effect
from freeart21.files.urdf import UrdfInertial
from freeart21.joint import Joint
from freeart21.reconstruction import Trust

WORLD = "world"
"""Name of the root link of a fixed base. MuJoCo, Drake and PyBullet take a root link of this name for the world."""


@dataclass(frozen=True)
class LinkModel:
    """One rigid part. File names are relative to the asset folder; meshes are in the link's frame."""

    name: str
    visual: str
    """OBJ file of the visual mesh."""
    texture: str | None
    """PNG file of the visual mesh's texture; None without colours."""
    hulls: tuple[str, ...]
    """OBJ files of convex collision meshes."""
    inertial: UrdfInertial
    primitives: tuple[Primitive, ...] = ()
    """Collision shapes in addition to the hulls."""
    material: Material | None = None
    """Friction and restitution of its surface; None leaves them to engines."""


@dataclass(frozen=True)
class AssetModel:
    """An asset: a tree of two links."""

    name: str
    root: LinkModel
    """The link that stands on the ground, or is fixed to the world."""
    child: LinkModel
    """The moving link; its origin is the joint's pivot."""
    joint: Joint
    """In the root link's frame, with finite limits."""
    effort: float
    """Largest actuator force, N m or N."""
    velocity: float
    """Largest speed, rad/s or m/s."""
    effects: tuple[Effect, ...] = ()
    """Effects of the joint; URDF and MJCF hold those that they can express."""
    base: Base = "free"
    """Whether the root link moves freely or is fixed to the world."""
    trust: Trust | None = None
    """Trust in the reconstruction; None when not stated."""
