"""Builds a truth: flags the faces that can be seen from outside, and those that a video showed."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from freeart21 import se3
from freeart21.articulation import Articulation
from freeart21.camera import Camera
from freeart21.formats.third_party import Parts
from freeart21.joint import Joint
from freeart21.mesh import Mesh, triangle_normals
from freeart21.se3 import Array
from freeart21.sphere import fibonacci_sphere
from freeart21.truth import Truth
from generator.motion import motion_range
from generator.rays import Caster, Hits

Flags = tuple[NDArray[np.bool_], NDArray[np.bool_]]

_DIRECTIONS = 40
_GRID = 100
_ESCAPES = 30
_SAME = 1e-6  # of the side's size: vertices within this distance are one


def build_truth(
    sides: Sequence[Mesh],
    parts: Parts,
    states: Array,
    camera: Camera,
    frames: Iterable[int],
    source: dict[str, Any],
    query_rgb: Callable[[int], NDArray[np.uint8]] = lambda i: np.zeros((0, 0, 3), np.uint8),
    query_mask: Callable[[int], NDArray[np.bool_]] = lambda i: np.zeros((0, 0), bool),
) -> Truth:
    """The truth of a video.

    Faces that cannot be seen from outside in any state (where solids of one part meet) are left out: no video shows
    them, and the truth, submitted as an answer, must score perfectly.

    Args:
        sides: fine meshes of parent and child side.
        parts: the sides as reference and moving part.
        states: (n,) joint states, rad or m.
        camera: of the video.
        frames: those in which visible faces are searched.
        source: facts for the truth's `source`.
        query_rgb: number of a held-out view to its colours (height, width, 3).
        query_mask: number of a held-out view to its mask (height, width).
    """
    meshes = sides[parts.order[0]], sides[parts.order[1]]
    shown = ((parts.Ts_camera[0][i], parts.Ts_camera[1][i], parts.part_mask(i) > 0) for i in frames)
    visible = visible_faces(meshes, camera, shown)
    outer = [o | v for o, v in zip(outer_faces(meshes, parts.joint), visible, strict=True)]
    return Truth(
        Articulation(parts.joint, *(mesh.with_faces(o) for mesh, o in zip(meshes, outer, strict=True))),
        states,
        *parts.Ts_camera,
        parts.seen,
        (outer[0][outer[0]], outer[1][outer[1]]),
        (visible[0][outer[0]], visible[1][outer[1]]),
        parts.part_mask,
        query_rgb,
        query_mask,
        source,
    )


def outer_faces(meshes: tuple[Mesh, Mesh], joint: Joint, states: int = 5) -> Flags:
    """Per side (F,) faces that a ray from outside can hit at one of `states` joint states spread over the range.

    First, parallel rays are cast from 40 directions, different ones at each state. For faces that these miss (smaller
    than the spacing of the rays, or deep inside), rays are cast from their centres in 30 directions, different ones at
    each state: a face is outer when one of them escapes. Faces that show through a slit in less than about 1 of 50
    directions may be missed.
    """
    caster = Caster(meshes)
    flags = (np.zeros(len(meshes[0].faces), bool), np.zeros(len(meshes[1].faces), bool))
    groups = coincident_faces(meshes[0]), coincident_faces(meshes[1])
    poses = [(np.eye(4), joint.transform(q)) for q in np.linspace(*motion_range(joint), states)]
    directions = fibonacci_sphere(_DIRECTIONS * states)
    for k, Ts in enumerate(poses):
        _mark_from_outside(caster, meshes, Ts, directions[k::states], flags)
    _mark_coincident(flags, groups)
    directions = fibonacci_sphere(_ESCAPES * states)
    for k, Ts in enumerate(poses):
        _mark_escaping(caster, meshes, Ts, directions[k::states], flags, groups)
    return flags


def visible_faces(
    meshes: tuple[Mesh, Mesh], camera: Camera, views: Iterable[tuple[Array, Array, NDArray[np.bool_]]]
) -> Flags:
    """Per side (F,) faces hit by a pixel's ray in one of the views, and the faces that coincide with those.

    A view is the pose of each side (4, 4) and the foreground mask (height, width).
    """
    caster = Caster(meshes)
    flags = (np.zeros(len(meshes[0].faces), bool), np.zeros(len(meshes[1].faces), bool))
    for T_first, T_second, foreground in views:
        _mark_hits(caster.look(camera, (T_first, T_second), foreground), flags)
    _mark_coincident(flags, (coincident_faces(meshes[0]), coincident_faces(meshes[1])))
    return flags


def coincident_faces(mesh: Mesh) -> NDArray[np.int64]:
    """(F,) group of each face: faces with the same three corners, in any order, share one.

    PartNet-Mobility holds most faces twice, once for each direction; a ray hits either.
    """
    if mesh.empty:
        return np.zeros(0, np.int64)
    cell = max(_SAME * float(np.ptp(mesh.vertices, axis=0).max()), 1e-12)
    corner = np.unique(np.rint(mesh.vertices / cell).astype(np.int64), axis=0, return_inverse=True)[1].reshape(-1)
    return np.unique(np.sort(corner[mesh.faces], axis=1), axis=0, return_inverse=True)[1].reshape(-1)


def _mark_coincident(flags: Flags, groups: tuple[NDArray[np.int64], NDArray[np.int64]]) -> None:
    """Copy flags to coincident faces."""
    for flag, group in zip(flags, groups, strict=True):
        marked = np.zeros(group.max(initial=-1) + 1, bool)
        marked[group[flag]] = True
        flag |= marked[group]


def _mark_hits(hits: Hits, flags: Flags) -> None:
    for k in (0, 1):
        flags[k][hits.face[hits.side == k]] = True


def _mark_from_outside(
    caster: Caster, meshes: tuple[Mesh, Mesh], Ts: tuple[Array, Array], directions: Array, flags: Flags
) -> None:
    corners = np.concatenate([se3.transform(T, m.vertices) for T, m in zip(Ts, meshes, strict=True)])
    low, high = corners.min(0), corners.max(0)
    centre, radius = (low + high) / 2, 0.5 * np.linalg.norm(high - low)
    offsets = (np.arange(_GRID) + 0.5) / _GRID * 2 - 1
    u, v = (g.reshape(-1, 1) for g in np.meshgrid(offsets, offsets))
    for direction in directions:
        across = np.linalg.svd(direction[None])[2][1:]
        origins = centre - 2 * radius * direction + radius * (u * across[0] + v * across[1])
        _mark_hits(caster.cast(origins, np.broadcast_to(direction, origins.shape), Ts), flags)


def _mark_escaping(
    caster: Caster,
    meshes: tuple[Mesh, Mesh],
    Ts: tuple[Array, Array],
    directions: Array,
    flags: Flags,
    groups: tuple[NDArray[np.int64], NDArray[np.int64]],
) -> None:
    for k, (T, mesh) in enumerate(zip(Ts, meshes, strict=True)):
        rest = np.flatnonzero(~flags[k])
        rest = rest[np.unique(groups[k][rest], return_index=True)[1]]  # one of each pair of faces that lie together
        vertices, faces = se3.transform(T, mesh.vertices), mesh.faces[rest]
        middle, normal = vertices[faces].mean(1), triangle_normals(vertices, faces)
        normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-30)
        step = 1e-5 * float(np.ptp(mesh.vertices, axis=0).max()) if len(rest) else 0.0
        for direction in directions:
            cosine = normal @ direction
            todo = np.flatnonzero((np.abs(cosine) > 0.15) & ~flags[k][rest])
            out = np.sign(cosine[todo])[:, None] * normal[todo]
            hits = caster.cast(middle[todo] + step * out, np.broadcast_to(direction, (len(todo), 3)), Ts)
            flags[k][rest[todo[hits.side < 0]]] = True
    _mark_coincident(flags, groups)
