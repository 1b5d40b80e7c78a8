"""A URDF as it is looked at: its links with visuals and collision shapes, its joints, and what is written beside them.

Reads what strict parsers refuse: limits without effort and velocity, repeated visual names, links without inertia.
"""

from __future__ import annotations

import xml.etree.ElementTree as ET
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from freeart21 import se3
from freeart21.errors import FreeArtError
from freeart21.files import checked
from freeart21.files.asset import MAX_URDF_BYTES, UrdfJoint, read_urdf_joints
from freeart21.files.mesh_file import read_ply
from freeart21.joint import Joint
from freeart21.mesh import Mesh
from freeart21.se3 import Array
from freeart21.view.obj import PLAIN, Piece, read_obj
from freeart21.view.simplify import box, cylinder, sphere


@dataclass(frozen=True)
class Inertial:
    """Mass properties of a link."""

    mass: float
    """kg."""
    centre: Array
    """(3,) centre of mass in the link's frame, m."""
    inertia: Array
    """(6,) ixx, ixy, ixz, iyy, iyz, izz about the centre of mass, kg m^2."""


@dataclass(frozen=True)
class UrdfLink:
    """One link and its shapes, in its own frame."""

    name: str
    visuals: tuple[Piece, ...]
    collisions: tuple[Piece, ...]
    inertial: Inertial | None


@dataclass(frozen=True)
class UrdfModel:
    """A whole URDF."""

    path: Path
    links: dict[str, UrdfLink]
    """In an order in which parents come before their children."""
    joints: dict[str, UrdfJoint]
    origins: dict[str, Array]
    """Joint name to (4, 4) parent link from joint frame."""
    axes: dict[str, Array]
    """Joint name to (3,) unit axis in the joint frame."""
    efforts: dict[str, tuple[float | None, float | None]]
    """Joint name to largest effort (N m or N) and velocity (rad/s or m/s); None where the file says nothing."""
    mimics: dict[str, tuple[str, float, float]]
    """Joint name to the joint that it follows, multiplier and offset."""
    missing: tuple[str, ...]
    """Mesh files that the URDF names and the folder lacks."""

    def joint(self, name: str) -> Joint:
        """A movable joint, its axis in the frame of its child link."""
        joint = self.joints[name]
        if joint.joint_type is None:
            raise FreeArtError(f"{self.path}: joint '{name}' is {joint.type}, expected a movable one")
        return Joint(name, joint.joint_type, self.axes[name], np.zeros(3), joint.lower, joint.upper)


def read_urdf(path: Path) -> UrdfModel:
    """The URDF with all meshes it names: OBJ and PLY here, other formats through trimesh.

    Meshes are looked for inside the URDF's folder only; `package://` is taken off. Raises FreeArtError when the file is
    not a URDF, when its joints are not a tree, or when a mesh is there and cannot be read.
    """
    joints = read_urdf_joints(path)
    root = ET.fromstring(checked.require_file(path, MAX_URDF_BYTES).read_bytes())
    missing: list[str] = []
    links = {}
    for element in root.findall("link"):
        name = element.get("name", "")
        links[name] = UrdfLink(
            name,
            _shapes(element, "visual", root, path, missing),
            _shapes(element, "collision", root, path, missing),
            _inertial(element, path),
        )
    elements = {element.get("name", ""): element for element in root.findall("joint")}
    order = _tree_order(list(links), joints, path)
    return UrdfModel(
        path,
        {name: links[name] for name in order},
        joints,
        {name: _origin(element, path) for name, element in elements.items()},
        {name: _axis(element, path) for name, element in elements.items()},
        {name: _effort(element, path) for name, element in elements.items()},
        {name: _mimic(element, path) for name, element in elements.items() if element.find("mimic") is not None},
        tuple(dict.fromkeys(missing)),
    )


def _tree_order(links: list[str], joints: dict[str, UrdfJoint], path: Path) -> list[str]:
    """Link names, parents first."""
    parent: dict[str, str] = {}
    for joint in joints.values():
        for link in (joint.parent, joint.child):
            if link not in links:
                raise FreeArtError(f"{path}: joint '{joint.name}' names link '{link}'; links: {', '.join(links)}")
        if joint.child in parent:
            raise FreeArtError(f"{path}: link '{joint.child}' has two parents, expected a tree")
        parent[joint.child] = joint.parent

    def depth(link: str) -> int:
        steps = 0
        while link in parent:
            link, steps = parent[link], steps + 1
            if steps > len(links):
                raise FreeArtError(f"{path}: its joints form a loop, expected a tree")
        return steps

    return sorted(links, key=depth)


def _shapes(link: ET.Element, kind: str, root: ET.Element, path: Path, missing: list[str]) -> tuple[Piece, ...]:
    pieces: list[Piece] = []
    for shape in link.findall(kind):
        geometry = shape.find("geometry/*")
        if geometry is None:
            raise FreeArtError(f"{path}: a {kind} of link '{link.get('name')}' has no geometry")
        T = _origin(shape, path)
        colour = _colour(shape, root, path) if kind == "visual" else None
        for piece in _geometry(geometry, path, missing):
            mesh = piece.mesh.moved(T)
            if mesh.colours is None or (colour is not None and piece.texture is None):
                mesh = replace(mesh, colours=np.tile(np.array(colour or PLAIN, np.uint8), (len(mesh.vertices), 1)))
            pieces.append(replace(piece, mesh=mesh))
    return tuple(pieces)


def _geometry(geometry: ET.Element, path: Path, missing: list[str]) -> list[Piece]:
    match geometry.tag:
        case "box":
            return [Piece(box(_vector(geometry, "size", path)))]
        case "sphere":
            return [Piece(sphere(_number(geometry, "radius", path)))]
        case "cylinder":
            return [Piece(cylinder(_number(geometry, "radius", path), _number(geometry, "length", path)))]
        case "mesh":
            return _mesh(geometry, path, missing)
    raise FreeArtError(f"{path}: geometry <{geometry.tag}> is unknown; known: box, cylinder, mesh, sphere")


def _mesh(geometry: ET.Element, path: Path, missing: list[str]) -> list[Piece]:
    name = geometry.get("filename", "")
    relative = name.removeprefix("file://")
    candidates = [relative]
    if name.startswith("package://"):
        inner = name.removeprefix("package://")
        candidates = [inner, inner.partition("/")[2]]
    file = next((f for f in (checked.inside(path.parent, c) for c in candidates) if f.is_file()), None)
    if file is None:
        missing.append(name)
        return []
    scale = _vector(geometry, "scale", path, "1 1 1")
    pieces = _read_mesh(file, path.parent)
    if np.allclose(scale, 1):
        return pieces
    flip = -1 if np.prod(scale) < 0 else 1
    return [
        replace(p, mesh=replace(p.mesh, vertices=p.mesh.vertices * scale, faces=p.mesh.faces[:, ::flip]))
        for p in pieces
    ]


def _read_mesh(file: Path, root: Path) -> list[Piece]:
    match file.suffix.lower():
        case ".obj":
            return read_obj(file, root)
        case ".ply":
            return [Piece(read_ply(file)[0])]
    import trimesh

    try:
        loaded = trimesh.load_mesh(file)
    except (ValueError, NotImplementedError, ImportError) as error:
        raise FreeArtError(f"{file} cannot be read as a mesh: {error}") from error
    return [Piece(Mesh(np.asarray(loaded.vertices), np.asarray(loaded.faces)))]


def _colour(shape: ET.Element, root: ET.Element, path: Path) -> tuple[int, int, int] | None:
    material = shape.find("material")
    if material is None:
        return None
    colour = material.find("color")
    if colour is None:
        named = (m for m in root.findall("material") if m.get("name") == material.get("name"))
        colour = next((m.find("color") for m in named), None)
    if colour is None:
        return None
    r, g, b = (round(255 * min(max(c, 0.0), 1.0)) for c in _floats(colour, "rgba", path, "1 1 1 1", 4)[:3])
    return r, g, b


def _inertial(link: ET.Element, path: Path) -> Inertial | None:
    inertial = link.find("inertial")
    mass = inertial.find("mass") if inertial is not None else None
    if inertial is None or mass is None:
        return None
    T = _origin(inertial, path)
    inertia = inertial.find("inertia")
    names = ("ixx", "ixy", "ixz", "iyy", "iyz", "izz")
    values = np.array([_number(inertia, name, path, "0") for name in names]) if inertia is not None else np.zeros(6)
    tensor = np.array(
        [[values[0], values[1], values[2]], [values[1], values[3], values[4]], [values[2], values[4], values[5]]]
    )
    turned = T[:3, :3] @ tensor @ T[:3, :3].T
    return Inertial(_number(mass, "value", path), T[:3, 3], turned[np.triu_indices(3)])


def _origin(element: ET.Element, path: Path) -> Array:
    """(4, 4) of an `<origin xyz rpy>`: R = Rz(yaw) Ry(pitch) Rx(roll)."""
    origin = element.find("origin")
    if origin is None:
        return np.eye(4)
    roll, pitch, yaw = _vector(origin, "rpy", path, "0 0 0")
    x, y, z = np.eye(3)
    return se3.pose(
        se3.exp_so3(yaw * z) @ se3.exp_so3(pitch * y) @ se3.exp_so3(roll * x), _vector(origin, "xyz", path, "0 0 0")
    )


def _axis(joint: ET.Element, path: Path) -> Array:
    element = joint.find("axis")
    axis = np.array([1.0, 0, 0]) if element is None else _vector(element, "xyz", path, "1 0 0")
    length = float(np.linalg.norm(axis))
    if length < 1e-9:
        raise FreeArtError(f"{path}: joint '{joint.get('name')}' has the axis {axis.tolist()}, expected a direction")
    return axis / length


def _effort(joint: ET.Element, path: Path) -> tuple[float | None, float | None]:
    limit = joint.find("limit")
    if limit is None:
        return None, None
    effort, velocity = (
        _number(limit, name, path) if limit.get(name) is not None else None for name in ("effort", "velocity")
    )
    return effort, velocity


def _mimic(joint: ET.Element, path: Path) -> tuple[str, float, float]:
    mimic = joint.find("mimic")
    assert mimic is not None
    return mimic.get("joint", ""), _number(mimic, "multiplier", path, "1"), _number(mimic, "offset", path, "0")


def _number(element: ET.Element, name: str, path: Path, default: str | None = None) -> float:
    return float(_floats(element, name, path, default, 1)[0])


def _vector(element: ET.Element, name: str, path: Path, default: str | None = None) -> Array:
    return _floats(element, name, path, default, 3)


def _floats(element: ET.Element, name: str, path: Path, default: str | None, count: int) -> Array:
    text = element.get(name, default)
    try:
        values = np.array([float(word) for word in (text or "").split()])
    except ValueError:
        values = np.zeros(0)
    if len(values) != count or not np.isfinite(values).all():
        raise FreeArtError(
            f"{path}: <{element.tag}> has {name} '{text}', expected {count} finite "
            f"{'number' if count == 1 else 'numbers'}"
        )
    return values
