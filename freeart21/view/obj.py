"""Wavefront OBJ files: triangles by material, each with colours and at most one texture."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from freeart21.errors import FreeArtError
from freeart21.files import checked
from freeart21.mesh import Mesh

MAX_OBJ_BYTES = 256 << 20
PLAIN = (190, 190, 190)
"""Colour of a surface without a given one."""


@dataclass(frozen=True)
class Piece:
    """The triangles of one material."""

    mesh: Mesh
    """With vertex colours."""
    uv: NDArray[np.float64] | None = None
    """(V, 2) texture coordinates, (0, 0) at the lower left corner; None without a texture."""
    texture: Path | None = None
    picture: NDArray[np.uint8] | None = None
    """(h, w, 3) RGB of a texture inside the mesh file; the vertex colours are sampled from it."""


@dataclass(frozen=True)
class _Material:
    colour: tuple[int, int, int] = PLAIN
    texture: Path | None = None


def read_obj(path: Path, root: Path) -> list[Piece]:
    """The pieces of an OBJ file, one per material; polygons become triangle fans.

    Material files and textures are read inside `root` only; without them a piece has a plain colour. Raises
    FreeArtError when the file cannot be read as OBJ.
    """
    lines = checked.read_text(path, MAX_OBJ_BYTES, root, errors="replace").splitlines()
    try:
        return _parse(lines, path, root)
    except (ValueError, IndexError) as error:
        raise FreeArtError(f"{path} is not a readable OBJ mesh: {error}") from error


def _parse(lines: list[str], path: Path, root: Path) -> list[Piece]:
    points = [line.split()[1:7] for line in lines if line.startswith("v ")]
    coordinates = np.array([line.split()[1:3] for line in lines if line.startswith("vt ")], float).reshape(-1, 2)
    vertices = np.array([point[:3] for point in points], float).reshape(-1, 3)
    painted = all(len(point) == 6 for point in points) and len(points) > 0
    colours = np.array([point[3:6] for point in points], float) if painted else None
    materials: dict[str, _Material] = {}
    corners: dict[str, list[tuple[int, int]]] = {}
    current = ""
    n_points = n_coordinates = 0
    for line in lines:
        words = line.split()
        match words[0] if words else "":
            case "v":
                n_points += 1
            case "vt":
                n_coordinates += 1
            case "mtllib":
                materials |= _read_mtl(path.parent / line.split(maxsplit=1)[1].strip(), root)
            case "usemtl":
                current = line.split(maxsplit=1)[1].strip() if len(words) > 1 else ""
            case "f":
                polygon = [_corner(word, n_points, n_coordinates) for word in words[1:]]
                if len(polygon) < 3:
                    raise ValueError(f"it has a face of {len(polygon)} corners")
                fan = corners.setdefault(current, [])
                for k in range(1, len(polygon) - 1):
                    fan += [polygon[0], polygon[k], polygon[k + 1]]
    return [
        _piece(np.array(fan), vertices, coordinates, colours, materials.get(name, _Material()))
        for name, fan in corners.items()
    ]


def _corner(word: str, n_points: int, n_coordinates: int) -> tuple[int, int]:
    """Indices of position and texture coordinate, from 0; -1 for no coordinate. OBJ counts from 1, or back from -1."""
    fields = word.split("/")
    point = int(fields[0])
    coordinate = int(fields[1]) if len(fields) > 1 and fields[1] else 0
    return (
        point - 1 if point > 0 else n_points + point,
        coordinate - 1 if coordinate >= 0 else n_coordinates + coordinate,
    )


def _piece(
    fan: NDArray[np.int64],
    vertices: NDArray[np.float64],
    coordinates: NDArray[np.float64],
    colours: NDArray[np.float64] | None,
    material: _Material,
) -> Piece:
    if fan[:, 0].min() < 0 or fan[:, 0].max() >= len(vertices) or fan[:, 1].max() >= len(coordinates):
        raise ValueError(f"a face names a vertex that does not exist; there are {len(vertices)}")
    textured = material.texture is not None and bool((fan[:, 1] >= 0).all())
    if not textured:
        fan = np.column_stack([fan[:, 0], np.full(len(fan), -1)])
    corners, index = np.unique(fan, axis=0, return_inverse=True)
    if colours is not None and not textured:
        painted = np.clip(np.rint(255 * colours[corners[:, 0]]), 0, 255).astype(np.uint8)
    else:
        painted = np.tile(np.array(material.colour, np.uint8), (len(corners), 1))
    return Piece(
        Mesh(vertices[corners[:, 0]], index.reshape(-1, 3), painted),
        coordinates[corners[:, 1]] if textured else None,
        material.texture if textured else None,
    )


def _read_mtl(path: Path, root: Path) -> dict[str, _Material]:
    path = checked.inside(root, str(path.resolve()))
    if not path.is_file():
        return {}
    materials: dict[str, _Material] = {}
    name, colour, texture = "", PLAIN, None
    for line in checked.read_text(path, checked.MAX_JSON_BYTES, errors="replace").splitlines():
        words = line.split()
        match words[0] if words else "":
            case "newmtl":
                name, colour, texture = line.split(maxsplit=1)[1].strip() if len(words) > 1 else "", PLAIN, None
            case "Kd":
                r, g, b = (round(255 * min(max(float(word), 0.0), 1.0)) for word in words[1:4])
                colour = (r, g, b)
            case "map_Kd":
                named = words[-1] if words[1].startswith("-") else line.split(maxsplit=1)[1].strip()
                file = checked.inside(root, str((path.parent / named).resolve()))
                texture = file if file.is_file() else None
            case _:
                continue
        materials[name] = _Material(colour, texture)
    return materials
