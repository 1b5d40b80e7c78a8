"""Solids by constructive geometry: bevelled boxes, rods, plates and what can be cut out of them. Metres, z up."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Literal

import numpy as np
from manifold3d import CrossSection, JoinType, Manifold, OpType, set_circular_segments
from numpy.typing import ArrayLike, NDArray

from freeart21.se3 import Array

Axis = Literal["x", "y", "z"]

_TURN: dict[str, tuple[float, float, float]] = {"x": (90.0, 0.0, 90.0), "y": (90.0, 0.0, 0.0), "z": (0.0, 0.0, 0.0)}

set_circular_segments(48)


def box(size: ArrayLike, centre: ArrayLike = (0, 0, 0), bevel: float = 0.0) -> Manifold:
    """A box of `size` (3,) about `centre` (3,), its edges cut at 45 degrees by `bevel` metres."""
    size = np.asarray(size, float)
    if bevel <= 0:
        return Manifold.cube(tuple(size), True).translate(tuple(np.asarray(centre, float)))
    slabs = [Manifold.cube(tuple(size - 2 * bevel * (np.arange(3) != k)), True) for k in range(3)]
    return Manifold.batch_hull(slabs).translate(tuple(np.asarray(centre, float)))


def round_box(size: ArrayLike, radius: float, centre: ArrayLike = (0, 0, 0), segments: int = 20) -> Manifold:
    """A box of `size` (3,) with all edges and corners rounded to `radius`."""
    half = np.asarray(size, float) / 2 - radius
    ball = Manifold.sphere(radius, segments)
    corners = [
        ball.translate((sx * half[0], sy * half[1], sz * half[2])) for sx in (-1, 1) for sy in (-1, 1) for sz in (-1, 1)
    ]
    return Manifold.batch_hull(corners).translate(tuple(np.asarray(centre, float)))


def rod(
    radius: float, length: float, axis: Axis, centre: ArrayLike = (0, 0, 0), bevel: float = 0.0, segments: int = 48
) -> Manifold:
    """A cylinder about `centre` along `axis`, its rims cut at 45 degrees by `bevel` metres."""
    solid = Manifold.cylinder(length, radius - bevel, radius - bevel, segments, True)
    if bevel > 0:
        solid = Manifold.batch_hull([solid, Manifold.cylinder(length - 2 * bevel, radius, radius, segments, True)])
    return turned(solid, axis).translate(tuple(np.asarray(centre, float)))


def plate(outline: CrossSection, thickness: float, axis: Axis, at: float = 0.0, bevel: float = 0.0) -> Manifold:
    """A convex `outline` made a plate of `thickness`, centred at `at` on `axis`; its rims are cut by `bevel` metres.

    The outline's (u, v) become (x, y) for axis z, (y, z) for axis x and (x, z) for axis y.
    """
    solid = Manifold.extrude(outline, thickness).translate((0, 0, -thickness / 2))
    if bevel > 0:
        inner = Manifold.extrude(outline.offset(-bevel, JoinType.Miter), thickness).translate((0, 0, -thickness / 2))
        outer = Manifold.extrude(outline, thickness - 2 * bevel).translate((0, 0, -thickness / 2 + bevel))
        solid = Manifold.batch_hull([inner, outer])
    return turned(solid, axis).translate(tuple(at * (np.array(["x", "y", "z"]) == axis)))


def turned(solid: Manifold, axis: Axis) -> Manifold:
    """A solid made along z, turned so that its (x, y, z) become (y, z, x) for axis x, (x, z, -y) for axis y."""
    return solid.rotate(_TURN[axis])


def rounded_outline(width: float, height: float, radius: float, segments: int = 32) -> CrossSection:
    """A rectangle about the origin with rounded corners."""
    inner = CrossSection.square((width - 2 * radius, height - 2 * radius), True)
    return inner.offset(radius, JoinType.Round, circular_segments=segments)


def polygon(points: ArrayLike) -> CrossSection:
    """The outline through `points` (n, 2), counter-clockwise."""
    return CrossSection([np.asarray(points, float)])


def union(solids: Iterable[Manifold]) -> Manifold:
    """All solids as one."""
    return Manifold.batch_boolean(list(solids), OpType.Add)


def tilted(solid: Manifold, axis: Axis, angle: float, about: ArrayLike) -> Manifold:
    """The solid turned by `angle` radians about `axis` through the point `about` (3,)."""
    at = np.asarray(about, float)
    degrees = np.degrees(angle) * (np.array(["x", "y", "z"]) == axis)
    return solid.translate(tuple(-at)).rotate(tuple(degrees)).translate(tuple(at))


def triangles(solid: Manifold) -> tuple[Array, NDArray[np.int64]]:
    """Vertices (V, 3), metres, and faces (F, 3), counter-clockwise from outside."""
    mesh = solid.to_mesh64() if hasattr(solid, "to_mesh64") else solid.to_mesh()
    return np.array(mesh.vert_properties[:, :3], float), np.array(mesh.tri_verts, np.int64)
