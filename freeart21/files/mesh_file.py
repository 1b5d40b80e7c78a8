"""Reads and writes part meshes as PLY, with vertex colours and per-face flags."""

from __future__ import annotations

import io
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from freeart21.errors import FreeArtError
from freeart21.files import atomic, checked
from freeart21.mesh import Mesh

MAX_PLY_BYTES = 512 << 20
_WORDS = {
    "i1": "char int8",
    "u1": "uchar uint8",
    "i2": "short int16",
    "u2": "ushort uint16",
    "i4": "int int32",
    "u4": "uint uint32",
    "f4": "float float32",
    "f8": "double float64",
}
_TYPES = {word: kind for kind, words in _WORDS.items() for word in words.split()}
_INDICES = ("vertex_indices", "vertex_index")
_ORDERS = {"ascii": "<", "binary_little_endian": "<", "binary_big_endian": ">"}


@dataclass(frozen=True)
class Header:
    """The header of a PLY file."""

    encoding: str
    elements: list[tuple[str, int, list[list[str]]]]
    """Name, number of entries, and the words of each property."""
    comments: list[str]
    body_at: int
    """Byte at which the entries begin."""

    def dtype(self, k: int) -> np.dtype[np.void]:
        """The entries of element `k`; of lists only one of three vertices, as fields n and i. ValueError otherwise."""
        order, fields = _ORDERS[self.encoding], list[tuple[Any, ...]]()
        for words in self.elements[k][2]:
            kinds = [_TYPES.get(word) for word in words[int(words[:1] == ["list"]) : -1]]
            if None in kinds or len(kinds) not in (1, 2) or (len(kinds) == 2 and words[3] not in _INDICES):
                given = checked.shorten(" ".join(words))
                raise ValueError(f"a property is {given}, expected a type of number and a name, or vertex_indices")
            if len(kinds) == 1:
                fields.append((words[1], f"{order}{kinds[0]}"))
            else:
                fields += [("n", f"{order}{kinds[0]}"), ("i", f"{order}{kinds[1]}", 3)]
        return np.dtype(fields)


def read_header(data: bytes) -> Header:
    """The header at the beginning of `data`; ValueError when there is none."""
    before, mark, after = data.partition(b"\nend_header")
    line_end = after.find(b"\n")
    if not data.startswith(b"ply") or not mark or after[: line_end + 1].strip() or line_end < 0:
        raise ValueError("it does not begin with 'ply', or has no end_header")
    encoding, elements, comments = "", list[tuple[str, int, list[list[str]]]](), []
    for line in before.decode("ascii").split("\n"):
        words = line.split()
        if words[:1] == ["format"]:
            encoding = words[1]
        elif words[:1] == ["comment"]:
            comments.append(line.strip())
        elif words[:1] == ["element"]:
            elements.append((words[1], int(words[2]), []))
            if int(words[2]) < 0:
                raise ValueError(f"element {checked.shorten(words[1])} has count {words[2]}")
        elif words[:1] == ["property"]:
            elements[-1][2].append(words[1:])
    if encoding not in _ORDERS:
        raise ValueError(f"its format is {checked.shorten(encoding)}, expected {' or '.join(_ORDERS)}")
    return Header(encoding, elements, comments, len(before) + len(mark) + line_end + 1)


def write_ply(path: Path, mesh: Mesh, flags: dict[str, NDArray[np.bool_]] | None = None) -> None:
    """Write `mesh` (vertices as float64) and named per-face flags (F,) as little-endian PLY."""
    flags = flags or {}
    vertex = [("x", "<f8"), ("y", "<f8"), ("z", "<f8")]
    if mesh.colours is not None:
        vertex += [("red", "u1"), ("green", "u1"), ("blue", "u1")]
    vertices = np.zeros(len(mesh.vertices), vertex)
    for k, axis in enumerate("xyz"):
        vertices[axis] = mesh.vertices[:, k]
    if mesh.colours is not None:
        for k, channel in enumerate(("red", "green", "blue")):
            vertices[channel] = mesh.colours[:, k]
    faces = np.zeros(len(mesh.faces), [("n", "u1"), ("i", "<i4", 3), *((name, "u1") for name in flags)])
    faces["n"], faces["i"] = 3, mesh.faces
    for name, value in flags.items():
        faces[name] = value
    kinds = {"<f8": "double", "u1": "uchar"}
    header = [
        "ply",
        "format binary_little_endian 1.0",
        "comment metres",
        f"element vertex {len(vertices)}",
        *(f"property {kinds[kind]} {name}" for name, kind in vertex),
        f"element face {len(faces)}",
        "property list uchar int vertex_indices",
        *(f"property uchar {name}" for name in flags),
        "end_header\n",
    ]
    atomic.write_bytes(path, "\n".join(header).encode() + vertices.tobytes() + faces.tobytes())


def read_ply(path: Path, root: Path | None = None) -> tuple[Mesh, dict[str, NDArray[np.bool_]]]:
    """The triangle mesh of a PLY file (ASCII or binary) and its per-face uchar flags.

    `root` is as in `checked`. Raises FreeArtError on polygons of other than three corners, and on anything that does
    not fit its own header.
    """
    data = checked.read_bytes(path, MAX_PLY_BYTES, root)
    try:
        return _parse(data)
    except (ValueError, KeyError, IndexError, UnicodeDecodeError) as error:
        raise FreeArtError(f"{path} is not a readable PLY triangle mesh: {error}") from error


def _parse(data: bytes) -> tuple[Mesh, dict[str, NDArray[np.bool_]]]:
    tables = _tables(data)
    vertex, face = tables.get("vertex"), tables.get("face")
    if vertex is None:
        raise ValueError("it has no vertices")
    points = np.stack([vertex[axis] for axis in "xyz"], -1).astype(float)
    colours = None
    if all(channel in (vertex.dtype.names or ()) for channel in ("red", "green", "blue")):
        rgb = np.stack([vertex[channel] for channel in ("red", "green", "blue")], -1)
        colours = rgb.astype(np.uint8) if rgb.dtype == np.uint8 else np.clip(rgb * 255 + 0.5, 0, 255).astype(np.uint8)
    if face is None or len(face) == 0:
        return Mesh(points, np.zeros((0, 3), int), colours), {}
    names = face.dtype.names or ()
    if (face["n"] != 3).any():
        raise ValueError("it has faces that are not triangles")
    flags = {name: face[name].astype(bool) for name in names if name not in ("n", "i") and face[name].dtype == np.uint8}
    return Mesh(points, face["i"].astype(np.int64), colours), flags


def _tables(data: bytes) -> dict[str, NDArray[Any]]:
    """Element name to its entries."""
    header, tables = read_header(data), {}
    text, at = header.encoding == "ascii", header.body_at
    lines = io.StringIO(data[at:].decode("ascii")) if text else io.StringIO()
    for k, (name, count, properties) in enumerate(header.elements):
        dtype = header.dtype(k)
        size = 2 * len(properties) if text else dtype.itemsize  # of text, a digit and a blank each at least
        if count * size > len(data) - at + text:
            raise ValueError(f"it ends before its {count} {name} entries")
        if text and count:
            tables[name] = np.loadtxt(lines, dtype, max_rows=count, ndmin=1)
        else:
            tables[name] = np.frombuffer(data, dtype, count, at)
            at += count * size
        if len(tables[name]) != count:
            raise ValueError(f"it ends before its {count} {name} entries")
    return tables
