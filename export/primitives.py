"""Primitive collision shapes: faster and rounder than hulls."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import trimesh
from numpy.typing import NDArray

from freeart21.mesh import Mesh
from freeart21.se3 import Array

_SIDES = 48
"""Sides of the prism that approximates a cylinder where only meshes are taken: 0.2 % of the radius inside it."""


@dataclass(frozen=True)
class Box:
    """A box centred at its frame's origin."""

    size: NDArray[np.float64]
    """(3,) side lengths, m."""
    T_link_shape: Array
    """(4, 4) the box's frame in the link's."""

    def mesh(self) -> Mesh:
        """Its surface in the link's frame."""
        return _mesh(trimesh.creation.box(self.size, self.T_link_shape))


@dataclass(frozen=True)
class Cylinder:
    """A cylinder along z, centred at its frame's origin."""

    radius: float
    """m."""
    length: float
    """m."""
    T_link_shape: Array
    """(4, 4) the cylinder's frame in the link's."""

    def mesh(self) -> Mesh:
        """A prism in the link's frame."""
        return _mesh(trimesh.creation.cylinder(self.radius, self.length, _SIDES, transform=self.T_link_shape))


@dataclass(frozen=True)
class Sphere:
    """A sphere centred at its frame's origin."""

    radius: float
    """m."""
    T_link_shape: Array
    """(4, 4) the sphere's frame in the link's."""

    def mesh(self) -> Mesh:
        """1,280 triangles in the link's frame."""
        ball = trimesh.creation.icosphere(3, self.radius)
        return _mesh(ball.apply_transform(self.T_link_shape))


Primitive = Box | Cylinder | Sphere
"""Shapes that URDF, MJCF and USD all have; URDF has no capsule."""


def _mesh(solid: trimesh.Trimesh) -> Mesh:
    return Mesh(solid.vertices, solid.faces)
