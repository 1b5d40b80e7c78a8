"""Contact measured from an asset's files alone: collision shapes against visual meshes, and overlap of the two links.

Used for the exporter's report and for `check-asset`; it needs only a URDF.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial
from pathlib import Path

import numpy as np
import trimesh

from export.checklist import Shapes, load_shapes
from export.decomposition import thicken
from export.fidelity import PER_SHAPES, Fidelity, depth_in_shapes, measure_fidelity, shape_planes
from export.outer_surface import DENSE, sample_evenly, sample_outer_surface
from freeart21 import se3
from freeart21.files.urdf import read_urdf
from freeart21.files.urdf_files import resolve_file
from freeart21.mesh import Mesh, join_meshes
from freeart21.se3 import Array

_MIN_POINTS = 5_000
"""Points on a link's surface when an asset has many links; otherwise they share `DENSE`, which bounds the time."""
_SHEET_SHARE = 1e-4
"""Thickness, over its size, given to a collision mesh without volume: engines reject or thicken it."""
_DEPTH_POINTS = 20_000
"""Points on a link's collision shapes that are tested for being inside the other link's."""


def read_link_shapes(urdf: Path) -> tuple[dict[str, Shapes], dict[str, Shapes]]:
    """Visual and collision shapes of a URDF by link, in the link's frame; raises FreeArtError."""
    files = partial(resolve_file, urdf, root=urdf.parent)
    links = read_urdf(urdf).links
    visuals = {name: load_shapes(link.visuals, files) for name, link in links.items()}
    return visuals, {name: load_shapes(link.collisions, files) for name, link in links.items()}


def measure_contact_fidelity(seen: Mapping[str, Shapes], touched: Mapping[str, Shapes]) -> dict[str, Fidelity]:
    """Fidelity of each link's collision shapes to the reachable part of its visual meshes; only of links that have
    both.

    A collision mesh counts as its convex hull, as in engines.
    """
    visuals = {
        name: join_meshes([Mesh(se3.transform(T, np.asarray(mesh.vertices, float)), mesh.faces) for T, mesh in shapes])
        for name, shapes in seen.items()
    }
    names = [name for name, mesh in visuals.items() if mesh.areas().sum() > 0 and convex_shapes(touched.get(name, []))]
    part = max(len(names), 1)
    return {
        name: measure_fidelity(
            sample_outer_surface(visuals[name], max(DENSE // part, _MIN_POINTS)),
            convex_shapes(touched[name]),
            count=max(PER_SHAPES // part, _MIN_POINTS),
        )
        for name in names
    }


def measure_contact_depth(urdf: Path, joint: str, touched: Mapping[str, Shapes], count: int) -> float:
    """m that the collision shapes of a joint's two links overlap at most, over `count` positions within the limits.

    Points on each link's shapes are tested against each single convex shape of the other, as in engines.
    """
    read = read_urdf(urdf)
    between = read.joints[joint]
    fixed, moving = touched[between.parent], touched[between.child]
    solids = [[trimesh.Trimesh(s.vertices, s.faces, process=False) for s in convex_shapes(x)] for x in (fixed, moving)]
    if not all(solids):
        return 0.0
    spaces = [shape_planes(own) for own in solids]
    points = [np.concatenate([_surface_points(solid, own) for solid in own]) for own in solids]
    deepest = 0.0
    for position in np.linspace(between.lower, between.upper, count):
        Ts = read.link_poses({joint: float(position)})
        T = se3.inverse(Ts[between.parent]) @ Ts[between.child]
        for mine, other, pose in ((1, 0, T), (0, 1, se3.inverse(T))):
            there = se3.transform(pose, points[mine])
            depth = depth_in_shapes(there, np.full(len(there), -1), *spaces[other])
            deepest = max(deepest, float(depth.max()))
    return deepest


def convex_shapes(shapes: Shapes) -> list[Mesh]:
    """The convex hull of each shape with faces, in the link's frame; sheets are thickened (`_SHEET_SHARE`)."""
    found = []
    for T, mesh in shapes:
        points = se3.transform(T, np.asarray(mesh.vertices, float)[np.unique(mesh.faces)])
        size = float(np.linalg.norm(np.ptp(points, axis=0))) if len(points) else 0.0
        if size > 0:
            hull = trimesh.convex.convex_hull(thicken(points, _SHEET_SHARE * size))
            found.append(Mesh(np.asarray(hull.vertices, float), np.asarray(hull.faces)))
    return found


def is_closed(mesh: trimesh.Trimesh) -> bool:
    """Whether each edge has two faces, once corners of equal position are merged: texture seams split them."""
    _, place = np.unique(mesh.vertices, axis=0, return_inverse=True)
    faces = place.reshape(-1)[mesh.faces]
    faces = faces[(faces != np.roll(faces, 1, axis=1)).all(1)]
    edges = np.sort(np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]]), axis=1)
    _, count = np.unique(edges, axis=0, return_counts=True)
    return bool((count % 2 == 0).all())


def _surface_points(solid: trimesh.Trimesh, all_of_them: list[trimesh.Trimesh]) -> Array:
    points, _ = sample_evenly(solid, sum(other.area for other in all_of_them) / _DEPTH_POINTS)
    return np.concatenate([np.asarray(solid.vertices, float), points])
