"""What a URDF or MJCF file is written from: two links, one joint, in metres, seconds, kilograms."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, get_args

from export.inertia import Inertial
from export.primitives import Primitive
from freeart21.effects.base import Effect
from freeart21.joint import Joint
from freeart21.reconstruction import Trust

Base = Literal["free", "fixed"]
BASES = get_args(Base)
WORLD = "world"
"""The link that a fixed base hangs on: MuJoCo, Drake and PyBullet take a root link of this name for the world
itself."""


@dataclass(frozen=True)
class LinkModel:
    """One rigid part: its files, relative to the asset folder, are in the frame of its link."""

    name: str
    visual: str
    """OBJ file to look at."""
    texture: str | None
    """PNG file that the visual mesh wears, or None when it has no colours."""
    hulls: tuple[str, ...]
    """OBJ files to collide with, each convex."""
    inertial: Inertial
    primitives: tuple[Primitive, ...] = ()
    """Shapes to collide with beside the hulls."""


@dataclass(frozen=True)
class AssetModel:
    """The whole asset, a tree of two links."""

    name: str
    root: LinkModel
    """Stands on the ground, or is nailed to the world."""
    child: LinkModel
    """Its frame stands at the pivot."""
    joint: Joint
    """In the root link's frame, with finite limits."""
    effort: float
    """Largest actuator force, N*m or N."""
    velocity: float
    """Largest speed, rad/s or m/s."""
    effects: tuple[Effect, ...] = ()
    """What acts on the joint; URDF and MJCF say as much of it as they can."""
    base: Base = "free"
    """Whether the root link moves freely or stands still in the world."""
    trust: Trust | None = None
    """Whether the reconstruction trusts itself; None when that is not stated."""


def number_text(*values: float) -> str:
    """Numbers with spaces between, each with the fewest digits that give it back exactly."""
    return " ".join(repr(float(value) + 0.0) for value in values)
