"""Where commands can write without data loss.

A command replaces only an older output of its own kind. A folder of ours has a marker, a JSON file that begins with its
schema and lists all that was written with it under "files" (`atomic.new_folder`); a file of ours has a mark near its
beginning. An output is never written over, around or into its inputs, into another output, or through a link. Anything
else is refused, before the work and again at its end.
"""

from __future__ import annotations

import os
from collections.abc import Iterable
from dataclasses import dataclass
from fnmatch import fnmatchcase
from pathlib import Path

from freeart21.errors import FreeArtError
from freeart21.files import checked

_HEAD = 4096
"""Bytes of a file that hold its mark: our writers put the schema first."""
_LEFTOVERS = (".*.part", ".*.old", ".*.lock", "__pycache__")
"""Patterns of what killed processes and Python leave."""


@dataclass(frozen=True)
class Output:
    """A kind of output, and how to recognise it."""

    what: str
    mark: bytes
    """Bytes near the beginning of the marker file, or of an output that is one file."""
    marker: str = ""
    """Of a folder: its file with the mark and the list."""
    files: tuple[str, ...] = ()
    """Of a folder: files that are not in the list."""

    def stands_at(self, path: Path) -> bool:
        """Whether `path` is an output of this kind."""
        file = path / self.marker if self.marker else path
        try:
            return self.mark in checked.read_head(file, _HEAD, checked.ANYWHERE)
        except FreeArtError:
            return False


def _json(kind: str) -> bytes:
    return f'"schema": "freeart21/{kind}/'.encode()


ASSET = Output("asset", _json("asset"), "asset.json")
RESULT = Output("result", _json("prediction"), "prediction.json")
ANSWER = Output("answer of gap", _json("verdict"), "verdict.json")
SITE = Output("site", _json("site"), "site.json")
DEMO = Output("demo", _json("demo"), "demo.json")
MASKS = Output("folder of masks", _json("masks"), "masks.json", ("index.html",))
PAGE = Output("page", b'<meta name="generator" content="freeart21')
SCORES = Output("table of scores", _json("scores"))
JOINT_ASSET = Output("asset of a few numbers", b"freeart21 joint-asset")


def import_of(layout: str) -> Output:
    """The results folder that `freeart21 import` makes of results in `layout`; an older one of that layout only."""
    return Output(f"import of {layout} results", f'"imported": "{layout}"'.encode(), "method.json")


_SEQUENCE = Output("sequence", _json("sequence"), "sequence.json")
_TRUTH = Output("truth", _json("truth"), "truth.json")
_DATA = Output("data folder", _json("benchmark"), "benchmark.json")
_UNDER_WAY = Output("unfinished recording", _json("recording-job"), ".recording/job.json")
_CLOSED = (_SEQUENCE, _TRUTH, _DATA, _UNDER_WAY, RESULT, ASSET, ANSWER, SITE)
"""Folders of one command's output, into which no other command writes."""
_GROWING = ("benchmark.json", ".recording", "sequences", "examples", "pictures")
"""Entries of a folder to which recordings can be added."""


def check_place(out: Path, kind: Output | None, inputs: Iterable[Path] = (), into: Path | None = None) -> None:
    """FreeArtError, in one line, unless `out` may be written; nothing is written yet.

    Args:
        out: the output, a folder or a file.
        kind: an older one of it may be replaced; None lets nothing be replaced.
        inputs: what is read to make it.
        into: the one input that may hold `out`, as a result holds its asset.
    """
    out = Path(out)
    require_replaceable(out, kind)
    _check_around(out, inputs, into)


def check_append(out: Path, inputs: Iterable[Path] = ()) -> None:
    """Raise FreeArtError unless recordings can be added to the folder `out`: a data folder, or an empty one."""
    out = Path(out)
    _check_path(out)
    if out.exists() and not out.is_dir():
        raise FreeArtError(f"{out} is a file, expected a data folder or a new one")
    if out.is_dir() and any(out.iterdir()) and not any((out / name).exists() for name in _GROWING):
        raise FreeArtError(f"{out} holds other things and is no data folder; choose another place")
    if out.is_dir() and not os.access(out, os.W_OK | os.X_OK):
        raise FreeArtError(f"cannot write {out}: no permission")
    for kind in _CLOSED:
        if kind not in (_DATA, _UNDER_WAY) and kind.stands_at(out):
            raise FreeArtError(f"{out} is a {kind.what}, expected a data folder or a new one")
    _check_around(out, inputs, None)


def require_replaceable(out: Path, kind: Output | None) -> None:
    """Raise FreeArtError unless `out` does not exist, or is an older output of `kind` without other files."""
    _check_path(out)
    if not out.exists():
        return
    if kind is None:
        raise FreeArtError(f"{out} exists; choose another place or remove it first")
    if out.is_dir() != bool(kind.marker):
        is_, expected = ("a folder", "a file") if out.is_dir() else ("a file", "a folder")
        raise FreeArtError(f"{out} is {is_}, expected {expected} for the {kind.what}; choose another place")
    if kind.marker and not any(out.iterdir()):
        return
    if not kind.stands_at(out):
        lacks = f"it has no {kind.marker} of ours" if kind.marker else "it lacks our mark"
        raise FreeArtError(
            f"{out} exists and is no older {kind.what} ({lacks}); choose another place or remove it first"
        )
    others = _other_files(out, kind)
    if others:
        more = f" and {len(others) - 1} more" if len(others) > 1 else ""
        raise FreeArtError(
            f"{out} is an older {kind.what}, but {others[0]}{more} in it would be lost; move that away, or choose "
            "another place"
        )


def _other_files(out: Path, kind: Output) -> list[str]:
    """Files in the folder `out` that neither its marker nor that of a folder in it lists, and all links."""
    ours = {kind.marker, *kind.files}
    for marker in {kind.marker, RESULT.marker, ASSET.marker}:
        for path in out.rglob(marker):
            place = path.parent.relative_to(out)
            ours |= {(place / name).as_posix() for name in _listed(path)}
    found = []
    for path in out.rglob("*"):
        inside = path.relative_to(out)
        left_over = any(fnmatchcase(part, pattern) for part in inside.parts for pattern in _LEFTOVERS)
        if path.is_symlink() or not (path.is_dir() or left_over or inside.as_posix() in ours):
            found.append(inside.as_posix())
    return sorted(found)


def _listed(marker: Path) -> tuple[str, ...]:
    """The files that a marker lists, by name or by hash, and itself; none where it has no list."""
    try:
        data = checked.read_json(marker)
    except FreeArtError:
        return ()
    listed = data.get("files", data.get("sha256"))
    return (marker.name, *map(str, listed)) if isinstance(listed, list | dict) else ()


def _check_path(out: Path) -> None:
    """FreeArtError when `out` is a link, or cannot be made: above it is no folder, or none with write permission."""
    if out.is_symlink():
        raise FreeArtError(f"{out} is a link; name the place itself")
    above = next((folder for folder in out.absolute().parents if folder.exists() or folder.is_symlink()), None)
    if above is None or not above.is_dir():
        raise FreeArtError(f"cannot write {out}: {above} is not a folder")
    if not os.access(above, os.W_OK | os.X_OK):
        raise FreeArtError(f"cannot write {out}: no permission to write in {above}")


def _check_around(out: Path, inputs: Iterable[Path], into: Path | None) -> None:
    place = out.resolve()
    allowed = None if into is None else Path(into).resolve()
    for path in inputs:
        given = Path(path).resolve()
        if place == given:
            raise FreeArtError(f"{out} is what would be read; choose another place to write")
        if place in given.parents:
            raise FreeArtError(f"{out} holds {path}, which would be read; choose another place to write")
        if given in place.parents and given != allowed and given.is_dir():
            raise FreeArtError(f"{out} lies in {path}, which would be read; choose another place to write")
    for folder in place.parents:
        for kind in _CLOSED:
            if folder != allowed and kind.stands_at(folder):
                raise FreeArtError(f"{out} lies in the {kind.what} {folder}; choose another place to write")
