"""PLY files as other projects' libraries write them."""

from __future__ import annotations

from pathlib import Path

import numpy as np


def write_cloud(path: Path, points, colour=(200, 200, 200)) -> None:
    """As plyfile writes a cloud: binary, float32 positions, uchar colours, no faces."""
    table = np.zeros(len(points), [(k, "<f4") for k in "xyz"] + [(k, "u1") for k in ("red", "green", "blue")])
    for k, axis in enumerate("xyz"):
        table[axis] = np.asarray(points)[:, k]
    for name, value in zip(("red", "green", "blue"), colour, strict=True):
        table[name] = value
    kinds = ["float x", "float y", "float z", "uchar red", "uchar green", "uchar blue"]
    head = ["ply", "format binary_little_endian 1.0", f"element vertex {len(table)}", *(f"property {k}" for k in kinds)]
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes("\n".join([*head, "end_header\n"]).encode() + table.tobytes())


def write_mesh(path: Path, vertices, faces) -> None:
    """As Open3D writes a mesh: binary, double positions, uchar uint lists."""
    table = np.zeros(len(faces), [("n", "u1"), ("i", "<u4", 3)])
    table["n"], table["i"] = 3, faces
    head = [
        *("ply", "format binary_little_endian 1.0", "comment Created by Open3D", f"element vertex {len(vertices)}"),
        *("property double x", "property double y", "property double z", f"element face {len(faces)}"),
        *("property list uchar uint vertex_indices", "end_header\n"),
    ]
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes("\n".join(head).encode() + np.asarray(vertices, "<f8").tobytes() + table.tobytes())


def write_obj(path: Path, vertices, faces) -> None:
    """As trimesh writes a mesh: text, indices from 1."""
    lines = [*(f"v {x:.8f} {y:.8f} {z:.8f}" for x, y, z in vertices)]
    lines += [f"f {a + 1} {b + 1} {c + 1}" for a, b, c in faces]
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text("\n".join(lines) + "\n")
