"""The files of takes: numbered, and never written over an existing file."""

from __future__ import annotations

import contextlib
import glob
import os
import tempfile
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
from generator.teleop.take_file import TakeFile, is_open, rename_new

MAX_FILES = 10_000
UNSAVED = "-unsaved"
"""Suffix of the name of an unsaved take."""


class Takes:
    """The files of one run: OUT, then OUT-2, OUT-3 and so on, and OUT-unsaved while a take is recorded."""

    def __init__(
        self, out: Path, joint_type: JointType, inputs: Iterable[Path] = (), size: float | None = None
    ) -> None:
        """`size` is the object's diagonal, metres. Raises FreeArtError when `out` exists or is not writable."""
        self._out, self._joint_type, self._inputs, self._size = out, joint_type, tuple(inputs), size
        self._file: TakeFile | None = None
        self._track: Track | None = None
        check_place(out, None, self._inputs)

    def next_name(self) -> str:
        """Name of the next take, if no other process takes it."""
        return _free_path(self._out).name

    def find_unsaved_takes(self) -> list[tuple[Path, float]]:
        """Unsaved takes of earlier runs, with their durations, s."""
        found = []
        for path in sorted(self._out.parent.glob(f"{glob.escape(self._out.stem)}{UNSAVED}*{self._out.suffix}")):
            with contextlib.suppress(FreeArtError, OSError):  # another file, or an unfinished one
                if not is_open(path):
                    take = read_take(path)
                    found.append((path, float(np.ptp(take.times))))
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
        path = self._out if self._file is None else self._file.path
        try:
            if self._file is None:
                path = _free_path(self._out.with_name(f"{self._out.stem}{UNSAVED}{self._out.suffix}"))
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
        try:
            self.write(driving)
            assert self._file is not None
            self._file.save(path)
        except (FreeArtError, OSError):  # its file was removed, or the disk is full
            write_new(path, self._text(driving))
            self.discard()
        self._file = None
        return path

    def discard(self) -> None:
        """Delete the file of the present take."""
        if self._file is not None:
            self._file.remove()
            self._file = None

    def rescue(self, driving: Driving) -> Path:
        """Write an unsaved take to its file, or else to another one, and return the path. Raises FreeArtError."""
        try:
            self.write(driving)
            assert self._file is not None
            file, self._file = self._file, None
            file.close()
            return file.path
        except FreeArtError as error:
            fault = error
        text = self._text(driving)
        for folder in (self._out.parent, Path(tempfile.gettempdir())):
            try:
                path = _free_path(folder / f"{self._out.stem}{UNSAVED}{self._out.suffix}")
                write_new(path, text)
                self.discard()
                return path
            except FreeArtError as error:
                fault = error
        raise fault

    def _head(self, driving: Driving) -> str:
        # a hand-held controller has tremor, a mouse has not
        held = headset_filter(self._joint_type) if "headset" in driving.devices else None
        return header_line(", ".join(driving.devices) or "none", "camera", self._joint_type, held, self._size)

    def _text(self, driving: Driving) -> bytes:
        return ("\n".join([self._head(driving), *(sample_line(*s) for s in driving.take.samples())]) + "\n").encode()


def _free_path(path: Path) -> Path:
    """The first of `path` and its numbered variants that does not exist."""
    for k in range(1, MAX_FILES):
        numbered = path if k == 1 else path.with_name(f"{path.stem}-{k}{path.suffix}")
        if not os.path.lexists(numbered):
            return numbered
    raise FreeArtError(f"{path} and {MAX_FILES} numbered files of that name exist")


def write_new(path: Path, data: bytes) -> None:
    """Write a new file, completely or not at all, also after a stop signal. Raises FreeArtError."""
    aside = path.with_name(f".{path.name}.{os.getpid()}{atomic.PART_SUFFIX}")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        try:
            with aside.open("wb") as file:
                file.write(data)
                file.flush()
                os.fsync(file.fileno())
            rename_new(aside, path)
        finally:
            aside.unlink(missing_ok=True)
    except FileExistsError as error:
        raise FreeArtError(f"{path} exists; choose another place or remove it first") from error
    except OSError as error:
        raise atomic.cannot_write(path, error) from error
