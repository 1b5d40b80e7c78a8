"""One writer at a time, by file locks that the system releases when the process ends."""

from __future__ import annotations

import contextlib
import fcntl
import os
import time
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

from freeart21.errors import FreeArtError
from freeart21.files import atomic


@contextlib.contextmanager
def only_writer(out: Path) -> Iterator[None]:
    """Be the only process that writes the folder `out`: holds the hidden lock file `.NAME.lock` next to it.

    First cleans up after killed processes (`atomic.recover_folder`). Folders made for the lock are removed when they
    stay empty. Raises FreeArtError when another process has the lock, and CannotWrite.
    """
    out = out.absolute()
    with hold_lock(out.parent / f".{out.name}.lock", f"another process is writing {out}", 0.0):
        atomic.recover_folder(out)
        yield


@contextlib.contextmanager
def hold_lock(
    lock: Path,
    otherwise: str,
    patience_s: float,
    folders: Sequence[Path] = (),
    keep: Callable[[], bool] = lambda: False,
) -> Iterator[None]:
    """Hold the lock file `lock`; FreeArtError `otherwise` when another process keeps it for `patience_s`.

    Afterwards its file, its new folders and the given `folders` are removed when they are empty, unless `keep`.
    """
    made = [*folders, *(folder for folder in lock.parents if not folder.exists())]
    deadline = time.monotonic() + patience_s
    while (handle := _acquire(lock)) is None:
        if time.monotonic() > deadline:
            raise FreeArtError(f"{otherwise}; wait for it, or choose another place")
        time.sleep(0.05)
    try:
        yield
    finally:
        if not keep():
            lock.unlink(missing_ok=True)
            for folder in made:
                with contextlib.suppress(OSError):  # what is not empty stays
                    folder.rmdir()
        os.close(handle)


def _acquire(path: Path) -> int | None:
    """A handle that holds the lock file `path`, or None when another process has it.

    The lock is taken exclusively, then kept as a shared one. Raises CannotWrite when the file cannot be made.
    """
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        handle = os.open(path, os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW, 0o644)
    except FileNotFoundError:  # another process has removed the folder
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
