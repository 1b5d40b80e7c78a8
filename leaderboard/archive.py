"""Results submitted as a ZIP file: its list is checked first, then all entries are unpacked to a temporary folder."""

from __future__ import annotations

import shutil
import tempfile
import zipfile
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path, PurePosixPath

from freeart21.errors import FreeArtError
from freeart21.files import checked
from leaderboard.submission import MAX_FILES, shorten

MAX_ARCHIVE_BYTES = 4 << 30
"""Of the ZIP, and of its unpacked content; 21 results of 300 frames with assets have 0.5 GB."""
MAX_DIRECTORY_BYTES = 64 << 20
"""Of the list of entries, which zipfile reads as a whole."""
_METHODS = (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED)
"""What zipfile unpacks in bounded memory."""
_IGNORED = ("__MACOSX", ".DS_Store", "Thumbs.db", "desktop.ini")


@contextmanager
def open_results(given: Path) -> Iterator[Path]:
    """The results folder `given`, or the one in the ZIP file `given`, unpacked until the block ends.

    The results lie at the top of the archive or in its only folder. Links become plain files. Raises FreeArtError
    before anything is unpacked when an entry would lie outside the folder, or when there are too many or too large
    ones; and later when an entry has another size than it declares.
    """
    given = Path(given)
    if not given.is_file():
        yield given
        return
    if given.suffix.lower() != ".zip":
        raise FreeArtError(f"{given} is a file, expected a folder of results or a .zip of one")
    with tempfile.TemporaryDirectory(prefix="freeart21-") as parent:
        folder = Path(parent) / (shorten(given.stem, 200) or "results")
        folder.mkdir()
        _unpack(given, folder)
        inside = list(folder.iterdir())
        is_wrapped = len(inside) == 1 and inside[0].is_dir() and not (inside[0] / "prediction.json").exists()
        yield inside[0] if is_wrapped else folder


def _unpack(path: Path, folder: Path) -> None:
    try:
        with (
            checked.open_file(path, MAX_ARCHIVE_BYTES, checked.ANYWHERE) as opened,
            checked.open_zip(opened, path, MAX_DIRECTORY_BYTES) as archive,
        ):
            archive.extractall(folder, _check_entries(path, archive, shutil.disk_usage(folder).free))
    except (zipfile.BadZipFile, zlib.error, EOFError, ValueError, OSError, RuntimeError, NotImplementedError) as error:
        raise FreeArtError(f"{path} cannot be unpacked: {shorten(str(error)) or type(error).__name__}") from error


def _check_entries(path: Path, archive: zipfile.ZipFile, free: int) -> list[zipfile.ZipInfo]:
    """The entries to unpack, of `free` bytes at most."""
    listed = archive.infolist()
    if len(listed) > MAX_FILES:
        raise FreeArtError(f"{path} has {len(listed)} entries, at most {MAX_FILES} are read")
    size, most = sum(entry.file_size for entry in listed), min(MAX_ARCHIVE_BYTES, free)
    if size > most:
        raise FreeArtError(f"{path} unpacks to {size} bytes, at most {most} are read or free")
    names = [PurePosixPath(entry.filename) for entry in listed]
    for entry, name in zip(listed, names, strict=True):
        if name.is_absolute() or ".." in name.parts or "\\" in entry.filename or not entry.filename.isprintable():
            raise FreeArtError(f"{path}: entry '{shorten(entry.filename)}' is no plain path inside the archive")
        if entry.compress_type not in _METHODS:
            raise FreeArtError(f"{path}: entry '{name}' is packed by method {entry.compress_type}, expected deflated")
    ignored = [any(part in _IGNORED or part.startswith("._") for part in name.parts) for name in names]
    return [entry for entry, skip in zip(listed, ignored, strict=True) if not skip]
