"""The files of takes: numbered, never written over an existing file, and whole after every write.

During recording samples are appended and undone ones cut off, so that a take stays when this process is killed.
"""

from __future__ import annotations

import contextlib
import glob
import os
from array import array
from collections.abc import Iterable
from pathlib import Path

import numpy as np

from freeart21.errors import FreeArtError
from freeart21.files import atomic
from freeart21.files.places import check_place
from freeart21.files.take import header_line, read_take, sample_line
from freeart21.joint import JointType
from freeart21.one_euro import headset_filter
from generator.teleop.driving import Driving, Track

MAX_FILES = 10_000
UNSAVED = "-unsaved"
"""Suffix of the name of an unsaved take."""
HEAD_BYTES = 1024
"""Length of the first line, padded with spaces: it is rewritten when a device is added. The longest has about 500."""


class Takes:
    """The files of one run: OUT, then OUT-2, OUT-3 and so on, and OUT-unsaved while a take is recorded."""

    def __init__(
        self, out: Path, joint_type: JointType, inputs: Iterable[Path] = (), size: float | None = None
    ) -> None:
        """`size` is the object's diagonal, metres. Raises FreeArtError when `out` exists or is not writable."""
        self._out, self._joint_type, self._inputs, self._size = out, joint_type, tuple(inputs), size
        self._unsaved = out.with_name(f"{out.stem}{UNSAVED}{out.suffix}")
        self._file: TakeFile | None = None
        self._track: Track | None = None
        check_place(out, None, self._inputs)

    def next_name(self) -> str:
        """Name of the next take, if no other process takes it."""
        return _free_path(self._out).name

    def find_unsaved_takes(self) -> list[tuple[Path, float]]:
        """Unsaved takes of earlier runs, with their durations, s."""
        found = []
        for path in sorted(self._out.parent.glob(f"{glob.escape(self._unsaved.stem)}*{self._out.suffix}")):
            with contextlib.suppress(FreeArtError):  # another file, or an unfinished one
                found.append((path, float(np.ptp(read_take(path).times))))
        return found

    def write(self, driving: Driving) -> None:
        """Update the file of the present take; the file of a discarded take is deleted.

        Raises FreeArtError when it cannot be written.
        """
        if driving.take is not self._track:
            self.discard()
            self._track = driving.take
        if self._file is None and driving.phase == "idle":
            return
        path = self._unsaved if self._file is None else self._file.path
        try:
            if self._file is None:
                path = _free_path(self._unsaved)
                path.parent.mkdir(parents=True, exist_ok=True)
                driving.take.unchanged = 0
                self._file = TakeFile(path)
            self._file.write(self._head(driving), driving.take)
        except OSError as error:
            raise atomic.cannot_write(path, error) from error

    def save(self, driving: Driving) -> Path:
        """Save the take under its name, completely or not at all. Raises FreeArtError."""
        path = _free_path(self._out)
        check_place(path, None, self._inputs)
        if self._file is not None and not self._file.is_in_place:  # it was removed: write the take anew
            self._file.close()
            self._file = None
        self.write(driving)
        assert self._file is not None
        try:
            self._file.save(path)
        except OSError as error:
            raise atomic.cannot_write(path, error) from error
        self._file = None
        return path

    def discard(self) -> None:
        """Delete the file of the present take."""
        if self._file is not None:
            self._file.remove()
            self._file = None

    def rescue(self, driving: Driving) -> Path:
        """Write an unsaved take to its file and return the path. Raises FreeArtError."""
        self.write(driving)
        assert self._file is not None
        file, self._file = self._file, None
        file.close()
        return file.path

    def _head(self, driving: Driving) -> str:
        # a hand-held controller has tremor, a mouse has not
        held = headset_filter(self._joint_type) if "headset" in driving.devices else None
        return header_line(", ".join(driving.devices) or "none", "camera", self._joint_type, held, self._size)


class TakeFile:
    """A file that is a valid take after every write: lines are written whole."""

    def __init__(self, path: Path) -> None:
        """Create the file, which must not exist. Raises OSError."""
        self.path = path
        self._file = os.open(path, os.O_RDWR | os.O_CREAT | os.O_EXCL | os.O_NOFOLLOW | os.O_CLOEXEC, 0o666)
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
        added = zip(track.times[whole:], track.places[whole:], strict=True)
        lines = [(sample_line(time, place.T, place.state) + "\n").encode() for time, place in added]
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

    @property
    def is_in_place(self) -> bool:
        """Whether the path still names this file."""
        with contextlib.suppress(OSError):
            return os.path.samestat(self.path.lstat(), os.fstat(self._file))
        return False

    def save(self, path: Path) -> None:
        """Rename the file to `path`, which must not exist. Raises OSError."""
        os.fsync(self._file)
        os.close(os.open(path, os.O_CREAT | os.O_EXCL, 0o666))  # the name is ours
        self.path.replace(path)
        self.close()

    def close(self) -> None:
        """Close the file."""
        with contextlib.suppress(OSError):
            os.close(self._file)

    def remove(self) -> None:
        """Delete the file."""
        if self.is_in_place:
            self.path.unlink(missing_ok=True)
        self.close()


def _free_path(path: Path) -> Path:
    """The first of `path` and its numbered variants that does not exist."""
    for k in range(1, MAX_FILES):
        numbered = path if k == 1 else path.with_name(f"{path.stem}-{k}{path.suffix}")
        if not os.path.lexists(numbered):
            return numbered
    raise FreeArtError(f"{path} and {MAX_FILES} numbered files of that name exist")
