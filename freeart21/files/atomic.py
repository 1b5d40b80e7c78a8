"""Writing aside and renaming, so that no half-written file or folder is ever seen under its name."""

from __future__ import annotations

import json
import math
import os
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from freeart21.errors import FreeArtError

ASIDE = ".part"
"""Ending of the hidden names under which files and folders are written aside."""


class CannotWrite(FreeArtError):
    """The disk refused: it is full, read-only, or may not be written."""


def cannot_write(path: Path, error: OSError) -> CannotWrite:
    """The error of `path`, which could not be written because of `error`."""
    return CannotWrite(f"cannot write {path}: {error.strerror or error}")


def write_bytes(path: Path, data: bytes, sync: bool = True) -> None:
    """Write `data` to `path` whole or not at all; parent folders are made.

    Without `sync` the file may be lost, not half-written, when the machine (rather than the process) stops before
    somebody calls `os.sync`. Raises CannotWrite.
    """
    aside: str | None = None
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        handle, aside = tempfile.mkstemp(dir=path.parent, prefix=f".{path.name}.", suffix=ASIDE)
        with os.fdopen(handle, "wb") as file:
            file.write(data)
            file.flush()
            os.fchmod(file.fileno(), 0o644)
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
def new_folder(path: Path, replace: bool = False) -> Iterator[Path]:
    """A folder to fill, which takes the name `path` when the block ends well and vanishes when it fails.

    Raises FreeArtError when `path` exists and `replace` is False, and CannotWrite. With `replace` the old folder stays
    until the new one is whole.
    """
    if path.exists() and not replace:
        raise FreeArtError(f"{path} exists; choose another place or remove it first")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        aside = Path(tempfile.mkdtemp(dir=path.parent, prefix=f".{path.name}.", suffix=ASIDE))
    except OSError as error:
        raise cannot_write(path, error) from error
    try:
        yield aside
        aside.chmod(0o755)
        if path.exists():
            old = Path(tempfile.mkdtemp(dir=path.parent, prefix=f".{path.name}.", suffix=".old"))
            path.replace(old / path.name)
            aside.replace(path)
            shutil.rmtree(old)
        else:
            aside.replace(path)
    except OSError as error:
        raise cannot_write(path, error) from error
    finally:
        shutil.rmtree(aside, ignore_errors=True)


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
