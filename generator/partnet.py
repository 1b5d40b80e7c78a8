"""Loads a PartNet-Mobility folder, real or written by `generator.partnet_writer`.

What such folders are like (each point has a test):

- The URDF alone is the truth: mobility_v2.json turns some axes round and counts in degrees. Limits may be "-0.0".
- The link `base` is empty; the last joint fixes the real root to it, turning y-up meshes to z-up.
- Links have no inertia and joints no dynamics, effort or velocity; collision shapes repeat the visual ones.
- Link frames sit on their joints, meshes stay in the object's frame: their origin is minus the sum of joint origins.
- Visual names repeat. Sliders may have their origin at zero, so their pivot means nothing.
- Meshes have double and inner faces; units are not metric (the diagonal is about 2); files may be absent.
"""

from __future__ import annotations

import contextlib
import functools
import xml.etree.ElementTree as ET
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import trimesh
from numpy.typing import NDArray

from freeart21 import se3
from freeart21.asset import Asset
from freeart21.errors import FreeArtError
from freeart21.files import checked
from freeart21.files.asset import UrdfJoint, movable_joint, read_urdf_joints
from freeart21.joint import Joint
from freeart21.se3 import Array
from generator.surface import Paint, Surface

URDF_NAME = "mobility.urdf"


@dataclass(frozen=True)
class Visual:
    """One mesh of a link."""

    mesh: Path
    T_link_mesh: Array
    scale: Array


@dataclass(frozen=True)
class Side:
    """All links on one side of the scored joint."""

    links: tuple[str, ...]
    surface: Surface
    """In the object's frame, the scored joint at zero and the others held."""


@dataclass(frozen=True)
class PartNetObject:
    """A loaded object and the two sides of its scored joint.

    The object's frame is that of the URDF's root link (z up), the scored joint at zero.
    """

    name: str
    """The folder's name."""
    category: str
    """As meta.json says; 'unknown' when it does not."""
    asset: Asset
    """Reference link = the joint's parent, moving link = its child; canonical frame = the object's frame."""
    joint: Joint
    """Motion of the child side against the parent side, in the object's frame."""
    parent_side: Side
    child_side: Side
    semantics: dict[str, str]
    """Link name to semantics.txt's kind and name, such as 'slider drawer'; mobility_v2.json may use other names."""
    missing: tuple[str, ...]
    """Mesh files that the URDF names and that are absent (only with `skip_missing`)."""

    @property
    def sides(self) -> tuple[Side, Side]:
        """Parent side, child side."""
        return self.parent_side, self.child_side


def load(folder: Path, joint: str | None = None, skip_missing: bool = False) -> PartNetObject:
    """The object in `folder`, with the joint named (or the one that meta.json calls scored, or the only movable one).

    Raises FreeArtError, in one line, when a file is missing or unreadable, when the joint is unknown (the movable ones
    are listed) or has no range, or when a side has no surface. `skip_missing` leaves out absent mesh files instead:
    in PartNet-Mobility those are parts without faces that were never shipped.
    """
    folder = Path(folder)
    urdf = folder / URDF_NAME
    if not urdf.is_file():
        raise FreeArtError(f"{folder} is not a PartNet-Mobility object: it has no {URDF_NAME}")
    meta = _meta(folder)
    scored = movable_joint(urdf, joint or meta.get("scored_joint"))
    if not scored.lower < scored.upper:
        raise FreeArtError(
            f"{urdf}: joint '{scored.name}' cannot move: its limits are [{scored.lower:g}, {scored.upper:g}]"
        )
    joints = read_urdf_joints(urdf)
    held = {
        j.name: float(np.clip(0.0, j.lower, j.upper)) for j in joints.values() if j.joint_type and j.name != scored.name
    }
    root = ET.fromstring(urdf.read_bytes())
    motions = read_motions(root, joints, urdf)
    Ts = link_poses(joints, motions, held)
    visuals = {element.get("name", ""): _visuals(element, folder, urdf) for element in root.findall("link")}
    absent = _absent(visuals, folder, urdf, skip_missing)
    below = _below(joints, scored.child)
    unknown = sorted(below - set(visuals))
    if unknown:
        raise FreeArtError(f"{urdf}: joints name links that do not exist: {', '.join(unknown)}")
    child = _side(scored, tuple(name for name in visuals if name in below), visuals, Ts, urdf)
    parent = _side(scored, tuple(name for name in visuals if name not in below), visuals, Ts, urdf)
    T_object_joint = Ts[scored.parent] @ motions[scored.name].T_parent_joint
    assert scored.joint_type is not None
    moving = Joint(
        scored.name,
        scored.joint_type,
        T_object_joint[:3, :3] @ motions[scored.name].axis,
        T_object_joint[:3, 3],
        scored.lower + 0.0,
        scored.upper + 0.0,
    )
    asset = Asset(
        urdf,
        scored.name,
        scored.parent,
        scored.child,
        Ts[scored.parent],
        held=held,
        source={"format": "PartNet-Mobility", "object": folder.name},
    )
    return PartNetObject(
        folder.name, str(meta.get("model_cat", "unknown")), asset, moving, parent, child, _semantics(folder), absent
    )


@dataclass(frozen=True)
class Motion:
    """Where a joint sits and which way it moves."""

    T_parent_joint: Array
    """(4, 4) parent link's frame from the joint's frame at position zero."""
    axis: Array
    """(3,) unit vector in the joint's frame."""


def link_poses(joints: dict[str, UrdfJoint], motions: dict[str, Motion], q: dict[str, float]) -> dict[str, Array]:
    """Link name to T_root_link (4, 4) at joint positions `q`, rad or m; joints not named stand at zero."""
    children = {j.child for j in joints.values()}
    roots = sorted({j.parent for j in joints.values()} - children)
    if len(roots) != 1:
        raise FreeArtError(f"the URDF has the root links {', '.join(roots) or 'none'}, expected one")
    Ts = {roots[0]: np.eye(4)}
    waiting = list(joints.values())
    while waiting:
        ready = [j for j in waiting if j.parent in Ts]
        if not ready:
            raise FreeArtError(f"the URDF's joints form a loop at link '{waiting[0].parent}'")
        for j in ready:
            motion = motions[j.name]
            T = Ts[j.parent] @ motion.T_parent_joint
            if j.joint_type is not None:
                T = T @ Joint(j.name, j.joint_type, motion.axis, np.zeros(3), -np.inf, np.inf).transform(
                    q.get(j.name, 0.0)
                )
            Ts[j.child] = T
        waiting = [j for j in waiting if j not in ready]
    return Ts


def _meta(folder: Path) -> dict:
    path = folder / "meta.json"
    return checked.read_json(path) if path.is_file() else {}


def read_motions(root: ET.Element, joints: dict[str, UrdfJoint], urdf: Path) -> dict[str, Motion]:
    """Joint name to where it sits and which way it moves, of the URDF element `root`."""
    motions = {}
    for element in root.findall("joint"):
        name = element.get("name", "")
        axis = _numbers(element.find("axis"), "xyz", (1.0, 0.0, 0.0), f"{urdf}: joint '{name}' axis")
        length = float(np.linalg.norm(axis))
        if joints[name].joint_type is not None and length < 1e-9:
            raise FreeArtError(f"{urdf}: joint '{name}' has axis {axis.tolist()}, expected a direction")
        motions[name] = Motion(_origin(element, f"{urdf}: joint '{name}'"), axis / max(length, 1e-9))
    return motions


def _visuals(link: ET.Element, folder: Path, urdf: Path) -> list[Visual]:
    visuals = []
    for element in link.findall("visual"):
        mesh = element.find("geometry/mesh")
        where = f"{urdf}: link '{link.get('name')}'"
        if mesh is None or not mesh.get("filename"):
            raise FreeArtError(f"{where} has a visual that is not a mesh; expected <mesh filename=...>")
        visuals.append(
            Visual(
                checked.inside(folder, mesh.get("filename", "")),
                _origin(element, where),
                _numbers(mesh, "scale", (1.0, 1.0, 1.0), where),
            )
        )
    return visuals


def _absent(visuals: dict[str, list[Visual]], folder: Path, urdf: Path, skip_missing: bool) -> tuple[str, ...]:
    """Mesh files named but not there; FreeArtError unless they may be skipped."""
    meshes = {v.mesh for of_link in visuals.values() for v in of_link}
    absent = tuple(sorted(str(mesh.relative_to(folder.resolve())) for mesh in meshes if not mesh.is_file()))
    if absent and not skip_missing:
        more = f" and {len(absent) - 1} more" if len(absent) > 1 else ""
        raise FreeArtError(
            f"{urdf} names the mesh {absent[0]}, which does not exist{more}; --skip-missing leaves absent meshes out"
        )
    return absent


def _side(
    scored: UrdfJoint, links: tuple[str, ...], visuals: dict[str, list[Visual]], Ts: dict[str, Array], urdf: Path
) -> Side:
    pieces = [
        read_obj(v.mesh).moved(Ts[name] @ v.T_link_mesh, v.scale)
        for name in links
        for v in visuals[name]
        if v.mesh.is_file()
    ]
    surface = Surface.joined(pieces)
    if len(surface.faces) == 0:
        raise FreeArtError(
            f"{urdf}: joint '{scored.name}' has no surface on the side of links {', '.join(links) or '(none)'}"
        )
    return Side(links, surface)


def _below(joints: dict[str, UrdfJoint], link: str) -> set[str]:
    """`link` and every link that hangs on it."""
    found, at = {link}, [link]
    while at:
        parent = at.pop()
        for j in joints.values():
            if j.parent == parent and j.child not in found:
                found.add(j.child)
                at.append(j.child)
    return found


def read_obj(path: Path) -> Surface:
    """The triangles of an OBJ file with its materials; FreeArtError when it is unreadable or a picture is missing."""
    pictures = _pictures(path)
    try:
        scene = trimesh.load_scene(path, process=False, group_material=True)
    except (ValueError, IndexError, KeyError, TypeError, OSError) as error:
        raise FreeArtError(f"{path} is not a readable OBJ file: {error}") from error
    return Surface.joined([_surface(m, pictures) for m in scene.geometry.values() if isinstance(m, trimesh.Trimesh)])


def _surface(mesh: trimesh.Trimesh, pictures: dict[str, Path]) -> Surface:
    material, uv = getattr(mesh.visual, "material", None), getattr(mesh.visual, "uv", None)
    diffuse = getattr(material, "diffuse", None)
    colour = np.full(3, 255, np.uint8) if diffuse is None else np.asarray(diffuse, np.uint8)[:3]
    file = pictures.get(getattr(material, "name", None) or "")
    picture = None if file is None or uv is None else _read_picture(file, file.stat().st_mtime_ns)
    count = len(mesh.vertices)
    return Surface(
        np.asarray(mesh.vertices, float),
        np.asarray(mesh.faces, np.int64),
        np.zeros((count, 2)) if uv is None else np.asarray(uv, float)[:, :2],
        np.zeros(count, np.int64),
        (Paint(colour, picture),),
    )


def _pictures(obj: Path) -> dict[str, Path]:
    """Material name to the picture of its colour, from the material libraries that an OBJ file names.

    (trimesh opens no picture outside the mesh's own folder, and PartNet-Mobility's lie in ../images.) Raises
    FreeArtError when a library or a picture is missing, or leads out of the object's folder.
    """
    pictures = {}
    with obj.open(errors="replace") as file:
        libraries = [line.split(None, 1)[1].strip() for line in file if line.startswith("mtllib ")]
    for library in libraries:
        mtl, material = obj.parent / library, ""
        if not mtl.is_file():
            raise FreeArtError(f"{obj} names the material library {library}, which does not exist")
        for words in (line.split() for line in mtl.read_text(errors="replace").splitlines()):
            if words[:1] == ["newmtl"]:
                material = " ".join(words[1:])
            elif words[:1] == ["map_Kd"]:
                pictures[material] = checked.inside(obj.parent.parent, f"{obj.parent.name}/{words[-1]}")
                if not pictures[material].is_file():
                    raise FreeArtError(f"{mtl} names the picture {words[-1]}, which does not exist")
    return pictures


@functools.lru_cache(maxsize=64)
def _read_picture(path: Path, changed_ns: int) -> NDArray[np.uint8]:
    """The picture as it was at the time `changed_ns`; the meshes of an object share few pictures."""
    return checked.read_rgb(path)


def _origin(element: ET.Element, where: str) -> Array:
    origin = element.find("origin")
    roll, pitch, yaw = _numbers(origin, "rpy", (0.0, 0.0, 0.0), where)
    x, y, z = np.eye(3)
    R = se3.exp_so3(yaw * z) @ se3.exp_so3(pitch * y) @ se3.exp_so3(roll * x)
    return se3.pose(R, _numbers(origin, "xyz", (0.0, 0.0, 0.0), where))


def _numbers(element: ET.Element | None, key: str, default: tuple[float, ...], where: str) -> Array:
    text = None if element is None else element.get(key)
    if text is None:
        return np.array(default)
    values = np.array([np.nan])
    with contextlib.suppress(ValueError):
        values = np.array([float(word) for word in text.split()])
    if values.shape != (3,) or not np.isfinite(values).all():
        raise FreeArtError(f"{where}: {key} is '{text}', expected three numbers")
    return values


def _semantics(folder: Path) -> dict[str, str]:
    path = folder / "semantics.txt"
    rows = [line.split(None, 1) for line in path.read_text().splitlines() if line.strip()] if path.is_file() else []
    return {row[0]: row[1] for row in rows if len(row) == 2}
