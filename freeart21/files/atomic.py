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


def write_bytes(path: Path, data: bytes) -> None:
    """Write `data` to `path` whole or not at all; parent folders are made."""
    path.parent.mkdir(parents=True, exist_ok=True)
    handle, aside = tempfile.mkstemp(dir=path.parent, prefix=f".{path.name}.", suffix=".part")
    try:
        with os.fdopen(handle, "wb") as file:
            file.write(data)
            file.flush()
            os.fsync(file.fileno())
        Path(aside).chmod(0o644)
        Path(aside).replace(path)
    except OSError as error:
        raise FreeArtError(f"cannot write {path}: {error.strerror}") from error
    finally:
        Path(aside).unlink(missing_ok=True)


def write_json(path: Path, data: Any) -> None:
    """Write `data` as JSON; numpy numbers and arrays become plain ones, NaN becomes null."""
    text = json.dumps(_plain(data), indent=1, allow_nan=False)
    write_bytes(path, (text + "\n").encode())


@contextmanager
def new_folder(path: Path, replace: bool = False) -> Iterator[Path]:
    """A folder to fill, which takes the name `path` when the block ends well and vanishes when it fails.

    Raises FreeArtError when `path` exists and `replace` is False. With `replace` the old folder stays until the new one
    is whole.
    """
    if path.exists() and not replace:
        raise FreeArtError(f"{path} exists; choose another place or remove it first")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        aside = Path(tempfile.mkdtemp(dir=path.parent, prefix=f".{path.name}.", suffix=".part"))
    except OSError as error:
        raise FreeArtError(f"cannot write {path}: {error.strerror}") from error
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
        raise FreeArtError(f"cannot write {path}: {error.strerror or error}") from error
    finally:
        shutil.rmtree(aside, ignore_errors=True)


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
