"""Part meshes cleaned and written as OBJ, with the texture that they wear."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import trimesh
from numpy.typing import NDArray

from export.atlas import Skin
from freeart21.files import atomic, checked
from freeart21.mesh import Mesh, bounding_diagonal

_RAYS = 2000
"""Places of a surface that are asked which side is outside."""
_GREY = (0.7, 0.7, 0.7)  # of a part without colours


@dataclass(frozen=True)
class MeshSettings:
    """How part meshes are cleaned and written."""

    max_faces: int = 20_000
    """Faces a part may keep; more are reduced (`export.surface`)."""
    min_component: float = 0.01
    """Connected pieces of less than this fraction of the part's area are dropped; the largest always stays."""
    points: int = 25_000
    """Points of a part's surface, about, that its closing is computed with; a cut through 60 000 took a minute."""
    sheet_m: float = 0.001
    """Metres of thickness that a part gets of which only a flat sheet was seen."""
    video_frames: int = 120
    """Frames of a video that a texture is made of, evenly spread over those that show the object."""


def deduplicated(mesh: Mesh) -> Mesh:
    """Vertices of equal position and colour merged; triangles without area or said twice removed."""
    colours = np.zeros((len(mesh.vertices), 0)) if mesh.colours is None else mesh.colours.astype(float)
    rows = np.hstack([mesh.vertices, colours])
    _, first, back = np.unique(rows, axis=0, return_index=True, return_inverse=True)
    faces = back.reshape(-1)[mesh.faces]
    merged = Mesh(mesh.vertices[first], faces, None if mesh.colours is None else mesh.colours[first])
    area = merged.areas()
    faces = faces[area > 1e-12 * max(area.max(initial=0.0), 1e-300)]
    _, kept = np.unique(np.sort(faces, axis=1), axis=0, return_index=True)
    return _compact(merged, faces[np.sort(kept)])


def inside_out(mesh: Mesh) -> bool:
    """Whether the surface faces inwards: straight from behind it one gets away more often than from before it.

    Holes do not matter, as they do for the volume: a tray whose underside nobody saw encloses a negative one.
    """
    area = mesh.areas()
    picked = np.searchsorted(np.cumsum(area), area.sum() * (np.arange(_RAYS) + 0.5) / _RAYS).clip(max=len(area) - 1)
    corners = mesh.vertices[mesh.faces[picked]]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-300)
    off = 1e-5 * bounding_diagonal(mesh) * normal
    rays = trimesh.Trimesh(mesh.vertices, mesh.faces, process=False).ray
    before, behind = (rays.intersects_any(corners.mean(1) + k * off, k * normal).sum() for k in (1, -1))
    return bool(before > behind)


def turned(mesh: Mesh) -> Mesh:
    """The mesh with every triangle facing the other way."""
    return Mesh(mesh.vertices, mesh.faces[:, ::-1], mesh.colours)


def without_crumbs(mesh: Mesh, fraction: float) -> Mesh:
    """The mesh without connected pieces of less than `fraction` of its area; the largest always stays."""
    if mesh.empty:
        return mesh
    _, place = np.unique(mesh.vertices, axis=0, return_inverse=True)
    corners = place.reshape(-1)[mesh.faces]
    edges = np.concatenate([corners[:, [0, 1]], corners[:, [1, 2]]])
    label = trimesh.graph.connected_component_labels(edges, node_count=int(place.max()) + 1)[corners[:, 0]]
    area = np.bincount(label, mesh.areas())
    large = area >= min(fraction * area.sum(), area.max())
    return _compact(mesh, mesh.faces[large[label]])


def write_visual(folder: Path, name: str, mesh: Mesh, skin: Skin | None) -> str | None:
    """Write NAME.obj and NAME.mtl, and NAME.png when the mesh has a skin; returns the texture's file name or None."""
    texture = None
    material = f"newmtl {name}\nKa 0 0 0\nKs 0 0 0\nd 1\nillum 1\n"
    if skin is None:
        material += "Kd {:g} {:g} {:g}\n".format(*_GREY)
    else:
        texture = f"{name}.png"
        material += f"Kd 1 1 1\nmap_Kd {texture}\n"
        atomic.write_bytes(folder / texture, checked.encode_png(skin.image))
    atomic.write_bytes(folder / f"{name}.mtl", material.encode())
    atomic.write_bytes(folder / f"{name}.obj", _visual_obj(mesh, name, skin).encode())
    return texture


def write_hull(path: Path, hull: Mesh) -> None:
    """Write a bare mesh as OBJ, for collision."""
    lines = [_rows("v", hull.vertices, "%.9g"), _rows("f", hull.faces + 1, "%d")]
    atomic.write_bytes(path, "".join(lines).encode())


def smooth_normals(mesh: Mesh) -> NDArray[np.float64]:
    """(V, 3) unit normals, area-weighted over the triangles round each position."""
    a, b, c = (mesh.vertices[mesh.faces[:, k]] for k in range(3))
    normal = np.cross(b - a, c - a)
    _, place = np.unique(mesh.vertices, axis=0, return_inverse=True)
    place = place.reshape(-1)
    total = np.zeros((int(place.max()) + 1, 3))
    for k in range(3):
        np.add.at(total, place[mesh.faces[:, k]], normal)
    length = np.linalg.norm(total, axis=1, keepdims=True)
    unit = np.where(length > 0, total / np.maximum(length, 1e-300), [0.0, 0.0, 1.0])
    return unit[place]


def _visual_obj(mesh: Mesh, name: str, skin: Skin | None) -> str:
    corner = mesh.faces + 1
    if skin is not None:
        columns = np.stack([corner, skin.atlas.corners + 1, corner], -1).reshape(-1, 9)
        faces = _rows("f", columns, "%d/%d/%d %d/%d/%d %d/%d/%d")
    else:
        faces = _rows("f", np.stack([corner, corner], -1).reshape(-1, 6), "%d//%d %d//%d %d//%d")
    return "".join(
        [
            f"mtllib {name}.mtl\no {name}\n",
            _rows("v", mesh.vertices, "%.9g %.9g %.9g"),
            "" if skin is None else _rows("vt", skin.atlas.uv, "%.7f %.7f"),
            _rows("vn", smooth_normals(mesh), "%.4f %.4f %.4f"),
            f"usemtl {name}\n",
            faces,
        ]
    )


def _rows(word: str, rows: NDArray, pattern: str) -> str:
    """One line a row, beginning with `word`; `pattern` formats one number, or the whole row."""
    if pattern.count("%") == 1:
        pattern = " ".join([pattern] * rows.shape[1])
    line = f"{word} {pattern}\n"
    return "".join([line % tuple(row) for row in rows.tolist()])


def _compact(mesh: Mesh, faces: NDArray[np.int64]) -> Mesh:
    """The mesh of these faces, without vertices that none of them uses."""
    used, back = np.unique(faces, return_inverse=True)
    colours = None if mesh.colours is None else mesh.colours[used]
    return Mesh(mesh.vertices[used], back.reshape(-1, 3), colours)
