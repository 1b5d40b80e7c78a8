"""Makes a closed part hollow where its panels say so: what stands behind a seen surface that nobody saw from behind.

A closed part (`export.surface`) is solid wherever nothing was seen. A plane in its surface can be known to be thin in
one place and thick in another: its other side was seen there, or the space behind it is empty (`export.free_space`).
Then it is a panel of that thickness that goes on past an unseen core, or a panel that ends where a solid block begins.
The shorter description of each core is taken, in bits:

    solid    a number for every such plane that bounds the core, and one for a surface that lies exactly where the view
             or the other part's motion ended
    hollow   a yes for every other plane that bounds the core, and for what bounds it and lies on no plane; and a number
             for the thickness where no rim shows it: then walls are as thick as usual for size and material, and no
             thicker than where known empty space begins behind them

A number is log2(size / voxel) bits, a yes -log2 of the share of the part's surface that is known to be thin. A plane
that is seen from both sides is a slab of its own thickness. The surface around a hollow core that nobody saw stays as a
panel where its area is less than that of the seen panels' backs; where known empty space lies before it, and it does
not bound the whole part, it goes.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
import trimesh
from numba import njit
from numpy.typing import NDArray
from scipy.ndimage import binary_dilation, distance_transform_edt, label
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from export.decomposition import robust_hull
from export.free_space import UNKNOWN, SpaceGrid
from export.outer_surface import sample_evenly
from export.planes import PLANE_TOLERANCE, Planes, fit_planes
from freeart21 import se3
from freeart21.mesh import Mesh, bounding_diagonal
from freeart21.se3 import Array

_SPLIT = 3.0
"""A plane whose thick places are this many times as thick as its thin ones is a panel that ends at a core."""
_THIN, _THICK = 0.1, 0.9
"""Quantiles of a plane's thickness: thin for at least a tenth, so that rims and rounded edges do not count. Sides of a
cabinet with one opened drawer of three are thin in 13 to 23 %, broad faces of a solid phone in at most 6."""
_MIN_CORE = 0.01
"""Volume of a core over that of the part, below which it stays solid."""
_VOTES = 25
"""Neighbouring points of an unseen surface that say together whether space was looked through."""
_LEAST_SHARE = 0.02
"""Voxels that the surface of a cavity stays away from voxel centres: triangles keep an area."""
_PROBES = 1.5
"""Voxels behind an unseen surface at which cores are looked up."""
_REACH = (1.5, 2.5, 3.5)
"""Voxels in front of an unseen surface at which known empty space says that the view ended there."""


@dataclass(frozen=True)
class Panels:
    """What makes a part hollow."""

    cavities: tuple[Mesh, ...] = ()
    """Closed meshes, faces outwards, that are to be subtracted from the part."""
    report: dict[str, Any] = field(default_factory=dict)
    """For asset.json."""


@dataclass(frozen=True)
class _Points:
    """Even points on a closed part."""

    at: Array
    normals: Array
    depth: Array
    """(n,) m inwards to where the part is known to end; infinite where nobody knows."""
    exact: NDArray[np.bool_]
    """(n,) whether the surface on that other side was seen."""
    each: float
    """m^2 of a point."""


def find_panels(closed: Mesh, observed: NDArray[np.bool_], space: SpaceGrid, wall: float = np.inf) -> Panels:
    """The cavities of a closed part, whose triangles `observed` (F,) were seen; none where it is better described as a
    solid. `wall`, m, is the usual thickness where no rim shows it."""
    h, size = space.voxel, bounding_diagonal(closed)
    solid = trimesh.Trimesh(closed.vertices, closed.faces, process=False)
    seen = _measure_points(solid, observed, observed, space)
    if not len(seen.at):
        return Panels()
    planes = fit_planes(seen.at, seen.normals, PLANE_TOLERANCE * size)
    split, share, thickness, source = _find_thickness(seen, planes, wall)
    if thickness is None:
        return Panels(report={"panels": 0})
    thickness = max(thickness, h)
    thick = _slabs(seen, planes, split, thickness)
    inside = fill_inside(closed, space)
    near = binary_dilation(inside, iterations=3)
    room = np.where(near, np.inf, -np.inf)
    for t in np.unique(thick):
        room = np.minimum(room, _distances(near, seen, thick == t, planes, t, space) - t)
    cores, count = label(inside & (room > 0))
    patch = _measure_points(solid, ~observed, observed, space)
    empty = [space.look_up(patch.at + reach * h * patch.normals) != UNKNOWN for reach in _REACH]
    blocked = _smooth(patch.at, np.any(empty, axis=0)) & ~_bounds(patch.at, seen.at, 2 * h)
    within = _look_up(cores, space, patch.at - _PROBES * h * patch.normals)
    behind = _look_up(cores, space, seen.at - (thick + h)[:, None] * seen.normals)
    volume = np.bincount(cores.ravel(), minlength=count + 1)
    bits = float(np.log2(size / h))
    kept, report = np.zeros(len(patch.at), bool), []
    hollow = np.zeros(count + 1, bool)
    for core in range(1, count + 1):
        if volume[core] < _MIN_CORE * inside.sum():
            continue
        backs = behind == core
        faces = within == core
        areas = np.bincount(planes.label[backs & (planes.label >= 0)], minlength=len(planes)) * seen.each
        bounding = np.flatnonzero(areas > (4 * h) ** 2)
        shadow, unseen = (float((faces & which).sum() * patch.each) for which in (blocked, ~blocked))
        solid_bits = bits * (int(split[bounding].sum()) + int(shadow > unseen))
        others = int((~split[bounding]).sum()) + int((backs & (planes.label < 0)).sum() * seen.each > (4 * h) ** 2)
        hollow_bits = -others * float(np.log2(share)) + (0.0 if source == "rims" else bits)
        hollow[core] = hollow_bits < solid_bits
        closes = unseen < float(backs.sum() * seen.each)
        if hollow[core] and closes:
            kept |= faces & ~blocked
        report.append(
            {
                "volume_m3": float(volume[core] * h**3),
                "hollow": bool(hollow[core]),
                "closed": bool(closes),
                "solid_bits": round(solid_bits, 1),
                "hollow_bits": round(hollow_bits, 1),
            }
        )
    facts = {"thickness_m": thickness, "thickness_by": source, "planes": len(planes), "cores": report}
    if not hollow.any():
        return Panels(report=facts)
    room = np.minimum(room, _signed_depth(inside, h) + 2 * h)
    if kept.any():
        room = np.minimum(room, _distances(near, patch, kept, None, thickness, space) - thickness)
    return Panels(tuple(_extract(room, hollow[cores], space)), facts)


def sealed_faces(mesh: Mesh) -> NDArray[np.bool_]:
    """(F,) the walls of cavities that nothing connects with the outside: shells of a closed mesh that face inwards.

    No view, and no contact, ever sees them; only the mass does.
    """
    a, b, c = mesh.faces.T
    ones = np.ones(2 * len(a), bool)
    edges = coo_array((ones, (np.concatenate([a, b]), np.concatenate([b, c]))), shape=2 * (len(mesh.vertices),))
    shell = connected_components(edges, directed=False)[1][a]
    x, y, z = (mesh.vertices[corner] for corner in (a, b, c))
    volume = np.bincount(shell, np.einsum("ni,ni->n", x, np.cross(y, z)))
    return np.asarray(volume[shell] < 0)


def _measure_points(
    solid: trimesh.Trimesh, chosen: NDArray[np.bool_], observed: NDArray[np.bool_], space: SpaceGrid
) -> _Points:
    """Points on the triangles `chosen` (F,), half a voxel apart, and how thick the part is behind each."""
    faces = np.flatnonzero(chosen)
    area = float(solid.area_faces[faces].sum())
    each = max((0.7 * space.voxel) ** 2, area / 60_000)
    some = trimesh.Trimesh(solid.vertices, solid.faces[faces], process=False)
    if not area > 0:
        empty = np.zeros((0, 3))
        return _Points(empty, empty, np.zeros(0), np.zeros(0, bool), each)
    at, of = sample_evenly(some, each)
    every = np.arange(len(at))
    if len(at) > 2 * area / each:  # small triangles: one point in each was too many
        _, every = np.unique(np.floor(at / np.sqrt(each)).astype(np.int64), axis=0, return_index=True)
    at, normals = at[every], some.face_normals[of[every]]
    depth, exact = np.full(len(at), np.inf), np.zeros(len(at), bool)
    step = 1e-4 * space.voxel
    where, ray, hit = solid.ray.intersects_location(at - step * normals, -normals, multiple_hits=False)
    opposite = np.einsum("ij,ij->i", solid.face_normals[hit], normals[ray]) < -_OPPOSITE
    exact[ray] = observed[hit] & opposite
    ends = np.linalg.norm(where - at[ray], axis=1)
    depth[ray[exact[ray]]] = ends[exact[ray]]
    empty = space.depth_to_empty(at, normals, np.where(exact, depth, np.inf))
    exact &= depth <= empty + space.voxel
    return _Points(at, normals, np.where(exact, depth, np.minimum(depth, empty)), exact, each)


_OPPOSITE = 0.9
"""Cosine between a face and the one on its other side, of a panel."""


def _find_thickness(seen: _Points, planes: Planes, wall: float) -> tuple[NDArray[np.bool_], float, float | None, str]:
    """(p,) which planes are thin in one place and thick in another, the share of the planes' known surface that is
    thin, the panels' thickness, m, or None, and where it comes from."""
    split = np.zeros(len(planes), bool)
    thin = np.zeros(len(seen.at), bool)
    for k in range(len(planes)):
        own = np.flatnonzero(planes.label == k)
        own = own[np.isfinite(seen.depth[own])]
        if not len(own):
            continue
        low, high = np.quantile(seen.depth[own], [_THIN, _THICK])
        split[k] = high > _SPLIT * low
        if split[k]:
            thin[own[seen.depth[own] < np.sqrt(low * high)]] = True
    if not split.any():
        return split, 0.0, None, ""
    share = float(thin.sum() / (np.isfinite(seen.depth) & (planes.label >= 0)).sum())
    rims = thin & seen.exact
    if rims.any():
        return split, share, float(np.median(seen.depth[rims])), "rims"
    most = float(np.quantile(seen.depth[thin], 0.25))
    return split, share, min(most, wall), "size and material" if wall < most else "empty space behind"


def _slabs(seen: _Points, planes: Planes, split: NDArray[np.bool_], thickness: float) -> Array:
    """(n,) m of material behind each point in front of a hollow core: its slab's own, `thickness` elsewhere.

    A slab is seen from both sides, and neither side is a panel that is thin elsewhere.
    """
    thick, tree = np.full(len(seen.at), thickness), cKDTree(seen.at)
    panel = np.append(split, False)[planes.label]
    for k in np.flatnonzero(~split):
        own = planes.label == k
        both = own & seen.exact
        if both.sum() > 0.5 * own.sum() and not (
            panel[tree.query(seen.at[both] - seen.depth[both, None] * seen.normals[both])[1]].mean() > 0.5
        ):
            high = float(np.quantile(seen.depth[both], _THICK))
            similar = thick[np.abs(thick / high - 1) < 0.1]
            thick[own] = similar[0] if len(similar) else high  # few different ones
    return thick


def _distances(
    where: NDArray[np.bool_],
    every: _Points,
    chosen: NDArray[np.bool_],
    planes: Planes | None,
    level: float,
    space: SpaceGrid,
) -> Array:
    """(X, Y, Z) m from the voxels `where` to the points `chosen` (n,) of a surface: exact within two voxels of `level`,
    by voxels elsewhere; -infinite where not asked.

    Exact is the distance to the plane of the nearest point, or to its fitted plane, as far as it reaches.
    """
    surface, normals = every.at[chosen], every.normals[chosen]
    labels = None if planes is None else planes.label[chosen]
    h = space.voxel
    marked = np.ones(space.state.shape, bool)
    at = np.rint(se3.transform(se3.inverse(space.T_part_grid), surface) / h).astype(np.int64)
    at = at[((at >= 0) & (at < marked.shape)).all(1)]
    marked[tuple(at.T)] = False
    coarse = h * np.asarray(distance_transform_edt(marked))
    found = np.where(where, coarse, -np.inf)
    band = where & (np.abs(coarse - level) < 2 * h)
    points = space.centres(band)
    _, nearest = cKDTree(surface).query(points)
    n = normals[nearest]
    away = points - surface[nearest]
    ahead = np.einsum("ij,ij->i", away, n)
    aside = np.sqrt(np.maximum((away**2).sum(1) - ahead**2, 0.0))
    if planes is not None and labels is not None and len(planes):
        k = labels[nearest]
        on = k >= 0
        ahead[on] = np.einsum("ij,ij->i", points[on], planes.normals[k[on]]) - planes.offsets[k[on]]
    found[band] = np.hypot(ahead, np.maximum(aside - h, 0.0))
    return found


def _bounds(at: Array, seen: Array, near: float) -> NDArray[np.bool_]:
    """(n,) whether points (n, 3) are within `near`, m, of the convex hull of `seen` points, or outside: what is empty
    in front of them is outside the part."""
    planes = robust_hull(seen).equations
    planes = planes[np.unique(np.round(planes, 6), axis=0, return_index=True)[1]]
    out = np.full(len(at), -np.inf)
    for plane in planes:
        out = np.maximum(out, at @ plane[:3] + plane[3])
    return out > -near


def _smooth(at: Array, flags: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """(n,) flags, each by the majority of its neighbours."""
    if not len(at):
        return flags
    k = min(_VOTES, len(at))
    return np.asarray(flags[cKDTree(at).query(at, k=k)[1].reshape(len(at), k)].mean(1) > 0.5)


def _look_up(cores: NDArray[np.integer], space: SpaceGrid, points: Array) -> NDArray[np.int64]:
    """(n,) core that points (n, 3) lie in; 0 in none."""
    at = np.rint(se3.transform(se3.inverse(space.T_part_grid), points) / space.voxel).astype(np.int64)
    within = ((at >= 0) & (at < cores.shape)).all(1)
    found = np.zeros(len(points), np.int64)
    found[within] = cores[tuple(at[within].T)]
    return found


def _signed_depth(inside: NDArray[np.bool_], voxel: float) -> Array:
    """m inside (above 0) or outside the marked voxels."""
    return voxel * np.asarray(distance_transform_edt(inside) - distance_transform_edt(~inside))


def _extract(room: Array, chosen: NDArray[np.bool_], space: SpaceGrid) -> list[Mesh]:
    """Closed meshes of the components of room > 0 that hold chosen voxels."""
    from skimage.measure import marching_cubes

    least = _LEAST_SHARE * space.voxel
    room = np.where(np.isfinite(room), room, -space.voxel)
    room = np.where(np.abs(room) < least, np.where(room > 0, least, -least), room)
    parts, count = label(room > 0)
    own = np.zeros(count + 1, bool)
    own[np.unique(parts[chosen & (parts > 0)])] = True
    own[0] = False
    meshes = []
    for k in np.flatnonzero(own):
        if (parts == k).sum() < 27:
            continue
        near = binary_dilation(parts == k)
        padded = np.pad(
            np.where(near & ((parts == k) | (room <= 0)), room, -space.voxel), 1, constant_values=-space.voxel
        )
        vertices, faces, _, _ = marching_cubes(np.clip(padded, -2 * space.voxel, 2 * space.voxel), 0.0)
        mesh = Mesh(se3.transform(space.T_part_grid, space.voxel * (vertices - 1)), faces.astype(np.int64))
        a, b, c = np.moveaxis(mesh.vertices[mesh.faces], 1, 0)
        outward = float(np.einsum("ij,ij->i", a, np.cross(b, c)).sum()) > 0
        meshes.append(mesh if outward else Mesh(mesh.vertices, mesh.faces[:, ::-1]))
    return meshes


def fill_inside(closed: Mesh, space: SpaceGrid) -> NDArray[np.bool_]:
    """(X, Y, Z) whether a voxel's centre lies in a closed mesh."""
    vertices = se3.transform(se3.inverse(space.T_part_grid), closed.vertices) / space.voxel
    inside = np.zeros(space.state.shape, np.bool_)
    _toggle(inside, vertices + np.array([1.234e-7, 2.345e-7, 0.0]), closed.faces)
    return inside


@njit(nogil=True, cache=True)
def _toggle(inside: NDArray[np.bool_], vertices: Array, faces: NDArray[np.int64]) -> None:  # pragma: no cover
    """Invert the voxels above every triangle, column by column."""
    for f in range(len(faces)):
        a, b, c = vertices[faces[f, 0]], vertices[faces[f, 1]], vertices[faces[f, 2]]
        area = (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])
        if area == 0:
            continue
        for i in range(
            max(0, int(np.ceil(min(a[0], b[0], c[0])))),
            min(inside.shape[0] - 1, int(np.floor(max(a[0], b[0], c[0])))) + 1,
        ):
            for j in range(
                max(0, int(np.ceil(min(a[1], b[1], c[1])))),
                min(inside.shape[1] - 1, int(np.floor(max(a[1], b[1], c[1])))) + 1,
            ):
                p = ((b[0] - i) * (c[1] - j) - (b[1] - j) * (c[0] - i)) / area
                q = ((c[0] - i) * (a[1] - j) - (c[1] - j) * (a[0] - i)) / area
                r = 1 - p - q
                if p < 0 or q < 0 or r < 0:
                    continue
                z = p * a[2] + q * b[2] + r * c[2]
                for k in range(max(0, int(np.ceil(z))), inside.shape[2]):
                    inside[i, j, k] = not inside[i, j, k]
