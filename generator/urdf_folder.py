"""Converts any URDF with visuals to a PartNet-Mobility folder, so that one loader reads all objects.

Meshes (`freeart21.view.mesh_pieces`) and primitives become OBJ files with a picture for every colour. A visual has the
colour that the URDF gives it, else its mesh's materials, else grey. A mesh that bounds no volume (open, or with
reversed faces) is written with each face in both directions, like PartNet-Mobility's: renderers show a face from its
front only. Collision shapes are left out; joints, inertia, origins and scales are kept. All files that the URDF and its
meshes name are in one folder, the root (`freeart21.files.urdf_files`).
"""

from __future__ import annotations

import hashlib
import xml.etree.ElementTree as ET
from dataclasses import replace
from pathlib import Path

import numpy as np
import trimesh

from freeart21.errors import FreeArtError
from freeart21.files import atomic, checked
from freeart21.files.asset import find_movable_joint
from freeart21.files.urdf import UrdfShape, parse_urdf
from freeart21.files.urdf_files import describe_missing_file, file_names, find_root, resolve_file
from freeart21.view.link_shapes import primitive
from freeart21.view.mesh_pieces import ENDINGS, read_pieces, up_axis
from freeart21.view.obj import Piece
from generator import partnet, textures
from generator.partnet_files import MAX_OBJ_BYTES, Gaps, read_obj
from generator.partnet_writer import material_lines
from generator.surface import Paint, Surface

_NOTES = "notes.json"
"""Remarks on the URDF, stored in the folder written for it."""
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
    names = {shape.filename for link in partnet.read_tree(urdf).links.values() for shape in link.visuals}
    for path in (urdf, *(resolve_file(urdf, name, root) for name in sorted(names) if name)):
        data = checked.read_bytes(path, MAX_OBJ_BYTES, checked.ANYWHERE) if path.is_file() else b""
        sums.update(hashlib.sha256(data).digest())
    return sums.hexdigest()


def load_urdf(
    urdf: Path, folder: Path, joint: str | None = None, skip_missing: bool = False, root: Path | None = None
) -> partnet.PartNetObject:
    """The object of a URDF with the named joint, or the only movable one; `folder` is written unless it exists.

    Files that the URDF names are in `root`, by default its own folder or its package's. Raises FreeArtError, in one
    line, as `generator.partnet.load` does.
    """
    scored = find_movable_joint(urdf, joint).name
    try:
        if not folder.is_dir():
            write_folder(urdf, folder, skip_missing, root)
        loaded = partnet.load(folder, scored)
        notes = checked.read_json(folder / _NOTES)["notes"]
        return replace(loaded, notes=(*notes, *loaded.notes))
    except atomic.CannotWrite:
        raise
    except FreeArtError as error:
        raise FreeArtError(str(error).replace(str(folder / partnet.URDF_NAME), str(urdf))) from error


def write_folder(urdf: Path, folder: Path, skip_missing: bool = False, root: Path | None = None) -> Path:
    """Write the new folder `folder` with mobility.urdf, OBJ meshes and pictures of what `urdf` shows."""
    read, robot = partnet.read_tree(urdf), parse_urdf(urdf)
    root = find_root(urdf, file_names(robot), root)
    gaps = Gaps()
    with atomic.new_folder(folder) as aside:
        count = 0
        for element in [*robot]:
            if element.tag not in ("link", "joint"):
                robot.remove(element)
        for joint_element in robot.findall("joint"):
            if joint_element.get("type") == partnet.FLOATING:  # SAPIEN does not know it
                joint_element.set("type", "fixed")
        for link in robot.findall("link"):
            for collision in link.findall("collision"):
                link.remove(collision)
            shapes = read.links[link.get("name", "")].visuals
            for visual, shape in zip(link.findall("visual"), shapes, strict=True):
                surface = _surface(shape, urdf, f"{urdf}: link '{link.get('name')}'", skip_missing, root, gaps)
                if surface is None or len(surface.faces) == 0:
                    link.remove(visual)
                    continue
                count += 1
                surface = surface if _bounds_volume(surface) else _both_sides(surface)
                for own in visual.findall("material"):
                    visual.remove(own)
                geometry = visual.find("geometry")
                assert geometry is not None
                mesh = geometry[0]
                if mesh.tag != "mesh":
                    mesh.clear()
                    mesh.tag = "mesh"
                mesh.set("filename", f"textured_objs/{_write(surface, aside, f'mesh-{count}')}")
        atomic.write_json(aside / _NOTES, {"notes": [*gaps.notes(), *partnet.floating_notes(read.joints)]})
        atomic.write_bytes(aside / partnet.URDF_NAME, ET.tostring(robot))
    return folder


def clear_notes(folder: Path) -> None:
    """Remove the remarks on the URDF from `folder`."""
    (folder / _NOTES).unlink()


def _surface(shape: UrdfShape, urdf: Path, where: str, skip_missing: bool, root: Path, gaps: Gaps) -> Surface | None:
    """The surface of a visual in its mesh's frame; None for an absent file with `skip_missing`."""
    if shape.kind != "mesh":
        surface = _joined([Piece(primitive(shape, where))])
    elif not shape.size.all():
        raise FreeArtError(f"{where} has a mesh of scale {shape.size.tolist()}, expected none to be zero")
    else:
        path = resolve_file(urdf, shape.filename, root)
        if path.suffix.lower() not in ENDINGS:
            raise FreeArtError(f"{where} has the mesh '{shape.filename}', expected {', '.join(ENDINGS)}")
        if not checked.is_there(path):
            if skip_missing:
                gaps.meshes.add(shape.filename)
                return None
            absent = describe_missing_file(urdf, shape.filename, root)
            raise FreeArtError(f"{where} names the mesh {absent}; --skip-missing leaves absent meshes out")
        if path.suffix.lower() == ".obj":
            surface = read_obj(path, root, gaps)
        else:
            surface = _joined(read_pieces(path, root))
            if path.suffix.lower() == ".dae" and up_axis(path, root) in ("X_UP", "Y_UP"):
                gaps.axes.add(shape.filename)
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


def _both_sides(surface: Surface) -> Surface:
    """The surface with each face in both directions."""
    return Surface.joined([surface, replace(surface, faces=surface.faces[:, ::-1])])


def _write(surface: Surface, folder: Path, stem: str) -> str:
    """Write a surface as textured_objs/STEM.obj, with materials and pictures; returns the file's name."""
    lines, materials = [f"mtllib {stem}.mtl"], list[str]()
    lines += [f"v {x:.9g} {y:.9g} {z:.9g}" for x, y, z in surface.vertices.tolist()]
    lines += [f"vt {u:.6g} {v:.6g}" for u, v in surface.uv.tolist()]
    of_face = surface.paint[surface.faces[:, 0]]
    for k, paint in enumerate(surface.paints):
        faces = surface.faces[of_face == k] + 1
        if len(faces) == 0:
            continue
        lines.append(f"usemtl paint-{k}")
        lines += [f"f {a}/{a} {b}/{b} {c}/{c}" for a, b, c in faces.tolist()]
        picture = textures.plain(tuple((paint.colour / 255.0).tolist())) if paint.picture is None else paint.picture
        atomic.write_bytes(folder / "images" / f"{stem}-{k}.png", checked.encode_png(picture))
        # plain colours are pictures, too, because SAPIEN takes Kd as linear
        materials += material_lines(f"paint-{k}", "plastic", f"{stem}-{k}.png")
    atomic.write_bytes(folder / "textured_objs" / f"{stem}.obj", ("\n".join(lines) + "\n").encode())
    atomic.write_bytes(folder / "textured_objs" / f"{stem}.mtl", ("\n".join(materials) + "\n").encode())
    return f"{stem}.obj"
