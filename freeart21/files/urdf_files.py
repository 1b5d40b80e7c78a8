"""Resolves the file names of a URDF within one folder, the root.

A name is relative to the URDF, absolute, or an address: package://NAME/PATH and model://NAME/PATH (looked up with and
without NAME in each folder from the URDF's to the root), or file://PATH. Percent-encoding and backslashes are decoded
where no file has the literal name. Nothing outside the root is opened.
"""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from urllib.parse import unquote

from freeart21.errors import FreeArtError

_LEVELS = 3
"""Folders above the URDF's own that may be its package: PACKAGE/urdf/robots/arm/a.urdf."""
_PACKAGES = ("package://", "model://")
_MARKS = ("package.xml", "model.config")
"""Files in the top folder of a ROS package, and of a Gazebo model."""


def find_root(urdf: Path, names: Iterable[str] = (), root: Path | None = None) -> Path:
    """The folder that bounds the file `names` of a URDF: `root` when given, else the URDF's own or that of its package.

    A folder above is the package when it holds package.xml or model.config, when it holds a folder meshes beside the
    URDF's folder urdf, or when its name is the package of an address. Raises FreeArtError when `root` is no folder.
    """
    if root is not None:
        if not root.is_dir():
            raise FreeArtError(f"the root {root} is not a folder")
        return root
    packages = {name.partition("://")[2].partition("/")[0] for name in names if name.startswith(_PACKAGES)}
    home = urdf.absolute().parent
    root = home
    for folder in (home, *home.parents[:_LEVELS]):
        if Path.home().is_relative_to(folder):  # a folder that holds the user's home is no package
            break
        holds_both = folder == home.parent and home.name.lower() == "urdf" and (folder / "meshes").is_dir()
        if holds_both or folder.name in packages or any((folder / mark).is_file() for mark in _MARKS):
            root = folder
    return root


def resolve_file(urdf: Path, filename: str, root: Path | None = None) -> Path:
    """Path inside `root` (default: `find_root`) of a file that a URDF names; it need not exist.

    Raises FreeArtError when the name leads out of the root.
    """
    return _candidates(urdf, filename, root)[0]


def find_file(urdf: Path, filename: str, root: Path | None = None) -> Path:
    """The same, but FreeArtError, which lists the places searched, when the file does not exist."""
    path = resolve_file(urdf, filename, root)
    if not path.is_file():
        raise FreeArtError(f"{urdf} names the mesh {describe_missing_file(urdf, filename, root)}")
    return path


def describe_missing_file(urdf: Path, filename: str, root: Path | None = None) -> str:
    """Text for a message about a missing file, such as "'a.obj', which does not exist: ..."."""
    folder = find_root(urdf, [filename], root).resolve()
    places = [str(place.relative_to(folder)) for place in _candidates(urdf, filename, root)]
    return (
        f"'{filename}', which does not exist: looked for {' and '.join(places[:_LEVELS])} in {folder}; "
        "--root DIR looks in another folder"
    )


def _candidates(urdf: Path, filename: str, root: Path | None) -> list[Path]:
    """Resolved paths inside the root where the file may be, existing ones first."""
    root = find_root(urdf, [filename], root)
    decoded = unquote(filename)
    paths = [
        path for name in (filename, decoded, decoded.replace("\\", "/")) for path in _unresolved_paths(urdf, name, root)
    ]
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


def _unresolved_paths(urdf: Path, name: str, root: Path) -> list[Path]:
    """Places that a name may point to, in order."""
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
