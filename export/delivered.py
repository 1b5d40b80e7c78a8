"""What an asset's own files say of its contact: shapes reloaded, and held against what is seen of each link.

The exporter's numbers and `check-asset`'s rule come of this module, which knows a URDF's shapes and nothing of how they
were made.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial
from pathlib import Path

import numpy as np
import trimesh

from export.checklist import shapes_of
from export.decomposition import thickened
from export.fidelity import PER_SHAPES, Fidelity, depth_within, half_spaces, measured
from export.outside import DENSE, even_points, outside_of
from freeart21 import se3
from freeart21.files.urdf import parse_urdf, read_urdf
from freeart21.files.urdf_files import resolve_file
from freeart21.mesh import Mesh
from freeart21.se3 import Array

Shapes = list[tuple[Array, trimesh.Trimesh]]
"""Pose (4, 4) in the link and mesh of each shape."""
_LEAST_POINTS = 5_000
"""Points on a link's surface of an asset with many links; others share `DENSE`, so that the time is bounded."""
_SHEET = 1e-4
"""Part of its size that a contact mesh without a volume is thick: engines refuse it or make it thick themselves."""
_DEPTH_POINTS = 20_000
"""Points on the contact shapes of a link that are looked for in the other's."""


def delivered_shapes(urdf: Path) -> tuple[dict[str, Shapes], dict[str, Shapes]]:
    """Visual and collision shapes of a URDF by link, in its frame, as its files say; raises FreeArtError."""
    files = partial(resolve_file, urdf, root=urdf.parent)
    links = parse_urdf(urdf).findall("link")
    seen, touched = ({e.get("name", ""): shapes_of(e, tag, files) for e in links} for tag in ("visual", "collision"))
    return seen, touched


def contact_fidelity(seen: Mapping[str, Shapes], touched: Mapping[str, Shapes]) -> dict[str, Fidelity]:
    """How true the collision shapes of each link are to the part of its visual meshes that can be seen from outside.

    Only of links that have both. A collision mesh counts as its convex hull, as engines take it.
    """
    visuals = {name: _joined(shapes) for name, shapes in seen.items()}
    names = [name for name, mesh in visuals.items() if mesh.areas().sum() > 0 and convex_shapes(touched.get(name, []))]
    part = max(len(names), 1)
    return {
        name: measured(
            outside_of(visuals[name], max(DENSE // part, _LEAST_POINTS)),
            convex_shapes(touched[name]),
            count=max(PER_SHAPES // part, _LEAST_POINTS),
        )
        for name in names
    }


def contact_depth(urdf: Path, joint: str, touched: Mapping[str, Shapes], count: int) -> float:
    """Metres that the collision shapes (`delivered_shapes`) of a joint's two links are in each other, where they are
    deepest, in `count` positions from limit to limit.

    Points of each one's surface are looked for in single convex shapes of the other, as engines do.
    """
    read = read_urdf(urdf)
    between = read.joints[joint]
    fixed, moving = touched[between.parent], touched[between.child]
    solids = [[trimesh.Trimesh(s.vertices, s.faces, process=False) for s in convex_shapes(x)] for x in (fixed, moving)]
    if not all(solids):
        return 0.0
    spaces = [half_spaces(own) for own in solids]
    points = [np.concatenate([_on(solid, own) for solid in own]) for own in solids]
    deepest = 0.0
    for position in np.linspace(between.lower, between.upper, count):
        Ts = read.link_poses({joint: float(position)})
        T = se3.inverse(Ts[between.parent]) @ Ts[between.child]
        for mine, other, pose in ((1, 0, T), (0, 1, se3.inverse(T))):
            there = se3.transform(pose, points[mine])
            depth = depth_within(there, np.full(len(there), -1), *spaces[other])
            deepest = max(deepest, float(depth.max()))
    return deepest


def convex_shapes(shapes: Shapes) -> list[Mesh]:
    """The convex hull of each shape that has faces, in the link's frame; sheets get a thickness (`_SHEET`)."""
    found = []
    for T, mesh in shapes:
        points = se3.transform(T, np.asarray(mesh.vertices, float)[np.unique(mesh.faces)])
        size = float(np.linalg.norm(np.ptp(points, axis=0))) if len(points) else 0.0
        if size > 0:
            hull = trimesh.convex.convex_hull(thickened(points, _SHEET * size))
            found.append(Mesh(np.asarray(hull.vertices, float), np.asarray(hull.faces)))
    return found


def closed(mesh: trimesh.Trimesh) -> bool:
    """Whether each edge has two faces, with corners of equal position taken for one: seams of textures split them."""
    _, place = np.unique(mesh.vertices, axis=0, return_inverse=True)
    faces = place.reshape(-1)[mesh.faces]
    faces = faces[(faces != np.roll(faces, 1, axis=1)).all(1)]
    edges = np.sort(np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]]), axis=1)
    _, count = np.unique(edges, axis=0, return_counts=True)
    return bool((count % 2 == 0).all())


def _on(solid: trimesh.Trimesh, all_of_them: list[trimesh.Trimesh]) -> Array:
    points, _ = even_points(solid, sum(other.area for other in all_of_them) / _DEPTH_POINTS)
    return np.concatenate([np.asarray(solid.vertices, float), points])


def _joined(shapes: Shapes) -> Mesh:
    """All shapes as one mesh in the link's frame."""
    first = np.cumsum([0, *(len(mesh.vertices) for _, mesh in shapes)])
    vertices = [se3.transform(T, np.asarray(mesh.vertices, float)) for T, mesh in shapes]
    faces = [np.asarray(mesh.faces) + k for (_, mesh), k in zip(shapes, first, strict=False)]
    return Mesh(np.concatenate([np.zeros((0, 3)), *vertices]), np.concatenate([np.zeros((0, 3), int), *faces]))
