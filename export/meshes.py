"""Cleaning of part meshes, and OBJ files with materials and textures."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import trimesh
from numpy.typing import NDArray

from export.atlas import Texture
from freeart21.files import atomic, checked
from freeart21.mesh import Mesh, bounding_diagonal, triangle_normals

_RAYS = 2000
"""Surface points from which rays are cast to find the outside."""
GREY = (0.7, 0.7, 0.7)  # of a part without colours
MIN_COMPONENT = 0.01
"""Fraction of a part's area or volume below which a connected component is dropped; the largest always stays."""


def merge_duplicates(mesh: Mesh) -> Mesh:
    """The mesh with vertices of equal position and colour merged, without degenerate and repeated triangles."""
    colours = np.zeros((len(mesh.vertices), 0)) if mesh.colours is None else mesh.colours.astype(float)
    rows = np.hstack([mesh.vertices, colours])
    _, first, back = np.unique(rows, axis=0, return_index=True, return_inverse=True)
    faces = back.reshape(-1)[mesh.faces]
    merged = Mesh(mesh.vertices[first], faces, None if mesh.colours is None else mesh.colours[first])
    area = merged.areas()
    faces = faces[area > 1e-12 * max(area.max(initial=0.0), 1e-300)]
    _, unique = np.unique(np.sort(faces, axis=1), axis=0, return_index=True)
    return _keep_faces(merged, faces[np.sort(unique)])


def is_inside_out(mesh: Mesh) -> bool:
    """Whether the surface faces inwards: rays that start behind it escape more often than rays that start in front.

    Unlike the sign of the volume this holds for meshes with holes: a tray without an underside has a negative volume.
    """
    area = mesh.areas()
    picked = np.searchsorted(np.cumsum(area), area.sum() * (np.arange(_RAYS) + 0.5) / _RAYS).clip(max=len(area) - 1)
    corners = mesh.vertices[mesh.faces[picked]]
    normal = triangle_normals(mesh.vertices, mesh.faces[picked])
    normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-300)
    off = 1e-5 * bounding_diagonal(mesh) * normal
    rays = trimesh.Trimesh(mesh.vertices, mesh.faces, process=False).ray
    before, behind = (rays.intersects_any(corners.mean(1) + k * off, k * normal).sum() for k in (1, -1))
    return bool(before > behind)


def flip_faces(mesh: Mesh) -> Mesh:
    """The mesh with the opposite orientation of every triangle."""
    return Mesh(mesh.vertices, mesh.faces[:, ::-1], mesh.colours)


def drop_small_components(mesh: Mesh, fraction: float = MIN_COMPONENT) -> Mesh:
    """The mesh without connected components of less than `fraction` of its area; the largest always stays."""
    if mesh.empty:
        return mesh
    _, place = np.unique(mesh.vertices, axis=0, return_inverse=True)
    corners = place.reshape(-1)[mesh.faces]
    edges = np.concatenate([corners[:, [0, 1]], corners[:, [1, 2]]])
    label = trimesh.graph.connected_component_labels(edges, node_count=int(place.max()) + 1)[corners[:, 0]]
    area = np.bincount(label, mesh.areas())
    large = area >= min(fraction * area.sum(), area.max())
    return _keep_faces(mesh, mesh.faces[large[label]])


def write_visual(folder: Path, name: str, mesh: Mesh, texture: Texture | None) -> str | None:
    """Write NAME.obj and NAME.mtl, and NAME.png for a texture; returns the texture's file name or None."""
    file = None
    material = f"newmtl {name}\nKa 0 0 0\nKs 0 0 0\nd 1\nillum 1\n"
    if texture is None:
        material += "Kd {:g} {:g} {:g}\n".format(*GREY)
    else:
        file = f"{name}.png"
        material += f"Kd 1 1 1\nmap_Kd {file}\n"
        atomic.write_bytes(folder / file, checked.encode_png(texture.image))
    atomic.write_bytes(folder / f"{name}.mtl", material.encode())
    atomic.write_bytes(folder / f"{name}.obj", _format_visual_obj(mesh, name, texture).encode())
    return file


def write_hull(path: Path, hull: Mesh) -> None:
    """Write a mesh without material as OBJ."""
    lines = [_format_rows("v", hull.vertices, "%.9g"), _format_rows("f", hull.faces + 1, "%d")]
    atomic.write_bytes(path, "".join(lines).encode())


def vertex_normals(mesh: Mesh) -> NDArray[np.float64]:
    """(V, 3) unit normals, area-weighted over the triangles around each position."""
    normal = triangle_normals(mesh.vertices, mesh.faces)
    _, place = np.unique(mesh.vertices, axis=0, return_inverse=True)
    place = place.reshape(-1)
    total = np.zeros((int(place.max()) + 1, 3))
    for k in range(3):
        np.add.at(total, place[mesh.faces[:, k]], normal)
    length = np.linalg.norm(total, axis=1, keepdims=True)
    unit = np.where(length > 0, total / np.maximum(length, 1e-300), [0.0, 0.0, 1.0])
    return unit[place]


def _format_visual_obj(mesh: Mesh, name: str, texture: Texture | None) -> str:
    corner = mesh.faces + 1
    if texture is not None:
        columns = np.stack([corner, texture.atlas.corners + 1, corner], -1).reshape(-1, 9)
        faces = _format_rows("f", columns, "%d/%d/%d %d/%d/%d %d/%d/%d")
    else:
        faces = _format_rows("f", np.stack([corner, corner], -1).reshape(-1, 6), "%d//%d %d//%d %d//%d")
    return "".join(
        [
            f"mtllib {name}.mtl\no {name}\n",
            _format_rows("v", mesh.vertices, "%.9g %.9g %.9g"),
            "" if texture is None else _format_rows("vt", texture.atlas.uv, "%.7f %.7f"),
            _format_rows("vn", vertex_normals(mesh), "%.4f %.4f %.4f"),
            f"usemtl {name}\n",
            faces,
        ]
    )


def _format_rows(word: str, rows: NDArray[np.generic], pattern: str) -> str:
    """One line per row, beginning with `word`; `pattern` formats one number or the whole row."""
    if pattern.count("%") == 1:
        pattern = " ".join([pattern] * rows.shape[1])
    line = f"{word} {pattern}\n"
    return "".join([line % tuple(row) for row in rows.tolist()])


def number_cells(points: NDArray[np.floating], size: float) -> NDArray[np.int64]:
    """(n,) a number for the cubic cell of side `size` that each of points (n, 3) lies in, in lexicographic order."""
    cells = np.floor(points / size).astype(np.int64)
    cells -= cells.min(0)
    return np.ravel_multi_index(tuple(cells.T), tuple(cells.max(0) + 1))


def _keep_faces(mesh: Mesh, faces: NDArray[np.int64]) -> Mesh:
    """The mesh of these faces, without unused vertices."""
    used, back = np.unique(faces, return_inverse=True)
    colours = None if mesh.colours is None else mesh.colours[used]
    return Mesh(mesh.vertices[used], back.reshape(-1, 3), colours)
