"""Where the files are that a URDF names: the one resolver of all readers, within one folder, the root.

Names are relative to the URDF, absolute, or addresses: package://NAME/PATH and model://NAME/PATH (looked up in each
folder from the URDF's to the root, with and without NAME) and file://PATH. Percent-encoded characters and backslashes
are understood where no file is named so. Nothing outside the root is opened, whatever a name says.
"""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Iterable
from pathlib import Path
from urllib.parse import unquote

from freeart21.errors import FreeArtError

_LEVELS = 3
"""So many folders above the URDF's own are asked whether they are its package: PACKAGE/urdf/robots/arm/a.urdf."""
_PACKAGES = ("package://", "model://")
_MARKS = ("package.xml", "model.config")
"""Files in the top folder of a ROS package, and of a Gazebo model."""


def find_root(urdf: Path, names: Iterable[str] = (), root: Path | None = None) -> Path:
    """The folder that holds what a URDF of these file `names` may name: `root` when it is given, else the URDF's own,
    or that of the package it lies in.

    A folder above is the package's when it holds package.xml or model.config, or both this URDF's folder, called urdf,
    and one called meshes, or when its own name is the package that a name begins with. Raises FreeArtError when `root`
    is not a folder.
    """
    if root is not None:
        if not root.is_dir():
            raise FreeArtError(f"the root {root} is not a folder")
        return root
    packages = {name.partition("://")[2].partition("/")[0] for name in names if name.startswith(_PACKAGES)}
    home = urdf.absolute().parent
    root = home
    for folder in (home, *home.parents[:_LEVELS]):
        if Path.home().is_relative_to(folder):  # what holds everything is no package
            break
        holds_both = folder == home.parent and home.name.lower() == "urdf" and (folder / "meshes").is_dir()
        if holds_both or folder.name in packages or any((folder / mark).is_file() for mark in _MARKS):
            root = folder
    return root


def file_names(robot: ET.Element) -> list[str]:
    """The names of all files that the elements of a URDF name."""
    return [name for element in robot.iter() if (name := element.get("filename"))]


def named_inside(urdf: Path, filename: str, root: Path | None = None) -> Path:
    """Where in `root` (by default `find_root`'s) the file is that a URDF names, whether it exists or not.

    Raises FreeArtError when the name leads out of the root.
    """
    return _places(urdf, filename, root)[0]


def named_file(urdf: Path, filename: str, root: Path | None = None) -> Path:
    """The file in `root` that a URDF names; FreeArtError says where it was looked for when there is none."""
    path = named_inside(urdf, filename, root)
    if not path.is_file():
        raise FreeArtError(f"{urdf} names the mesh {missing_file(urdf, filename, root)}")
    return path


def missing_file(urdf: Path, filename: str, root: Path | None = None) -> str:
    """What to say of a file that a URDF names and that is not there, such as "'a.obj', which does not exist: ..."."""
    folder = find_root(urdf, [filename], root).resolve()
    places = [str(place.relative_to(folder)) for place in _places(urdf, filename, root)]
    return (
        f"'{filename}', which does not exist: looked for {' and '.join(places[:_LEVELS])} in {folder}; "
        "--root DIR looks in another folder"
    )


def _places(urdf: Path, filename: str, root: Path | None) -> list[Path]:
    """Resolved paths inside the root at which the file may be, the one that exists first."""
    root = find_root(urdf, [filename], root)
    decoded = unquote(filename)
    paths = [path for name in (filename, decoded, decoded.replace("\\", "/")) for path in _paths(urdf, name, root)]
    try:
        resolved = dict.fromkeys(path.resolve() for path in paths)
        places = [path for path in resolved if path.is_relative_to(root.resolve())]
        places.sort(key=lambda path: not path.is_file())
    except (OSError, RuntimeError, ValueError) as error:  # a circle of links, a name too long
        raise FreeArtError(f"{urdf} names the file '{filename[:80]}', which cannot be looked up: {error}") from error
    if not places:
        raise FreeArtError(
            f"{urdf} names the file '{filename}', which leads out of the folder {root.resolve()}; --root DIR names a "
            "larger one"
        )
    return places


def _paths(urdf: Path, name: str, root: Path) -> list[Path]:
    """Where a name may point to, in order; unresolved."""
    home, top = urdf.absolute().parent, root.absolute()
    if name.startswith(_PACKAGES):
        inner = name.partition("://")[2].lstrip("/")
        bases = dict.fromkeys([home, *(folder for folder in home.parents if folder.is_relative_to(top)), top])
        return [base / path for base in bases for path in (inner, inner.partition("/")[2]) if path]
    if name.startswith("file://"):
        return [home / name.removeprefix("file://").removeprefix("localhost")]
    if "://" in name:
        raise FreeArtError(
            f"{urdf} names the file '{name[:80]}', expected a path, or an address of package://, model:// or file://"
        )
    return [home / name]
