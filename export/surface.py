"""Closes a part's surface into the boundary of a solid: observed surface stays in place, holes get patches.

A reconstruction has triangles only where a frame saw the part. Its vertices are triangulated into Delaunay tetrahedra.
The solid is the set of tetrahedra whose boundary S minimises

    area(S off the planes) + PLANE_WEIGHT * area(S on a plane)
        + OBSERVED_WEIGHT * (area of observed triangles without solid behind and air in front)
        + bits * (area that symmetries suppose, without solid behind and air in front)
        + (volume of solid in known empty space) / voxel

found as a minimum cut (Labatut, Pons, Keriven, ICCV 2007). The planes are those that were seen, continued, and those
that bound what was seen (`planes.suppose_planes`): points on them are vertices, too. Tetrahedra on which the normals at
all four corners agree are fixed beforehand. Thus an unseen back is flat where planes describe it more shortly, other
holes are closed by the smallest area, a thin plate seen from both sides becomes two sheets with a rim, and openings
whose inside was seen stay open. What the symmetries of the seen surface put where nobody looked
(`export.symmetry`) are vertices, too, and evidence as strong as the odds that it is right. The boundary is closed and
consistently oriented; it is decimated at last.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import fast_simplification
import manifold3d
import numpy as np
import trimesh
from numba import njit
from numpy.typing import NDArray
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import breadth_first_order, connected_components, maximum_flow
from scipy.spatial import Delaunay, QhullError, cKDTree

from export.carving import drop_small_pieces
from export.free_space import UNKNOWN, SpaceGrid
from export.meshes import (
    MIN_COMPONENT,
    drop_small_components,
    flip_faces,
    is_inside_out,
    merge_duplicates,
    number_cells,
)
from export.planes import PLANE_TOLERANCE, fit_planes, plane_axes, sample_planes, suppose_planes
from export.settings import MeshSettings
from export.symmetry import Supposed, suppose_by_symmetry
from export.winding_number import Winding
from freeart21.errors import FreeArtError
from freeart21.mesh import Mesh, bounding_diagonal, triangle_normals

MAX_FACES = 4_000_000
"""Most triangles of a part, ten times those of our largest reconstruction."""
MAX_LAYERS = 4.0
"""Largest area of a part's triangles over the area of the solid's boundary. 18 parts of nine true objects have 0.3 to
1.0, a cabinet of loose boards (PartNet-Mobility 45940) 1.8, 5,000 random triangles 20."""
OBSERVED_WEIGHT = 8.0
"""Weight of an observed area against the same area of boundary. At 1 holes would consume the surface."""
PLANE_WEIGHT = 0.5
"""Weight of area on a plane that is known anyway. At 1 the smallest area wins and backs are bent between ragged edges;
near 0 planes far from all that was seen cost nothing."""
_PLANE_SPACINGS = 2.0
"""Least spacings between points on supposed planes."""
_BACK_SPACINGS = 4.0
"""Spacings behind a seen face within which known empty space gets points of its own. A needle costs more area than its
face is worth when it is longer than 2.3 spacings, at `OBSERVED_WEIGHT`; 4 is set by hand."""
_PROBE_OFFSET = 0.25
"""Spacings in front of and behind an observed triangle where air and solid are expected: a wall can be half a spacing
thick."""
_OBSERVED_DISTANCE = 0.5
"""Spacings from observed triangles within which a boundary triangle counts as observed."""
_SYMMETRIC_SPACINGS = 1.5
"""Spacings from a point that a symmetry supposes within which a triangle of the patch counts as supposed by it; set
by hand, as such points are up to one apart."""
_MIN_SPACINGS = 150.0
"""Least number of spacings along a part's diagonal, so that a wall between two large triangles differs from a
hollow."""
_FACING_COSINE = 0.2
"""Cosine beyond which a surface faces a point, or faces away from it."""
_WALK_STEPS = 1000
"""Most tetrahedra on a walk."""
_PINCH_ROUNDS = 20
"""Rounds of filling edges at which the solid touches itself."""
_PRESOLVE_ROUNDS = 100
"""Rounds of fixing tetrahedra before the cut; late rounds fix few."""
_SAMPLE_WEIGHTS = np.array([[4, 1, 1], [1, 4, 1], [1, 1, 4]]) / 6
"""Points on a triangle, as weights of its corners, that are tested for being observed."""
_AGGRESSION = 3.0
"""Of quadric decimation: less stops above the target, more moves a monitor's surface by a third more."""
_DECIMATIONS = 3
"""Tries of quadric decimation, which can stop a little above the target."""
_CAPACITY_UNITS = 200.0
"""Integer capacity in the cut of a triangle of mean area."""
_VERTEX_SHIFT = 1e-6
"""m that coincident vertices are moved: above the digits of the OBJ, below any accuracy."""
_FIRST_TOLERANCE = 1 / 20
"""Spacings by which simplifying may move the surface at first; doubled until there are few enough triangles."""
_SHEET_M = 0.001
"""m: thickness given to a part that was only seen as a flat sheet."""


@dataclass(frozen=True)
class Surface:
    """The closed surface of one part. Observed triangles come first, the patch last."""

    mesh: Mesh
    """Watertight, oriented outwards, of positive volume; vertices are shared."""
    patch_first: int
    """Index of the first triangle of the patch."""
    flipped: bool = False
    """Whether the input's triangles faced inwards and were flipped."""
    layers: float = 1.0
    """Area of the input over the area of the mesh."""
    symmetric_count: int = 0
    """Triangles at the beginning of the patch that lie where a symmetry supposes surface (`export.symmetry`)."""
    panel_count: int = 0
    """Triangles at the end of the patch that are the unseen backs of panels (`export.hollows`); the others close the
    part by the smallest area."""
    supposed: Supposed = field(default_factory=Supposed)
    """What symmetries suppose where nobody looked."""

    @property
    def is_solid(self) -> bool:
        """Whether the input is mostly the surface of a solid, not a heap of crossing triangles."""
        return self.layers <= MAX_LAYERS

    @property
    def observed(self) -> NDArray[np.bool_]:
        """(F,) which triangles were observed."""
        return np.arange(len(self.mesh.faces)) < self.patch_first

    @property
    def patch_count(self) -> int:
        """Triangles of the patch."""
        return len(self.mesh.faces) - self.patch_first

    @property
    def patch_share(self) -> float:
        """The patch's fraction of the area."""
        area = self.mesh.areas()
        return float(area[self.patch_first :].sum() / area.sum())

    def without(self, faces: NDArray[np.bool_]) -> Surface:
        """The surface without some of its triangles, flags (F,); closed where these bound a hollow."""
        patch = faces[self.patch_first :]
        return replace(
            self,
            mesh=self.mesh.with_faces(~faces),
            patch_first=self.patch_first - int(faces[: self.patch_first].sum()),
            symmetric_count=self.symmetric_count - int(patch[: self.symmetric_count].sum()),
            panel_count=self.panel_count - int(patch[len(patch) - self.panel_count :].sum()),
        )


def close_surface(part: Mesh, settings: MeshSettings, space: SpaceGrid | None = None) -> Surface:
    """The closed surface of a part, of about `max_faces` triangles at most.

    Args:
        part: triangles, m.
        settings: limits of size.
        space: where the part is known not to be, in its frame; a patch avoids it.

    Raises FreeArtError when no triangle has an area, or there are more than `MAX_FACES`.
    """
    if len(part.faces) > MAX_FACES:
        raise FreeArtError(f"mesh has {len(part.faces)} triangles, expected at most {MAX_FACES}")
    given = merge_duplicates(Mesh(part.vertices, part.faces))
    seen = drop_small_components(given)
    if seen.empty:
        raise FreeArtError("mesh has no triangle of any area")
    wrong_way = is_inside_out(seen)
    seen = flip_faces(seen) if wrong_way else seen
    own = float(np.sqrt(4 / np.sqrt(3) * seen.areas().mean()))
    spacing = _point_spacing(seen, own, settings.points)
    solid, supposed = _make_solid(seen.vertices, seen.faces), Supposed()
    whole = solid is not None
    if solid is None:
        sheet = _thicken_sheet(seen, _SHEET_M)
        if sheet is not None:
            solid = _make_solid(sheet.vertices, sheet.faces)
        else:
            solid, supposed = _extract_solid(seen, spacing, space, settings)
    if solid is None:
        raise FreeArtError("mesh cannot be closed: it has no inside")
    if not whole or solid.num_tri() > settings.max_faces:
        solid = _simplify(solid, _FIRST_TOLERANCE * min(own, spacing), settings.max_faces)
    vertices, faces = _to_arrays(solid)
    vertices = _separate_vertices(vertices, faces)
    observed = np.ones(len(faces), bool) if whole else _find_observed(vertices, faces, seen, spacing)
    symmetric = np.zeros(len(faces), bool)
    if len(supposed.points):
        away, _ = cKDTree(supposed.points).query(vertices[faces].mean(1))
        symmetric = ~observed & (away < _SYMMETRIC_SPACINGS * spacing)
    faces = faces[np.argsort(np.where(observed, 0, 2 - symmetric), kind="stable")]
    mesh = _transfer_colours(Mesh(vertices, faces), part)
    layers = float(given.areas().sum() / mesh.areas().sum())
    return Surface(mesh, int(observed.sum()), wrong_way, layers, int(symmetric.sum()), supposed=supposed)


def subtract_cavities(surface: Surface, cavities: Sequence[Mesh], tolerance: float, settings: MeshSettings) -> Surface:
    """A closed surface without `cavities`, closed meshes that face outwards; their walls become panels of the patch.

    Loose pieces of less than `MIN_COMPONENT` of the rest go. The cavities' walls move by `tolerance`, m, at most, where
    that saves triangles.
    """
    solid, tools = _make_solid(surface.mesh.vertices, surface.mesh.faces), []
    for cavity in cavities:
        tool = _make_solid(cavity.vertices, cavity.faces)
        if tool is not None:
            tools.append(tool.simplify(tolerance))
    if solid is None or not tools:
        return surface
    walls = manifold3d.Manifold.batch_boolean(tools, manifold3d.OpType.Add)
    rest = drop_small_pieces((solid - walls).as_original())
    if not rest.volume() > 0:
        return surface
    return _retrace(surface, _simplify(rest, tolerance, settings.max_faces), Mesh(*_to_arrays(walls)), tolerance)


def replace_mesh(surface: Surface, mesh: Mesh, tolerance: float, settings: MeshSettings) -> Surface:
    """A closed surface with another mesh: `mesh`, what is left of the surface's own after a cut.

    What moved by more than `tolerance`, m, belongs to the patch. Unchanged where `mesh` is not closed.
    """
    solid = _make_solid(mesh.vertices, mesh.faces)
    if solid is None:
        return surface
    panels = surface.mesh.faces[len(surface.mesh.faces) - surface.panel_count :]
    solid = _simplify(solid, _FIRST_TOLERANCE * tolerance, settings.max_faces)
    return _retrace(surface, solid, Mesh(surface.mesh.vertices, panels), tolerance)


def _retrace(surface: Surface, rest: manifold3d.Manifold, panels: Mesh, tolerance: float) -> Surface:
    """The surface of a solid that is cut out of a closed one: observed and coloured as that is within `tolerance`, m,
    panels where it runs along `panels`."""
    vertices, faces = _to_arrays(rest)
    vertices = _separate_vertices(vertices, faces)
    seen = surface.mesh.with_faces(surface.observed)
    observed = _find_observed(vertices, faces, Mesh(seen.vertices, seen.faces), 2 * tolerance)
    first, last = surface.patch_first, surface.patch_first + surface.symmetric_count
    copies, kind = Mesh(surface.mesh.vertices, surface.mesh.faces[first:last]), np.where(observed, 0, 2)
    for order, old in ((1, copies), (3, panels)):
        if not old.empty:
            near = Winding(old).distance(vertices[faces].mean(1)) < 2 * tolerance
            kind = np.where((kind > 0) & near, order, kind)
    faces = faces[np.argsort(kind, kind="stable")]
    mesh = _transfer_colours(Mesh(vertices, faces), surface.mesh)
    first, symmetric, _, panel = (int(n) for n in np.bincount(kind, minlength=4))
    return replace(surface, mesh=mesh, patch_first=first, symmetric_count=symmetric, panel_count=panel)


def _separate_vertices(vertices: NDArray[np.float64], faces: NDArray[np.int64]) -> NDArray[np.float64]:
    """Vertices (n, 3), coincident ones moved inwards by a micrometre.

    Two closed sheets that touch in an edge are valid, but merging equal positions would give that edge four triangles.
    """
    _, place, count = np.unique(vertices, axis=0, return_inverse=True, return_counts=True)
    twice = count[place.reshape(-1)] > 1
    across = triangle_normals(vertices, faces)
    normals = np.stack([np.bincount(faces.ravel(), np.repeat(across[:, k], 3), len(vertices)) for k in range(3)], -1)
    length = np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-300)
    return np.where(twice[:, None], vertices - _VERTEX_SHIFT * normals / length, vertices)


def _point_spacing(seen: Mesh, own: float, points: int) -> float:
    """Target spacing of points on the surface, m: that of the input, bounded by the part's size and by the number of
    points."""
    most = bounding_diagonal(seen) / _MIN_SPACINGS
    least = float(np.sqrt(2 / np.sqrt(3) * seen.areas().sum() / points))  # equilateral triangles
    return max(min(own, most), least)


def _extract_solid(
    seen: Mesh, spacing: float, space: SpaceGrid | None, settings: MeshSettings
) -> tuple[manifold3d.Manifold | None, Supposed]:
    """The solid of the module's formula, None when there is none; and what symmetries supposed."""
    vertices, faces = trimesh.remesh.subdivide_to_size(seen.vertices, seen.faces, 1.5 * spacing, max_iter=30)
    own = points = vertices[_pick_one_per_cell(vertices, 0.5 * spacing)]
    tree = cKDTree(own)
    across = 0.5 * triangle_normals(vertices, faces)
    centre, area = vertices[faces].mean(1), np.linalg.norm(across, axis=1)
    nearest = tree.query(centre)[1]
    normal = np.stack([np.bincount(nearest, across[:, k], len(own)) for k in range(3)], -1).astype(float)
    length = np.linalg.norm(normal, axis=1)
    tolerance = PLANE_TOLERANCE * bounding_diagonal(seen)
    planes = fit_planes(own[length > 0], normal[length > 0] / length[length > 0, None], tolerance)
    normals, offsets = suppose_planes(own, planes)
    axes, few = plane_axes(planes, own), settings.points // 4
    more = [sample_planes(normals, offsets, own, axes, _PLANE_SPACINGS * spacing, few)]
    supposed = Supposed()
    if space is not None:
        more.append(_sample_free_space(own, space, few))
        facing = length > 0
        supposed = suppose_by_symmetry(seen, own[facing], normal[facing] / length[facing, None], axes, space, spacing)
    added = np.concatenate([supposed.points, *more])
    points = np.concatenate([own, added[tree.query(added)[0] > spacing], _sample_backs(own, normal, spacing, space)])
    try:
        tetrahedra = Delaunay(points)
    except QhullError:
        return None, supposed
    step = _PROBE_OFFSET * spacing * across / np.maximum(area, 1e-300)[:, None]
    centre = np.concatenate([centre, supposed.points])
    step = np.concatenate([step, _PROBE_OFFSET * spacing * supposed.normals])
    worth = np.append(OBSERVED_WEIGHT * area, supposed.bits * spacing**2)
    start = tetrahedra.vertex_to_simplex[cKDTree(points).query(centre)[1]]
    evidence = np.zeros(len(tetrahedra.simplices))
    for sign in (-1.0, 1.0):
        place = _locate_tetrahedra(points, tetrahedra.simplices, tetrahedra.neighbors, start, centre + sign * step)
        np.subtract.at(evidence, place[place >= 0], sign * worth[place >= 0])
    if space is not None:
        corners = points[tetrahedra.simplices]
        volume = np.abs(np.linalg.det(corners[:, 1:] - corners[:, :1])) / 6
        evidence -= volume / space.voxel * (space.look_up(corners.mean(1)) != UNKNOWN)
    normal = np.concatenate([normal, np.zeros((len(points) - len(own), 3))])
    known = _classify_by_normals(tetrahedra, normal)
    inside = _minimum_cut(
        tetrahedra, _facet_costs(tetrahedra, normals, offsets, tolerance), evidence, known, np.sqrt(3) / 4 * spacing**2
    )
    inside = _drop_small_components(tetrahedra, inside)
    boundary = _boundary_triangles(tetrahedra, _fill_pinched_edges(tetrahedra, inside))
    return _make_solid(points, boundary) if len(boundary) else None, supposed


def _facet_costs(
    tetrahedra: Delaunay, normals: NDArray[np.float64], offsets: NDArray[np.float64], tolerance: float
) -> NDArray[np.float64]:
    """(T, 4) m^2 that each facet costs as a boundary: its area, `PLANE_WEIGHT` of it where all its corners are within
    `tolerance`, m, of one of the planes."""
    points, facets = tetrahedra.points, tetrahedra.simplices[:, _FACETS]
    near = np.abs(points @ normals.T - offsets) < tolerance
    bits = (near @ (1 << np.arange(len(offsets), dtype=np.uint64)).astype(np.uint64)).astype(np.uint64)
    on = (bits[facets[..., 0]] & bits[facets[..., 1]] & bits[facets[..., 2]]) != 0
    area = 0.5 * np.linalg.norm(triangle_normals(points, facets), axis=-1)
    return np.asarray(np.where(on, PLANE_WEIGHT, 1.0) * area)


@njit(cache=True)
def _locate_tetrahedra(
    points: NDArray[np.float64],
    simplices: NDArray[np.int32],
    neighbours: NDArray[np.int32],
    start: NDArray[np.int32],
    targets: NDArray[np.float64],
) -> NDArray[np.int64]:
    """(n,) the tetrahedron that contains each of `targets` (n, 3); -1 outside the hull or when not found.

    A walk from tetrahedron `start` (n,) through facets that have the target beyond them (Devillers et al. 2002).
    """
    found = np.full(len(targets), -1)
    for i in range(len(targets)):
        t = start[i]
        for _ in range(_WALK_STEPS):
            if t < 0:
                break
            beyond = -1
            for k in range(4):
                a = points[simplices[t, (k + 1) % 4]]
                b = points[simplices[t, (k + 2) % 4]] - a
                c = points[simplices[t, (k + 3) % 4]] - a
                p, q = targets[i] - a, points[simplices[t, k]] - a
                x, y, z = b[1] * c[2] - b[2] * c[1], b[2] * c[0] - b[0] * c[2], b[0] * c[1] - b[1] * c[0]
                if (x * p[0] + y * p[1] + z * p[2]) * (x * q[0] + y * q[1] + z * q[2]) < 0:
                    beyond = k
                    break
            if beyond < 0:
                found[i] = t
                break
            t = neighbours[t, beyond]
    return found


def _classify_by_normals(tetrahedra: Delaunay, normal: NDArray[np.floating]) -> NDArray[np.int8]:
    """(T,) 1 where the observed surface at all four corners, with `normal` (n, 3), faces away from the tetrahedron's
    centre, -1 where it faces it, 0 otherwise."""
    corners = tetrahedra.points[tetrahedra.simplices]
    ahead = corners.mean(1)[:, None] - corners
    n = normal[tetrahedra.simplices]
    size = np.linalg.norm(ahead, axis=-1) * np.linalg.norm(n, axis=-1)
    cosine = np.einsum("tki,tki->tk", ahead, n) / np.maximum(size, 1e-300)
    away, facing = (cosine < -_FACING_COSINE).all(1), (cosine > _FACING_COSINE).all(1)
    return np.asarray(away.astype(np.int8) - facing.astype(np.int8))


def _sample_free_space(own: NDArray[np.float64], space: SpaceGrid, most: int) -> NDArray[np.float64]:
    """At most `most` centres, evenly spread, of the known empty voxels within the box of `own`."""
    free = space.centres(space.state != UNKNOWN)
    free = free[((free > own.min(0)) & (free < own.max(0))).all(1)]
    size = space.voxel
    while len(free) > most:
        free, size = free[_pick_one_per_cell(free, size)], 1.25 * size
    return free


def _sample_backs(
    own: NDArray[np.float64], normal: NDArray[np.float64], spacing: float, space: SpaceGrid | None
) -> NDArray[np.float64]:
    """(m, 3) where known empty space begins behind seen points `own` (n, 3) with outward normals (n, 3) of any length,
    up to `_BACK_SPACINGS` deep.

    Without them needles alone stand behind a thin wall's seen face. Their area costs more than the face is worth, and
    the cut takes the wall away.
    """
    length = np.linalg.norm(normal, axis=1)
    if space is None or not length.any():
        return np.zeros((0, 3))
    own, normal = own[length > 0], normal[length > 0] / length[length > 0, None]
    depth = space.depth_to_empty(own, normal, _BACK_SPACINGS * spacing)
    found = np.isfinite(depth)
    backs = own[found] - depth[found, None] * normal[found]
    distance, nearest = cKDTree(own).query(backs)
    ahead = np.einsum("ij,ij->i", backs - own[nearest], normal[nearest])  # of the other side, where that was seen
    backs = backs[(distance > 0.5 * spacing) & (ahead < 0)]
    return backs[_pick_one_per_cell(backs, 0.5 * spacing)]


def _pick_one_per_cell(points: NDArray[np.float64], size: float) -> NDArray[np.int64]:
    """Indices of the first point in each cubic cell of side `size`."""
    if len(points) == 0:
        return np.zeros(0, np.int64)
    return np.sort(np.unique(number_cells(points - points.min(0), size), return_index=True)[1])


_FACETS = np.array([[1, 2, 3], [0, 3, 2], [0, 1, 3], [0, 2, 1]])
"""Facet k of a tetrahedron is opposite its corner k."""


def _minimum_cut(
    tetrahedra: Delaunay,
    area: NDArray[np.float64],
    evidence: NDArray[np.float64],
    known: NDArray[np.int8],
    unit_area: float,
) -> NDArray[np.bool_]:
    """(T,) which tetrahedra are solid.

    Args:
        tetrahedra: Delaunay tetrahedra; outside the hull is air.
        area: (T, 4) m^2 that a facet costs as a boundary.
        evidence: (T,) m^2 that a tetrahedron costs as air (above 0) or as solid (below).
        known: (T,) 1 fixed as solid, -1 fixed as air, 0 open.
        unit_area: m^2 of a mean triangle, for integer capacities.
    """
    sure = _presolve(tetrahedra.neighbors, area, evidence, known)
    open_ = np.flatnonzero(sure == 0)
    n, solid, air = len(open_), len(open_), len(open_) + 1
    node = np.where(sure > 0, solid, air)
    node[open_] = np.arange(n)
    ends = np.where(tetrahedra.neighbors < 0, air, node[tetrahedra.neighbors])[open_]
    starts = np.repeat(np.arange(n), 4).reshape(n, 4)
    towards_solid, weight = ends == solid, area[open_]
    rows = np.concatenate([np.where(towards_solid, solid, starts).ravel(), np.full(n, solid), np.arange(n)])
    columns = np.concatenate([np.where(towards_solid, starts, ends).ravel(), np.arange(n), np.full(n, air)])
    areas = np.concatenate([weight.ravel(), np.maximum(evidence[open_], 0), np.maximum(-evidence[open_], 0)])
    capacity = np.minimum(np.rint(areas * (_CAPACITY_UNITS / unit_area)), 2**30).astype(np.int32)
    graph = coo_matrix((capacity, (rows, columns)), shape=(n + 2, n + 2)).tocsr()  # duplicate entries are summed
    residual = graph - maximum_flow(graph, solid, air).flow
    residual.data = np.maximum(residual.data, 0)
    residual.eliminate_zeros()
    inside = np.zeros(n + 2, bool)
    inside[breadth_first_order(residual, solid, return_predecessors=False)] = True
    return inside[node]


def _presolve(
    neighbours: NDArray[np.int32], area: NDArray[np.float64], evidence: NDArray[np.float64], known: NDArray[np.int8]
) -> NDArray[np.int8]:
    """(T,) 1 or -1 where a tetrahedron is solid or air in some minimum cut whatever its open neighbours are, else 0.

    Its pull to one side is then at least everything that could pull it to the other. The minimum stays the same, and
    little of the graph is left.
    """
    sure = np.append(known, np.int8(-1))  # neighbour -1: outside the hull
    open_ = np.flatnonzero(known == 0)
    for _ in range(_PRESOLVE_ROUNDS):
        adjacent, facets = sure[neighbours[open_]], area[open_]
        pull = evidence[open_] + (adjacent * facets).sum(1)
        doubt = np.where(adjacent == 0, facets, 0.0).sum(1)
        decided = np.abs(pull) >= doubt
        sure[open_[decided]] = np.sign(pull[decided])
        if decided.sum() <= len(open_) // 1000:
            break
        open_ = np.flatnonzero(sure[:-1] == 0)
    return sure[:-1]


def _drop_small_components(tetrahedra: Delaunay, inside: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """The solid without components, and without hollows, of less than `MIN_COMPONENT` of its volume."""
    corners = tetrahedra.points[tetrahedra.simplices]
    volume = np.abs(np.linalg.det(corners[:, 1:] - corners[:, :1])) / 6
    n = len(inside)
    for kind in (True, False):
        same = (
            (tetrahedra.neighbors >= 0) & (inside[tetrahedra.neighbors] == inside[:, None]) & (inside == kind)[:, None]
        )
        first, k = np.nonzero(same)
        links = coo_matrix((np.ones(len(first), bool), (first, tetrahedra.neighbors[first, k])), shape=(n, n))
        _, label = connected_components(links, directed=False)
        size = np.bincount(label, volume)
        small = size < min(MIN_COMPONENT * volume[inside].sum(), size[label[inside]].max(initial=0.0))
        if not kind:  # air that reaches the hull is no hollow
            small[label[(tetrahedra.neighbors < 0).any(1)]] = False
        inside = np.where((inside == kind) & small[label], not kind, inside)
    return inside


def _fill_pinched_edges(tetrahedra: Delaunay, inside: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """The solid with edges at which it touches itself filled all round, so that no edge has more than two triangles."""
    inside = inside.copy()
    for _ in range(_PINCH_ROUNDS):
        edges = np.sort(_boundary_facets(tetrahedra, inside)[1][:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1)
        of, count = np.unique(edges @ [len(tetrahedra.points), 1], return_counts=True)
        pinched = np.stack(np.divmod(of[count > 2], len(tetrahedra.points)), -1)
        if len(pinched) == 0:
            break
        flags = np.zeros(len(tetrahedra.points), bool)
        flags[pinched] = True
        near = np.flatnonzero(flags[tetrahedra.simplices].sum(1) >= 2)
        corners = tetrahedra.simplices[near]
        for a, b in pinched:
            inside[near[(corners == a).any(1) & (corners == b).any(1)]] = True
    return inside


def _boundary_facets(tetrahedra: Delaunay, inside: NDArray[np.bool_]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """(F,) solid tetrahedra at the air, and (F, 3) their facets there."""
    beyond = (tetrahedra.neighbors >= 0) & inside[tetrahedra.neighbors]
    of, k = np.nonzero(inside[:, None] & ~beyond)
    return of, np.take_along_axis(tetrahedra.simplices[of], _FACETS[k], axis=1).astype(np.int64)


def _boundary_triangles(tetrahedra: Delaunay, inside: NDArray[np.bool_]) -> NDArray[np.int64]:
    """(F, 3) triangles between solid and air, counter-clockwise seen from the air."""
    of, facets = _boundary_facets(tetrahedra, inside)
    hands = _orientations(tetrahedra.simplices, tetrahedra.neighbors, _FACETS)
    corners = tetrahedra.points[tetrahedra.simplices]
    volume = np.linalg.det(corners[:, 1:] - corners[:, :1])
    largest = np.abs(volume).argmax()
    turn = hands[of] * hands[largest] * volume[largest] < 0
    facets[turn] = facets[turn][:, ::-1]
    return facets


@njit(cache=True)
def _orientations(
    simplices: NDArray[np.int32], neighbours: NDArray[np.int32], order: NDArray[np.int64]
) -> NDArray[np.int64]:
    """(T,) 1 for tetrahedra with the corner order of the first one, -1 for mirrored ones.

    Propagated between neighbours: the sign of the volume is noise for flat tetrahedra.
    """
    hands = np.zeros(len(simplices), np.int64)
    hands[0] = 1
    queue = [0]
    while len(queue):
        t = queue.pop()
        for k in range(4):
            u = neighbours[t, k]
            if u < 0 or hands[u] != 0:
                continue
            across = 0
            while neighbours[u, across] != t:
                across += 1
            first, second = simplices[t, order[k, 0]], simplices[t, order[k, 1]]
            same = False
            for i in range(3):
                a, b = simplices[u, order[across, i]], simplices[u, order[across, (i + 1) % 3]]
                same = same or (a == second and b == first)
            hands[u] = hands[t] if same else -hands[t]
            queue.append(u)
    return hands


def _find_observed(
    vertices: NDArray[np.float64], faces: NDArray[np.int64], seen: Mesh, spacing: float
) -> NDArray[np.bool_]:
    """(F,) which triangles lie on observed ones of the same orientation, at most of their sample points.

    Patches smaller than the square of four spacings are below the sampling's resolution and count as observed.
    """
    surface, across = Winding(seen), triangle_normals(seen.vertices, seen.faces)
    normal = triangle_normals(vertices, faces)
    distance, nearest = surface.nearest(np.einsum("sk,fki->sfi", _SAMPLE_WEIGHTS, vertices[faces]).reshape(-1, 3))
    same_side = np.einsum("sfi,fi->sf", across[nearest].reshape(len(_SAMPLE_WEIGHTS), -1, 3), normal) > 0
    votes = (same_side & (distance.reshape(same_side.shape) < _OBSERVED_DISTANCE * spacing)).sum(0)
    observed = 2 * votes > len(_SAMPLE_WEIGHTS)
    pairs = trimesh.graph.face_adjacency(faces)
    pairs = pairs[~observed[pairs].any(1)]
    label = trimesh.graph.connected_component_labels(pairs, node_count=len(faces))
    area = np.bincount(label, 0.5 * np.linalg.norm(normal, axis=1))
    return np.asarray(observed | (area[label] < (4 * spacing) ** 2))


def _thicken_sheet(seen: Mesh, thickness: float) -> Mesh | None:
    """A flat sheet with its copy `thickness` behind it and a rim; None when it is not flat."""
    used = seen.vertices
    _, extent, _ = np.linalg.svd(used - used.mean(0), full_matrices=False)
    if len(extent) == 3 and extent[2] > 1e-4 * extent[0]:
        return None
    normal = triangle_normals(used, seen.faces).sum(0)
    if not np.linalg.norm(normal) > 0:
        return None
    normal /= np.linalg.norm(normal)
    edges = seen.faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2)
    _, where, count = np.unique(np.sort(edges, axis=1), axis=0, return_index=True, return_counts=True)
    rim, n = edges[where[count == 1]], len(used)
    sides = np.concatenate([rim[:, [1, 0, 0]] + [0, 0, n], rim[:, [1, 0, 1]] + [0, n, n]])
    return Mesh(
        np.concatenate([used, used - thickness * normal]),
        np.concatenate([seen.faces, seen.faces[:, ::-1] + n, sides]),
    )


def _make_solid(points: NDArray[np.float64], faces: NDArray[np.int64]) -> manifold3d.Manifold | None:
    """The solid inside these triangles; None when they enclose none.

    manifold3d splits the surface where it touches itself in an edge or a point; overlapping pieces are united.
    """
    mesh = manifold3d.Mesh64(np.array(points, order="C"), np.array(faces, np.uint64, order="C"))
    solid = manifold3d.Manifold(mesh)
    if solid.status() != manifold3d.Error.NoError:
        return None
    pieces = solid.decompose()
    if len(pieces) > 1 and all(piece.volume() > 0 for piece in pieces):
        solid = manifold3d.Manifold.batch_boolean(pieces, manifold3d.OpType.Add)
    return solid if solid.volume() > 0 else None


def _simplify(solid: manifold3d.Manifold, tolerance: float, max_faces: int) -> manifold3d.Manifold:
    """The solid with about `max_faces` triangles at most, by quadric decimation (Garland and Heckbert 1997).

    First, vertices that move the surface by less than the tolerance go. Where decimation breaks the surface,
    manifold3d's own simplification is used: it moves the surface twice as much, but always gives a solid.
    """
    simple = solid.simplify(tolerance)
    for _ in range(_DECIMATIONS):
        if simple.num_tri() <= max_faces:
            return simple
        points, faces = _to_arrays(simple)
        points, faces = fast_simplification.simplify(
            points.astype(np.float32), faces.astype(np.int32), target_count=int(0.98 * max_faces), agg=_AGGRESSION
        )
        decimated = _make_solid(points.astype(float), faces.astype(np.int64))
        if decimated is None or decimated.num_tri() >= simple.num_tri():
            break
        simple = decimated
    while simple.num_tri() > max_faces:
        tolerance *= 2
        simple = simple.simplify(tolerance)
    return simple


def _to_arrays(solid: manifold3d.Manifold) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    mesh = solid.to_mesh64()
    return np.asarray(mesh.vert_properties)[:, :3].astype(float), np.asarray(mesh.tri_verts).astype(np.int64)


def _transfer_colours(mesh: Mesh, part: Mesh) -> Mesh:
    """The mesh with the colours of the part's nearest vertices."""
    if part.colours is None:
        return mesh
    used = np.unique(part.faces)
    nearest = cKDTree(part.vertices[used]).query(mesh.vertices)[1]
    return replace(mesh, colours=part.colours[used][nearest])
