"""Data types of a procedural object: links that consist of pieces, each of one material."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from manifold3d import Manifold
from numpy.typing import NDArray

from freeart21.joint import JointType

Point = tuple[float, float, float]
"""Metres, in the object's frame."""
Rng = np.random.Generator
Finish = Literal["plastic", "metal", "wood", "rubber", "paper"]

ABS, STEEL, BRASS = 1050.0, 7850.0, 8500.0
"""Densities, kg/m^3."""
SHINE: dict[str, tuple[float, float]] = {
    "plastic": (0.25, 60.0),
    "metal": (0.55, 120.0),
    "wood": (0.08, 20.0),
    "rubber": (0.03, 8.0),
    "paper": (0.02, 4.0),
}
"""Finish to specular strength (MTL Ks) and exponent (MTL Ns)."""


@dataclass(frozen=True)
class Material:
    """Appearance and density of a piece."""

    name: str
    colour: tuple[float, float, float]
    """sRGB, 0 to 1; not used with a texture."""
    finish: Finish
    density: float
    """kg/m^3."""
    texture: NDArray[np.uint8] | None = None
    """(h, w, 3) RGB, or None for a plain colour."""
    tile_m: float | None = None
    """Metres that one repeat of the texture covers; None fits it once to the piece's bounding box."""


def textured(
    name: str, finish: Finish, density: float, texture: NDArray[np.uint8], tile_m: float | None = None
) -> Material:
    """A material that shows a texture, every `tile_m` metres or once over its piece; density in kg/m^3."""
    return Material(name, (1, 1, 1), finish, density, texture, tile_m)


def printed(name: str, texture: NDArray[np.uint8]) -> Material:
    """A printed paper label of 900 kg/m^3."""
    return textured(name, "paper", 900.0, texture)


@dataclass(frozen=True)
class Piece:
    """One solid of one material, in the object's frame (z up, metres) with all joints at zero."""

    name: str
    solid: Manifold
    material: Material


Pieces = tuple[Piece, ...]


@dataclass(frozen=True)
class Hinge:
    """The joint that carries a link."""

    type: JointType
    parent: str
    """Name of the parent link."""
    axis: tuple[float, float, float]
    """In the object's frame."""
    pivot: tuple[float, float, float]
    """Metres, in the object's frame."""
    lower: float
    upper: float
    """Limits, rad or m."""


@dataclass(frozen=True)
class Link:
    """A rigid part."""

    semantic: str
    """PartNet-Mobility's name for such a part, for example 'rotation_lid'."""
    pieces: tuple[Piece, ...]
    hinge: Hinge | None = None
    """None for the root link."""

    @property
    def mass(self) -> float:
        """kg, from the materials' densities."""
        return float(sum(piece.solid.volume() * piece.material.density for piece in self.pieces))


@dataclass(frozen=True)
class ObjectModel:
    """A procedural object. Links are 'link_0', 'link_1', ... and the joint of link_k is 'joint_k'; the root is last."""

    name: str
    category: str
    """A PartNet-Mobility category, such as 'Stapler'."""
    links: tuple[Link, ...]
    scored_joint: int
    """Index of the joint that is recorded; the others stay at zero."""
    seed: int

    @property
    def diagonal(self) -> float:
        """Diagonal of the axis-aligned bounding box of all solids, joints at zero, metres."""
        boxes = np.array([piece.solid.bounding_box() for link in self.links for piece in link.pieces])
        return float(np.linalg.norm(boxes[:, 3:].max(0) - boxes[:, :3].min(0)))

    def scaled(self, factor: float) -> ObjectModel:
        """The object scaled by `factor`, materials unchanged: solids, pivots, slides and texture tiles."""
        return replace(self, links=tuple(_scaled_link(link, factor) for link in self.links))


def _scaled_link(link: Link, factor: float) -> Link:
    pieces = tuple(
        replace(
            piece,
            solid=piece.solid.scale((factor, factor, factor)),
            material=replace(
                piece.material, tile_m=None if piece.material.tile_m is None else factor * piece.material.tile_m
            ),
        )
        for piece in link.pieces
    )
    hinge = link.hinge
    if hinge is None:
        return replace(link, pieces=pieces)
    x, y, z = hinge.pivot
    slide = factor if hinge.type == "prismatic" else 1.0
    scaled = replace(
        hinge, pivot=(factor * x, factor * y, factor * z), lower=slide * hinge.lower, upper=slide * hinge.upper
    )
    return replace(link, pieces=pieces, hinge=scaled)
