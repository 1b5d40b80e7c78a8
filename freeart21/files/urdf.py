"""Reads and writes URDF: links with shapes and masses, joints, forward kinematics.

It accepts what strict parsers refuse: limits without effort and velocity, repeated visual names, links without inertia.
Input is untrusted: sizes are bounded, a document type (and so entities) is refused, no path leaves the folder, and
every error is one line. Mesh files are not opened here.
"""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections import Counter
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field, replace
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
_UNLIMITED = 1e16
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
    name: str = ""
    texture: str = ""
    """File name of the material's picture."""


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
    lower: float = -np.inf
    """rad or m; -inf when unlimited or beyond LARGEST_LIMIT."""
    upper: float = np.inf
    """rad or m; inf likewise."""
    limited: bool = False
    """Whether there is a <limit>."""
    effort: float | None = None
    """Largest N m or N; None when not given."""
    velocity: float | None = None
    """Largest rad/s or m/s; None when not given."""
    damping: float = 0.0
    friction: float = 0.0
    mimic: tuple[str, float, float] | None = None
    """Name of the joint that it mimics, multiplier and offset."""
    axis_length: float = 1.0
    """Of the axis as written."""
    pivot: Array = field(default_factory=lambda: np.zeros(3))
    """(3,) a point of the axis in the joint's frame, m; zero in a URDF, not in other formats."""

    @property
    def joint_type(self) -> JointType | None:
        """'revolute' or 'prismatic' when it has one degree of freedom, else None."""
        return _MOVABLE.get(self.type)

    @property
    def stated(self) -> bool:
        """Whether the file states its range, be it endless."""
        return self.limited or self.type == "continuous"

    @property
    def ordered(self) -> bool:
        """Whether the stated range is not empty."""
        return self.stated and self.lower < self.upper

    @property
    def sweep(self) -> tuple[float, float]:
        """The limits, or a turn either way or half a metre where there is none; twice zero for an empty range."""
        if not self.ordered:
            return 0.0, 0.0
        end = np.pi if self.joint_type == "revolute" else 0.5
        lower, upper = self.lower, self.upper
        if np.isinf(lower) and np.isinf(upper):
            return -end, end
        return (upper - end if np.isinf(lower) else lower), (lower + end if np.isinf(upper) else upper)

    @property
    def loaded(self) -> float:
        """Position at which a simulator should load it: zero, or the limit nearest to zero."""
        return float(np.clip(0.0, self.lower, self.upper)) if self.ordered else 0.0

    def transform(self, q: float | Array) -> Array:
        """(..., 4, 4) the child link's frame in the parent's at position(s) `q` (...), rad or m. A joint of another
        type is fixed."""
        if self.joint_type is None:
            return self.T_parent_joint
        free = Joint(self.name, self.joint_type, self.axis, self.pivot, -np.inf, np.inf)
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
    parents_first: tuple[str, ...] = ()
    """All links, level by level."""
    mujoco: Mapping[str, Mapping[str, str]] = field(default_factory=dict)
    """MuJoCo's extension of the format: names of the elements in <mujoco> to their attributes."""

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

    def with_shapes(self, change: Callable[[str, UrdfShape], UrdfShape | None]) -> Urdf:
        """The URDF with `change(tag, shape)` in place of each shape, without it for None; the tag is 'visual' or
        'collision'."""

        def changed(tag: str, shapes: tuple[UrdfShape, ...]) -> tuple[UrdfShape, ...]:
            return tuple(new for shape in shapes if (new := change(tag, shape)) is not None)

        links = {
            name: replace(
                link, visuals=changed("visual", link.visuals), collisions=changed("collision", link.collisions)
            )
            for name, link in self.links.items()
        }
        return replace(self, links=links)


def read_urdf(path: Path) -> Urdf:
    """The URDF in `path`; no mesh is opened.

    Raises FreeArtError when the file is no URDF, a number cannot be parsed, names repeat, or the joints form no tree.
    """
    robot = _parse_urdf(path)
    joints, links = _joints_by_name(_parse_joints(robot, path), path), _parse_links(robot, path)
    for name, times in Counter(link.name for link in links).items():
        if times > 1:
            raise FreeArtError(f"{path} has link '{name}' {times} times, expected unique names")
    by_name = {link.name: link for link in links}
    extension = robot.find("mujoco")
    mujoco = {} if extension is None else {e.tag: dict(e.attrib) for e in extension}
    parents_first = _sort_parents_first(list(by_name), joints, path)
    return Urdf(path, robot.get("name", ""), by_name, joints, parents_first, mujoco)


def read_urdf_joints(path: Path) -> dict[str, UrdfJoint]:
    """Joint name to joint, in file order. Only the joints are read, and they need not form a tree.

    Raises FreeArtError when the file is no URDF or a joint's number cannot be parsed.
    """
    return _joints_by_name(_parse_joints(_parse_urdf(path), path), path)


def read_urdf_parts(path: Path) -> tuple[list[UrdfLink], list[UrdfJoint]]:
    """Links and joints as they are listed: names may repeat or lack, and joints need not form a tree.

    Raises FreeArtError when the file is no URDF or a number cannot be parsed.
    """
    robot = _parse_urdf(path)
    return _parse_links(robot, path), _parse_joints(robot, path)


def read_file_names(path: Path, tags: Iterable[str] | None = None) -> list[str]:
    """All file names in a URDF, or those of the elements `tags` (empty where one has none)."""
    elements = _parse_urdf(path).iter()
    if tags is None:
        return [name for element in elements if (name := element.get("filename"))]
    return [element.get("filename", "") for element in elements if element.tag in tags]


def format_urdf(urdf: Urdf, comment: str = "") -> bytes:
    """The URDF file, with `comment` at its top. Limits that are infinite are written as 1e16."""
    robot = ET.Element("robot", name=urdf.name)
    if comment:
        robot.append(ET.Comment(comment))
    if urdf.mujoco:
        extension = ET.SubElement(robot, "mujoco")
        for tag, attributes in urdf.mujoco.items():
            ET.SubElement(extension, tag, dict(attributes))
    for link in urdf.links.values():
        element = ET.SubElement(robot, "link", name=link.name)
        if link.inertial is not None:
            _add_inertial(element, link.inertial)
        for tag, shapes in (("visual", link.visuals), ("collision", link.collisions)):
            for k, shape in enumerate(shapes):
                _add_shape(element, tag, shape, f"{link.name}_{k}")
    for joint in urdf.joints.values():
        _add_joint(robot, joint)
    ET.indent(robot)
    return bytes(ET.tostring(robot, encoding="utf-8", xml_declaration=True)) + b"\n"


def number_text(*values: float) -> str:
    """Numbers separated by spaces, each with the fewest digits that give it back exactly."""
    return " ".join(repr(float(value) + 0.0) for value in values)


def _add_origin(element: ET.Element, T: Array) -> None:
    R, across = T[:3, :3], float(np.hypot(T[0, 0], T[1, 0]))
    if across > 1e-9:
        rpy = np.arctan2(R[2, 1], R[2, 2]), np.arctan2(-R[2, 0], across), np.arctan2(R[1, 0], R[0, 0])
    else:  # gimbal lock: any yaw will do
        rpy = np.arctan2(-R[1, 2], R[1, 1]), np.arctan2(-R[2, 0], across), 0.0
    ET.SubElement(element, "origin", xyz=number_text(*T[:3, 3]), rpy=number_text(*rpy))


def _add_inertial(link: ET.Element, of: UrdfInertial) -> None:
    element = ET.SubElement(link, "inertial")
    ET.SubElement(element, "origin", xyz=number_text(*of.centre), rpy="0 0 0")
    ET.SubElement(element, "mass", value=number_text(of.mass))
    moments = zip(_MOMENTS, of.inertia[np.triu_indices(3)], strict=True)
    ET.SubElement(element, "inertia", {name: number_text(value) for name, value in moments})


def _add_shape(link: ET.Element, tag: str, shape: UrdfShape, material: str) -> None:
    element = ET.SubElement(link, tag, {"name": shape.name} if shape.name else {})
    _add_origin(element, shape.T_link_shape)
    if shape.kind:
        geometry = ET.SubElement(ET.SubElement(element, "geometry"), shape.kind)
        if shape.kind == "mesh":
            geometry.set("filename", shape.filename)
        at = 0
        for attribute, count in _SIZES.get(shape.kind, ()):
            size = shape.size[at : at + count]
            at += count
            if shape.kind != "mesh" or (size != 1).any():
                geometry.set(attribute, number_text(*size))
    if shape.rgba is not None or shape.texture:
        look = ET.SubElement(element, "material", name=material)
        if shape.rgba is not None:
            ET.SubElement(look, "color", rgba=number_text(*shape.rgba))
        if shape.texture:
            ET.SubElement(look, "texture", filename=shape.texture)


def _add_joint(robot: ET.Element, joint: UrdfJoint) -> None:
    element = ET.SubElement(robot, "joint", name=joint.name, type=joint.type)
    ET.SubElement(element, "parent", link=joint.parent)
    ET.SubElement(element, "child", link=joint.child)
    _add_origin(element, joint.T_parent_joint)
    if joint.type == "fixed":
        return
    ET.SubElement(element, "axis", xyz=number_text(*joint.axis))
    if joint.limited:
        ends = np.clip([joint.lower, joint.upper], -_UNLIMITED, _UNLIMITED)
        values = {"lower": ends[0], "upper": ends[1], "effort": joint.effort, "velocity": joint.velocity}
        ET.SubElement(element, "limit", {key: number_text(x) for key, x in values.items() if x is not None})
    if joint.damping or joint.friction:
        losses = {"damping": number_text(joint.damping), "friction": number_text(joint.friction)}
        ET.SubElement(element, "dynamics", losses)
    if joint.mimic is not None:
        leader, multiplier, offset = joint.mimic
        numbers = {"multiplier": number_text(multiplier), "offset": number_text(offset)}
        ET.SubElement(element, "mimic", {"joint": leader, **numbers})


def _parse_urdf(path: Path) -> ET.Element:
    """The <robot> element of a URDF file; FreeArtError when there is none."""
    robot = read_xml(path)
    if robot.tag != "robot":
        raise FreeArtError(f"{path} is not a URDF: its root is <{robot.tag}>, expected <robot>")
    return robot


def read_root_tag(path: Path) -> str:
    """The name of an XML file's root element, such as 'robot' or 'mujoco'."""
    return read_xml(path).tag


def read_comments(path: Path) -> list[str]:
    """The comments of an XML file, without space at their ends."""
    elements = read_xml(path, comments=True).iter()
    return [(element.text or "").strip() for element in elements if not isinstance(element.tag, str)]


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


def _attribute(element: ET.Element, path: str, attribute: str, default: str = "") -> str:
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


def _parse_origin(element: ET.Element, where: str) -> Array:
    """(4, 4) of an element's <origin xyz rpy>: R = Rz(yaw) Ry(pitch) Rx(roll), rad."""
    roll, pitch, yaw = parse_numbers(_attribute(element, "origin", "rpy", "0 0 0"), 3, f"{where} has rpy")
    x, y, z = np.eye(3)
    R = se3.exp_so3(yaw * z) @ se3.exp_so3(pitch * y) @ se3.exp_so3(roll * x)
    return se3.pose(R, parse_numbers(_attribute(element, "origin", "xyz", "0 0 0"), 3, f"{where} has xyz"))


def _joints_by_name(joints: list[UrdfJoint], path: Path) -> dict[str, UrdfJoint]:
    found: dict[str, UrdfJoint] = {}
    for joint in joints:
        if not (joint.name and joint.parent and joint.child) or joint.name in found:
            raise FreeArtError(f"{path}: joint '{joint.name}' needs a unique name, a parent and a child")
        found[joint.name] = joint
    return found


def _parse_joints(robot: ET.Element, path: Path) -> list[UrdfJoint]:
    return [_parse_joint(element, f"{path}: joint '{element.get('name', '')}'") for element in robot.findall("joint")]


def _parse_links(robot: ET.Element, path: Path) -> list[UrdfLink]:
    materials = {m.get("name", ""): m for m in robot.findall("material")}
    return [_parse_link(element, materials, path) for element in robot.findall("link")]


def _parse_joint(element: ET.Element, where: str) -> UrdfJoint:
    kind, limit, mimic = element.get("type", ""), element.find("limit"), element.find("mimic")

    def number(tag: str, attribute: str, default: str = "0", finite: bool = True) -> float:
        return float(
            parse_numbers(_attribute(element, tag, attribute, default), 1, f"{where} has {attribute}", finite)[0]
        )

    def end(attribute: str) -> float:
        value = number("limit", attribute, finite=False)
        return value if abs(value) <= LARGEST_LIMIT else float(np.copysign(np.inf, value))

    def strength(attribute: str) -> float | None:
        value = number("limit", attribute, finite=False)
        return value if np.isfinite(value) else None

    axis = parse_numbers(_attribute(element, "axis", "xyz", "1 0 0"), 3, f"{where} has axis")
    length = float(np.linalg.norm(axis))
    if kind in _MOVABLE and length < 1e-9:
        raise FreeArtError(f"{where} has axis {axis.tolist()}, expected a direction")
    unlimited = kind == "continuous" or limit is None
    given = set() if limit is None else set(limit.keys())
    return UrdfJoint(
        element.get("name", ""),
        kind,
        _attribute(element, "parent", "link"),
        _attribute(element, "child", "link"),
        _parse_origin(element, where),
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
        length,
    )


def _parse_link(element: ET.Element, materials: Mapping[str, ET.Element], path: Path) -> UrdfLink:
    name = element.get("name", "")
    where = f"{path}: link '{name}'"
    visuals = tuple(_parse_shape(shape, materials, f"{where}: a visual") for shape in element.findall("visual"))
    collisions = tuple(_parse_shape(shape, {}, f"{where}: a collision") for shape in element.findall("collision"))
    return UrdfLink(name, visuals, collisions, _parse_inertial(element, where))


def _parse_shape(shape: ET.Element, materials: Mapping[str, ET.Element], where: str) -> UrdfShape:
    T, name = _parse_origin(shape, where), shape.get("name", "")
    geometry = shape.find("geometry/*")
    if geometry is None:
        return UrdfShape("", T, np.zeros(0), name=name)
    default = "1 1 1" if geometry.tag == "mesh" else None
    sizes = [
        parse_numbers(geometry.get(attribute, default), count, f"{where} has {attribute}")
        for attribute, count in _SIZES.get(geometry.tag, ())
    ]
    size = np.concatenate([np.zeros(0), *sizes])
    filename, rgba = geometry.get("filename", ""), _parse_rgba(shape, materials, where)
    return UrdfShape(geometry.tag, T, size, filename, rgba, name, _attribute(shape, "material/texture", "filename"))


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
        return float(parse_numbers(_attribute(inertial, tag, attribute, "0"), 1, f"{where} has {attribute}")[0])

    T = _parse_origin(inertial, where)
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
