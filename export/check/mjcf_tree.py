"""Reads an MJCF without MuJoCo: bodies and joints as a tree, and the files that it names.

Supports bodies with at most one hinge or slide each (and a free joint at the top), default classes, degrees, and all
notations of orientation. Everything else (`<include>`, `<replicate>`, `<frame>`, ball joints, ...) raises
UnsupportedMjcf; then only MuJoCo's own reading is used.
"""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from export.check.tree import Tree, TreeJoint
from freeart21 import se3
from freeart21.errors import FreeArtError
from freeart21.files import checked
from freeart21.files.urdf import UrdfInertial, parse_numbers, read_xml
from freeart21.joint import JointType
from freeart21.se3 import Array

_KINDS: dict[str, JointType] = {"hinge": "revolute", "slide": "prismatic"}
_UNSUPPORTED = ("include", "replicate", "frame", "attach", "composite", "flexcomp", "plugin")


class UnsupportedMjcf(Exception):
    """The file uses a feature that this reader does not support."""


def list_files(mjcf: Path, folder: Path) -> Iterator[Path]:
    """The files that an MJCF names; FreeArtError when one lies outside `folder`, or another file is included."""
    root = read_xml(mjcf)
    folders = {kind: "" for kind in ("mesh", "texture")}
    for compiler in root.iter("compiler"):
        both = compiler.get("assetdir", "")
        folders = {kind: compiler.get(f"{kind}dir", both) or folders[kind] for kind in folders}
    for element in root.iter():
        if element.tag in ("include", "model", "plugin", "extension"):
            raise FreeArtError(f"{mjcf} has <{element.tag}>, expected one file without extensions")
        for name in (value for key, value in element.attrib.items() if key.startswith("file")):
            below = folders["texture" if element.tag == "texture" else "mesh"]
            yield checked.inside(folder, str(mjcf.parent.resolve() / below / name))


def read_mjcf_tree(mjcf: Path) -> Tree:
    """The tree of bodies below the world's only child.

    Raises UnsupportedMjcf, or FreeArtError for what is no MJCF or no number.
    """
    root = read_xml(mjcf)
    for tag in _UNSUPPORTED:
        if root.find(f".//{tag}") is not None:
            raise UnsupportedMjcf(f"it has <{tag}>")
    world = root.findall("worldbody")
    bodies = [body for part in world for body in part.findall("body")]
    if len(bodies) != 1:
        raise UnsupportedMjcf(f"its world has {len(bodies)} bodies")
    reader = _Reader(root, mjcf)
    reader.body(bodies[0], None, "main")
    return Tree(bodies[0].get("name", ""), tuple(reader.links), reader.joints, reader.inertials)


class _Reader:
    def __init__(self, root: ET.Element, path: Path):
        self.path = path
        self.links: list[str] = []
        self.joints: dict[str, TreeJoint] = {}
        self.inertials: dict[str, UrdfInertial] = {}
        options: dict[str, str] = {}
        for compiler in root.iter("compiler"):
            options |= compiler.attrib
        if options.get("coordinate", "local") != "local":
            raise UnsupportedMjcf("its coordinates are global")
        self.unit = 1.0 if options.get("angle", "degree") == "radian" else np.pi / 180
        self.sequence = options.get("eulerseq", "xyz")
        self.autolimits = options.get("autolimits", "true") == "true"
        self.classes: dict[str, dict[str, str]] = {"main": {}}
        for default in root.findall("default"):
            self._class(default, default.get("class", "main"), {})

    def _class(self, default: ET.Element, name: str, above: dict[str, str]) -> None:
        joint = default.find("joint")
        self.classes[name] = above | ({} if joint is None else dict(joint.attrib))
        for inner in default.findall("default"):
            self._class(inner, inner.get("class", ""), self.classes[name])

    def body(self, element: ET.Element, parent: str | None, inherited: str) -> None:
        name, inherited = element.get("name", ""), element.get("childclass", inherited)
        if not name:
            raise UnsupportedMjcf("a body has no name")
        self.links.append(name)
        inertial = element.find("inertial")
        if inertial is not None:
            self.inertials[name] = self._inertial(inertial, name)
        found = element.findall("joint")
        free = [*element.findall("freejoint"), *(j for j in found if j.get("type") == "free")]
        if (free and parent is not None) or len(found) > 1:
            raise UnsupportedMjcf(f"body '{name}' has {len(found) + len(free)} joints")
        if parent is not None:
            self._add_joint(element, name, parent, found[0] if found else None, inherited)
        elif [j for j in found if j not in free]:
            raise UnsupportedMjcf(f"body '{name}' is attached to the world by a joint")
        for child in element.findall("body"):
            self.body(child, name, inherited)

    def _add_joint(self, body: ET.Element, name: str, parent: str, joint: ET.Element | None, inherited: str) -> None:
        T = se3.pose(self._rotation(body, name), self._numbers(body, "pos", "0 0 0", 3, name))
        if joint is None:
            title, kind, attributes = f"{name} (welded)", None, {}
        else:
            attributes = self.classes.get(joint.get("class", inherited), {}) | joint.attrib
            title, mjcf_type = attributes.get("name", f"{name} (joint)"), attributes.get("type", "hinge")
            if mjcf_type not in _KINDS:
                raise UnsupportedMjcf(f"joint '{title}' is of type {mjcf_type}")
            kind = _KINDS[mjcf_type]
        element = ET.Element("joint", attributes)
        axis = self._numbers(element, "axis", "0 0 1", 3, title)
        length = float(np.linalg.norm(axis))
        if length < 1e-9:
            raise FreeArtError(f"{self.path}: joint '{title}' has axis {axis.tolist()}, expected a direction")
        unit = self.unit if kind == "revolute" else 1.0
        limited = attributes.get("limited", "auto")
        if limited == "true" or (limited == "auto" and self.autolimits and "range" in attributes):
            lower, upper = unit * self._numbers(element, "range", "0 0", 2, title)
        else:
            lower, upper = -np.inf, np.inf
        first = {key: self._numbers(element, key, "0", None, title)[0] for key in ("damping", "frictionloss", "ref")}
        if first["ref"]:
            raise UnsupportedMjcf(f"joint '{title}' has a ref")
        self.joints[title] = TreeJoint(
            title,
            kind,
            parent,
            name,
            T,
            axis / length,
            self._numbers(element, "pos", "0 0 0", 3, title),
            float(lower),
            float(upper),
            float(first["damping"]),
            float(first["frictionloss"]),
        )

    def _inertial(self, element: ET.Element, name: str) -> UrdfInertial:
        R = self._rotation(element, name)
        if "fullinertia" in element.attrib:
            xx, yy, zz, xy, xz, yz = self._numbers(element, "fullinertia", "", 6, name)
            tensor = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
        else:
            tensor = np.diag(self._numbers(element, "diaginertia", "0 0 0", 3, name))
        mass = float(self._numbers(element, "mass", "0", 1, name)[0])
        return UrdfInertial(mass, self._numbers(element, "pos", "0 0 0", 3, name), R @ tensor @ R.T)

    def _rotation(self, element: ET.Element, name: str) -> Array:
        """(3, 3) from quat, axisangle, euler, xyaxes or zaxis."""
        if "quat" in element.attrib:
            return se3.rotation_from_wxyz(self._numbers(element, "quat", "", 4, name))
        if "axisangle" in element.attrib:
            axisangle = self._numbers(element, "axisangle", "", 4, name)
            return se3.exp_so3(self.unit * axisangle[3] * axisangle[:3] / np.linalg.norm(axisangle[:3]))
        if "euler" in element.attrib:
            R = np.eye(3)
            for letter, angle in zip(self.sequence, self._numbers(element, "euler", "", 3, name), strict=True):
                turn = se3.exp_so3(self.unit * angle * np.eye(3)["xyz".index(letter.lower())])
                R = R @ turn if letter.islower() else turn @ R
            return R
        if "xyaxes" in element.attrib:
            x, y = self._numbers(element, "xyaxes", "", 6, name).reshape(2, 3)
            x = x / np.linalg.norm(x)
            y = y - x * (x @ y)
            y /= np.linalg.norm(y)
            return np.stack([x, y, np.cross(x, y)], -1)
        if "zaxis" in element.attrib:
            z = self._numbers(element, "zaxis", "", 3, name)
            z = z / np.linalg.norm(z)
            axis = np.cross([0.0, 0.0, 1.0], z)
            sine = float(np.linalg.norm(axis))
            angle = np.arctan2(sine, z[2])
            return se3.exp_so3(angle * axis / sine if sine > 1e-12 else np.array([angle, 0.0, 0.0]))
        return np.eye(3)

    def _numbers(self, element: ET.Element, key: str, default: str, count: int | None, name: str) -> Array:
        text = element.get(key, default)
        if count is None:  # MuJoCo 4 allows several
            count = max(1, len(text.split()))
        return parse_numbers(text, count, f"{self.path}: '{name}' has {key}")
