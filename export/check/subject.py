"""Finds the asset to check: an asset folder, a folder with one URDF or MJCF, or such a file. Input is untrusted."""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import islice
from pathlib import Path

from freeart21.errors import FreeArtError
from freeart21.files import checked
from freeart21.files.asset import read_asset
from freeart21.files.asset_copy import list_mjcf_files
from freeart21.files.urdf import read_file_names, read_root_tag
from freeart21.files.urdf_files import find_root, resolve_file

MAX_FILE_BYTES = 256 << 20
"""Largest file."""
MAX_BYTES = 1 << 30
"""All files together."""
_LOOKED_AT = 100
"""Most files of a folder that are tested for being a URDF or MJCF."""


@dataclass(frozen=True)
class Subject:
    """The files of one asset; at least a URDF or an MJCF."""

    folder: Path
    """No file outside it is opened."""
    urdf: Path | None
    mjcf: Path | None


def find_subject(path: Path, root: Path | None = None) -> Subject:
    """The asset at `path`; its files must be inside `root` or, without one, inside the folder or the URDF's package.

    Raises FreeArtError when there is none or several, a file declares a document type (and so entities), names a file
    outside the folder, or is too large.
    """
    path = Path(path)
    if not path.exists():
        raise FreeArtError(f"{path} does not exist")
    if path.is_file():
        kind = _file_kind(path)
        if kind is None:
            raise FreeArtError(f"{path} is no asset: expected a folder, a URDF (<robot>) or an MJCF (<mujoco>)")
        subject = Subject(path.parent, path if kind == "robot" else None, path if kind == "mujoco" else None)
    elif checked.is_there(path / "asset.json"):
        urdf = read_asset(path).urdf
        mjcf = urdf.with_suffix(".xml")
        subject = Subject(path.resolve(), urdf, mjcf if _file_kind(mjcf) == "mujoco" else None)
    else:
        subject = _find_in_folder(path)
    if root is not None:
        subject = replace(subject, folder=find_root(path, root=root))
    elif subject.urdf is not None and not (path / "asset.json").is_file():
        found = find_root(subject.urdf, read_file_names(subject.urdf))
        if subject.folder.absolute().is_relative_to(found):
            subject = replace(subject, folder=found)
    _check_files(subject)
    return subject


def _find_in_folder(folder: Path) -> Subject:
    """The only URDF or MJCF of a folder or, if it holds none itself, of its subfolders."""
    for pattern in ("*", "*/*", "*/*/*"):  # such as PACKAGE/urdf/a.urdf
        files = sorted(islice((f for f in folder.glob(pattern) if f.suffix in (".urdf", ".xml")), _LOOKED_AT))
        kinds = {file: _file_kind(file) for file in files}
        urdfs = [file for file, kind in kinds.items() if kind == "robot"]
        mjcfs = [file for file, kind in kinds.items() if kind == "mujoco"]
        if len(urdfs) == 1:
            mjcf = urdfs[0].with_suffix(".xml")
            return Subject(folder, urdfs[0], mjcf if mjcf in mjcfs else None)
        if not urdfs and len(mjcfs) == 1:
            return Subject(folder, None, mjcfs[0])
        if urdfs or mjcfs:
            names = ", ".join(file.relative_to(folder).as_posix() for file in [*urdfs, *mjcfs])
            raise FreeArtError(f"{folder} holds several URDF or MJCF files; name one of {names}")
    for file in sorted(folder.glob("**/*.xacro"))[:1]:
        _file_kind(file)
    raise FreeArtError(f"{folder} is no asset: it holds neither asset.json nor a URDF or MJCF file")


def _file_kind(path: Path) -> str | None:
    """'robot' or 'mujoco', from the root element; None for other files."""
    if path.suffix.lower() not in (".urdf", ".xml", ".xacro") or not path.is_file():
        return None
    tag = read_root_tag(path)
    return tag if tag in ("robot", "mujoco") else None


def _check_files(subject: Subject) -> None:
    files: set[Path] = set()
    if subject.urdf is not None:
        files |= {resolve_file(subject.urdf, name, subject.folder) for name in read_file_names(subject.urdf)}
    if subject.mjcf is not None:
        files |= set(list_mjcf_files(subject.mjcf, subject.folder))
    sizes = {file: file.stat().st_size for file in files if file.is_file()}
    for file, size in sizes.items():
        if size > MAX_FILE_BYTES:
            raise FreeArtError(f"{file} has {size} bytes, at most {MAX_FILE_BYTES} are read")
    if sum(sizes.values()) > MAX_BYTES:
        raise FreeArtError(f"{subject.folder} names files of {sum(sizes.values())} bytes, at most {MAX_BYTES} are read")
