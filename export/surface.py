"""A part's surface as the closed boundary of a solid: what was seen stays where it is, what was not gets a patch.

A reconstruction has triangles only where a frame looked. Its vertices cut space into Delaunay tetrahedra, and the solid
is the set of tetrahedra whose boundary S is least in

    area(S) + FAITH * (area of the observed triangles that do not have the solid behind and air in front of them)

found as a minimum cut (Labatut, Pons, Keriven: Efficient multi-view reconstruction of large-scale scenes using interest
points, Delaunay triangulation and graph cuts, ICCV 2007). Where the surface at all four corners of a tetrahedron faces
it, or turns its back to it, that is settled beforehand. So a hole is closed by the least area that its rim allows, a
thin thing seen from both sides becomes two sheets with a rim, and an opening whose inside was seen stays open. The
boundary of a solid is closed and consistently oriented, and its vertices were observed; decimation then thins them.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import fast_simplification
import manifold3d
import numpy as np
import trimesh
from numba import njit
from numpy.typing import NDArray
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import breadth_first_order, connected_components, maximum_flow
from scipy.spatial import Delaunay, QhullError, cKDTree

from export.meshes import MeshSettings, deduplicated, inside_out, turned, without_crumbs
from freeart21.errors import FreeArtError
from freeart21.mesh import Mesh, bounding_diagonal

MAX_FACES = 4_000_000
"""Triangles of a part that are looked at, ten times those of our largest reconstruction."""
MAX_LAYERS = 4.0
"""Times the area of the solid's boundary that a part's triangles may have. Of 18 parts of nine true objects they have
0.3 to 1.0, of a cabinet of loose boards (PartNet-Mobility 45940) 1.8, of 5,000 random triangles 20."""
FAITH = 8.0
"""How much more an observed area weighs than an equal area of the boundary: at 1 holes would eat the surface."""
_SIDE = 0.25
"""Spacings before and behind an observed triangle at which there is air and solid: a wall may be half of one thick."""
_NEAR = 1.0
"""Spacings within which a boundary triangle counts as observed; further from all that was seen it is a patch."""
_ACROSS = 150.0
"""Spacings along a part's diagonal at least: what a wall between two large triangles needs to be told from a hollow."""
_CLEAR = 0.2
"""Cosine beyond which a surface faces a place, or turns its back to it."""
_STEPS = 1000
"""Tetrahedra that a walk may pass."""
_PINCHES = 20
"""Rounds of filling edges at which the solid touches itself."""
_ROUNDS = 100
"""Rounds of taking plain tetrahedra out of the cut; later ones take few."""
_NEIGHBOURS = 4
"""Observed triangles that a place on the boundary is held against."""
_SAMPLES = np.array([[4, 1, 1], [1, 4, 1], [1, 1, 4]]) / 6
"""Places on a triangle, as weights of its corners, that are asked whether they were seen."""
_AGGRESSION = 3.0
"""Of quadric decimation: with less it stops before its aim, with more it moves a monitor's surface by a third more."""
_DECIMATIONS = 3
"""Tries of quadric decimation, which may stop a little above its aim."""
_UNITS = 200.0
"""Integer capacity of a triangle of mean area in the cut."""
_APART = 1e-6
"""m that vertices of one place are moved: more than OBJ's digits, less than anything that is measured."""
_FIRST_TOLERANCE = 1 / 20
"""Spacings by which simplifying may move the surface at first; doubled until there are few enough triangles."""


@dataclass(frozen=True)
class Surface:
    """The closed surface of one part. Its first triangles are observed, its last ones the patch."""

    mesh: Mesh
    """Watertight, oriented outwards, of positive volume; vertices shared."""
    patch_first: int
    """First triangle that closes what nobody saw; all after it do, too."""
    turned: bool = False
    """Whether the part's triangles faced inwards and were turned."""
    layers: float = 1.0
    """Area that was given, crumbs too, over the area of the mesh, which is the boundary of the solid."""

    @property
    def is_solid(self) -> bool:
        """Whether what was given is the surface of a solid for the most part, and does not cross it everywhere."""
        return self.layers <= MAX_LAYERS

    @property
    def observed(self) -> NDArray[np.bool_]:
        """(F,) which triangles were seen."""
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


def closed(part: Mesh, settings: MeshSettings, elsewhere: NDArray[np.float64] | None = None) -> Surface:
    """The closed surface of a part, of about `max_faces` triangles at most.

    `elsewhere` (n, 3) are places in the part's frame where it is not: where the other part was seen to go. A patch
    keeps out of their way.

    Raises FreeArtError when there is no triangle of any area, or more than `MAX_FACES`.
    """
    if len(part.faces) > MAX_FACES:
        raise FreeArtError(f"mesh has {len(part.faces)} triangles, expected at most {MAX_FACES}")
    given = deduplicated(Mesh(part.vertices, part.faces))
    seen = without_crumbs(given, settings.min_component)
    if seen.empty:
        raise FreeArtError("mesh has no triangle of any area")
    wrong_way = inside_out(seen)
    seen = turned(seen) if wrong_way else seen
    own = float(np.sqrt(4 / np.sqrt(3) * seen.areas().mean()))
    spacing = _spacing(seen, own, settings.points)
    solid = _solid(seen.vertices, seen.faces)
    whole = solid is not None
    if solid is None:
        sheet = _thickened(seen, settings.sheet_m)
        solid = _solid(sheet.vertices, sheet.faces) if sheet is not None else _cut(seen, spacing, elsewhere, settings)
    if solid is None:
        raise FreeArtError("mesh cannot be closed: it has no inside")
    if not whole or solid.num_tri() > settings.max_faces:
        solid = _simplified(solid, _FIRST_TOLERANCE * min(own, spacing), settings.max_faces)
    vertices, faces = _arrays(solid)
    vertices = _apart(vertices, faces)
    observed = np.ones(len(faces), bool) if whole else _observed(vertices, faces, seen, spacing)
    faces = faces[np.argsort(~observed, kind="stable")]
    mesh = _coloured(Mesh(vertices, faces), part)
    return Surface(mesh, int(observed.sum()), wrong_way, float(given.areas().sum() / mesh.areas().sum()))


def _apart(vertices: NDArray[np.float64], faces: NDArray[np.int64]) -> NDArray[np.float64]:
    """Vertices (n, 3), those that share a place moved a micrometre inwards: two sheets that touch in an edge are closed
    each, but whoever merges equal places makes one edge of four triangles of them."""
    _, place, count = np.unique(vertices, axis=0, return_inverse=True, return_counts=True)
    twice = count[place.reshape(-1)] > 1
    corners = vertices[faces]
    across = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals = np.stack([np.bincount(faces.ravel(), np.repeat(across[:, k], 3), len(vertices)) for k in range(3)], -1)
    length = np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-300)
    return np.where(twice[:, None], vertices - _APART * normals / length, vertices)


def _spacing(seen: Mesh, own: float, points: int) -> float:
    """How far apart points on the surface are to stand, metres: as they do, but not too far, and not too many."""
    most = bounding_diagonal(seen) / _ACROSS
    least = float(np.sqrt(2 / np.sqrt(3) * seen.areas().sum() / points))  # equilateral triangles
    return max(min(own, most), least)


def _cut(
    seen: Mesh, spacing: float, elsewhere: NDArray[np.float64] | None, settings: MeshSettings
) -> manifold3d.Manifold | None:
    """The solid of the module's formula.

    Where the other part was (`elsewhere`), solid costs a cell face a cell: thick regions are cleared, films stay.
    """
    vertices, faces = trimesh.remesh.subdivide_to_size(seen.vertices, seen.faces, 1.5 * spacing, max_iter=30)
    own = points = vertices[_thinned(vertices, 0.5 * spacing)]
    if elsewhere is not None:
        free, size = _clear_of(own, elsewhere, spacing, settings.points // 4)
        points = np.concatenate([own, free])
    corners = vertices[faces]
    across = 0.5 * np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    centre, area = corners.mean(1), np.linalg.norm(across, axis=1)
    try:
        tetrahedra = Delaunay(points)
    except QhullError:
        return None
    nearest = cKDTree(own).query(centre)[1]
    step = _SIDE * spacing * across / np.maximum(area, 1e-300)[:, None]
    start = tetrahedra.vertex_to_simplex[nearest]
    evidence = np.zeros(len(tetrahedra.simplices))
    for sign in (-1.0, 1.0):
        place = _located(points, tetrahedra.simplices, tetrahedra.neighbors, start, centre + sign * step)
        np.subtract.at(evidence, place[place >= 0], sign * FAITH * area[place >= 0])
    if elsewhere is not None and len(free):
        corners = points[tetrahedra.simplices]
        volume = np.abs(np.linalg.det(corners[:, 1:] - corners[:, :1])) / 6
        evidence -= volume / size * _same_cell(corners.mean(1), free, size)
    normal = np.stack([np.bincount(nearest, across[:, k], len(points)) for k in range(3)], -1).astype(float)
    inside = _least_boundary(tetrahedra, evidence, _unanimous(tetrahedra, normal), np.sqrt(3) / 4 * spacing**2)
    inside = _without_specks(tetrahedra, inside, settings.min_component)
    boundary = _boundary(tetrahedra, _without_pinches(tetrahedra, inside))
    return _solid(points, boundary) if len(boundary) else None


@njit(cache=True)
def _located(points, simplices, neighbours, start, targets):
    """(n,) the tetrahedron in which each of `targets` (n, 3) lies, -1 outside of the hull or where none is found.

    A walk from tetrahedron `start` (n,), through every facet that has the target beyond it (Devillers et al. 2002).
    """
    found = np.full(len(targets), -1)
    for i in range(len(targets)):
        t = start[i]
        for _ in range(_STEPS):
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


def _unanimous(tetrahedra: Delaunay, normal: NDArray[np.floating]) -> NDArray[np.int8]:
    """(T,) 1 where the observed surface at all four corners, of `normal` (n, 3), turns its back to a tetrahedron's
    middle, -1 where its face, 0 where they do not say the same."""
    corners = tetrahedra.points[tetrahedra.simplices]
    ahead = corners.mean(1)[:, None] - corners
    n = normal[tetrahedra.simplices]
    size = np.linalg.norm(ahead, axis=-1) * np.linalg.norm(n, axis=-1)
    cosine = np.einsum("tki,tki->tk", ahead, n) / np.maximum(size, 1e-300)
    return (cosine < -_CLEAR).all(1).astype(np.int8) - (cosine > _CLEAR).all(1).astype(np.int8)


def _clear_of(
    own: NDArray[np.float64], elsewhere: NDArray[np.float64], spacing: float, most: int
) -> tuple[NDArray[np.float64], float]:
    """Of the places `elsewhere` in the box of `own` one a cell, `most` at most, 2 spacings off; the cells' side."""
    inside = ((elsewhere > own.min(0)) & (elsewhere < own.max(0))).all(1)
    size, free = spacing, elsewhere[inside]
    while len(free := free[_thinned(free, size)]) > most:
        size *= 1.25
    return free[cKDTree(own).query(free)[0] > 2 * spacing] if len(free) else free, size


def _same_cell(places: NDArray[np.float64], marked: NDArray[np.float64], size: float) -> NDArray[np.bool_]:
    """(n,) whether a cubic cell of side `size` holds both one of the places (n, 3) and one of those `marked`."""
    low = marked.min(0)
    shape = np.floor((marked.max(0) - low) / size).astype(np.int64) + 1
    cells = np.floor((places - low) / size).astype(np.int64)
    within = ((cells >= 0) & (cells < shape)).all(1)
    flat = np.ravel_multi_index(np.where(within[:, None], cells, 0).T, shape)
    known = np.unique(np.ravel_multi_index(np.floor((marked - low) / size).astype(np.int64).T, shape))
    return within & np.isin(flat, known)


def _thinned(points: NDArray[np.float64], size: float) -> NDArray[np.int64]:
    """Indices of one point in each cubic cell of side `size`: the first."""
    if len(points) == 0:
        return np.zeros(0, np.int64)
    cells = np.floor((points - points.min(0)) / size).astype(np.int64)
    return np.sort(np.unique(cells, axis=0, return_index=True)[1])


_FACETS = np.array([[1, 2, 3], [0, 3, 2], [0, 1, 3], [0, 2, 1]])
"""Facet k of a tetrahedron is across from its corner k."""


def _least_boundary(
    tetrahedra: Delaunay, evidence: NDArray[np.float64], known: NDArray[np.int8], unit_area: float
) -> NDArray[np.bool_]:
    """(T,) which tetrahedra are solid: the minimum cut.

    `evidence` (T,) is the area, m^2, that a tetrahedron costs as air (above 0) or as solid (below); those `known` (T,)
    to be solid (1) or air (-1) are so, and outside of the hull is air.
    """
    facets = tetrahedra.points[tetrahedra.simplices[:, _FACETS]]
    area = 0.5 * np.linalg.norm(np.cross(facets[:, :, 1] - facets[:, :, 0], facets[:, :, 2] - facets[:, :, 0]), axis=-1)
    sure = _plain(tetrahedra.neighbors, area, evidence, known)
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
    capacity = np.minimum(np.rint(areas * (_UNITS / unit_area)), 2**30).astype(np.int32)
    graph = coo_matrix((capacity, (rows, columns)), shape=(n + 2, n + 2)).tocsr()  # what says the same is summed
    left = graph - maximum_flow(graph, solid, air).flow
    left.data = np.maximum(left.data, 0)
    left.eliminate_zeros()
    inside = np.zeros(n + 2, bool)
    inside[breadth_first_order(left, solid, return_predecessors=False)] = True
    return inside[node]


def _plain(
    neighbours: NDArray[np.int32], area: NDArray[np.float64], evidence: NDArray[np.float64], known: NDArray[np.int8]
) -> NDArray[np.int8]:
    """(T,) 1 or -1 where a tetrahedron is solid or air in some minimum cut whatever its open neighbours are, else 0.

    What pulls it to one side is then at least all that could pull it to the other. Taking these out first leaves the
    minimum as it is, and a small part of the graph.
    """
    sure = np.append(known, np.int8(-1))  # neighbour -1: outside of the hull
    open_ = np.flatnonzero(known == 0)
    for _ in range(_ROUNDS):
        beside, facets = sure[neighbours[open_]], area[open_]
        pull = evidence[open_] + (beside * facets).sum(1)
        doubt = np.where(beside == 0, facets, 0.0).sum(1)
        decided = np.abs(pull) >= doubt
        sure[open_[decided]] = np.sign(pull[decided])
        if decided.sum() <= len(open_) // 1000:
            break
        open_ = np.flatnonzero(sure[:-1] == 0)
    return sure[:-1]


def _without_specks(tetrahedra: Delaunay, inside: NDArray[np.bool_], fraction: float) -> NDArray[np.bool_]:
    """The solid without loose pieces, and without hollows, of less than `fraction` of its volume."""
    corners = tetrahedra.points[tetrahedra.simplices]
    volume = np.abs(np.linalg.det(corners[:, 1:] - corners[:, :1])) / 6
    n = len(inside)
    for kind in (True, False):
        alike = (
            (tetrahedra.neighbors >= 0) & (inside[tetrahedra.neighbors] == inside[:, None]) & (inside == kind)[:, None]
        )
        first, k = np.nonzero(alike)
        links = coo_matrix((np.ones(len(first), bool), (first, tetrahedra.neighbors[first, k])), shape=(n, n))
        _, label = connected_components(links, directed=False)
        size = np.bincount(label, volume)
        small = size < min(fraction * volume[inside].sum(), size[label[inside]].max(initial=0.0))
        if not kind:  # air that reaches the hull is no hollow
            small[label[(tetrahedra.neighbors < 0).any(1)]] = False
        inside = np.where((inside == kind) & small[label], not kind, inside)
    return inside


def _without_pinches(tetrahedra: Delaunay, inside: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """The solid with edges at which its boundary touches itself filled all round: no two triangles share them then."""
    inside = inside.copy()
    for _ in range(_PINCHES):
        faces = _boundary(tetrahedra, inside)
        edges = np.sort(faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1)
        edges, count = np.unique(edges, axis=0, return_counts=True)
        pinched = edges[count > 2]
        if len(pinched) == 0:
            break
        flags = np.zeros(len(tetrahedra.points), bool)
        flags[pinched] = True
        near = np.flatnonzero(flags[tetrahedra.simplices].sum(1) >= 2)
        corners = tetrahedra.simplices[near]
        for a, b in pinched:
            inside[near[(corners == a).any(1) & (corners == b).any(1)]] = True
    return inside


def _boundary(tetrahedra: Delaunay, inside: NDArray[np.bool_]) -> NDArray[np.int64]:
    """(F, 3) triangles between solid and air, counter-clockwise seen from the air."""
    beyond = (tetrahedra.neighbors >= 0) & inside[tetrahedra.neighbors]
    of, k = np.nonzero(inside[:, None] & ~beyond)
    facets = np.take_along_axis(tetrahedra.simplices[of], _FACETS[k], axis=1).astype(np.int64)
    hands = _hands(tetrahedra.simplices, tetrahedra.neighbors, _FACETS)
    corners = tetrahedra.points[tetrahedra.simplices]
    volume = np.linalg.det(corners[:, 1:] - corners[:, :1])
    largest = np.abs(volume).argmax()
    turn = hands[of] * hands[largest] * volume[largest] < 0
    facets[turn] = facets[turn][:, ::-1]
    return facets


@njit(cache=True)
def _hands(simplices, neighbours, order):
    """(T,) 1 for tetrahedra whose corners are ordered as those of the first are, -1 for the mirrored.

    From neighbour to neighbour: the volume's sign is noise where a tetrahedron is flat.
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


def _observed(vertices: NDArray[np.float64], faces: NDArray[np.int64], seen: Mesh, spacing: float) -> NDArray[np.bool_]:
    """(F,) which triangles lie on observed ones that face the same way, at most of their points.

    Patches of less than the square of four spacings are within what the sampling tells: they count as observed.
    """
    points, triangles = trimesh.remesh.subdivide_to_size(seen.vertices, seen.faces, 1.5 * spacing, max_iter=30)
    corners = points[triangles]
    centre, across = corners.mean(1), np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    tree = cKDTree(centre)
    corners = vertices[faces]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    votes = np.zeros(len(faces), int)
    k = min(_NEIGHBOURS, len(centre))
    for weights in _SAMPLES:
        place = np.einsum("k,fki->fi", weights, corners)
        distance, nearest = tree.query(place, k=k)
        distance, nearest = distance.reshape(len(faces), k), nearest.reshape(len(faces), k)
        alike = np.einsum("fi,fki->fk", normal, across[nearest]) > 0
        votes += ((distance < _NEAR * spacing) & alike).any(1)
    observed = 2 * votes > len(_SAMPLES)
    pairs = trimesh.graph.face_adjacency(faces)
    pairs = pairs[~observed[pairs].any(1)]
    label = trimesh.graph.connected_component_labels(pairs, node_count=len(faces))
    area = np.bincount(label, 0.5 * np.linalg.norm(normal, axis=1))
    return observed | (area[label] < (4 * spacing) ** 2)


def _thickened(seen: Mesh, thickness: float) -> Mesh | None:
    """A flat sheet with its copy `thickness` behind it and a rim between; None when it is not flat."""
    used = seen.vertices
    _, extent, _ = np.linalg.svd(used - used.mean(0), full_matrices=False)
    if len(extent) == 3 and extent[2] > 1e-4 * extent[0]:
        return None
    a, b, c = (used[seen.faces[:, k]] for k in range(3))
    normal = np.cross(b - a, c - a).sum(0)
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


def _solid(points: NDArray[np.float64], faces: NDArray[np.int64]) -> manifold3d.Manifold | None:
    """The solid inside of these triangles; None when they enclose none.

    Where the surface touches itself in an edge or a point, manifold3d doubles it; pieces that overlap are united.
    """
    mesh = manifold3d.Mesh64(np.array(points, order="C"), np.array(faces, np.uint64, order="C"))
    solid = manifold3d.Manifold(mesh)
    if solid.status() != manifold3d.Error.NoError:
        return None
    pieces = solid.decompose()
    if len(pieces) > 1 and all(piece.volume() > 0 for piece in pieces):
        solid = manifold3d.Manifold.batch_boolean(pieces, manifold3d.OpType.Add)
    return solid if solid.volume() > 0 else None


def _simplified(solid: manifold3d.Manifold, tolerance: float, max_faces: int) -> manifold3d.Manifold:
    """The solid with about `max_faces` triangles at most, by quadric decimation (Garland and Heckbert 1997).

    First goes what moves the surface by less than the tolerance. Where decimation folds the surface beyond repair,
    manifold3d's own simplification has the last word: it moves twice as much, but keeps every solid one.
    """
    simple = solid.simplify(tolerance)
    for _ in range(_DECIMATIONS):
        if simple.num_tri() <= max_faces:
            return simple
        points, faces = _arrays(simple)
        points, faces = fast_simplification.simplify(
            points.astype(np.float32), faces.astype(np.int32), target_count=int(0.98 * max_faces), agg=_AGGRESSION
        )
        decimated = _solid(points.astype(float), faces.astype(np.int64))
        if decimated is None or decimated.num_tri() >= simple.num_tri():
            break
        simple = decimated
    while simple.num_tri() > max_faces:
        tolerance *= 2
        simple = simple.simplify(tolerance)
    return simple


def _arrays(solid: manifold3d.Manifold) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    mesh = solid.to_mesh64()
    return np.asarray(mesh.vert_properties)[:, :3].astype(float), np.asarray(mesh.tri_verts).astype(np.int64)


def _coloured(mesh: Mesh, part: Mesh) -> Mesh:
    """The mesh with the colours of the part's nearest vertices."""
    if part.colours is None:
        return mesh
    used = np.unique(part.faces)
    nearest = cKDTree(part.vertices[used]).query(mesh.vertices)[1]
    return replace(mesh, colours=part.colours[used][nearest])
