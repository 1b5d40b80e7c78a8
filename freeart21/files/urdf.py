"""A URDF as numbers: links with their shapes and masses, joints, and where every link is. The one reader of them all.

Reads what strict parsers refuse (limits without effort and velocity, repeated visual names, links without inertia) and
trusts nothing: bounded size, no document type (so no entities), no path outside of the folder, and one clear line for
whatever is wrong. What a mesh file holds is its reader's affair.
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
"""Attributes that give a geometry's size, and how many numbers each holds."""
LARGEST_LIMIT = 1e3
"""rad or m: a limit beyond it is none. Files say 1e16 (the default of SDFormat), 1e30 or inf of a joint without end."""
LARGEST_NUMBER = 1e9
"""SI: no length, mass or moment of an asset is beyond it; products of such numbers stay finite."""
_MOMENTS = ("ixx", "ixy", "ixz", "iyy", "iyz", "izz")


@dataclass(frozen=True)
class UrdfShape:
    """A visual or a collision shape of a link."""

    kind: str
    """As the URDF says: mesh, box, sphere, cylinder, capsule; empty when it says nothing."""
    T_link_shape: Array
    """(4, 4) the shape's frame in its link's."""
    size: Array
    """Mesh: three scale factors. Box: three sides. Sphere: radius. Cylinder, capsule: radius and length. All in
    metres; empty for other kinds."""
    filename: str = ""
    """Of a mesh, as the URDF names it."""
    rgba: Array | None = None
    """(4,) colour of a visual in 0..1, its own or that of the material that it names."""


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
    """As the URDF says: fixed, revolute, continuous, prismatic, ..."""
    parent: str
    child: str
    T_parent_joint: Array
    """(4, 4) the frame of the joint, and of the child link at position zero, in the parent link's."""
    axis: Array
    """(3,) unit vector in the joint's frame; only a fixed joint may have (0, 0, 0)."""
    lower: float
    """rad or m; -inf without a limit, or with one beyond LARGEST_LIMIT."""
    upper: float
    """rad or m; inf likewise."""
    limited: bool
    """Whether there is a <limit> at all."""
    effort: float | None
    """Largest N m or N, where the URDF says so."""
    velocity: float | None
    """Largest rad/s or m/s, where the URDF says so."""
    damping: float
    friction: float
    mimic: tuple[str, float, float] | None = None
    """The joint that it follows, multiplier and offset."""

    @property
    def joint_type(self) -> JointType | None:
        """'revolute' or 'prismatic' when it moves with one degree of freedom, else None."""
        return _MOVABLE.get(self.type)

    def transform(self, q: float) -> Array:
        """(4, 4) the child link's frame in the parent's at position `q`, rad or m; of a joint that moves, if at all, as
        a hinge or a slider."""
        if self.joint_type is None:
            return self.T_parent_joint
        free = Joint(self.name, self.joint_type, self.axis, np.zeros(3), -np.inf, np.inf)
        return np.asarray(self.T_parent_joint @ free.transform(q))


@dataclass(frozen=True)
class Urdf:
    """A whole URDF, its joints a tree (or several)."""

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
        """The link that hangs on no joint; FreeArtError when there are several."""
        hung = {joint.child for joint in self.joints.values()}
        roots = [name for name in self.links if name not in hung]
        if len(roots) != 1:
            raise FreeArtError(f"{self.path} has the root links {', '.join(roots) or 'none'}, expected one")
        return roots[0]

    def link_poses(self, q: Mapping[str, float]) -> dict[str, Array]:
        """Link name to T_root_link (4, 4), its own root's; see the function of this name."""
        Ts = link_poses(self.joints, q)
        return {name: Ts.get(name, np.eye(4)) for name in self.links}


def read_urdf(path: Path) -> Urdf:
    """The URDF in `path`; no mesh is opened.

    Raises FreeArtError when the file is not a URDF, a number is not one, names repeat, or its joints are not a tree.
    """
    robot = parsed(path)
    joints = _joints(robot, path)
    materials = {m.get("name", ""): m for m in robot.findall("material")}
    elements = robot.findall("link")
    for name, times in Counter(e.get("name", "") for e in elements).items():
        if times > 1:
            raise FreeArtError(f"{path} has link '{name}' {times} times, expected names of their own")
    links = {e.get("name", ""): _link(e, materials, path) for e in elements}
    return Urdf(path, robot.get("name", ""), links, joints, _parents_first(list(links), joints, path))


def read_urdf_joints(path: Path) -> dict[str, UrdfJoint]:
    """Joint name to joint, in file order; looks at nothing but the joints, and they may be no tree.

    Raises FreeArtError when the file is not a URDF or a joint's number is not one.
    """
    return _joints(parsed(path), path)


def parsed(path: Path) -> ET.Element:
    """The <robot> of a URDF file of bounded size; FreeArtError when there is none."""
    robot = read_xml(path)
    if robot.tag != "robot":
        raise FreeArtError(f"{path} is not a URDF: its root is <{robot.tag}>, expected <robot>")
    return robot


def read_xml(path: Path, comments: bool = False, root: Path | None = None) -> ET.Element:
    """The root of an XML file, as `parsed_xml`, and bounded; ANYWHERE when `root` (see `checked`) is None."""
    return parsed_xml(checked.read_bytes(path, MAX_URDF_BYTES, root or checked.ANYWHERE), path, comments)


def parsed_xml(data: bytes, where: Path, comments: bool = False) -> ET.Element:
    """XML from anywhere, maybe with its comments; FreeArtError when it is none or declares a document type."""
    try:
        root = ET.fromstring(data, ET.XMLParser(target=_Builder(insert_comments=comments)))
    except (ET.ParseError, LookupError, ValueError) as error:  # an encoding may be unknown
        if b"<xacro:" in data:  # its prefix is not declared
            raise _unexpanded(where) from error
        raise FreeArtError(f"{where} is not XML: {error}") from error
    if root.tag == "robot" and any(map(_is_macro, root.iter())):
        raise _unexpanded(where)
    return root


def _is_macro(element: ET.Element) -> bool:
    """Whether an element is xacro's, or has an attribute with one of its expressions, ${...} or $(...)."""
    name = element.tag if isinstance(element.tag, str) else ""  # comments have none
    return (name.startswith("{") and "xacro" in name) or any("${" in v or "$(" in v for v in element.attrib.values())


def _unexpanded(where: Path) -> FreeArtError:
    return FreeArtError(
        f"{where} is a xacro file, a macro text from which URDFs are made, and is no URDF yet: expand it first, "
        f"`xacro {where.name} > expanded.urdf` (of ROS, or of `pip install xacro`)"
    )


class _Builder(ET.TreeBuilder):
    """Refuses documents that declare entities, before the first is read."""

    def doctype(self, name: str, pubid: str | None, system: str | None) -> None:
        """Called where a document type begins."""
        raise ET.ParseError(f"it declares a document type '{name}', which is not read")


def link_poses(joints: Mapping[str, UrdfJoint], q: Mapping[str, float]) -> dict[str, Array]:
    """Link name to T_root_link (4, 4) at joint positions `q`, rad or m; joints not named stand at zero.

    Covers the links that joints name; these must form trees (`read_urdf` makes sure). A joint that mimics another one
    stands where `q` says, too: `with_followers` completes it.
    """
    hung = {joint.child for joint in joints.values()}
    Ts = {joint.parent: np.eye(4) for joint in joints.values() if joint.parent not in hung}
    below, waiting = children(joints.values()), list(Ts)
    while waiting:
        for joint in below.get(waiting.pop(), ()):
            Ts[joint.child] = Ts[joint.parent] @ joint.transform(q.get(joint.name, 0.0))
            waiting.append(joint.child)
    return Ts


class _Follower(Protocol):
    @property
    def mimic(self) -> tuple[str, float, float] | None: ...


def with_followers(joints: Mapping[str, _Follower], q: Mapping[str, float]) -> dict[str, float]:
    """`q`, rad or m, and where it puts the joints that mimic others: multiplier times the leader's position + offset.

    A leader that `q` does not name stands at zero. Raises FreeArtError when a leader is no joint, or mimics in turn
    who mimics it.
    """
    full = dict(q)
    for name, joint in joints.items():
        factor, shift, at, mimic = 1.0, 0.0, name, joint.mimic
        for _ in joints:
            if mimic is None:
                break
            at, multiplier, offset = mimic
            factor, shift = factor * multiplier, shift + factor * offset
            if at not in joints:
                raise FreeArtError(f"joint '{name}' mimics '{at}', which is no joint; joints: {', '.join(joints)}")
            mimic = joints[at].mimic
        else:
            raise FreeArtError(f"joint '{name}' mimics, by way of '{at}', itself")
        if at != name:
            full[name] = (factor * full.get(at, 0.0) if factor else 0.0) + shift
    return full


def children(joints: Iterable[UrdfJoint]) -> dict[str, list[UrdfJoint]]:
    """Link name to the joints that hang on it."""
    found: dict[str, list[UrdfJoint]] = {}
    for joint in joints:
        found.setdefault(joint.parent, []).append(joint)
    return found


def links_beyond(joints: Mapping[str, UrdfJoint], link: str) -> set[str]:
    """`link` and every link that hangs on it."""
    below, found, waiting = children(joints.values()), {link}, [link]
    while waiting:
        new = {joint.child for joint in below.get(waiting.pop(), ())} - found
        found |= new
        waiting += new
    return found


def told(element: ET.Element, path: str, attribute: str, default: str = "") -> str:
    """An attribute of the element at `path` below `element`, or the default when either is not there."""
    found = element.find(path)
    return default if found is None else found.get(attribute, default)


def numbers(text: str | None, count: int, what: str, finite: bool = True) -> Array:
    """(count,) numbers of an attribute's text, of any size if they need not be `finite`, else up to LARGEST_NUMBER;
    FreeArtError otherwise.

    `what` begins the error, such as "a.urdf: joint 'lid' has axis".
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


def origin_pose(element: ET.Element, where: str) -> Array:
    """(4, 4) of an element's <origin xyz rpy>: R = Rz(yaw) Ry(pitch) Rx(roll), angles about fixed axes, rad."""
    roll, pitch, yaw = numbers(told(element, "origin", "rpy", "0 0 0"), 3, f"{where} has rpy")
    x, y, z = np.eye(3)
    R = se3.exp_so3(yaw * z) @ se3.exp_so3(pitch * y) @ se3.exp_so3(roll * x)
    return se3.pose(R, numbers(told(element, "origin", "xyz", "0 0 0"), 3, f"{where} has xyz"))


def _joints(robot: ET.Element, path: Path) -> dict[str, UrdfJoint]:
    joints: dict[str, UrdfJoint] = {}
    for element in robot.findall("joint"):
        name = element.get("name", "")
        if not name or name in joints or element.find("parent") is None or element.find("child") is None:
            raise FreeArtError(f"{path}: joint '{name}' needs a name of its own, a parent and a child")
        joints[name] = _joint(element, f"{path}: joint '{name}'")
    return joints


def _joint(element: ET.Element, where: str) -> UrdfJoint:
    kind, limit, mimic = element.get("type", ""), element.find("limit"), element.find("mimic")

    def number(tag: str, attribute: str, default: str = "0", finite: bool = True) -> float:
        return float(numbers(told(element, tag, attribute, default), 1, f"{where} has {attribute}", finite)[0])

    def end(attribute: str) -> float:
        value = number("limit", attribute, finite=False)
        return value if abs(value) <= LARGEST_LIMIT else float(np.copysign(np.inf, value))

    def strength(attribute: str) -> float | None:
        value = number("limit", attribute, finite=False)
        return value if np.isfinite(value) else None

    axis = numbers(told(element, "axis", "xyz", "1 0 0"), 3, f"{where} has axis")
    length = float(np.linalg.norm(axis))
    if kind in _MOVABLE and length < 1e-9:
        raise FreeArtError(f"{where} has axis {axis.tolist()}, expected a direction")
    unlimited = kind == "continuous" or limit is None
    said = set() if limit is None else set(limit.keys())
    return UrdfJoint(
        element.get("name", ""),
        kind,
        told(element, "parent", "link"),
        told(element, "child", "link"),
        origin_pose(element, where),
        axis / max(length, 1e-9),
        -np.inf if unlimited else end("lower"),
        np.inf if unlimited else end("upper"),
        limit is not None,
        strength("effort") if "effort" in said else None,
        strength("velocity") if "velocity" in said else None,
        number("dynamics", "damping"),
        number("dynamics", "friction"),
        None
        if mimic is None
        else (mimic.get("joint", ""), number("mimic", "multiplier", "1"), number("mimic", "offset")),
    )


def _link(element: ET.Element, materials: Mapping[str, ET.Element], path: Path) -> UrdfLink:
    name = element.get("name", "")
    where = f"{path}: link '{name}'"
    visuals = tuple(_shape(shape, materials, f"{where}: a visual") for shape in element.findall("visual"))
    collisions = tuple(_shape(shape, {}, f"{where}: a collision") for shape in element.findall("collision"))
    return UrdfLink(name, visuals, collisions, _inertial(element, where))


def _shape(shape: ET.Element, materials: Mapping[str, ET.Element], where: str) -> UrdfShape:
    T = origin_pose(shape, where)
    geometry = shape.find("geometry/*")
    if geometry is None:
        return UrdfShape("", T, np.zeros(0))
    default = "1 1 1" if geometry.tag == "mesh" else None
    sizes = [
        numbers(geometry.get(attribute, default), count, f"{where} has {attribute}")
        for attribute, count in _SIZES.get(geometry.tag, ())
    ]
    size = np.concatenate([np.zeros(0), *sizes])
    return UrdfShape(geometry.tag, T, size, geometry.get("filename", ""), _rgba(shape, materials, where))


def _rgba(shape: ET.Element, materials: Mapping[str, ET.Element], where: str) -> Array | None:
    own = shape.find("material")
    if own is None:
        return None
    colour = own.find("color")
    if colour is None:
        named = materials.get(own.get("name", ""))
        colour = None if named is None else named.find("color")
    return None if colour is None else numbers(colour.get("rgba", "1 1 1 1"), 4, f"{where} has rgba")


def _inertial(link: ET.Element, where: str) -> UrdfInertial | None:
    inertial = link.find("inertial")
    if inertial is None or inertial.find("mass") is None:
        return None

    def number(tag: str, attribute: str) -> float:
        return float(numbers(told(inertial, tag, attribute, "0"), 1, f"{where} has {attribute}")[0])

    T = origin_pose(inertial, where)
    tensor = np.zeros((3, 3))
    tensor[np.triu_indices(3)] = [number("inertia", name) for name in _MOMENTS]
    tensor = tensor + np.triu(tensor, 1).T
    return UrdfInertial(number("mass", "value"), T[:3, 3], T[:3, :3] @ tensor @ T[:3, :3].T)


def _parents_first(links: list[str], joints: Mapping[str, UrdfJoint], path: Path) -> tuple[str, ...]:
    """Link names level by level, in file order; FreeArtError when the joints are not trees of these links."""
    hung: dict[str, str] = {}
    known = set(links)
    for joint in joints.values():
        for link in (joint.parent, joint.child):
            if link not in known:
                raise FreeArtError(f"{path}: joint '{joint.name}' names link '{link}'; links: {', '.join(links)}")
        if joint.child in hung:
            both = f"joints '{hung[joint.child]}' and '{joint.name}'"
            raise FreeArtError(f"{path}: link '{joint.child}' hangs on both {both}, expected a tree")
        hung[joint.child] = joint.name
    below, place = children(joints.values()), {name: i for i, name in enumerate(links)}
    order: list[str] = []
    level = [name for name in links if name not in hung]
    while level:
        order += level
        level = sorted((j.child for name in level for j in below.get(name, ())), key=place.__getitem__)
    if len(order) < len(links):
        left = min(known - set(order), key=place.__getitem__)
        raise FreeArtError(f"{path}: its joints form a loop at link '{left}', expected a tree")
    return tuple(order)
