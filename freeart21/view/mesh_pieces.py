"""The loader of all mesh files that URDFs name; a piece has one material.

They are read by trimesh (COLLADA by pycollada). COLLADA lengths are converted to metres by their <unit>.
<up_axis> of COLLADA and glTF is ignored, as in RViz and MoveIt: a URDF places the mesh as it is written. Files that a
mesh file names are read inside the root only.
"""

from __future__ import annotations

import hashlib
import io
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from urllib.parse import unquote
from weakref import WeakValueDictionary

import numpy as np
from numpy.typing import NDArray

from freeart21 import se3
from freeart21.errors import FreeArtError
from freeart21.files import checked
from freeart21.files.urdf import parse_xml
from freeart21.mesh import Mesh

MAX_BYTES = 256 << 20
"""Of a mesh file, and of each file that it names."""
PLAIN = (190, 190, 190)
"""Colour of a surface without a given one."""
ENDINGS = (".obj", ".dae", ".glb", ".gltf", ".stl", ".ply", ".off")
"""Endings of readable files, in lower case."""
_MOST_VERTICES = 1 << 24
"""Most vertices in all copies of all meshes of a scene: 4 GB with everything computed from them."""

_MOST_PIXELS = 4 * checked.MAX_PIXELS
"""Of all different pictures of the meshes in use."""
_PICTURES: WeakValueDictionary[bytes, NDArray[np.uint8]] = WeakValueDictionary()


@dataclass(frozen=True)
class Piece:
    """The triangles of one material."""

    mesh: Mesh
    """With vertex colours, if any are given; those of a picture are sampled from it."""
    uv: NDArray[np.float64] | None = None
    """(V, 2) texture coordinates, (0, 0) at the lower left corner; None without a picture."""
    picture: NDArray[np.uint8] | None = None
    """(h, w, 3) RGB of its texture."""


def read_pieces(file: Path, root: Path) -> list[Piece]:
    """The pieces of a mesh file, m; none of an OBJ file without faces.

    Raises FreeArtError, in one line, when its format is none of `ENDINGS`, it cannot be read, or has no faces.
    """
    ending = file.suffix.lower()
    if ending not in ENDINGS:
        raise FreeArtError(f"{file} is no mesh that is read, expected {', '.join(ENDINGS)}")
    data = checked.read_bytes(file, MAX_BYTES, root)
    try:
        pieces = _pieces(file, root, data)
    except Exception as error:  # hostile bytes reach parsers of many formats
        if isinstance(error, FreeArtError) and str(error).startswith(str(file)):
            raise
        reason = " ".join(str(error).split()) or type(error).__name__
        raise FreeArtError(f"{file} is not a readable {ending} file: {reason[:200]}") from error
    if ending != ".obj" and not any(len(piece.mesh.faces) for piece in pieces):
        raise FreeArtError(f"{file} is not a readable {ending} file: it has no faces")
    return pieces


def up_axis(file: Path, root: Path) -> str:
    """The <up_axis> of a COLLADA file: X_UP, Y_UP, Z_UP, or empty."""
    asset = parse_xml(checked.read_bytes(file, MAX_BYTES, root), file).find("{*}asset/{*}up_axis")
    return "" if asset is None else (asset.text or "").strip()


def _pieces(file: Path, root: Path, data: bytes) -> list[Piece]:
    import trimesh

    ending = file.suffix.lower()
    unit = 1.0
    if ending == ".dae":  # its XML is checked before another parser reads it
        metres = parse_xml(data, file).find("{*}asset/{*}unit")
        unit = float("1" if metres is None else metres.get("meter", "1"))
        if not 0 < unit < np.inf:
            raise ValueError(f"its unit is {unit:g} m")
    if ending in (".glb", ".gltf"):
        text = data[20 : 20 + int.from_bytes(data[12:16], "little")] if ending == ".glb" else data
        accessors = checked.parse_json(text.decode("utf-8"), file).get("accessors", ())
        empty = sum(one["count"] for one in accessors if "bufferView" not in one)  # trimesh fills them with zeros
        if empty > _MOST_VERTICES:
            raise ValueError(f"its accessors have {empty} entries without data, at most {_MOST_VERTICES} are read")
    neighbours: Any = _Neighbours(file, root)
    options: dict[str, Any] = {"process": False} if ending in (".obj", ".ply") else {}
    scene = trimesh.load_scene(io.BytesIO(data), file_type=ending[1:], resolver=neighbours, **options)
    nodes = [(T, scene.geometry[name]) for T, name in (scene.graph[node] for node in scene.graph.nodes_geometry)]
    meshes = [(T, mesh) for T, mesh in nodes if isinstance(mesh, trimesh.Trimesh)]
    meshes = meshes[::-1] if ending == ".obj" else meshes  # trimesh takes their materials from the end of the file
    if (count := sum(len(mesh.vertices) for _, mesh in meshes)) > _MOST_VERTICES:
        raise FreeArtError(f"{file} has {count} vertices in all, at most {_MOST_VERTICES} are read")
    pieces = []
    for T, mesh in meshes:
        flip = -1 if np.linalg.det(T[:3, :3]) < 0 else 1
        colours, uv, picture = _look(mesh, linear=ending in (".glb", ".gltf"))
        vertices = unit * se3.transform(T, np.asarray(mesh.vertices, float))
        pieces.append(Piece(Mesh(vertices, np.asarray(mesh.faces)[:, ::flip], colours), uv, picture))
    return pieces


def _look(mesh: Any, linear: bool) -> tuple[NDArray[np.uint8] | None, NDArray[np.float64] | None, Any]:
    """Vertex colours (V, 3), texture coordinates (V, 2) and texture (h, w, 3) of a trimesh; None for each it lacks."""
    visual = mesh.visual
    if visual.kind in ("vertex", "face"):
        return np.asarray(visual.vertex_colors)[:, :3].astype(np.uint8), None, None
    material: Any = getattr(visual, "material", None)
    material = material.to_pbr() if hasattr(material, "to_pbr") else material
    factor = getattr(material, "baseColorFactor", None)
    colour = np.full(3, 255, np.uint8) if factor is None else np.asarray(factor)[:3].astype(np.uint8)
    if linear:  # glTF 2.0, 3.9.2: factors are linear, pictures sRGB (IEC 61966-2-1)
        x = colour / 255.0
        colour = np.rint(255 * np.where(x <= 0.0031308, 12.92 * x, 1.055 * x ** (1 / 2.4) - 0.055)).astype(np.uint8)
    image, uv = getattr(material, "baseColorTexture", None), getattr(visual, "uv", None)
    if image is None or uv is None or len(uv) != len(mesh.vertices):
        plain = material is None or (factor is None and image is None)
        return None if plain else np.tile(colour, (len(mesh.vertices), 1)), None, None
    if image.width * image.height > checked.MAX_PIXELS:
        raise ValueError(f"a picture is {image.width} x {image.height}, at most {checked.MAX_PIXELS} pixels are read")
    picture = _shared(np.asarray(image.convert("RGB"), np.uint8))
    uv = np.nan_to_num(np.asarray(uv, float)[:, :2])
    h, w = picture.shape[:2]
    at = np.floor(uv * [w, h]).astype(np.int64) % [w, h]
    return picture[h - 1 - at[:, 1], at[:, 0]], uv, picture


def _shared(picture: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """The picture (h, w, 3), or an equal one in use; ValueError when all in use have too many pixels."""
    known = _PICTURES.setdefault(hashlib.sha256(repr(picture.shape).encode() + picture.tobytes()).digest(), picture)
    if (count := sum(one.size // 3 for one in _PICTURES.values())) > _MOST_PIXELS:
        raise ValueError(f"all pictures together have {count} pixels, at most {_MOST_PIXELS} are read")
    return known


class _Neighbours:
    """Resolver for trimesh of the files that a mesh file names: inside the root, of bounded size."""

    def __init__(self, file: Path, root: Path):
        self._file, self._root = file, root

    def get(self, name: str) -> bytes:
        """The bytes of a file, by its path from the mesh file."""
        names = dict.fromkeys((name, unquote(name), unquote(name).removeprefix("file://").replace("\\", "/")))
        paths = [self._file.parent / each for each in names]
        path = next((each for each in paths if each.is_file()), paths[0])
        try:
            return checked.read_bytes(path, MAX_BYTES, self._root)
        except FreeArtError as error:
            raise ValueError(f"it names '{name[:80]}': {error}") from error

    __getitem__ = get
