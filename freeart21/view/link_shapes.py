"""The shapes of a URDF's links as meshes: mesh files, boxes, spheres, cylinders and capsules."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from freeart21.errors import FreeArtError
from freeart21.files import checked
from freeart21.files.urdf import Urdf, UrdfShape, read_urdf
from freeart21.files.urdf_files import find_root, resolve_file
from freeart21.mesh import Mesh
from freeart21.view.mesh_pieces import PLAIN, Piece, read_pieces


@dataclass(frozen=True)
class ShownUrdf:
    """A URDF with the shapes of its links, each in its link's frame."""

    urdf: Urdf
    visuals: dict[str, tuple[Piece, ...]]
    """By link, parents before their children."""
    collisions: dict[str, tuple[Piece, ...]]
    missing: tuple[str, ...]
    """Mesh files that the URDF names and that do not exist."""


def read_shown(path: Path, root: Path | None = None) -> ShownUrdf:
    """The URDF with all meshes that it names.

    Meshes are looked for inside `root` only, as `urdf_files.resolve_file` does. Raises FreeArtError when the URDF
    cannot be read, a geometry is unknown, or a mesh is there and cannot be read.
    """
    urdf = read_urdf(path)
    missing: list[str] = []
    pieces = [
        {
            name: _pieces(shapes, f"{path}: a {kind} of link '{name}'", path, root, missing)
            for name in urdf.parents_first
            for shapes in [getattr(urdf.links[name], f"{kind}s")]
        }
        for kind in ("visual", "collision")
    ]
    return ShownUrdf(urdf, pieces[0], pieces[1], tuple(dict.fromkeys(missing)))


def _pieces(
    shapes: tuple[UrdfShape, ...], where: str, path: Path, root: Path | None, missing: list[str]
) -> tuple[Piece, ...]:
    pieces: list[Piece] = []
    for shape in shapes:
        if not shape.kind:
            raise FreeArtError(f"{where} has no geometry")
        own = _mesh(shape, path, root, missing) if shape.kind == "mesh" else [Piece(primitive(shape, where))]
        colour = None if shape.rgba is None else np.round(255 * np.clip(shape.rgba[:3], 0, 1)).astype(np.uint8)
        for piece in own:
            mesh = piece.mesh.moved(shape.T_link_shape)
            if mesh.colours is None or (colour is not None and piece.picture is None):
                plain = np.array(PLAIN, np.uint8) if colour is None else colour
                mesh = replace(mesh, colours=np.tile(plain, (len(mesh.vertices), 1)))
            pieces.append(replace(piece, mesh=mesh))
    return tuple(pieces)


def primitive(shape: UrdfShape, where: str) -> Mesh:
    """The surface of a box, sphere, cylinder or capsule in its own frame, m.

    Raises FreeArtError, beginning with `where`, for another kind and for sizes that are not positive.
    """
    if not (shape.size > 0).all():
        raise FreeArtError(f"{where} has a {shape.kind} of size {shape.size.tolist()}, expected more than zero")
    from trimesh import creation

    scale = float(shape.size.max())
    size = [float(each) / scale for each in shape.size]
    match shape.kind:
        case "box":
            return of_trimesh(creation.box(size), scale)
        case "sphere":
            return of_trimesh(creation.uv_sphere(1.0), scale)
        case "cylinder":
            return of_trimesh(creation.cylinder(size[0], size[1]), scale)
        case "capsule":
            return of_trimesh(creation.capsule(size[1], size[0]), scale)
    raise FreeArtError(f"{where}: geometry <{shape.kind}> is unknown; known: box, capsule, cylinder, mesh, sphere")


def _mesh(shape: UrdfShape, path: Path, root: Path | None, missing: list[str]) -> list[Piece]:
    file = resolve_file(path, shape.filename, root)
    if not checked.is_there(file):
        missing.append(shape.filename)
        return []
    pieces = read_pieces(file, find_root(path, [shape.filename], root))
    if np.allclose(shape.size, 1):
        return pieces
    flip = -1 if np.prod(shape.size) < 0 else 1
    return [
        replace(p, mesh=replace(p.mesh, vertices=p.mesh.vertices * shape.size, faces=p.mesh.faces[:, ::flip]))
        for p in pieces
    ]


def of_trimesh(mesh: Any, scale: float = 1.0) -> Mesh:
    """A trimesh's surface, without colours, times `scale`: trimesh drops faces of its solids that are very small."""
    return Mesh(scale * np.asarray(mesh.vertices, float), np.asarray(mesh.faces, np.int64))
