"""Results handed in as one ZIP file: looked through before anything is unpacked, then unpacked aside."""

from __future__ import annotations

import shutil
import stat
import tempfile
import zipfile
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path, PurePosixPath

from freeart21.errors import FreeArtError
from freeart21.files import checked
from leaderboard.submission import MAX_FILES, escape_unprintable

MAX_ARCHIVE_BYTES = 4 << 30
"""Of the file, and of all that is in it: 21 results of 300 frames with assets have 0.5 GB."""
MAX_ENTRY_BYTES = 1 << 30
MAX_DIRECTORY_BYTES = 64 << 20
"""Of the list of entries, which is read as a whole before any of it can be looked at."""
DEEPEST, LONGEST_NAME = 12, 200
"""Folders in folders, and bytes of each name, of what is in an archive."""
_METHODS = (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED)
_ENCRYPTED = 0x1
_LEFT_BY_SYSTEMS = ("__MACOSX", ".DS_Store", "Thumbs.db", "desktop.ini")


@contextmanager
def open_results(given: Path) -> Iterator[Path]:
    """The folder of results that `given` is, or that the ZIP file `given` holds, unpacked until the block ends.

    The results may stand in the archive themselves or in one folder of it. Raises FreeArtError, before anything is
    unpacked, when an entry would lie outside, is a link or no file, is encrypted, said twice, or too large, or when
    there are too many; and when the bytes are not what their entry says.
    """
    given = Path(given)
    if not given.is_file():
        yield given
        return
    if given.suffix.lower() != ".zip":
        raise FreeArtError(f"{given} is a file, expected a folder of results or a .zip of one")
    with tempfile.TemporaryDirectory(prefix="freeart21-") as aside:
        folder = Path(aside) / (escape_unprintable(given.stem)[:LONGEST_NAME] or "results")
        folder.mkdir()
        _unpack(given, folder)
        yield _top(folder)


def _unpack(path: Path, folder: Path) -> None:
    try:
        with (
            checked.open_file(path, MAX_ARCHIVE_BYTES, checked.ANYWHERE) as opened,
            checked.open_zip(opened, path, MAX_DIRECTORY_BYTES) as archive,
        ):
            entries = _entries(path, archive)
            free = shutil.disk_usage(folder).free
            if (size := sum(entry.file_size for entry, _ in entries)) > free:
                raise FreeArtError(f"{path} unpacks to {size} bytes, there are {free} free in {folder.parent}")
            for entry, name in entries:
                _write(path, archive, entry, folder / name)
    except (zipfile.BadZipFile, zlib.error, EOFError, ValueError, OSError, RuntimeError, NotImplementedError) as error:
        said = (str(error).splitlines() or [""])[0]
        raise FreeArtError(f"{path} cannot be unpacked: {escape_unprintable(said) or type(error).__name__}") from error


def _entries(path: Path, archive: zipfile.ZipFile) -> list[tuple[zipfile.ZipInfo, PurePosixPath]]:
    """Every file in the archive that is a result's, and its place."""
    found: list[tuple[zipfile.ZipInfo, PurePosixPath]] = []
    listed = archive.infolist()
    if len(listed) > MAX_FILES:
        raise FreeArtError(f"{path} has {len(listed)} entries, at most {MAX_FILES} are read")
    total, seen = 0, set()
    for entry in listed:
        name = PurePosixPath(entry.filename)
        wrong = _wrong(entry, name)
        if wrong:
            raise FreeArtError(f"{path}: entry '{escape_unprintable(entry.filename)[:LONGEST_NAME]}' {wrong}")
        if entry.is_dir() or any(part in _LEFT_BY_SYSTEMS or part.startswith("._") for part in name.parts):
            continue
        total += entry.file_size
        if total > MAX_ARCHIVE_BYTES:
            raise FreeArtError(f"{path} unpacks to more than {MAX_ARCHIVE_BYTES} bytes, which is the most that is read")
        if name in seen:
            raise FreeArtError(f"{path}: entry '{name}' is there twice, expected once")
        seen.add(name)
        found.append((entry, name))
    return found


def _wrong(entry: zipfile.ZipInfo, name: PurePosixPath) -> str:
    """What keeps an entry from being unpacked; empty when nothing does."""
    said, kind = entry.filename, stat.S_IFMT(entry.external_attr >> 16)
    if name.is_absolute() or ".." in name.parts or "\\" in said or ":" in said or not name.parts:
        return "leads out of the archive, expected a plain relative path"
    if not said.isprintable() or len(name.parts) > DEEPEST or any(len(p.encode()) > LONGEST_NAME for p in name.parts):
        return f"has no plain name, expected at most {DEEPEST} folders and {LONGEST_NAME} bytes a name"
    if kind not in (0, stat.S_IFREG, stat.S_IFDIR):
        return "is a link or no file, expected the file itself"
    if entry.flag_bits & _ENCRYPTED:
        return "is encrypted"
    if entry.compress_type not in _METHODS:
        return f"is packed by method {entry.compress_type}, expected stored or deflated"
    if entry.file_size > MAX_ENTRY_BYTES:
        return f"unpacks to {entry.file_size} bytes, at most {MAX_ENTRY_BYTES} are read"
    return ""


def _write(path: Path, archive: zipfile.ZipFile, entry: zipfile.ZipInfo, place: Path) -> None:
    """Unpack one entry, and no more bytes than it says that it has."""
    place.parent.mkdir(parents=True, exist_ok=True)
    left = entry.file_size
    with archive.open(entry) as packed, place.open("xb") as file:
        while some := packed.read(1 << 20):
            left -= len(some)
            if left < 0:
                raise FreeArtError(f"{path}: entry '{entry.filename}' has more bytes than it says")
            file.write(some)
    if left:
        raise FreeArtError(f"{path}: entry '{entry.filename}' has {left} bytes less than it says")


def _top(folder: Path) -> Path:
    """The folder of results in what was unpacked: itself, or its only folder unless that is an answer."""
    inside = list(folder.iterdir())
    only = inside[0] if len(inside) == 1 and inside[0].is_dir() else None
    if only is None or (only / "prediction.json").exists():
        return folder
    return only
