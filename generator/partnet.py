"""Loads a PartNet-Mobility folder, real or written by `generator.partnet_writer`.

Properties of such folders (`tests/test_partnet.py` loads folders with each of them):

- Only mobility.urdf is read for geometry and joints: mobility_v2.json reverses some axes and uses degrees, and names
  and ids in semantics.txt and meta.json may differ. Other URDFs in the folder (ManiSkill's mobility_cvx,
  mobility_fixed) are ignored. Limits may be "-0.0".
- The link `base` is empty; the last joint fixes the real root to it and turns y-up meshes to z-up. Parts that are free
  in the world ("free" in semantics.txt, as a stapler's base) are fixed to it, too: the recorder moves the root.
- Links have no inertia, joints no dynamics, effort or velocity; collision shapes repeat the visual ones.
- Link frames are at the joints, meshes in the object's frame: their origin is minus the sum of joint origins.
- Visual names repeat. The origin of a slider may be zero, so that its pivot has no meaning.
- Joints may be continuous, without limits. A slider that also rotates is two joints with an empty link between them,
  and its limits may exclude zero: joints are held, and recorded, only within their limits.
- Meshes hold each face twice, once for each direction, and inner faces; units are not metric (the diagonal is about 2).
- Meshes, pictures and material libraries may be absent (see `generator.partnet_files`), and the folder may hold files
  that the URDF does not name.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from freeart21 import se3
from freeart21.asset import Asset
from freeart21.errors import FreeArtError
from freeart21.files import checked
from freeart21.files.asset import find_movable_joint, held_positions, read_semantics
from freeart21.files.urdf import MAX_URDF_BYTES, Urdf, UrdfJoint, UrdfLink, read_urdf, subtree_links
from freeart21.joint import Joint
from freeart21.mesh import bounding_diagonal
from freeart21.se3 import Array
from generator.motion import motion_range
from generator.partnet_files import Gaps, read_obj, resolve_inside
from generator.surface import Surface

URDF_NAME = "mobility.urdf"
BOX_NAME = "bounding_box.json"
FLOATING = "floating"

# fmt: off
INCOMPLETE = frozenset((
    "10090", "10108", "10356", "11538", "12115", "9918", "9987", "10546", "11260", "11887", "12071", "12542",
    "12578", "12584", "12612", "23724", "25144", "29525", "30857", "32213", "32746", "2780", "39138", "43142",
    "3380", "3593", "7130", "7138", "7347", "7221", "7306", "7320", "8966",
))
# fmt: on
"""Objects whose URDF names meshes that were never published because they have no faces (SAPIEN's issues 33 and 201; the
list is r-pad's missing_objs.txt). One of them, the scissors 10546, belongs to FreeArt-21."""


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
    """From meta.json; 'unknown' without it."""
    asset: Asset
    """Reference link = the joint's parent, moving link = its child; canonical frame = the object's frame."""
    joint: Joint
    """Motion of the child side relative to the parent side, in the object's frame."""
    parent_side: Side
    child_side: Side
    semantics: dict[str, str]
    """Link name to semantics.txt's kind and name, such as 'slider drawer'; mobility_v2.json may use other names."""
    missing: tuple[str, ...]
    """Absent mesh files that the URDF names (only with `skip_missing`, or for an object of `INCOMPLETE`)."""
    notes: tuple[str, ...]
    """Remarks on this object for the user, one line each."""

    @property
    def sides(self) -> tuple[Side, Side]:
        """Parent side, child side."""
        return self.parent_side, self.child_side


def find_folder(name: str, root: Path) -> Path | None:
    """The folder of object `name`: ROOT/NAME or, as the data set unpacks, ROOT/dataset/NAME; None when absent."""
    return next((place for place in (root / name, root / "dataset" / name) if place.is_dir()), None)


def load(folder: Path, joint: str | None = None, skip_missing: bool = False) -> PartNetObject:
    """Load the object in `folder` with the named joint (or meta.json's scored joint, or the only movable one).

    Raises FreeArtError, in one line, when a file is missing or unreadable, when the joint is unknown (the movable ones
    are listed) or has no range, or when a side has no surface. `skip_missing` leaves absent mesh files out instead, as
    is always done for the objects in `INCOMPLETE`.
    """
    folder = Path(folder)
    urdf = folder / URDF_NAME
    if not urdf.is_file():
        raise FreeArtError(f"{folder} is not a PartNet-Mobility object: it has no {URDF_NAME}")
    meta = _meta(folder)
    read = read_tree(urdf)
    joints = read.joints
    scored = find_movable_joint(urdf, joint or meta.get("scored_joint"))
    if not scored.lower < scored.upper:
        raise FreeArtError(
            f"{urdf}: joint '{scored.name}' cannot move: its limits are [{scored.lower:g}, {scored.upper:g}]"
        )
    held = held_positions(joints, scored.name)
    Ts = read.link_poses(held)
    visuals = {link.name: _visuals(link, folder, urdf) for link in read.links.values()}
    gaps = Gaps()
    absent = _missing_meshes(visuals, folder, urdf, skip_missing or folder.resolve().name in INCOMPLETE)
    gaps.meshes.update(absent)
    below = subtree_links(joints, scored.child)
    child = _side(scored, tuple(name for name in visuals if name in below), visuals, Ts, folder, gaps)
    parent = _side(scored, tuple(name for name in visuals if name not in below), visuals, Ts, folder, gaps)
    T_object_joint = Ts[scored.parent] @ scored.T_parent_joint
    assert scored.joint_type is not None
    lower, upper = scored.lower + 0.0, scored.upper + 0.0
    if (
        scored.joint_type == "prismatic"
    ):  # a missing limit: the object's diagonal from the other, or half of it to either side
        size = bounding_diagonal(parent.surface.mesh(), child.surface.mesh())
        ends = np.isfinite([lower, upper])
        lower = lower if ends[0] else (upper - size if ends[1] else -0.5 * size)
        upper = upper if ends[1] else lower + size
    axis, pivot = T_object_joint[:3, :3] @ scored.axis, T_object_joint[:3, 3]
    moving = Joint(scored.name, scored.joint_type, axis, pivot, lower, upper)
    asset = Asset(
        urdf,
        scored.name,
        scored.parent,
        scored.child,
        Ts[scored.parent],
        held=held,
        source={"format": "PartNet-Mobility", "object": folder.name},
    )
    notes = (
        *gaps.notes(),
        *_joint_notes(moving, scored, joints, held),
        *_scale_notes(read, visuals, folder),
        *_meta_notes(meta, folder),
    )
    category = str(meta.get("model_cat", "unknown"))
    return PartNetObject(
        folder.name, category, asset, moving, parent, child, read_semantics(folder / "semantics.txt"), absent, notes
    )


def _joint_notes(moving: Joint, scored: UrdfJoint, joints: dict[str, UrdfJoint], held: dict[str, float]) -> list[str]:
    notes = []
    ends = np.isfinite([scored.lower, scored.upper])
    if not ends.all():
        low, high = motion_range(moving)
        lacks = "limits" if not ends.any() else "upper limit" if ends[0] else "lower limit"
        unit = "rad" if moving.type == "revolute" else "m"
        notes.append(f"joint '{moving.name}' has no {lacks}: it is moved from {low:.4g} to {high:.4g} {unit}")
    if not moving.lower <= 0 <= moving.upper:
        notes.append(f"joint '{moving.name}' never stands at 0: its limits are [{moving.lower:g}, {moving.upper:g}]")
    for name, q in held.items():
        if mimic := joints[name].mimic:
            notes.append(f"joint '{name}' follows '{mimic[0]}' (mimic) and is held at {q:g}: only two parts move")
        elif q != 0:
            notes.append(f"joint '{name}' cannot stand at 0 and is held at {q:g}")
    return notes + floating_notes(joints)


def floating_notes(joints: dict[str, UrdfJoint]) -> list[str]:
    """Remarks on floating joints, which are held at their origin."""
    return [f"joint '{j.name}' is {FLOATING}: it is held at its origin" for j in joints.values() if j.type == FLOATING]


def _scale_notes(read: Urdf, visuals: dict[str, list[Visual]], folder: Path) -> list[str]:
    """Remarks on hinges whose frames were not scaled with the meshes, found by bounding_box.json (of the old meshes).

    At state zero the assembly is right in any case. A hinge whose axis is outside the assembly by more than 5 % of its
    diagonal moves its part away from the object; no real object has one.
    """
    box = _read_box_diagonal(folder / BOX_NAME)
    if box is None or all(np.allclose(v.scale, 1) for of_link in visuals.values() for v in of_link):
        return []
    Ts = read.link_poses({})
    points = np.concatenate(
        [
            se3.transform(Ts[name] @ v.T_link_mesh, v.scale * surface.vertices[np.unique(surface.faces)])
            for name, of_link in visuals.items()
            for v in of_link
            if v.mesh.is_file() and len((surface := read_obj(v.mesh, folder, Gaps())).faces)
        ]
    )
    low, high = points.min(0), points.max(0)
    size = float(np.linalg.norm(high - low))
    if abs(size / box - 1) < 0.01:
        return []
    notes = []
    for joint in read.joints.values():
        if joint.joint_type == "revolute":
            T = Ts[joint.parent] @ joint.T_parent_joint
            if not _line_crosses_box(T[:3, 3], T[:3, :3] @ joint.axis, low - 0.05 * size, high + 0.05 * size):
                notes.append(
                    f"the assembly disagrees with {BOX_NAME}: meshes have {size / box:.3g} of its size, but joint "
                    f"'{joint.name}' turns about an axis outside them, so its part floats; recorded as {URDF_NAME} says"
                )
    return notes


def _read_box_diagonal(path: Path) -> float | None:
    """The diagonal of a PartNet-Mobility object's bounding box; None without a file or with an empty box."""
    if not path.is_file():
        return None
    data = checked.read_json(path)
    diagonal = float(
        np.linalg.norm(checked.numbers(data, "max", (3,), path) - checked.numbers(data, "min", (3,), path))
    )
    return diagonal if diagonal > 0 else None


def _line_crosses_box(point: Array, direction: Array, low: Array, high: Array) -> bool:
    """Whether a line crosses a box (slab method)."""
    with np.errstate(divide="ignore", invalid="ignore"):
        ends = np.sort([(low - point) / direction, (high - point) / direction], axis=0)
    still = np.abs(direction) < 1e-12
    within = (low <= point) & (point <= high)
    near = np.where(still, np.where(within, -np.inf, np.inf), ends[0])
    far = np.where(still, np.where(within, np.inf, -np.inf), ends[1])
    return bool(near.max() <= far.min())


def _meta_notes(meta: dict[str, Any], folder: Path) -> list[str]:
    stated = str(meta.get("anno_id", folder.name))
    ours = "scored_joint" in meta
    return [] if ours or stated == folder.name else [f"meta.json calls the object {stated}; the folder's name is kept"]


def read_tree(urdf: Path) -> Urdf:
    """Read a URDF; FreeArtError when it is not one tree of links, or has an unknown joint type.

    SAPIEN would take an unknown type for a fixed joint, and reports other faults without their place.
    """
    read = read_urdf(urdf)
    try:
        checked.read_bytes(urdf, MAX_URDF_BYTES, checked.ANYWHERE).decode("utf-8")
    except UnicodeDecodeError as error:
        raise FreeArtError(f"{urdf} is not UTF-8 text: {error}") from error
    for j in read.joints.values():
        if j.joint_type is None and j.type not in ("fixed", FLOATING):
            raise FreeArtError(
                f"{urdf}: joint '{j.name}' has type '{j.type}', expected fixed, revolute, continuous, prismatic or "
                f"{FLOATING} (which is held)"
            )
        if j.joint_type and j.type != "continuous" and not j.limited:
            raise FreeArtError(f"{urdf}: joint '{j.name}' is {j.type} and has no <limit>, expected lower and upper")
        if j.lower > j.upper:
            raise FreeArtError(
                f"{urdf}: joint '{j.name}' has limits [{j.lower:g}, {j.upper:g}], expected lower <= upper"
            )
    read.root  # noqa: B018  raises unless there is one
    return read


def _meta(folder: Path) -> dict[str, Any]:
    path = folder / "meta.json"
    meta = checked.read_json(path) if path.is_file() else {}
    if not isinstance(meta.get("scored_joint", ""), str):
        raise FreeArtError(f"{path}: scored_joint is {meta['scored_joint']!r}, expected a joint's name")
    return meta


def _visuals(link: UrdfLink, folder: Path, urdf: Path) -> list[Visual]:
    visuals = []
    for shape in link.visuals:
        where = f"{urdf}: link '{link.name}'"
        if shape.kind != "mesh" or not shape.filename:
            raise FreeArtError(f"{where} has a visual that is not a mesh; expected <mesh filename=...>")
        if not shape.filename.lower().endswith(".obj"):
            raise FreeArtError(f"{where} has the mesh '{shape.filename}', expected an .obj file")
        path = resolve_inside(folder, shape.filename, f"{where} has the mesh")
        if not shape.size.all():
            raise FreeArtError(f"{where} has a mesh of scale {shape.size.tolist()}, expected none to be zero")
        visuals.append(Visual(path, shape.T_link_shape, shape.size))
    return visuals


def _missing_meshes(visuals: dict[str, list[Visual]], folder: Path, urdf: Path, may_lack: bool) -> tuple[str, ...]:
    """Absent mesh files; FreeArtError unless `may_lack`."""
    meshes = {v.mesh for of_link in visuals.values() for v in of_link}
    absent = tuple(sorted(str(mesh.relative_to(folder.resolve())) for mesh in meshes if not mesh.is_file()))
    if absent and not may_lack:
        more = f" and {len(absent) - 1} more" if len(absent) > 1 else ""
        raise FreeArtError(
            f"{urdf} names the mesh {absent[0]}, which does not exist{more}; --skip-missing leaves absent meshes out"
        )
    return absent


def _side(
    scored: UrdfJoint,
    links: tuple[str, ...],
    visuals: dict[str, list[Visual]],
    Ts: dict[str, Array],
    folder: Path,
    gaps: Gaps,
) -> Side:
    pieces = [
        read_obj(v.mesh, folder, gaps).moved(Ts[name] @ v.T_link_mesh, v.scale)
        for name in links
        for v in visuals[name]
        if v.mesh.is_file()
    ]
    surface = Surface.joined(pieces)
    if len(surface.faces) == 0:
        lacks = gaps.notes()[:1] and f" ({gaps.notes()[0]})"
        raise FreeArtError(
            f"{folder / URDF_NAME}: joint '{scored.name}' has no surface on the side of links "
            f"{', '.join(links) or '(none)'}{lacks or ''}"
        )
    return Side(links, surface)
