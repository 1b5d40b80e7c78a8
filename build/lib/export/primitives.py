"""Collision shapes that engines know by name: cheaper and rounder than hulls."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import trimesh
from numpy.typing import NDArray

from freeart21.mesh import Mesh
from freeart21.se3 import Array

_SIDES = 48
"""Of the prism that stands for a cylinder where only meshes are taken: 0.2 % of the radius inside it."""


@dataclass(frozen=True)
class Box:
    """A box with its middle at its own frame's origin."""

    size: NDArray[np.float64]
    """(3,) full sides, m."""
    T_link_shape: Array
    """(4, 4) the box's frame in its link's."""

    def mesh(self) -> Mesh:
        """Its surface in the link's frame."""
        return _mesh(trimesh.creation.box(self.size, self.T_link_shape))


@dataclass(frozen=True)
class Cylinder:
    """A cylinder along z of its own frame, its middle at the origin."""

    radius: float
    """m."""
    length: float
    """m."""
    T_link_shape: Array
    """(4, 4) the cylinder's frame in its link's."""

    def mesh(self) -> Mesh:
        """Its surface in the link's frame, a prism of many sides."""
        return _mesh(trimesh.creation.cylinder(self.radius, self.length, _SIDES, transform=self.T_link_shape))


@dataclass(frozen=True)
class Sphere:
    """A ball."""

    radius: float
    """m."""
    T_link_shape: Array
    """(4, 4) the ball's frame in its link's."""

    def mesh(self) -> Mesh:
        """Its surface in the link's frame, of 1,280 triangles."""
        ball = trimesh.creation.icosphere(3, self.radius)
        return _mesh(ball.apply_transform(self.T_link_shape))


Primitive = Box | Cylinder | Sphere
"""Shapes that URDF, MJCF and USD all have; URDF has no capsule."""


def _mesh(solid: trimesh.Trimesh) -> Mesh:
    return Mesh(solid.vertices, solid.faces)
