"""Copies of an asset's files, with changes: everything that its URDF, and the MJCF next to it, reference.

Files inside the asset's folder keep their place. Those referenced by absolute path, package:// or from a parent folder
go to `outside/`, and the copy references them there, so it is self-contained. A URDF may be untrusted: only meshes and
pictures of bounded size are copied, and nothing is written outside the folder.
"""

from __future__ import annotations

import os
import shutil
import xml.etree.ElementTree as ET
from collections.abc import Callable, Container, Iterable, Iterator, Mapping
from pathlib import Path

import numpy as np

from freeart21.errors import FreeArtError
from freeart21.files import atomic, checked
from freeart21.files.hashes import file_sha256
from freeart21.files.urdf import read_xml
from freeart21.files.urdf_files import find_file, resolve_file
from freeart21.se3 import Array

MAX_FILE_BYTES = 512 << 20
MAX_BYTES = 2 << 30
ENDINGS = (
    *(".obj", ".stl", ".dae", ".ply", ".off", ".glb", ".gltf", ".bin", ".msh", ".mtl"),
    *(".png", ".jpg", ".jpeg", ".bmp", ".tga", ".tif", ".tiff", ".hdr", ".ktx"),
)
"""Of files that are copied: meshes, their materials, pictures."""
OUTSIDE = "outside"
_NAMED_FILES = ("mesh", "texture", "hfield")
_BESIDE_MESH = ("mtllib", "map_Kd", "map_Ka", "map_Ks", "map_d", "map_Bump", "map_bump", "bump", "norm")


class _Copy:
    """State of a copy into a folder."""

    def __init__(self, home: Path, folder: Path):
        self.home, self.folder, self.total = home, folder, 0
        self.done: dict[Path, str] = {}
        """Source to its name in the folder."""
        self.places: dict[Path, str] = {}
        """Folder outside of `home`, absolute, to its place in the new one."""

    def take(self, source: Path, named_by: str) -> str:
        """Copy a file and the files that it references; its name in the new folder."""
        source = Path(os.path.normpath(source))
        if source not in self.done:
            inside = source.is_relative_to(self.home)
            base = self.home if inside else source.parent
            self._copy(source, base, "" if inside else self._place(base), named_by)
        return self.done[source]

    def _copy(self, source: Path, base: Path, place: str, named_by: str) -> None:
        name = str(Path(place) / source.relative_to(base))
        if source.suffix.lower() not in ENDINGS:
            raise FreeArtError(f"{named_by} names file '{source}', expected a mesh or a picture ({', '.join(ENDINGS)})")
        size = source.stat().st_size
        self.total += size
        if size > MAX_FILE_BYTES or self.total > MAX_BYTES:
            raise FreeArtError(
                f"{named_by} names file '{source}' of {size} bytes, {self.total} with those before: at most "
                f"{MAX_FILE_BYTES} each and {MAX_BYTES} together are copied"
            )
        target = self.folder / name
        target.parent.mkdir(parents=True, exist_ok=True)
        shutil.copyfile(checked.require_file(source, MAX_FILE_BYTES, checked.ANYWHERE), target)
        self.done[source] = name
        for other in _referenced_files(source):
            if other.is_relative_to(base) and other not in self.done and other.suffix.lower() in ENDINGS:
                self._copy(other, base, place, str(source))  # elsewhere only colours are lost

    def _place(self, folder: Path) -> str:
        if folder not in self.places:
            used = {*self.places.values(), *(f"{OUTSIDE}/{p.name}" for p in (self.home / OUTSIDE).glob("*"))}
            self.places[folder] = next(n for n in (f"{OUTSIDE}/{k}" for k in range(len(used) + 1)) if n not in used)
        return self.places[folder]


def copy_asset_files(urdf: Path, folder: Path, root: Path | None = None) -> dict[str, ET.Element]:
    """Copy the files that the asset of `urdf` needs, all inside `root`, into `folder`.

    Returns the URDF, and the MJCF next to it if any, by file name, with references updated; the caller writes both.
    Raises FreeArtError when a referenced file is missing, too large, or neither mesh nor picture.
    """
    copy, robot = _copy_urdf(urdf, folder, root)
    out, mjcf = {urdf.name: robot}, mjcf_path(urdf)
    if mjcf.is_file():
        model = read_xml(mjcf, comments=True)
        if model.tag == "mujoco":  # else another file of that name
            _copy_named(mjcf, model, copy)
            out[mjcf.name] = model
    if (copy.home / "semantics.txt").is_file():
        shutil.copyfile(checked.require_file(copy.home / "semantics.txt", MAX_FILE_BYTES), folder / "semantics.txt")
    return out


def copy_urdf(urdf: Path, folder: Path, root: Path | None = None, skip_missing: bool = False) -> None:
    """Copy a URDF and the files that it names, all inside `root`, into `folder`; absent ones keep their name with
    `skip_missing`. Raises FreeArtError as `copy_asset_files`."""
    write_xml(folder / urdf.name, _copy_urdf(urdf, folder, root, skip_missing)[1])


def _copy_urdf(urdf: Path, folder: Path, root: Path | None, skip_missing: bool = False) -> tuple[_Copy, ET.Element]:
    """Copies the files that a URDF names; returns the state of the copy, and the URDF with references updated."""
    folder.mkdir(parents=True, exist_ok=True)
    copy = _Copy(Path(os.path.normpath(urdf.absolute().parent)), folder)
    robot = read_xml(urdf, comments=True)
    for element in _naming(robot, "filename"):
        name = element.get("filename", "")
        if not (skip_missing and not resolve_file(urdf, name, root).is_file()):
            element.set("filename", copy.take(find_file(urdf, name, root), str(urdf)))
    return copy, robot


def list_mjcf_files(mjcf: Path, folder: Path) -> Iterator[Path]:
    """The files that an MJCF names; FreeArtError when one lies outside `folder`, or another file is included."""
    root = read_xml(mjcf)
    folders = _mjcf_folders(root)
    for element in root.iter():
        if element.tag in ("include", "model", "plugin", "extension"):
            raise FreeArtError(f"{mjcf} has <{element.tag}>, expected one file without extensions")
        for name in (value for key, value in element.attrib.items() if key.startswith("file")):
            below = folders.get("texture" if element.tag == "texture" else "mesh", "")
            yield checked.inside(folder, str(mjcf.parent.resolve() / below / name))


def _mjcf_folders(root: ET.Element) -> dict[str, str]:
    """Element name to the folder, relative to the MJCF, that its compiler states for the element's files."""
    folders: dict[str, str] = {}
    for compiler in root.iter("compiler"):
        every = compiler.get("assetdir", "")
        meshes, textures = (compiler.get(word, every) for word in ("meshdir", "texturedir"))
        folders |= {k: v for k, v in (("mesh", meshes), ("hfield", meshes), ("texture", textures)) if v}
    return folders


def file_hashes(urdf: Path, root: Path | None = None) -> dict[str, str]:
    """SHA-256 of the URDF, the files that describe the asset, and referenced files, by name; missing ones are
    omitted."""
    home = urdf.parent
    described = (urdf, home / "asset.json", home / "effects.json", mjcf_path(urdf))
    found = {path.name: path for path in described if path.is_file()}
    for name in sorted({e.get("filename", "") for e in _naming(read_xml(urdf), "filename")}):
        if (path := resolve_file(urdf, name, root)).is_file():
            found[name] = path
    return {name: file_sha256(path, checked.ANYWHERE) for name, path in found.items()}


def mjcf_path(urdf: Path) -> Path:
    """Path of the MJCF of a URDF."""
    return urdf.with_suffix(".mjcf" if urdf.suffix == ".xml" else ".xml")


def write_xml(path: Path, root: ET.Element) -> None:
    """Write a URDF or MJCF atomically."""
    declared = True if root.tag == "robot" else None
    atomic.write_bytes(path, ET.tostring(root, encoding="utf-8", xml_declaration=declared) + b"\n")


def set_dynamics(robot: ET.Element, losses: Mapping[str, Mapping[str, float]]) -> None:
    """Set `<dynamics>` of every joint of a URDF from damping and friction by joint; the rest is unchanged."""
    for joint in robot.findall("joint"):
        sums = losses.get(joint.get("name", ""), {"damping": 0.0, "friction": 0.0})
        element = joint.find("dynamics")
        if element is None and not any(sums.values()):
            continue
        element = ET.SubElement(joint, "dynamics") if element is None else element
        for word, value in sums.items():
            element.set(word, repr(value))


def set_mjcf_joint(
    model: ET.Element, joint: str, unset: Iterable[str], attributes: Mapping[str, str], where: Path
) -> None:
    """Replace the attributes `unset` of an MJCF's joint by `attributes`; FreeArtError when it has no such joint."""
    element = next((e for e in model.iter("joint") if e.get("name") == joint), None)
    if element is None:
        names = ", ".join(e.get("name", "") for e in model.iter("joint"))
        raise FreeArtError(f"{where} has no joint '{joint}'; joints: {names or 'none'}")
    for word in unset:
        element.attrib.pop(word, None)
    element.attrib.update(attributes)


def scale_inertials(
    robot: ET.Element, links: Container[str], mass: float, inertia: float, move: Callable[[str, Array], Array]
) -> None:
    """Multiply masses and moments of `links` by factors; `move` maps a link's name and its centre of mass (3,) in its
    frame to the new one."""
    for link in robot.findall("link"):
        name, inertial = link.get("name", ""), link.find("inertial")
        if name not in links or inertial is None:
            continue
        for element in inertial.findall("mass"):
            element.set("value", repr(float(element.get("value", "0")) * mass))
        for tensor in inertial.findall("inertia"):
            for key, value in tensor.attrib.items():
                tensor.set(key, repr(float(value) * inertia))
        origin = inertial.find("origin")
        origin = ET.SubElement(inertial, "origin") if origin is None else origin
        centre = np.array([float(v) for v in origin.get("xyz", "0 0 0").split()])
        origin.set("xyz", " ".join(repr(float(v)) for v in move(name, centre)))


def _naming(root: ET.Element, attribute: str) -> list[ET.Element]:
    return [e for tag in _NAMED_FILES for e in root.iter(tag) if e.get(attribute)]


def _copy_named(path: Path, root: ET.Element, copy: _Copy) -> None:
    """Copy the files of an MJCF and update their references; its compiler's folders are removed."""
    folders = _mjcf_folders(root)
    for compiler in root.iter("compiler"):
        for word in ("assetdir", "meshdir", "texturedir"):
            compiler.attrib.pop(word, None)
    for element in _naming(root, "file"):
        name = element.get("file", "")
        source = copy.home / folders.get(element.tag, "") / name
        if not source.is_file():
            raise FreeArtError(f"{path} names file '{name}', which does not exist")
        element.set("file", copy.take(source, str(path)))


def _referenced_files(source: Path) -> list[Path]:
    """Existing files that an OBJ or MTL file references."""
    if source.suffix.lower() not in (".obj", ".mtl"):
        return []
    found: list[Path] = []
    for line in checked.read_text(source, MAX_FILE_BYTES, checked.ANYWHERE, errors="replace").split("\n"):
        word, _, rest = line.strip().partition(" ")
        if word not in _BESIDE_MESH or not rest.strip():
            continue
        for name in (rest.strip(), rest.split()[-1]):  # with spaces, or after options
            other = Path(os.path.normpath(source.parent / name.replace("\\", "/")))
            if other.is_file() and other not in found:
                found.append(other)
                break
    return found
