"""Writes under a hidden name, then renames: no half-written file or folder is ever seen under its name."""

from __future__ import annotations

import contextlib
import json
import math
import os
import re
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from freeart21 import processes
from freeart21.errors import FreeArtError
from freeart21.files import checked
from freeart21.files.places import Output, require_replaceable
from freeart21.processes import os_error_text

PART_SUFFIX = ".part"
"""Suffix of the hidden names of unfinished files and folders."""
OLD_SUFFIX = ".old"
"""Suffix of the hidden name of a folder while a new one replaces it."""


class CannotWrite(FreeArtError):
    """The disk is full, read-only, or without write permission."""


def cannot_write(path: Path, error: OSError) -> CannotWrite:
    """The error for a `path` that could not be written because of `error`."""
    return CannotWrite(f"cannot write {path}: {os_error_text(error)}")


def write_bytes(path: Path, data: bytes, sync: bool = True, mode: int = 0o644) -> None:
    """Write `data` to `path` whole or not at all, with these permissions; parent folders are made.

    Without `sync` a crash of the machine before the next `os.sync` can lose the file, but not leave it half-written.
    Raises CannotWrite, and KeyboardInterrupt after a stop signal.
    """
    processes.raise_if_stopped()
    aside: str | None = None
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        handle, aside = tempfile.mkstemp(dir=path.parent, prefix=f".{path.name}.", suffix=PART_SUFFIX)
        with os.fdopen(handle, "wb") as file:
            file.write(data)
            file.flush()
            os.fchmod(file.fileno(), mode)
            if sync:
                os.fsync(file.fileno())
        Path(aside).replace(path)
        aside = None
    except OSError as error:
        raise cannot_write(path, error) from error
    finally:
        if aside is not None:
            Path(aside).unlink(missing_ok=True)


def write_json(path: Path, data: Any) -> None:
    """Write `data` as JSON; numpy numbers and arrays become plain ones, NaN becomes null."""
    write_bytes(path, json_text(data).encode())


def json_text(data: Any) -> str:
    """The text of the file that `write_json` writes."""
    return json.dumps(_plain(data), indent=1, allow_nan=False) + "\n"


@contextmanager
def new_folder(path: Path, older: Output | None = None) -> Iterator[Path]:
    """A folder to fill: it is renamed to `path` when the block succeeds, and removed when it fails.

    An existing folder at `path` stays until the new one is complete. Only an older output of the kind `older` is
    replaced (`places.require_replaceable`, checked before and after the block), and the new one's marker gets the list
    of its files. Raises FreeArtError, and CannotWrite.
    """
    require_replaceable(path, older)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        aside = Path(tempfile.mkdtemp(dir=path.parent, prefix=f".{path.name}.", suffix=PART_SUFFIX))
    except OSError as error:
        raise cannot_write(path, error) from error
    try:
        yield aside
        processes.raise_if_stopped()
        require_replaceable(path, older)
        if older is not None and (aside / older.marker).is_file():
            _list_files(aside, older.marker)
        aside.chmod(0o755)
        with processes.defer_stop():
            _replace_folder(aside, path)
    except OSError as error:
        raise cannot_write(path, error) from error
    finally:
        with processes.defer_stop():
            shutil.rmtree(aside, ignore_errors=True)


def _list_files(folder: Path, marker: str) -> None:
    """Write the names of all other files of `folder` into its marker, unless that lists them by their hashes."""
    data = checked.read_json(folder / marker)
    if "sha256" not in data:
        names = sorted(path.relative_to(folder).as_posix() for path in folder.rglob("*") if path.is_file())
        write_json(folder / marker, {**data, "files": [name for name in names if name != marker]})


def _replace_folder(aside: Path, path: Path) -> None:
    """Rename `aside` to `path`. An older folder there is removed afterwards, or restored when the renaming fails."""
    if not path.exists():
        aside.replace(path)
        return
    old = Path(tempfile.mkdtemp(dir=path.parent, prefix=f".{path.name}.", suffix=OLD_SUFFIX))
    try:
        path.replace(old / path.name)
        aside.replace(path)
    except BaseException:
        with contextlib.suppress(OSError):  # another process has put its new folder there: keep that
            (old / path.name).replace(path)
        raise
    finally:
        if path.exists():
            shutil.rmtree(old, ignore_errors=True)


def recover_folder(path: Path) -> None:
    """Clean up after processes that were killed while they wrote the folder `path`. The caller holds its lock.

    Unfinished folders are removed; a folder that was about to be replaced gets its name back.
    """
    if not path.parent.is_dir():
        return
    leftover = re.compile(
        rf"\.{re.escape(path.name)}\.[a-z0-9_]{{8}}({re.escape(PART_SUFFIX)}|{re.escape(OLD_SUFFIX)})"
    )
    for place in sorted(path.parent.iterdir()):
        if not leftover.fullmatch(place.name) or place.is_symlink():
            continue
        if place.suffix == OLD_SUFFIX and not path.exists() and (place / path.name).is_dir():
            (place / path.name).replace(path)
        if place.is_dir():
            shutil.rmtree(place, ignore_errors=True)
        else:
            place.unlink(missing_ok=True)


def remove_leftovers(folder: Path) -> None:
    """Remove unfinished files and folders of killed processes anywhere in `folder`."""
    for path in [*folder.rglob(f".*{PART_SUFFIX}")]:
        if path.is_dir():
            shutil.rmtree(path, ignore_errors=True)
        else:
            path.unlink(missing_ok=True)


def _plain(value: Any) -> Any:
    if hasattr(value, "tolist"):
        value = value.tolist()
    if isinstance(value, dict):
        return {str(k): _plain(v) for k, v in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(v) for v in value]
    if isinstance(value, float) and not math.isfinite(value):
        if math.isnan(value):
            return None
        raise FreeArtError(f"cannot write {value} to JSON")
    if isinstance(value, Path):
        return str(value)
    return value
