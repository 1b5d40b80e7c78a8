"""The shapes of a URDF's links as meshes: mesh files, boxes, spheres, cylinders and capsules."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from freeart21.errors import FreeArtError
from freeart21.files import checked
from freeart21.files.urdf import Urdf, UrdfShape, read_urdf
from freeart21.files.urdf_files import find_root, resolve_file
from freeart21.mesh import Mesh
from freeart21.view.mesh_pieces import PLAIN, Piece, read_pieces
from freeart21.view.simplify import box, capsule, cylinder, sphere


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
    visuals = {
        name: _pieces(urdf.links[name].visuals, f"{path}: a visual of link '{name}'", path, root, missing)
        for name in urdf.parents_first
    }
    collisions = {
        name: _pieces(urdf.links[name].collisions, f"{path}: a collision of link '{name}'", path, root, missing)
        for name in urdf.parents_first
    }
    return ShownUrdf(urdf, visuals, collisions, tuple(dict.fromkeys(missing)))


def _pieces(
    shapes: tuple[UrdfShape, ...], where: str, path: Path, root: Path | None, missing: list[str]
) -> tuple[Piece, ...]:
    pieces: list[Piece] = []
    for shape in shapes:
        colour = None if shape.rgba is None else np.round(255 * np.clip(shape.rgba[:3], 0, 1)).astype(np.uint8)
        for piece in _geometry(shape, where, path, root, missing):
            mesh = piece.mesh.moved(shape.T_link_shape)
            if mesh.colours is None or (colour is not None and piece.picture is None):
                plain = np.array(PLAIN, np.uint8) if colour is None else colour
                mesh = replace(mesh, colours=np.tile(plain, (len(mesh.vertices), 1)))
            pieces.append(replace(piece, mesh=mesh))
    return tuple(pieces)


def _geometry(shape: UrdfShape, where: str, path: Path, root: Path | None, missing: list[str]) -> list[Piece]:
    match shape.kind:
        case "":
            raise FreeArtError(f"{where} has no geometry")
        case "mesh":
            return _mesh(shape, path, root, missing)
    return [Piece(primitive(shape, where))]


def primitive(shape: UrdfShape, where: str) -> Mesh:
    """The surface of a box, sphere, cylinder or capsule in its own frame, m.

    Raises FreeArtError, beginning with `where`, for another kind and for sizes that are not positive.
    """
    if not (shape.size > 0).all():
        raise FreeArtError(f"{where} has a {shape.kind} of size {shape.size.tolist()}, expected more than zero")
    match shape.kind:
        case "box":
            return box(shape.size)
        case "sphere":
            return sphere(float(shape.size[0]))
        case "cylinder":
            return cylinder(*map(float, shape.size))
        case "capsule":
            return capsule(*map(float, shape.size))
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
