"""A URDF as engines are given it: as written, but with absolute file names and without what is only looked at."""

from __future__ import annotations

import tempfile
import xml.etree.ElementTree as ET
from pathlib import Path

from freeart21.files.urdf import parsed
from freeart21.files.urdf_files import named_inside


def plain_urdf(urdf: Path, folder: Path, extra: ET.Element | None = None) -> Path:
    """A copy in a temporary folder that lives as long as the process; `extra` is added at its beginning."""
    robot = parsed(urdf)
    for link in robot.findall("link"):
        for visual in link.findall("visual"):
            link.remove(visual)
    for element in robot.iter():
        if "filename" in element.attrib:
            element.set("filename", str(named_inside(urdf, element.attrib["filename"], folder)))
    if extra is not None:
        robot.insert(0, extra)
    copy = Path(tempfile.mkdtemp()) / "asset.urdf"
    copy.write_bytes(ET.tostring(robot))
    return copy
