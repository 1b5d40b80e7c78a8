"""Meshes of plain solids."""

from __future__ import annotations

import numpy as np
import trimesh

from freeart21 import se3
from freeart21.mesh import Mesh


def as_mesh(solid: trimesh.Trimesh) -> Mesh:
    return Mesh(solid.vertices, solid.faces)


def box(size, centre=(0.0, 0.0, 0.0), colour=None) -> Mesh:
    solid = trimesh.creation.box(size, se3.pose(np.eye(3), centre))
    colours = None if colour is None else np.tile(np.array(colour, np.uint8), (len(solid.vertices), 1))
    return Mesh(solid.vertices, solid.faces, colours)


def tray(wall: float, size=(0.2, 0.15, 0.08)) -> trimesh.Trimesh:
    """A box with walls and a floor, open above."""
    hollow = trimesh.creation.box(np.array(size) - [2 * wall, 2 * wall, 0], se3.pose(np.eye(3), (0, 0, wall)))
    return trimesh.boolean.difference([trimesh.creation.box(size), hollow])
