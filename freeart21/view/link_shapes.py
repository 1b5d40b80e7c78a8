"""The shapes of a URDF's links as they are drawn: meshes of its folder, boxes, spheres and cylinders."""

from __future__ import annotations

import io
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from freeart21.errors import FreeArtError
from freeart21.files import checked
from freeart21.files.mesh_file import read_ply
from freeart21.files.urdf import Urdf, UrdfShape, read_urdf
from freeart21.files.urdf_files import find_root, named_inside
from freeart21.mesh import Mesh
from freeart21.view.obj import MAX_OBJ_BYTES, PLAIN, Piece, read_obj
from freeart21.view.simplify import box, cylinder, sphere


@dataclass(frozen=True)
class ShownUrdf:
    """A URDF and what its links look like, each in its own frame."""

    urdf: Urdf
    visuals: dict[str, tuple[Piece, ...]]
    """By link, parents before their children."""
    collisions: dict[str, tuple[Piece, ...]]
    missing: tuple[str, ...]
    """Mesh files that the URDF names and the folder lacks."""


def read_shown(path: Path, root: Path | None = None) -> ShownUrdf:
    """The URDF with all meshes it names: OBJ and PLY here, other formats through trimesh.

    Meshes are looked for inside `root` only, as `urdf_files.named_inside` does. Raises FreeArtError when the URDF
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
            if mesh.colours is None or (colour is not None and piece.texture is None):
                plain = np.array(PLAIN, np.uint8) if colour is None else colour
                mesh = replace(mesh, colours=np.tile(plain, (len(mesh.vertices), 1)))
            pieces.append(replace(piece, mesh=mesh))
    return tuple(pieces)


def _geometry(shape: UrdfShape, where: str, path: Path, root: Path | None, missing: list[str]) -> list[Piece]:
    match shape.kind:
        case "":
            raise FreeArtError(f"{where} has no geometry")
        case "box":
            return [Piece(box(shape.size))]
        case "sphere":
            return [Piece(sphere(float(shape.size[0])))]
        case "cylinder":
            return [Piece(cylinder(*map(float, shape.size)))]
        case "mesh":
            return _mesh(shape, path, root, missing)
    raise FreeArtError(f"{where}: geometry <{shape.kind}> is unknown; known: box, cylinder, mesh, sphere")


def _mesh(shape: UrdfShape, path: Path, root: Path | None, missing: list[str]) -> list[Piece]:
    file = named_inside(path, shape.filename, root)
    if not file.is_file():
        missing.append(shape.filename)
        return []
    pieces = _read_mesh(file, find_root(path, [shape.filename]) if root is None else root)
    if np.allclose(shape.size, 1):
        return pieces
    flip = -1 if np.prod(shape.size) < 0 else 1
    return [
        replace(p, mesh=replace(p.mesh, vertices=p.mesh.vertices * shape.size, faces=p.mesh.faces[:, ::flip]))
        for p in pieces
    ]


def _read_mesh(file: Path, root: Path) -> list[Piece]:
    match file.suffix.lower():
        case ".obj":
            return read_obj(file, root)
        case ".ply":
            return [Piece(read_ply(file, root)[0])]
    import trimesh

    try:
        data = io.BytesIO(checked.read_bytes(file, MAX_OBJ_BYTES, root))
        loaded = trimesh.load_mesh(data, file_type=file.suffix[1:].lower())  # from memory: it names no other file
    except FreeArtError:
        raise
    except Exception as error:  # hostile bytes reach parsers of many formats
        raise FreeArtError(f"{file} cannot be read as a mesh: {error}") from error
    return [Piece(Mesh(np.asarray(loaded.vertices), np.asarray(loaded.faces)))]
