"""One writer at a time, by locks that the system takes away with the process: a killed one leaves none."""

from __future__ import annotations

import contextlib
import fcntl
import os
import time
from collections.abc import Iterator
from pathlib import Path

from freeart21.errors import FreeArtError
from freeart21.files import atomic


@contextlib.contextmanager
def only_writer(out: Path) -> Iterator[None]:
    """Be the only process that makes the folder `out`: holds the hidden file `.NAME.lock` beside it.

    Clears up first what killed ones left (`atomic.mend`); folders made for the lock go when they stay empty. Raises
    FreeArtError when another process has the lock, and CannotWrite.
    """
    out = out.absolute()
    with locked(out.parent / f".{out.name}.lock", f"another process is writing {out}", 0.0):
        atomic.mend(out)
        yield


@contextlib.contextmanager
def locked(lock: Path, otherwise: str, patience_s: float) -> Iterator[None]:
    """Hold the lock file `lock`; FreeArtError `otherwise` when another process has it for longer than `patience_s`."""
    made = [folder for folder in lock.parents if not folder.exists()]
    deadline = time.monotonic() + patience_s
    while (handle := take(lock)) is None:
        if time.monotonic() > deadline:
            raise FreeArtError(f"{otherwise}; wait for it, or choose another place")
        time.sleep(0.05)
    try:
        yield
    finally:
        release(lock, handle, made)


def release(lock: Path, handle: int, made: list[Path]) -> None:
    """Give up the lock; its file goes, and those of the folders `made` for it (the innermost first) that are empty."""
    lock.unlink(missing_ok=True)
    for folder in made:
        with contextlib.suppress(OSError):  # what is not empty stays
            folder.rmdir()
    os.close(handle)


def take(path: Path) -> int | None:
    """A handle that holds the lock file `path`, shared after nobody else had it; None when somebody has.

    Raises CannotWrite when the file cannot be made.
    """
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        handle = os.open(path, os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW, 0o644)
    except FileNotFoundError:  # its folder went, with the process that made it
        return None
    except OSError as error:
        raise atomic.cannot_write(path, error) from error
    try:
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
        if path.exists() and os.fstat(handle).st_ino == path.stat().st_ino:
            fcntl.flock(handle, fcntl.LOCK_SH | fcntl.LOCK_NB)
            return handle
    except OSError:
        pass
    os.close(handle)
    return None
