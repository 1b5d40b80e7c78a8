"""Results submitted as a ZIP file: every entry is checked first, then all are unpacked to a temporary folder."""

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
"""Of the ZIP, and of its unpacked content; 21 results of 300 frames with assets have 0.5 GB."""
MAX_ENTRY_BYTES = 1 << 30
MAX_DIRECTORY_BYTES = 64 << 20
"""Of the list of entries, which zipfile reads as a whole."""
DEEPEST, LONGEST_NAME = 12, 200
"""Most nested folders, and bytes of each name, in an archive."""
_METHODS = (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED)
_ENCRYPTED = 0x1
_IGNORED = ("__MACOSX", ".DS_Store", "Thumbs.db", "desktop.ini")


@contextmanager
def open_results(given: Path) -> Iterator[Path]:
    """The results folder `given`, or the one in the ZIP file `given`, unpacked until the block ends.

    The results lie at the top of the archive or in its only folder. Raises FreeArtError before anything is unpacked
    when an entry would lie outside the folder, is not a regular file, is encrypted, occurs twice or is too large, or
    when there are too many; and later when an entry has another size than it declares.
    """
    given = Path(given)
    if not given.is_file():
        yield given
        return
    if given.suffix.lower() != ".zip":
        raise FreeArtError(f"{given} is a file, expected a folder of results or a .zip of one")
    with tempfile.TemporaryDirectory(prefix="freeart21-") as parent:
        folder = Path(parent) / (escape_unprintable(given.stem)[:LONGEST_NAME] or "results")
        folder.mkdir()
        _unpack(given, folder)
        yield _find_results(folder)


def _unpack(path: Path, folder: Path) -> None:
    try:
        with (
            checked.open_file(path, MAX_ARCHIVE_BYTES, checked.ANYWHERE) as opened,
            checked.open_zip(opened, path, MAX_DIRECTORY_BYTES) as archive,
        ):
            entries = _check_entries(path, archive)
            free = shutil.disk_usage(folder).free
            if (size := sum(entry.file_size for entry, _ in entries)) > free:
                raise FreeArtError(f"{path} unpacks to {size} bytes, there are {free} free in {folder.parent}")
            for entry, name in entries:
                _write(path, archive, entry, folder / name)
    except (zipfile.BadZipFile, zlib.error, EOFError, ValueError, OSError, RuntimeError, NotImplementedError) as error:
        message = escape_unprintable((str(error).splitlines() or [""])[0])
        raise FreeArtError(f"{path} cannot be unpacked: {message or type(error).__name__}") from error


def _check_entries(path: Path, archive: zipfile.ZipFile) -> list[tuple[zipfile.ZipInfo, PurePosixPath]]:
    """Every file to unpack and its relative path."""
    found: list[tuple[zipfile.ZipInfo, PurePosixPath]] = []
    listed = archive.infolist()
    if len(listed) > MAX_FILES:
        raise FreeArtError(f"{path} has {len(listed)} entries, at most {MAX_FILES} are read")
    total, seen = 0, set()
    for entry in listed:
        name = PurePosixPath(entry.filename)
        fault = _find_fault(entry, name)
        if fault:
            raise FreeArtError(f"{path}: entry '{escape_unprintable(entry.filename)[:LONGEST_NAME]}' {fault}")
        if entry.is_dir() or any(part in _IGNORED or part.startswith("._") for part in name.parts):
            continue
        total += entry.file_size
        if total > MAX_ARCHIVE_BYTES:
            raise FreeArtError(f"{path} unpacks to more than {MAX_ARCHIVE_BYTES} bytes, which is the most that is read")
        if name in seen:
            raise FreeArtError(f"{path}: entry '{name}' is there twice, expected once")
        seen.add(name)
        found.append((entry, name))
    return found


def _find_fault(entry: zipfile.ZipInfo, name: PurePosixPath) -> str:
    """Why an entry must not be unpacked; empty when it may be."""
    given, kind = entry.filename, stat.S_IFMT(entry.external_attr >> 16)
    if name.is_absolute() or ".." in name.parts or "\\" in given or ":" in given or not name.parts:
        return "leads out of the archive, expected a plain relative path"
    if not given.isprintable() or len(name.parts) > DEEPEST or any(len(p.encode()) > LONGEST_NAME for p in name.parts):
        return f"has no plain name, expected at most {DEEPEST} folders and {LONGEST_NAME} bytes a name"
    if kind not in (0, stat.S_IFREG, stat.S_IFDIR):
        return "is a link or not a file, expected the file itself"
    if entry.flag_bits & _ENCRYPTED:
        return "is encrypted"
    if entry.compress_type not in _METHODS:
        return f"is packed by method {entry.compress_type}, expected stored or deflated"
    if entry.file_size > MAX_ENTRY_BYTES:
        return f"unpacks to {entry.file_size} bytes, at most {MAX_ENTRY_BYTES} are read"
    return ""


def _write(path: Path, archive: zipfile.ZipFile, entry: zipfile.ZipInfo, place: Path) -> None:
    """Unpack one entry, checking its declared size on the way."""
    place.parent.mkdir(parents=True, exist_ok=True)
    missing = entry.file_size
    with archive.open(entry) as packed, place.open("xb") as file:
        while chunk := packed.read(1 << 20):
            missing -= len(chunk)
            if missing < 0:
                raise FreeArtError(f"{path}: entry '{entry.filename}' has more bytes than it says")
            file.write(chunk)
    if missing:
        raise FreeArtError(f"{path}: entry '{entry.filename}' has {missing} bytes less than it says")


def _find_results(folder: Path) -> Path:
    """`folder`, or its only subfolder unless that is the result of a sequence."""
    inside = list(folder.iterdir())
    only = inside[0] if len(inside) == 1 and inside[0].is_dir() else None
    if only is None or (only / "prediction.json").exists():
        return folder
    return only
