"""The file of a take during recording: samples are appended, undone ones cut off."""

from __future__ import annotations

import contextlib
import fcntl
import os
from array import array
from pathlib import Path

from freeart21.files.take import sample_line
from generator.teleop.driving import Track

HEAD_BYTES = 1024
"""Length of the first line, padded with spaces: it is rewritten when a device is added. The longest has about 500."""


class TakeFile:
    """A file that is a valid take after every write.

    Lines are written whole, so they stay when this process is killed. The file is locked as long as it is open.
    """

    def __init__(self, path: Path) -> None:
        """Create the file, which must not exist. Raises OSError."""
        self.path = path
        self._file = os.open(path, os.O_RDWR | os.O_CREAT | os.O_EXCL | os.O_NOFOLLOW | os.O_CLOEXEC, 0o666)
        fcntl.flock(self._file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        self._head = ""
        self._ends = array("q", [HEAD_BYTES])
        """Length of the file, bytes, up to sample k."""

    def write(self, head: str, track: Track) -> None:
        """Update the samples to those of `track` and the first line to `head`. Raises OSError."""
        if head != self._head:
            self._put(0, (head.ljust(HEAD_BYTES - 1) + "\n").encode())
            self._head = head
        whole = min(track.unchanged, len(self._ends) - 1)
        if whole < len(self._ends) - 1:
            del self._ends[whole + 1 :]
            os.ftruncate(self._file, self._ends[-1])
        lines = [(sample_line(*track.sample(k)) + "\n").encode() for k in range(whole, len(track))]
        try:
            self._put(self._ends[-1], b"".join(lines))
        except OSError:  # no half line stays
            os.ftruncate(self._file, self._ends[-1])
            raise
        for line in lines:
            self._ends.append(self._ends[-1] + len(line))
        track.unchanged = len(track)

    def _put(self, at: int, data: bytes) -> None:
        while data:
            count = os.pwrite(self._file, data, at)
            at, data = at + count, data[count:]

    def save(self, path: Path) -> None:
        """Rename the file to `path`, which must not exist. Raises OSError."""
        self._require_own_name()
        os.fsync(self._file)
        rename_new(self.path, path)
        self.close()

    def close(self) -> None:
        """Close the file."""
        with contextlib.suppress(OSError):
            os.close(self._file)

    def remove(self) -> None:
        """Delete the file."""
        with contextlib.suppress(OSError):
            self._require_own_name()
            self.path.unlink()
        self.close()

    def _require_own_name(self) -> None:
        """Raise FileNotFoundError when the path now names another file."""
        if not os.path.samestat(self.path.lstat(), os.fstat(self._file)):
            raise FileNotFoundError(f"{self.path} is another file")


def is_open(path: Path) -> bool:
    """Whether a process is still writing the take at `path`. Raises OSError."""
    file = os.open(path, os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK | os.O_CLOEXEC)
    try:
        fcntl.flock(file, fcntl.LOCK_SH | fcntl.LOCK_NB)
    except BlockingIOError:
        return True
    finally:
        os.close(file)
    return False


def rename_new(aside: Path, path: Path) -> None:
    """Rename `aside` to `path` without replacing an existing file. Raises OSError."""
    try:
        os.link(aside, path)
    except FileExistsError:
        raise
    except OSError:  # a file system without links, or no file
        if os.path.lexists(path):
            raise FileExistsError from None
        aside.rename(path)
    else:
        aside.unlink(missing_ok=True)
