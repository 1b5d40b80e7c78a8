"""Two rigid parts and the joint between them."""

from __future__ import annotations

from dataclasses import dataclass

from numpy.typing import ArrayLike

from freeart21.joint import Joint
from freeart21.mesh import Mesh
from freeart21.se3 import Array

PARTS: tuple[str, str] = ("reference", "moving")
"""Part names in the order of part masks: pixel value 1 is the reference part, 2 the moving part, 0 neither."""


@dataclass(frozen=True)
class Articulation:
    """An articulated object of two parts in its canonical frame: the frame of the reference part.

    Both meshes are given at state zero, so that the moving part at state q is `moving` mapped by `joint.transform(q)`.
    """

    joint: Joint
    reference: Mesh
    moving: Mesh

    def part(self, name: str) -> Mesh:
        """The mesh of 'reference' or 'moving', at state zero."""
        return {"reference": self.reference, "moving": self.moving}[name]

    def moved(self, T_new_canonical: ArrayLike) -> Articulation:
        """The same object written in another canonical frame."""
        return Articulation(
            self.joint.moved(T_new_canonical), self.reference.moved(T_new_canonical), self.moving.moved(T_new_canonical)
        )

    def posed(self, T_camera_reference: Array, q: float) -> tuple[Mesh, Mesh]:
        """Reference and moving mesh in the camera frame, for the reference pose (4, 4) and the joint state `q`."""
        T_camera_moving = T_camera_reference @ self.joint.transform(q)
        return self.reference.moved(T_camera_reference), self.moving.moved(T_camera_moving)
