"""Solids by constructive geometry: bevelled boxes, rods, plates and what can be cut out of them. Metres, z up."""

from __future__ import annotations

from collections.abc import Iterable
from itertools import pairwise
from typing import Literal

import cv2
import numpy as np
from manifold3d import CrossSection, FillRule, JoinType, Manifold, Mesh64, OpType, set_circular_segments, triangulate
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
    return turned(solid, axis).translate(_along(axis, at))


def _along(axis: str, distance: float) -> tuple[float, ...]:
    return tuple(distance * (np.array(["x", "y", "z"]) == axis))


def turned(solid: Manifold, axis: Axis) -> Manifold:
    """A solid made along z, turned so that its (x, y, z) become (y, z, x) for axis x, (x, z, -y) for axis y."""
    return solid.rotate(_TURN[axis])


def lathe(profile: ArrayLike, axis: Axis = "z", centre: ArrayLike = (0, 0, 0), segments: int = 32) -> Manifold:
    """The `profile` (n, 2) of radii and heights, counter-clockwise, turned about `axis`, its height 0 at `centre`."""
    solid = Manifold.revolve(polygon(profile), segments)
    return turned(solid, axis).translate(tuple(np.asarray(centre, float)))


def repeated(solid: Manifold, step: ArrayLike, count: int) -> Manifold:
    """`count` copies of a solid, each moved by `step` (3,) from the last, their middle where the solid is."""
    step = np.asarray(step, float)
    return union(solid.translate(tuple((k - (count - 1) / 2) * step)) for k in range(count))


def pair(solid: Manifold, axis: Axis, offset: float) -> Manifold:
    """Two copies of a solid, moved by `offset` against and along `axis`."""
    return union(solid.translate(_along(axis, sign * offset)) for sign in (-1, 1))


def corners(solid: Manifold, axes: Literal["xy", "xz", "yz"], first: float, second: float) -> Manifold:
    """Four copies of a solid, moved by `first` and `second` against and along the two `axes`."""
    one, other = axes
    moved = [solid.translate(_along(one, sign * first)) for sign in (-1, 1)]
    return union(copy.translate(_along(other, sign * second)) for copy in moved for sign in (-1, 1))


def tapered(low: CrossSection, high: CrossSection, length: float, axis: Axis, at: float = 0.0) -> Manifold:
    """A solid from the convex outline `low` at `at` on `axis` to the convex outline `high`, `length` further on.

    It grows against the axis for axis y, as `turned` turns it.
    """
    thin = 1e-5
    ends = [Manifold.extrude(low, thin), Manifold.extrude(high, thin).translate((0, 0, length - thin))]
    solid = turned(Manifold.batch_hull(ends), axis)
    return solid.translate(_along(axis, at))


def screw(radius: float, axis: Axis, at: ArrayLike, sign: int = 1, segments: int = 20) -> Manifold:
    """A cross-slotted screw head on a surface point `at` (3,) that faces along `axis`, or against it for sign -1."""
    head = rod(radius, radius, "z", (0, 0, 0), 0.25 * radius, segments)
    slots = [box((1.4 * radius, 0.3 * radius, radius)), box((0.3 * radius, 1.4 * radius, radius))]
    up = -sign if axis == "y" else sign
    head -= union(slots).translate((0, 0, up * 0.75 * radius))
    return turned(head, axis).translate(tuple(np.asarray(at, float)))


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
    degrees = _along(axis, float(np.degrees(angle)))
    return solid.translate(tuple(-at)).rotate(degrees).translate(tuple(at))


def smooth_outline(points: ArrayLike, radius: float, hollow: float = 0.0, segments: int = 24) -> CrossSection:
    """The outline through `points` (n, 2), its outward corners rounded to `radius` and its inward ones to `hollow`."""
    outline = polygon(points)
    if radius > 0:
        outline = outline.offset(-radius, JoinType.Miter).offset(radius, JoinType.Round, circular_segments=segments)
    if hollow > 0:
        outline = outline.offset(hollow, JoinType.Miter).offset(-hollow, JoinType.Round, circular_segments=segments)
    return outline.simplify(radius * 1e-3 + 1e-7)


def moulded(
    outline: CrossSection, thickness: float, axis: Axis, at: float = 0.0, radius: float = 0.0005, segments: int = 2
) -> Manifold:
    """Any `outline`, holes too, made a plate as by `plate`, all its rims rounded to `radius`.

    Raises ValueError where `radius` is more than the outline's own curves allow.
    """
    contours, inner = zip(*(_inset(np.asarray(c, float), radius) for c in outline.to_polygons()), strict=True)
    inner_outline = CrossSection([1e3 * c for c in inner])  # in millimetres: outlines are rounded to 1e-8 of their unit
    signed = sum(float(np.sum(c[:, 0] * np.roll(c[:, 1], -1) - c[:, 1] * np.roll(c[:, 0], -1))) / 2 for c in inner)
    if abs(inner_outline.area() * 1e-6 - signed) > 1e-5 * signed:
        raise ValueError(f"rims of radius {radius:g} meet each other: the outline is too narrow somewhere")
    quarter = np.linspace(0, np.pi / 2, segments + 1)
    share = np.concatenate([1 - np.sin(quarter), 1 - np.sin(quarter[::-1])])
    rise = np.concatenate([radius * (1 - np.cos(quarter)), thickness - radius * (1 - np.cos(quarter[::-1]))])
    vertices: list[Array] = []
    faces: list[NDArray[np.int64]] = []
    first: list[int] = []
    for contour, inset in zip(contours, inner, strict=True):
        n, start = len(contour), sum(len(v) for v in vertices)
        first.append(start)
        rings = contour + share[:, None, None] * (inset - contour)
        height = np.broadcast_to(rise[:, None, None] - thickness / 2, (len(rise), n, 1))
        vertices.append(np.concatenate([rings, height], -1).reshape(-1, 3))
        faces.append(start + _walls(len(rise), n))
    ends = np.concatenate([np.arange(len(c)) + s for c, s in zip(contours, first, strict=True)])
    steps = np.concatenate([np.full(len(c), (len(rise) - 1) * len(c)) for c in contours])
    cap = np.asarray(triangulate(inner), np.int64)
    faces += [ends[cap][:, ::-1], (ends + steps)[cap]]
    return turned(_solid(np.concatenate(vertices), np.concatenate(faces)), axis).translate(_along(axis, at))


def loft(rings: ArrayLike) -> Manifold:
    """The solid whose skin runs through `rings` (k, n, 3), closed by flat ends.

    Each ring turns counter-clockwise seen from the side of the next one.
    """
    rings = np.asarray(rings, float)
    k, n = rings.shape[:2]
    faces = [_walls(k, n)]
    for ring, start, flip in ((rings[0], 0, True), (rings[-1], (k - 1) * n, False)):
        centred = ring - ring.mean(0)
        normal = np.cross(centred, np.roll(centred, -1, 0)).sum(0)
        u = np.linalg.svd(normal[None] / np.linalg.norm(normal))[2][1]
        v = np.cross(normal / np.linalg.norm(normal), u)
        cap = np.asarray(triangulate([np.stack([centred @ u, centred @ v], -1)]), np.int64) + start
        faces.append(cap[:, ::-1] if flip else cap)
    return _solid(rings.reshape(-1, 3), np.concatenate(faces))


def tube(path: ArrayLike, radius: float, segments: int = 8, closed: bool = False) -> Manifold:
    """A round wire of `radius` along `path` (n, 3), whose ends are joined when `closed`."""
    path = np.asarray(path, float)
    ahead = np.roll(path, -1, 0) - path
    along = ahead + np.roll(ahead, 1, 0)
    if not closed:
        along[0], along[-1] = ahead[0], ahead[-2]
    along /= np.linalg.norm(along, axis=1, keepdims=True)
    side = np.linalg.svd(along[:1])[2][1]
    turn = 2 * np.pi * np.arange(segments) / segments
    rings = []
    for point, tangent in zip(path, along, strict=True):
        side = side - tangent * (side @ tangent)
        side /= np.linalg.norm(side)
        rings.append(point + radius * (np.cos(turn)[:, None] * side + np.sin(turn)[:, None] * np.cross(tangent, side)))
    if not closed:
        return loft(rings)
    # A loop's last ring meets the first one turned: the twist of the frames is made up by shifting the points' numbers.
    gap = rings[0] - path[0]
    last = rings[-1] - path[-1]
    shift = int(np.argmax([np.sum(np.roll(gap, -s, 0) * last) for s in range(segments)]))
    faces = _walls(len(rings), segments)
    j, n = np.arange(segments), (len(rings) - 1) * segments
    a, b, c, d = n + j, n + (j + 1) % segments, (j + 1 + shift) % segments, (j + shift) % segments
    return _solid(np.concatenate(rings), np.concatenate([faces, np.stack([a, b, c], -1), np.stack([a, c, d], -1)]))


def coil(radius: float, wire: float, length: float, turns: int, axis: Axis, centre: ArrayLike = (0, 0, 0)) -> Manifold:
    """A helical spring of `turns` about `axis`, `radius` to the middle of its round `wire`."""
    t = np.linspace(0, 1, 12 * turns + 1)
    angle = 2 * np.pi * turns * t
    path = np.stack([radius * np.cos(angle), radius * np.sin(angle), length * (t - 0.5)], -1)
    return turned(tube(path, wire, 6), axis).translate(tuple(np.asarray(centre, float)))


def text_outline(text: str, height: float, width: float | None = None) -> CrossSection:
    """`text` as an outline about the origin, its letters `height` metres high, or less where `width` would be passed.

    To be raised from or sunk into a surface, by `plate`.
    """
    font, scale, thick = cv2.FONT_HERSHEY_DUPLEX, 3.0, 7
    (w, h), base = cv2.getTextSize(text, font, scale, thick)
    picture = np.zeros((h + base + 40, w + 40), np.uint8)
    cv2.putText(picture, text, (20, h + 20), font, scale, 255, thick, cv2.LINE_AA)
    contours, _ = cv2.findContours(picture, cv2.RETR_CCOMP, cv2.CHAIN_APPROX_NONE)
    contours = [cv2.approxPolyDP(c, 1.0, True)[:, 0].astype(float) for c in contours]
    outline = CrossSection([c * [1, -1] for c in contours if len(c) > 2], FillRule.EvenOdd)
    u0, v0, u1, v1 = outline.bounds()
    size = height / (v1 - v0) if width is None else min(height / (v1 - v0), width / (u1 - u0))
    return outline.translate((-(u0 + u1) / 2, -(v0 + v1) / 2)).scale((size, size))


def triangles(solid: Manifold) -> tuple[Array, NDArray[np.int64]]:
    """Vertices (V, 3), metres, and faces (F, 3), counter-clockwise from outside."""
    mesh = solid.to_mesh64() if hasattr(solid, "to_mesh64") else solid.to_mesh()
    return np.array(mesh.vert_properties[:, :3], float), np.array(mesh.tri_verts, np.int64)


def _inset(contour: Array, depth: float) -> tuple[Array, Array]:
    """The contour (n, 2), and it moved `depth` into the solid on its left.

    Edges far shorter than `depth` that would turn over, as outlines have them by rounding, are drawn together first.
    """
    while True:
        ahead = np.roll(contour, -1, 0) - contour
        long = np.linalg.norm(ahead, axis=1)
        ahead /= long[:, None]
        normal = np.stack([-ahead[:, 1], ahead[:, 0]], -1)
        before = np.roll(normal, 1, 0)
        moved = contour + depth * (normal + before) / (1 + np.sum(normal * before, 1, keepdims=True))
        flipped = np.sum((np.roll(moved, -1, 0) - moved) * ahead, 1) < 0
        if not flipped.any():
            return contour, moved
        k = int(np.where(flipped, long, np.inf).argmin())
        if long[k] > 0.3 * depth:
            raise ValueError(f"rims of radius {depth:g} do not fit the outline's curves")
        after = (k + 1) % len(contour)
        contour = contour.copy()
        contour[k] = (contour[k] + contour[after]) / 2
        contour = np.delete(contour, after, 0)


def _walls(rings: int, n: int) -> NDArray[np.int64]:
    """Faces (2 n (rings - 1), 3) of the skin through rings of n points, numbered one ring after the other."""
    i, j = (g.reshape(-1) for g in np.meshgrid(np.arange(rings - 1), np.arange(n), indexing="ij"))
    a, b = i * n + j, i * n + (j + 1) % n
    return np.concatenate([np.stack([a, b, b + n], -1), np.stack([a, b + n, a + n], -1)])


def _solid(vertices: Array, faces: NDArray[np.int64]) -> Manifold:
    solid = Manifold(Mesh64(vertices, faces.astype(np.uint64)))
    if solid.status().name != "NoError" or solid.volume() <= 0:
        raise ValueError(f"not a solid: {solid.status().name}, volume {solid.volume():g}")
    return solid


def stroke(points: ArrayLike, radii: ArrayLike, segments: int = 24) -> CrossSection:
    """The outline that a disc sweeps on its way through `points` (n, 2) while its radius goes through `radii` (n,)."""
    discs = [
        CrossSection.circle(float(r), segments).translate((float(x), float(y)))
        for (x, y), r in zip(np.asarray(points, float), np.broadcast_to(radii, len(np.asarray(points))), strict=True)
    ]
    spans = [CrossSection.batch_hull(pair) for pair in pairwise(discs)]
    return CrossSection.batch_boolean(spans or discs, OpType.Add)


def softened(outline: CrossSection, radius: float, segments: int = 24) -> CrossSection:
    """The outline with all its corners, inward and outward, rounded to at least `radius`."""
    for step in (-radius, 2 * radius, -radius):
        outline = outline.offset(step, JoinType.Round, circular_segments=segments)
    return outline.simplify(radius / 40)


def stood(solid: Manifold) -> Manifold:
    """A solid drawn flat (x right, y up, z towards the viewer) stood up to face -x."""
    return solid.transform([[0, 0, -1, 0], [-1, 0, 0, 0], [0, 1, 0, 0]])
