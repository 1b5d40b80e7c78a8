"""Loads the object of a URDF: its surfaces, and the two sides of its scored joint.

Meshes (`freeart21.view.mesh_pieces`) and primitives are read by us, also for the renderer. A visual has the colour
that the URDF gives it, else its mesh's materials, else grey. A mesh that bounds no volume (open, or with reversed
faces) gets each face in both directions, like PartNet-Mobility's: renderers show a face from its front only. All files
that the URDF and its meshes name are in one folder, the root (`freeart21.files.urdf_files`).
"""

from __future__ import annotations

import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import trimesh

from freeart21.asset import Asset
from freeart21.errors import FreeArtError
from freeart21.files import checked
from freeart21.files.asset import find_movable_joint, held_positions
from freeart21.files.urdf import (
    MAX_URDF_BYTES,
    Urdf,
    UrdfJoint,
    UrdfShape,
    read_file_names,
    read_urdf,
    subtree_links,
)
from freeart21.files.urdf_files import describe_missing_file, find_root, resolve_file
from freeart21.joint import Joint
from freeart21.mesh import bounding_diagonal
from freeart21.se3 import Array
from freeart21.view.link_shapes import primitive
from freeart21.view.mesh_pieces import ENDINGS, Piece, read_pieces, up_axis
from generator.motion import motion_range
from generator.partnet_files import MAX_OBJ_BYTES, Gaps, describe_gaps, read_obj
from generator.surface import Paint, Surface

FLOATING = "floating"
_GREY = np.full(3, 153, np.uint8)
_LARGEST = 1e6  # largest plausible coordinate


URDF_ENDINGS = (".urdf", ".xacro")
"""File names that stand for URDFs; the reader refuses xacro with an explanation."""


def object_name(urdf: Path) -> str:
    """Name of the object of this file; FreeArtError unless it can name a folder."""
    name = urdf.stem
    if not name or not all(c.isalnum() or c in "-_." for c in name) or name.startswith("."):
        raise FreeArtError(f"{urdf}: '{name}' cannot name a recording; expected letters, digits, '-', '_' and '.'")
    return name


def digest(urdf: Path, root: Path | None = None) -> str:
    """SHA-256, hexadecimal, of the URDF and of its visual meshes in `root`."""
    sums = hashlib.sha256()
    names = {shape.filename for link in read_tree(urdf).links.values() for shape in link.visuals}
    for path in (urdf, *(resolve_file(urdf, name, root) for name in sorted(names) if name)):
        data = checked.read_bytes(path, MAX_OBJ_BYTES, checked.ANYWHERE) if path.is_file() else b""
        sums.update(hashlib.sha256(data).digest())
    return sums.hexdigest()


@dataclass(frozen=True)
class Visual:
    """One visual of a link."""

    surface: Surface
    T_link_mesh: Array
    scale: Array


@dataclass(frozen=True)
class Side:
    """All links on one side of the scored joint."""

    links: tuple[str, ...]
    surface: Surface
    """In the object's frame, the scored joint at zero and the others held."""


@dataclass(frozen=True)
class LoadedObject:
    """A loaded object and the two sides of its scored joint.

    The object's frame is that of the URDF's root link (z up), the scored joint at zero.
    """

    name: str
    """The name of its folder, or of its URDF."""
    category: str
    """From PartNet-Mobility's meta.json; 'unknown' without it."""
    asset: Asset
    """Reference link = the joint's parent, moving link = its child; canonical frame = the object's frame."""
    joint: Joint
    """Motion of the child side relative to the parent side, in the object's frame."""
    parent_side: Side
    child_side: Side
    semantics: dict[str, str]
    """Link name to semantics.txt's kind and name, such as 'slider drawer'; mobility_v2.json may use other names."""
    notes: tuple[str, ...]
    """Remarks on this object for the user, one line each."""

    @property
    def sides(self) -> tuple[Side, Side]:
        """Parent side, child side."""
        return self.parent_side, self.child_side


def load_urdf(
    urdf: Path,
    joint: str | None = None,
    skip_missing: bool = False,
    root: Path | None = None,
    layout: str = "URDF",
) -> LoadedObject:
    """The object of a URDF with the named joint, or the only movable one.

    Files that the URDF names are in `root`, by default its own folder or its package's. The faces of a URDF of
    PartNet-Mobility's `layout` are taken as they are. Raises FreeArtError, in one line, when a file is missing or
    unreadable, when the joint is unknown (the movable ones are listed) or has no range, or when a side has no surface.
    """
    read, gaps = read_tree(urdf), Gaps(set)
    scored = find_movable_joint(urdf, joint)
    if not scored.lower < scored.upper:
        raise FreeArtError(
            f"{urdf}: joint '{scored.name}' cannot move: its limits are [{scored.lower:g}, {scored.upper:g}]"
        )
    root = find_root(urdf, read_file_names(urdf), root)
    visuals = read_visuals(read, root, gaps, closed=layout == "URDF")
    if gaps["meshes"] and not skip_missing:
        more = f" ({len(gaps['meshes'])} such meshes)" if len(gaps["meshes"]) > 1 else ""
        absent = describe_missing_file(urdf, min(gaps["meshes"]), root)
        raise FreeArtError(f"{urdf} names the mesh {absent}{more}; --skip-missing leaves absent meshes out")
    joints = read.joints
    held = held_positions(joints, scored.name)
    Ts = read.link_poses(held)
    below = subtree_links(joints, scored.child)
    child = _side(read, scored, tuple(link for link in visuals if link in below), visuals, Ts, gaps)
    parent = _side(read, scored, tuple(link for link in visuals if link not in below), visuals, Ts, gaps)
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
    name = urdf.stem if layout == "URDF" else root.name
    source: dict[str, Any] = {"format": layout, "object": name}
    asset = Asset(
        *(urdf, scored.name, scored.parent, scored.child, Ts[scored.parent]), held=held, source=source, root=root
    )
    notes = (*describe_gaps(gaps), *_joint_notes(moving, scored, joints, held))
    return LoadedObject(name, "unknown", asset, moving, parent, child, {}, notes)


def read_visuals(read: Urdf, root: Path, gaps: Gaps, closed: bool = True) -> dict[str, list[Visual]]:
    """Link name to what it shows, without absent files, which are added to `gaps`.

    With `closed`, a surface that bounds no volume gets each face in both directions.
    """
    found: dict[str, list[Visual]] = {}
    for name, link in read.links.items():
        found[name] = []
        for shape in link.visuals:
            surface = _surface(shape, read.path, f"{read.path}: link '{name}'", root, gaps)
            if surface is not None and len(surface.faces):
                if closed and not _bounds_volume(surface):
                    surface = Surface.joined([surface, replace(surface, faces=surface.faces[:, ::-1])])
                scale = shape.size if shape.kind == "mesh" else np.ones(3)
                found[name].append(Visual(surface, shape.T_link_shape, scale))
    return found


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
    floating = (j.name for j in joints.values() if j.type == FLOATING)
    return [f"joint '{name}' is {FLOATING}: it is held at its origin" for name in floating] + notes


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


def _side(
    read: Urdf,
    scored: UrdfJoint,
    links: tuple[str, ...],
    visuals: Mapping[str, Sequence[Visual]],
    Ts: Mapping[str, Array],
    gaps: Gaps,
) -> Side:
    pieces = [v.surface.moved(Ts[name] @ v.T_link_mesh, v.scale) for name in links for v in visuals[name]]
    surface = Surface.joined(pieces)
    if len(surface.faces) == 0:
        lacks = "".join(f" ({note})" for note in describe_gaps(gaps)[:1])
        raise FreeArtError(
            f"{read.path}: joint '{scored.name}' has no surface on the side of links "
            f"{', '.join(links) or '(none)'}{lacks}"
        )
    return Side(links, surface)


def _surface(shape: UrdfShape, urdf: Path, where: str, root: Path, gaps: Gaps) -> Surface | None:
    """The surface of a visual in its mesh's frame; None for an absent file."""
    if shape.kind != "mesh":
        surface = _joined([Piece(primitive(shape, where))])
    elif not shape.size.all():
        raise FreeArtError(f"{where} has a mesh of scale {shape.size.tolist()}, expected none to be zero")
    else:
        path = resolve_file(urdf, shape.filename, root)
        if path.suffix.lower() not in ENDINGS:
            raise FreeArtError(f"{where} has the mesh '{shape.filename}', expected {', '.join(ENDINGS)}")
        if not checked.is_there(path):
            gaps["meshes"].add(shape.filename)
            return None
        if path.suffix.lower() == ".obj":
            surface = read_obj(path, root, gaps)
        else:
            surface = _joined(read_pieces(path, root))
            if path.suffix.lower() == ".dae" and up_axis(path, root) in ("X_UP", "Y_UP"):
                gaps["axes"].add(shape.filename)
    if not (np.abs(surface.vertices) < _LARGEST).all():
        raise FreeArtError(f"{where} shows vertices beyond {_LARGEST:g}")
    if shape.rgba is None:
        return surface
    colour = Paint(np.rint(255 * np.clip(shape.rgba[:3], 0, 1)).astype(np.uint8))
    return replace(surface, paint=np.zeros_like(surface.paint), paints=(colour,))


def _joined(pieces: list[Piece]) -> Surface:
    """Pieces as one surface, each with its picture, its mean colour, or grey."""
    return Surface.joined([_painted(piece) for piece in pieces])


def _painted(piece: Piece) -> Surface:
    mesh, count = piece.mesh, len(piece.mesh.vertices)
    colour = _GREY if mesh.colours is None else np.rint(mesh.colours.mean(0)).astype(np.uint8)
    paint = Paint(colour) if piece.picture is None else Paint(np.full(3, 255, np.uint8), piece.picture)
    uv = np.zeros((count, 2)) if piece.uv is None else piece.uv
    return Surface(mesh.vertices, mesh.faces, uv, np.zeros(count, np.int64), (paint,))


def _bounds_volume(surface: Surface) -> bool:
    """Whether the surface is closed with all faces outwards."""
    mesh = trimesh.Trimesh(surface.vertices, surface.faces, process=True)
    mesh.update_faces(mesh.nondegenerate_faces())  # as at the poles of a sphere
    return bool(mesh.is_volume)
