"""Prepares a URDF for engines: absolute file names, no visuals, and mimic joints fixed (`tree.freeze_mimics`)."""

from __future__ import annotations

import tempfile
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

from export.check.tree import build_tree, freeze_mimics
from export.checklist import read_solid
from freeart21.files.urdf import UrdfShape, format_urdf, read_urdf
from freeart21.files.urdf_files import resolve_file

READ_BY_ENGINES = (".obj", ".stl", ".msh", ".vtk")
"""Collision mesh formats that engines read; others are converted to OBJ."""


def write_plain_urdf(urdf: Path, folder: Path, compiler: Mapping[str, str] | None = None) -> Path:
    """A copy in a temporary folder, which lives as long as the process.

    `compiler` overrides attributes of MuJoCo's <compiler> in the file.
    """
    read, place = read_urdf(urdf), Path(tempfile.mkdtemp())

    def engine_shape(tag: str, shape: UrdfShape) -> UrdfShape | None:
        if tag == "visual":
            return None
        if shape.kind != "mesh":
            return shape
        path = resolve_file(urdf, shape.filename, folder)
        if path.suffix.lower() not in READ_BY_ENGINES and path.is_file():
            copy = place / f"{len([*place.iterdir()])}.obj"
            read_solid(path).export(copy, include_normals=False, include_texture=False)
            path = copy
        return replace(shape, filename=str(path))

    held = freeze_mimics(build_tree(read)).joints
    joints = {name: held[name] for name in read.joints}
    mujoco = {**read.mujoco, "compiler": {**read.mujoco.get("compiler", {}), **(compiler or {})}}
    copy = place / "asset.urdf"
    copy.write_bytes(format_urdf(replace(read.with_shapes(engine_shape), joints=joints, mujoco=mujoco)))
    return copy
