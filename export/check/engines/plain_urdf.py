"""Prepares a URDF for engines: absolute file names, no visuals, and mimic joints fixed (`tree.freeze_mimics`)."""

from __future__ import annotations

import tempfile
import xml.etree.ElementTree as ET
from pathlib import Path

from export.check.tree import build_tree, freeze_mimics
from export.checklist import read_solid
from export.urdf import origin_element
from freeart21.files.urdf import parse_urdf, read_urdf
from freeart21.files.urdf_files import resolve_file

READ_BY_ENGINES = (".obj", ".stl", ".msh", ".vtk")
"""Collision mesh formats that engines read; others are converted to OBJ."""


def _as_obj(path: Path, copy: Path) -> Path:
    read_solid(path).export(copy, include_normals=False, include_texture=False)
    return copy


def write_plain_urdf(urdf: Path, folder: Path, extra: ET.Element | None = None) -> Path:
    """A copy in a temporary folder, which lives as long as the process.

    `extra` is inserted at the top; its attributes override those of an element of the same name in the file.
    """
    robot, place = parse_urdf(urdf), Path(tempfile.mkdtemp())
    for link in robot.findall("link"):
        for visual in link.findall("visual"):
            link.remove(visual)
    for element in robot.iter():
        if "filename" in element.attrib:
            path = resolve_file(urdf, element.attrib["filename"], folder)
            if path.suffix.lower() not in READ_BY_ENGINES and path.is_file():
                path = _as_obj(path, place / f"{len([*place.iterdir()])}.obj")
            element.set("filename", str(path))
    held = freeze_mimics(build_tree(read_urdf(urdf))).joints
    for joint in robot.findall("joint"):
        for mimic in joint.findall("mimic"):
            joint.remove(mimic)
            joint.set("type", "fixed")
            for origin in joint.findall("origin"):
                joint.remove(origin)
            joint.append(origin_element(held[joint.get("name", "")].T_parent_child))
    if extra is not None:
        for own in robot.findall(extra.tag):  # engines refuse two of them
            robot.remove(own)
            for words in own:
                same = extra.find(words.tag)
                if same is None:
                    extra.append(words)
                else:
                    same.attrib.update({key: value for key, value in words.attrib.items() if key not in same.attrib})
        robot.insert(0, extra)
    copy = place / "asset.urdf"
    copy.write_bytes(ET.tostring(robot))
    return copy
