"""Reads meshes, materials and pictures of a PartNet-Mobility folder, and makes a copy that SAPIEN can read.

Some objects of the data set are incomplete. What is left out is noted, what is wrong is refused, each in one line:

- A mesh that is absent or has no faces is left out (`generator.partnet` decides which may be absent).
- Without its picture or material library a surface has SAPIEN's plain colour: Kd, or a grey of 0.6.
- SAPIEN refuses meshes without faces and materials without their picture, so it gets a copy without them.
- As in SAPIEN, a picture replaces Kd, and Kd is linear.
"""

from __future__ import annotations

import contextlib
import functools
import io
import re
import tempfile
from collections import defaultdict
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from trimesh.exchange.obj import load_obj
from trimesh.geometry import triangulate_quads

from freeart21.errors import FreeArtError
from freeart21.files import checked
from freeart21.files.urdf import UrdfShape, format_urdf, read_urdf
from freeart21.files.urdf_files import resolve_file
from freeart21.se3 import Array
from generator.surface import Paint, Surface, srgb_bytes

MAX_OBJ_BYTES = 256 << 20
MAX_MTL_BYTES = 4 << 20
_NO_KD = 0.6  # default Kd of SAPIEN's reader (Assimp)
_FACE = re.compile(r"^[ \t]*f[ \t]", re.MULTILINE)
_FACE_LINE = re.compile(r"^[ \t]*f[ \t]+(.*)", re.MULTILINE)
_BACK_INDEX = re.compile(r"^[ \t]*f[ \t].*-\d", re.MULTILINE)
_NO_INDEX = re.compile(r"^[ \t]*f(?:[ \t]+[\d/-]+)*[ \t]+(?:0+|-\d+)(?:/|\s|$)", re.MULTILINE)
_LIBRARY = re.compile(r"^[ \t]*mtllib[ \t]+(.*\S)", re.MULTILINE)
_USED = re.compile(r"^[ \t]*usemtl[ \t]+(.*\S)", re.MULTILINE)
_BYTE_ORDER_MARK = b"\xef\xbb\xbf"  # makes SAPIEN miss a file's first line
_PICTURES = ("map_", "bump", "disp", "norm", "decal", "refl")  # first words of MTL lines that name a picture


Gaps = defaultdict[str, set[str]]
"""What an object lacks: a key of `GAPS` to names as in its files. Made by `Gaps(set)`."""
GAPS = {
    "meshes": "absent meshes are left out",
    "empty": "meshes without faces are left out",
    "libraries": "absent material libraries leave plain grey",
    "pictures": "absent pictures leave the plain colour",
    "axes": "COLLADA's <up_axis> is ignored, as in RViz: meshes are taken as they are written",
    "transparent": "materials are transparent: colour shows what is behind them, depth and mask do not",
}
"""Kind of gap to what comes of it."""


def describe_gaps(gaps: Gaps) -> tuple[str, ...]:
    """One line for each kind of gap, with up to three names and the number of others."""
    lines = []
    for kind, what in GAPS.items():
        if names := sorted(gaps[kind]):
            more = f" and {len(names) - 3} more" if len(names) > 3 else ""
            lines.append(f"{what}: {', '.join(names[:3])}{more}")
    return tuple(lines)


@dataclass(frozen=True)
class Material:
    """Appearance of a material of an MTL file in SAPIEN."""

    colour: NDArray[np.uint8]
    """(3,) sRGB of Kd."""
    picture: Path | None = None
    """The picture that replaces Kd."""


def read_obj(path: Path, folder: Path, gaps: Gaps) -> Surface:
    """The triangles of an OBJ file of the object in `folder`, with its materials; adds absent files to `gaps`.

    Raises FreeArtError, in one line, when the file is not an OBJ, refers to vertices that do not exist, when a picture
    is unreadable, or when a file is outside `folder`.
    """
    text = _text(path, MAX_OBJ_BYTES)
    materials = read_materials(path, text, folder, gaps)
    if not _FACE.search(text):
        gaps["empty"].add(_name(path, folder))
        return Surface.joined([])
    if _BACK_INDEX.search(text):
        text = _resolve_back_indices(text)
    if _NO_INDEX.search(text):
        raise FreeArtError(f"{path} is not a readable OBJ file: a face names a vertex before the first")
    used = "".join(f"newmtl {name}\n" for name in dict.fromkeys(_USED.findall(text)))
    text = "mtllib used\n" + _LIBRARY.sub("", text)
    try:  # materials are grouped by name only: the libraries are read above
        read = load_obj(io.StringIO(text), resolver={"used": used.encode()}, group_material=True)
        pieces = [_piece(geometry, materials) for geometry in read.get("geometry", {}).values()]
    except (ValueError, IndexError, KeyError, TypeError, AttributeError) as error:
        raise FreeArtError(f"{path} is not a readable OBJ file: {' '.join(str(error).split())}") from error
    surface = Surface.joined(pieces)
    if len(surface.faces) == 0:
        raise FreeArtError(f"{path} is not a readable OBJ file: it has faces, but none of three corners or more")
    return surface


def _piece(geometry: dict[str, Any], materials: dict[str, Material]) -> Surface:
    visual, vertices = geometry.get("visual"), np.asarray(geometry["vertices"], float)
    faces = triangulate_quads(geometry["faces"]).reshape(-1, 3)  # and polygons: fans
    if len(faces) and (vertices.shape[1:] != (3,) or faces.min() < 0 or faces.max() >= len(vertices)):
        raise IndexError("a face names a vertex that does not exist")
    uv = getattr(visual, "uv", None)
    name = getattr(getattr(visual, "material", None), "name", None) or ""
    material = materials.get(name) or Material(srgb_bytes(np.full(3, _NO_KD)))
    picture = None
    if material.picture is not None:
        picture = _read_picture(material.picture, material.picture.stat().st_mtime_ns)
    colour = material.colour if picture is None else np.full(3, 255, np.uint8)
    count = len(vertices)
    return Surface(
        vertices,
        faces,
        np.zeros((count, 2)) if uv is None else np.nan_to_num(np.asarray(uv, float)[:, :2]),
        np.zeros(count, np.int64),
        (Paint(colour, picture),),
    )


@functools.lru_cache(maxsize=64)
def _read_picture(path: Path, changed_ns: int) -> NDArray[np.uint8]:
    """Read a picture; cached by its modification time, because the meshes of an object share pictures."""
    return checked.read_rgb(path)


def _resolve_back_indices(text: str) -> str:
    """OBJ text with negative indices, which count back from the last vertex before them, replaced."""
    counts, lines = {"v": 0, "vt": 0, "vn": 0}, []
    for line in text.splitlines():
        words = line.split()
        if words and words[0] in counts:
            counts[words[0]] += 1
        elif words and words[0] == "f":
            above = tuple(counts.values())
            corners = (
                "/".join(
                    str(int(index) + 1 + n) if index.startswith("-") else index
                    for index, n in zip(corner.split("/"), above, strict=False)
                )
                for corner in words[1:]
            )
            line = "f " + " ".join(corners)
        lines.append(line)
    return "\n".join(lines) + "\n"


def read_materials(obj: Path, text: str, folder: Path, gaps: Gaps) -> dict[str, Material]:
    """Materials by name, from the libraries that the OBJ file `obj` with this text names."""
    materials: dict[str, Material] = {}
    for library in _LIBRARY.findall(text):
        mtl = _neighbour(obj, library, folder, "material library")
        if mtl is None:
            gaps["libraries"].add(library)
            continue
        name = ""
        for line in _text(mtl, MAX_MTL_BYTES).splitlines():
            key, _, rest = line.strip().partition(" ")
            rest = rest.strip()
            if key == "newmtl":
                name = rest
                materials[name] = Material(srgb_bytes(np.full(3, _NO_KD)))
            elif name and key == "Kd":
                kd = _floats(rest, mtl, "Kd")
                kd = np.clip(kd[:3] if len(kd) >= 3 else np.full(3, kd[0]), 0, 1)
                materials[name] = Material(srgb_bytes(kd), materials[name].picture)
            elif name and key == "d" and 0 < _floats(rest.removeprefix("-halo"), mtl, "d")[0] < 1:
                gaps["transparent"].add(_name(mtl, folder))
            elif name and key.startswith(_PICTURES):
                picture = _picture(rest, mtl, folder)
                if picture is None:
                    gaps["pictures"].add(rest)
                elif key == "map_Kd":
                    materials[name] = Material(materials[name].colour, picture)
    return materials


def _picture(rest: str, mtl: Path, folder: Path) -> Path | None:
    """The file named after `map_Kd`: the whole text, or its last word after options; None when absent."""
    for name in dict.fromkeys((rest, *rest.split()[-1:])):
        path = _neighbour(mtl, name.replace("\\", "/"), folder, "picture")
        if path is not None:
            return path
    return None


def _neighbour(origin: Path, name: str, folder: Path, what: str) -> Path | None:
    """The file `name` relative to the file `origin`, None when absent; FreeArtError when it is outside `folder`."""
    named = f"{origin} names the {what} '{name[:80]}'"
    if "://" in name or name.startswith(("/", "\\")):
        raise FreeArtError(f"{named}, expected a path inside {folder}")
    try:
        path = checked.inside(folder, f"{origin.parent.resolve().relative_to(folder.resolve())}/{name}")
        return path if path.is_file() else None
    except (OSError, RuntimeError, ValueError) as error:  # a circle of links, a name too long
        raise FreeArtError(f"{named}, which cannot be looked up: {error}") from error
    except FreeArtError as error:
        raise FreeArtError(f"{named}, which leads out of the folder {folder}") from error


def _floats(rest: str, mtl: Path, key: str) -> Array:
    values = np.array([])
    with contextlib.suppress(ValueError):
        values = np.array([float(word) for word in rest.split()])
    if len(values) == 0 or not np.isfinite(values).all():
        raise FreeArtError(f"{mtl}: {key} is '{rest}', expected numbers")
    return values


def _text(path: Path, limit: int) -> str:
    """A file's text with plain line feeds and without a byte order mark."""
    data = checked.read_bytes(path, limit)
    return data.decode("utf-8-sig", errors="replace").replace("\r\n", "\n").replace("\r", "\n")


def _name(path: Path, folder: Path) -> str:
    return str(path.resolve().relative_to(folder.resolve()))


# --- for SAPIEN -------------------------------------------------------------------------------------------------------


@contextlib.contextmanager
def sapien_urdf(urdf: Path, root: Path | None = None) -> Iterator[Path]:
    """A URDF that SAPIEN can load, valid inside the `with`: `urdf` itself, or a repaired copy.

    The copy lacks absent meshes and meshes without faces, as visuals and as collision shapes, and absent pictures of
    materials. Meshes with a mirroring scale have reversed faces (SAPIEN would show them from inside). Only OBJ files
    are inspected; all are in `root`, as in `freeart21.files.urdf_files`.
    """
    read = read_urdf(urdf)
    with tempfile.TemporaryDirectory(prefix="freeart21-") as place:

        def usable(_: str, shape: UrdfShape) -> UrdfShape | None:
            texture = str(resolve_file(urdf, shape.texture, root)) if shape.texture else ""
            if shape.kind != "mesh":
                return replace(shape, texture=texture)
            path = resolve_file(urdf, shape.filename, root)
            file = _mesh_for_sapien(path, Path(place), bool(np.prod(shape.size) < 0))
            files.append((str(urdf.absolute().parent / shape.filename), str(file)))
            return None if file is None else replace(shape, filename=str(file), texture=texture)

        files: list[tuple[str, str]] = []
        changed = read.with_shapes(usable)
        copy = Path(place) / urdf.name
        if any(named != file for named, file in files):
            copy.write_bytes(format_urdf(replace(changed, mujoco={})))
        yield copy if copy.is_file() else urdf


def _mesh_for_sapien(path: Path, place: Path, mirrored: bool) -> Path | None:
    """The mesh file itself, a repaired copy in `place`, or None when there is nothing to show.

    The copy lacks absent pictures; its faces are reversed when `mirrored`.
    """
    if path.suffix.lower() != ".obj":
        return checked.require_file(path, MAX_OBJ_BYTES, checked.ANYWHERE) if path.exists() else path
    if not path.is_file():
        return None
    text = _text(path, MAX_OBJ_BYTES)
    if not _FACE.search(text):
        return None
    libraries = [mtl for name in _LIBRARY.findall(text) if (mtl := path.parent / name).is_file()]
    lines = [
        _resolve_picture(line, path.parent) for mtl in libraries for line in _text(mtl, MAX_MTL_BYTES).splitlines()
    ]
    if (
        all(unchanged for _, unchanged in lines)
        and not mirrored
        and not any(checked.read_head(file, 3) == _BYTE_ORDER_MARK for file in (path, *libraries))
    ):
        return path
    if mirrored:
        text = _FACE_LINE.sub(lambda face: "f " + " ".join(reversed(face[1].split())), text)
    stem = place / f"mesh-{len(list(place.iterdir()))}"
    stem.with_suffix(".mtl").write_text("\n".join(line for line, _ in lines) + "\n")
    stem.with_suffix(".obj").write_text(f"mtllib {stem.name}.mtl\n" + _LIBRARY.sub("", text))
    return stem.with_suffix(".obj")


def _resolve_picture(line: str, folder: Path) -> tuple[str, bool]:
    """An MTL line with its picture's full path, empty when that is absent; and whether it needs no change."""
    key, _, rest = line.strip().partition(" ")
    rest = rest.strip()
    if not key.startswith(_PICTURES):
        return line, True
    for name in dict.fromkeys((rest, *rest.split()[-1:])):
        for path in (name, name.replace("\\", "/")):
            if (folder / path).is_file():
                return f"{key} {rest.removesuffix(name)}{(folder / path).resolve()}", path == name
    return "", False
