"""Writing aside and renaming, so that no half-written file or folder is ever seen under its name."""

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

from freeart21 import stopping
from freeart21.ending import reason
from freeart21.errors import FreeArtError
from freeart21.files.places import Output, require_replaceable

ASIDE = ".part"
"""Ending of the hidden names under which files and folders are written aside."""
OLD = ".old"
"""The same of a folder that is put by while a new one takes its place."""


class CannotWrite(FreeArtError):
    """The disk refused: it is full, read-only, or may not be written."""


def cannot_write(path: Path, error: OSError) -> CannotWrite:
    """The error of `path`, which could not be written because of `error`."""
    return CannotWrite(f"cannot write {path}: {reason(error)}")


def write_bytes(path: Path, data: bytes, sync: bool = True, mode: int = 0o644) -> None:
    """Write `data` to `path` whole or not at all, with these permissions; parent folders are made.

    Without `sync` the file may be lost, not half-written, when the machine (rather than the process) stops before
    somebody calls `os.sync`. Raises CannotWrite, and KeyboardInterrupt once the process was told to stop.
    """
    stopping.check()
    aside: str | None = None
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        handle, aside = tempfile.mkstemp(dir=path.parent, prefix=f".{path.name}.", suffix=ASIDE)
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
    """The text that `write_json` writes."""
    return json.dumps(_plain(data), indent=1, allow_nan=False) + "\n"


@contextmanager
def new_folder(path: Path, older: Output | None = None) -> Iterator[Path]:
    """A folder to fill, which takes the name `path` when the block ends well and vanishes when it fails.

    What stands at `path` stays until the new folder is whole, and is replaced when it is an older output of the kind
    `older` (`places.require_replaceable`, before the block and after it). Raises FreeArtError, and CannotWrite.
    """
    require_replaceable(path, older)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        aside = Path(tempfile.mkdtemp(dir=path.parent, prefix=f".{path.name}.", suffix=ASIDE))
    except OSError as error:
        raise cannot_write(path, error) from error
    try:
        yield aside
        stopping.check()
        require_replaceable(path, older)
        aside.chmod(0o755)
        with stopping.deferred():
            _put_in_place(aside, path)
    except OSError as error:
        raise cannot_write(path, error) from error
    finally:
        with stopping.deferred():
            shutil.rmtree(aside, ignore_errors=True)


def _put_in_place(aside: Path, path: Path) -> None:
    """Give `aside` the name `path`; what has it goes when the new folder is there, or gets it back."""
    if not path.exists():
        aside.replace(path)
        return
    old = Path(tempfile.mkdtemp(dir=path.parent, prefix=f".{path.name}.", suffix=OLD))
    try:
        path.replace(old / path.name)
        aside.replace(path)
    except BaseException:
        with contextlib.suppress(OSError):  # another process's new folder stands there: it is as good
            (old / path.name).replace(path)
        raise
    finally:
        if path.exists():
            shutil.rmtree(old, ignore_errors=True)


def mend(path: Path) -> None:
    """Clear up what processes left beside the folder `path` that were killed while they wrote it.

    Only who holds its lock may call this. A folder that was put by to be replaced gets its name back.
    """
    if not path.parent.is_dir():
        return
    left = re.compile(rf"\.{re.escape(path.name)}\.[a-z0-9_]{{8}}({re.escape(ASIDE)}|{re.escape(OLD)})")
    for place in sorted(path.parent.iterdir()):
        if not left.fullmatch(place.name) or place.is_symlink():
            continue
        if place.suffix == OLD and not path.exists() and (place / path.name).is_dir():
            (place / path.name).replace(path)
        if place.is_dir():
            shutil.rmtree(place, ignore_errors=True)
        else:
            place.unlink(missing_ok=True)


def sweep(folder: Path) -> None:
    """Remove what a killed process left aside anywhere in `folder`."""
    for path in [*folder.rglob(f".*{ASIDE}")]:
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
