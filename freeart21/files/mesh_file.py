"""Reads and writes part meshes as PLY, with vertex colours and per-face flags."""

from __future__ import annotations

import io
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from freeart21.errors import FreeArtError
from freeart21.files import atomic, checked
from freeart21.mesh import Mesh

MAX_PLY_BYTES = 512 << 20
PLY_TYPES = {
    "char": "i1",
    "int8": "i1",
    "uchar": "u1",
    "uint8": "u1",
    "short": "i2",
    "int16": "i2",
    "ushort": "u2",
    "uint16": "u2",
    "int": "i4",
    "int32": "i4",
    "uint": "u4",
    "uint32": "u4",
    "float": "f4",
    "float32": "f4",
    "double": "f8",
    "float64": "f8",
}


_Element = tuple[str, int, list[list[str]]]
"""Name, number of entries, and the words of each property."""
_Tables = dict[str, NDArray[Any]]


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
    end = data.index(b"end_header")
    body_at = data.index(b"\n", end) + 1
    lines = data[:end].decode("ascii").splitlines()
    if not lines or lines[0].strip() != "ply":
        raise ValueError("it does not begin with 'ply'")
    encoding = next(line.split()[1] for line in lines if line.startswith("format"))
    elements: list[_Element] = []
    for line in lines:
        words = line.split()
        if words[:1] == ["element"]:
            if int(words[2]) < 0:
                raise ValueError(f"element {words[1]} has count {words[2]}")
            elements.append((words[1], int(words[2]), []))
        elif words[:1] == ["property"]:
            elements[-1][2].append(words[1:])
    tables = (_ascii_tables if encoding == "ascii" else _binary_tables)(data[body_at:], elements, encoding)
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


def _dtype(properties: list[list[str]], order: str) -> np.dtype[np.void]:
    fields: list[tuple[Any, ...]] = []
    for words in properties:
        if words[0] == "list":
            if words[3] not in ("vertex_indices", "vertex_index"):
                raise ValueError(f"it has a list property '{words[3]}', expected vertex_indices only")
            fields += [("n", order + PLY_TYPES[words[1]]), ("i", order + PLY_TYPES[words[2]], 3)]
        else:
            fields.append((words[1], order + PLY_TYPES[words[0]]))
    return np.dtype(fields)


def _binary_tables(body: bytes, elements: list[_Element], encoding: str) -> _Tables:
    order = {"binary_little_endian": "<", "binary_big_endian": ">"}[encoding]
    tables, at = {}, 0
    for name, count, properties in elements:
        dtype = _dtype(properties, order)
        if at + count * dtype.itemsize > len(body):
            raise ValueError(f"it ends before its {count} {name} entries")
        tables[name] = np.frombuffer(body, dtype, count, at)
        at += count * dtype.itemsize
    return tables


def _ascii_tables(body: bytes, elements: list[_Element], encoding: str) -> _Tables:
    lines = io.StringIO(body.decode("ascii"))
    tables = {}
    for name, count, properties in elements:
        dtype = _dtype(properties, "<")
        if 2 * count * len(properties) > len(body) + 1:  # each entry has a digit and a blank
            raise ValueError(f"it ends before its {count} {name} entries")
        rows = np.loadtxt(lines, max_rows=count, ndmin=2) if count else np.zeros((0, 0))
        if len(rows) != count:
            raise ValueError(f"it ends before its {count} {name} entries")
        table = np.zeros(count, dtype)
        column = 0
        for field in dtype.names or ():
            width = 3 if field == "i" else 1
            table[field] = rows[:, column : column + width].reshape(table[field].shape)
            column += width
        tables[name] = table
    return tables
