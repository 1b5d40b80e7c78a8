"""The URDF reader: links with shapes and masses, joints, forward kinematics.

It accepts what strict parsers refuse: limits without effort and velocity, repeated visual names, links without inertia.
Input is untrusted: sizes are bounded, a document type (and so entities) is refused, no path leaves the folder, and
every error is one line. Mesh files are not opened here.
"""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections import Counter
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

import numpy as np

from freeart21 import se3
from freeart21.errors import FreeArtError
from freeart21.files import checked
from freeart21.joint import Joint, JointType
from freeart21.se3 import Array

MAX_URDF_BYTES = 16 << 20
_MOVABLE: dict[str, JointType] = {"revolute": "revolute", "continuous": "revolute", "prismatic": "prismatic"}
_SIZES = {"box": (("size", 3),), "sphere": (("radius", 1),), "mesh": (("scale", 3),)} | dict.fromkeys(
    ("cylinder", "capsule"), (("radius", 1), ("length", 1))
)
"""Attributes that give a geometry's size, and how many numbers each has."""
LARGEST_LIMIT = 1e3
"""rad or m: a limit beyond it counts as unlimited. Files write 1e16 (default of SDFormat), 1e30 or inf."""
LARGEST_NUMBER = 1e9
"""SI: larger lengths, masses and moments are refused, so that products stay finite."""
_MOMENTS = ("ixx", "ixy", "ixz", "iyy", "iyz", "izz")


@dataclass(frozen=True)
class UrdfShape:
    """A visual or a collision shape of a link."""

    kind: str
    """mesh, box, sphere, cylinder or capsule, as in the URDF; empty when there is no geometry."""
    T_link_shape: Array
    """(4, 4) the shape's frame in its link's."""
    size: Array
    """Mesh: three scale factors. Box: three sides. Sphere: radius. Cylinder and capsule: radius and length. Metres;
    empty for other kinds."""
    filename: str = ""
    """Of a mesh, as written in the URDF."""
    rgba: Array | None = None
    """(4,) colour in 0..1, the visual's own or that of the material it names."""


@dataclass(frozen=True)
class UrdfInertial:
    """Mass properties of a link."""

    mass: float
    """kg."""
    centre: Array
    """(3,) centre of mass in the link's frame, m."""
    inertia: Array
    """(3, 3) about the centre of mass, along the link's axes, kg m^2."""


@dataclass(frozen=True)
class UrdfLink:
    """One link, in its own frame."""

    name: str
    visuals: tuple[UrdfShape, ...]
    collisions: tuple[UrdfShape, ...]
    inertial: UrdfInertial | None


@dataclass(frozen=True)
class UrdfJoint:
    """One joint of a URDF."""

    name: str
    type: str
    """As in the URDF: fixed, revolute, continuous, prismatic, ..."""
    parent: str
    child: str
    T_parent_joint: Array
    """(4, 4) the joint's frame in the parent link's; also the child link's frame at position zero."""
    axis: Array
    """(3,) unit vector in the joint's frame; only a fixed joint may have (0, 0, 0)."""
    lower: float
    """rad or m; -inf when unlimited or beyond LARGEST_LIMIT."""
    upper: float
    """rad or m; inf likewise."""
    limited: bool
    """Whether there is a <limit>."""
    effort: float | None
    """Largest N m or N; None when not given."""
    velocity: float | None
    """Largest rad/s or m/s; None when not given."""
    damping: float
    friction: float
    mimic: tuple[str, float, float] | None = None
    """Name of the joint that it mimics, multiplier and offset."""

    @property
    def joint_type(self) -> JointType | None:
        """'revolute' or 'prismatic' when it has one degree of freedom, else None."""
        return _MOVABLE.get(self.type)

    def transform(self, q: float) -> Array:
        """(4, 4) the child link's frame in the parent's at position `q`, rad or m. A joint of another type is fixed."""
        if self.joint_type is None:
            return self.T_parent_joint
        free = Joint(self.name, self.joint_type, self.axis, np.zeros(3), -np.inf, np.inf)
        return np.asarray(self.T_parent_joint @ free.transform(q))


@dataclass(frozen=True)
class Urdf:
    """A URDF whose joints form a tree, or several."""

    path: Path
    name: str
    links: dict[str, UrdfLink]
    """In file order."""
    joints: dict[str, UrdfJoint]
    """In file order."""
    parents_first: tuple[str, ...]
    """All links, level by level."""

    @property
    def root(self) -> str:
        """The only link that is no joint's child; FreeArtError when there are several."""
        children = {joint.child for joint in self.joints.values()}
        roots = [name for name in self.links if name not in children]
        if len(roots) != 1:
            raise FreeArtError(f"{self.path} has the root links {', '.join(roots) or 'none'}, expected one")
        return roots[0]

    def link_poses(self, q: Mapping[str, float]) -> dict[str, Array]:
        """Link name to T_root_link (4, 4), each in the frame of its own root; see the function `link_poses`."""
        Ts = link_poses(self.joints, q)
        return {name: Ts.get(name, np.eye(4)) for name in self.links}


def read_urdf(path: Path) -> Urdf:
    """The URDF in `path`; no mesh is opened.

    Raises FreeArtError when the file is no URDF, a number cannot be parsed, names repeat, or the joints form no tree.
    """
    robot = parse_urdf(path)
    joints = _parse_joints(robot, path)
    materials = {m.get("name", ""): m for m in robot.findall("material")}
    elements = robot.findall("link")
    for name, times in Counter(e.get("name", "") for e in elements).items():
        if times > 1:
            raise FreeArtError(f"{path} has link '{name}' {times} times, expected unique names")
    links = {e.get("name", ""): _parse_link(e, materials, path) for e in elements}
    return Urdf(path, robot.get("name", ""), links, joints, _sort_parents_first(list(links), joints, path))


def read_urdf_joints(path: Path) -> dict[str, UrdfJoint]:
    """Joint name to joint, in file order. Only the joints are read, and they need not form a tree.

    Raises FreeArtError when the file is no URDF or a joint's number cannot be parsed.
    """
    return _parse_joints(parse_urdf(path), path)


def parse_urdf(path: Path) -> ET.Element:
    """The <robot> element of a URDF file; FreeArtError when there is none."""
    robot = read_xml(path)
    if robot.tag != "robot":
        raise FreeArtError(f"{path} is not a URDF: its root is <{robot.tag}>, expected <robot>")
    return robot


def read_xml(path: Path, comments: bool = False, root: Path | None = None) -> ET.Element:
    """The root element of an XML file of bounded size; `root` bounds the path (see `checked`), None is ANYWHERE."""
    return parse_xml(checked.read_bytes(path, MAX_URDF_BYTES, root or checked.ANYWHERE), path, comments)


def parse_xml(data: bytes, where: Path, comments: bool = False) -> ET.Element:
    """The root element of untrusted XML, with `comments` if wanted.

    Raises FreeArtError when it is no XML, declares a document type, or is a xacro file.
    """
    try:
        root = ET.fromstring(data, ET.XMLParser(target=_Builder(insert_comments=comments)))
    except (ET.ParseError, LookupError, ValueError) as error:  # an encoding may be unknown
        if b"<xacro:" in data:  # its prefix is not declared
            raise _xacro_error(where) from error
        raise FreeArtError(f"{where} is not XML: {error}") from error
    if root.tag == "robot" and any(map(_is_macro, root.iter())):
        raise _xacro_error(where)
    return root


def _is_macro(element: ET.Element) -> bool:
    """Whether an element is xacro's, or has an attribute with a xacro expression, ${...} or $(...)."""
    name = element.tag if isinstance(element.tag, str) else ""  # comments have none
    return (name.startswith("{") and "xacro" in name) or any("${" in v or "$(" in v for v in element.attrib.values())


def _xacro_error(where: Path) -> FreeArtError:
    return FreeArtError(
        f"{where} is a xacro file, a template for URDFs: expand it first, `xacro {where.name} > expanded.urdf` "
        "(part of ROS, or `pip install xacro`)"
    )


class _Builder(ET.TreeBuilder):
    """Refuses documents that declare a document type, before any entity is expanded."""

    def doctype(self, name: str, pubid: str | None, system: str | None) -> None:
        """Called where a document type begins."""
        raise ET.ParseError(f"it declares a document type '{name}', which is not read")


def link_poses(joints: Mapping[str, UrdfJoint], q: Mapping[str, float]) -> dict[str, Array]:
    """Link name to T_root_link (4, 4) at joint positions `q`, rad or m; joints missing in `q` are at zero.

    Covers the links that joints name. The joints must form trees, as `read_urdf` checks. Mimic joints are placed by `q`
    like all others: call `resolve_mimics` first.
    """
    children = {joint.child for joint in joints.values()}
    Ts = {joint.parent: np.eye(4) for joint in joints.values() if joint.parent not in children}
    below, pending = child_joints(joints.values()), list(Ts)
    while pending:
        for joint in below.get(pending.pop(), ()):
            Ts[joint.child] = Ts[joint.parent] @ joint.transform(q.get(joint.name, 0.0))
            pending.append(joint.child)
    return Ts


class _HasMimic(Protocol):
    @property
    def mimic(self) -> tuple[str, float, float] | None: ...


def resolve_mimics(joints: Mapping[str, _HasMimic], q: Mapping[str, float]) -> dict[str, float]:
    """`q`, rad or m, completed by the positions of mimic joints: multiplier times the leader's position plus offset.

    A leader missing in `q` is at zero. Raises FreeArtError when a leader does not exist, or joints mimic each other.
    """
    full = dict(q)
    for name, joint in joints.items():
        factor, shift, leader, mimic = 1.0, 0.0, name, joint.mimic
        for _ in joints:
            if mimic is None:
                break
            leader, multiplier, offset = mimic
            factor, shift = factor * multiplier, shift + factor * offset
            if leader not in joints:
                raise FreeArtError(f"joint '{name}' mimics '{leader}', which is no joint; joints: {', '.join(joints)}")
            mimic = joints[leader].mimic
        else:
            raise FreeArtError(f"joint '{name}' mimics itself by way of '{leader}'")
        if leader != name:
            full[name] = (factor * full.get(leader, 0.0) if factor else 0.0) + shift
    return full


def child_joints(joints: Iterable[UrdfJoint]) -> dict[str, list[UrdfJoint]]:
    """Link name to the joints that have it as parent."""
    found: dict[str, list[UrdfJoint]] = {}
    for joint in joints:
        found.setdefault(joint.parent, []).append(joint)
    return found


def subtree_links(joints: Mapping[str, UrdfJoint], link: str) -> set[str]:
    """`link` and all its descendants."""
    below, found, pending = child_joints(joints.values()), {link}, [link]
    while pending:
        new = {joint.child for joint in below.get(pending.pop(), ())} - found
        found |= new
        pending += new
    return found


def read_attribute(element: ET.Element, path: str, attribute: str, default: str = "") -> str:
    """An attribute of the element at `path` below `element`, or the default when either is missing."""
    found = element.find(path)
    return default if found is None else found.get(attribute, default)


def parse_numbers(text: str | None, count: int, what: str, finite: bool = True) -> Array:
    """(count,) numbers of an attribute's text. `finite` numbers may be at most LARGEST_NUMBER.

    Raises FreeArtError, which begins with `what`, such as "a.urdf: joint 'lid' has axis".
    """
    try:
        values = np.array([float(word) for word in (text or "").split()])
    except ValueError:
        values = np.zeros(0)
    if len(values) != count or np.isnan(values).any() or (finite and (np.abs(values) > LARGEST_NUMBER).any()):
        noun = "a finite number" if count == 1 else f"{count} finite numbers"
        noun += f" of at most {LARGEST_NUMBER:g}" * bool(len(values) == count and np.isfinite(values).all())
        raise FreeArtError(f"{what} '{text}', expected {noun}")
    return values


def parse_origin(element: ET.Element, where: str) -> Array:
    """(4, 4) of an element's <origin xyz rpy>: R = Rz(yaw) Ry(pitch) Rx(roll), rad."""
    roll, pitch, yaw = parse_numbers(read_attribute(element, "origin", "rpy", "0 0 0"), 3, f"{where} has rpy")
    x, y, z = np.eye(3)
    R = se3.exp_so3(yaw * z) @ se3.exp_so3(pitch * y) @ se3.exp_so3(roll * x)
    return se3.pose(R, parse_numbers(read_attribute(element, "origin", "xyz", "0 0 0"), 3, f"{where} has xyz"))


def _parse_joints(robot: ET.Element, path: Path) -> dict[str, UrdfJoint]:
    joints: dict[str, UrdfJoint] = {}
    for element in robot.findall("joint"):
        name = element.get("name", "")
        if not name or name in joints or element.find("parent") is None or element.find("child") is None:
            raise FreeArtError(f"{path}: joint '{name}' needs a unique name, a parent and a child")
        joints[name] = _parse_joint(element, f"{path}: joint '{name}'")
    return joints


def _parse_joint(element: ET.Element, where: str) -> UrdfJoint:
    kind, limit, mimic = element.get("type", ""), element.find("limit"), element.find("mimic")

    def number(tag: str, attribute: str, default: str = "0", finite: bool = True) -> float:
        return float(
            parse_numbers(read_attribute(element, tag, attribute, default), 1, f"{where} has {attribute}", finite)[0]
        )

    def end(attribute: str) -> float:
        value = number("limit", attribute, finite=False)
        return value if abs(value) <= LARGEST_LIMIT else float(np.copysign(np.inf, value))

    def strength(attribute: str) -> float | None:
        value = number("limit", attribute, finite=False)
        return value if np.isfinite(value) else None

    axis = parse_numbers(read_attribute(element, "axis", "xyz", "1 0 0"), 3, f"{where} has axis")
    length = float(np.linalg.norm(axis))
    if kind in _MOVABLE and length < 1e-9:
        raise FreeArtError(f"{where} has axis {axis.tolist()}, expected a direction")
    unlimited = kind == "continuous" or limit is None
    given = set() if limit is None else set(limit.keys())
    return UrdfJoint(
        element.get("name", ""),
        kind,
        read_attribute(element, "parent", "link"),
        read_attribute(element, "child", "link"),
        parse_origin(element, where),
        axis / max(length, 1e-9),
        -np.inf if unlimited else end("lower"),
        np.inf if unlimited else end("upper"),
        limit is not None,
        strength("effort") if "effort" in given else None,
        strength("velocity") if "velocity" in given else None,
        number("dynamics", "damping"),
        number("dynamics", "friction"),
        None
        if mimic is None
        else (mimic.get("joint", ""), number("mimic", "multiplier", "1"), number("mimic", "offset")),
    )


def _parse_link(element: ET.Element, materials: Mapping[str, ET.Element], path: Path) -> UrdfLink:
    name = element.get("name", "")
    where = f"{path}: link '{name}'"
    visuals = tuple(_parse_shape(shape, materials, f"{where}: a visual") for shape in element.findall("visual"))
    collisions = tuple(_parse_shape(shape, {}, f"{where}: a collision") for shape in element.findall("collision"))
    return UrdfLink(name, visuals, collisions, _parse_inertial(element, where))


def _parse_shape(shape: ET.Element, materials: Mapping[str, ET.Element], where: str) -> UrdfShape:
    T = parse_origin(shape, where)
    geometry = shape.find("geometry/*")
    if geometry is None:
        return UrdfShape("", T, np.zeros(0))
    default = "1 1 1" if geometry.tag == "mesh" else None
    sizes = [
        parse_numbers(geometry.get(attribute, default), count, f"{where} has {attribute}")
        for attribute, count in _SIZES.get(geometry.tag, ())
    ]
    size = np.concatenate([np.zeros(0), *sizes])
    return UrdfShape(geometry.tag, T, size, geometry.get("filename", ""), _parse_rgba(shape, materials, where))


def _parse_rgba(shape: ET.Element, materials: Mapping[str, ET.Element], where: str) -> Array | None:
    own = shape.find("material")
    if own is None:
        return None
    colour = own.find("color")
    if colour is None:
        named = materials.get(own.get("name", ""))
        colour = None if named is None else named.find("color")
    return None if colour is None else parse_numbers(colour.get("rgba", "1 1 1 1"), 4, f"{where} has rgba")


def _parse_inertial(link: ET.Element, where: str) -> UrdfInertial | None:
    inertial = link.find("inertial")
    if inertial is None or inertial.find("mass") is None:
        return None

    def number(tag: str, attribute: str) -> float:
        return float(parse_numbers(read_attribute(inertial, tag, attribute, "0"), 1, f"{where} has {attribute}")[0])

    T = parse_origin(inertial, where)
    tensor = np.zeros((3, 3))
    tensor[np.triu_indices(3)] = [number("inertia", name) for name in _MOMENTS]
    tensor = tensor + np.triu(tensor, 1).T
    return UrdfInertial(number("mass", "value"), T[:3, 3], T[:3, :3] @ tensor @ T[:3, :3].T)


def _sort_parents_first(links: list[str], joints: Mapping[str, UrdfJoint], path: Path) -> tuple[str, ...]:
    """Link names level by level, each level in file order; FreeArtError when the joints do not form trees of these
    links."""
    parent_joint: dict[str, str] = {}
    known = set(links)
    for joint in joints.values():
        for link in (joint.parent, joint.child):
            if link not in known:
                raise FreeArtError(f"{path}: joint '{joint.name}' names link '{link}'; links: {', '.join(links)}")
        if joint.child in parent_joint:
            both = f"joints '{parent_joint[joint.child]}' and '{joint.name}'"
            raise FreeArtError(f"{path}: link '{joint.child}' is the child of both {both}, expected a tree")
        parent_joint[joint.child] = joint.name
    below, place = child_joints(joints.values()), {name: i for i, name in enumerate(links)}
    order: list[str] = []
    level = [name for name in links if name not in parent_joint]
    while level:
        order += level
        level = sorted((j.child for name in level for j in below.get(name, ())), key=place.__getitem__)
    if len(order) < len(links):
        unreached = min(known - set(order), key=place.__getitem__)
        raise FreeArtError(f"{path}: its joints form a loop at link '{unreached}', expected a tree")
    return tuple(order)
