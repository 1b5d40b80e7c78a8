"""Where takes are written: beside each other, never over anything."""

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
from freeart21.files.take import header, read_take, sample
from freeart21.joint import JointType
from freeart21.one_euro import headset
from generator.teleop.driving import Driving, Track
from generator.teleop.take_file import TakeFile, is_open, rename_new

MAX_FILES = 10_000
UNSAVED = "-unsaved"
"""Of the name of a take that nobody has saved yet."""


class Takes:
    """The files of one run: OUT, then OUT-2, OUT-3 and so on, and OUT-unsaved while a take is made."""

    def __init__(
        self, out: Path, joint_type: JointType, inputs: Iterable[Path] = (), size: float | None = None
    ) -> None:
        """`size` is the object's diagonal, metres. Raises FreeArtError unless `out` is free and may be written."""
        self._out, self._joint_type, self._inputs, self._size = out, joint_type, tuple(inputs), size
        self._file: TakeFile | None = None
        self._track: Track | None = None
        check_place(out, None, self._inputs)

    def next_name(self) -> str:
        """What the next take will be called, if nobody else takes the name."""
        return _free(self._out).name

    def unsaved_takes(self) -> list[tuple[Path, float]]:
        """Takes that an earlier run left unsaved, and how long each lasts, s."""
        found = []
        for path in sorted(self._out.parent.glob(f"{glob.escape(self._out.stem)}{UNSAVED}*{self._out.suffix}")):
            with contextlib.suppress(FreeArtError, OSError):  # another file, or one that is being made
                if not is_open(path):
                    take = read_take(path)
                    found.append((path, float(np.ptp(take.times))))
        return found

    def write(self, driving: Driving) -> None:
        """Bring the file of the take that is being made to what it is now; one that was thrown away goes.

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
                path = _free(self._out.with_name(f"{self._out.stem}{UNSAVED}{self._out.suffix}"))
                path.parent.mkdir(parents=True, exist_ok=True)
                driving.take.unchanged = 0
                self._file = TakeFile(path)
            self._file.write(self._head(driving), driving.take)
        except OSError as error:
            raise atomic.cannot_write(path, error) from error

    def save(self, driving: Driving) -> Path:
        """Give the take its name, whole or not at all. Raises FreeArtError."""
        path = _free(self._out)
        check_place(path, None, self._inputs)
        try:
            self.write(driving)
            assert self._file is not None
            self._file.save(path)
        except (FreeArtError, OSError):  # its file is gone, or its disk is full
            write_new(path, self._text(driving))
            self.discard()
        self._file = None
        return path

    def discard(self) -> None:
        """Delete the file of the take that is being made."""
        if self._file is not None:
            self._file.remove()
            self._file = None

    def rescue(self, driving: Driving) -> Path:
        """Write an unsaved take to its file, else to another one, and return its place. Raises FreeArtError."""
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
                path = _free(folder / f"{self._out.stem}{UNSAVED}{self._out.suffix}")
                write_new(path, text)
                self.discard()
                return path
            except FreeArtError as error:
                fault = error
        raise fault

    def _head(self, driving: Driving) -> str:
        # controllers in hands shake, mice do not
        held = headset(self._joint_type) if "headset" in driving.devices else None
        return header(", ".join(driving.devices) or "none", "camera", self._joint_type, held, self._size)

    def _text(self, driving: Driving) -> bytes:
        return ("\n".join([self._head(driving), *(sample(*s) for s in driving.take.samples())]) + "\n").encode()


def _free(path: Path) -> Path:
    """`path`, or it with a number, whichever is the first that nothing has."""
    for k in range(1, MAX_FILES):
        numbered = path if k == 1 else path.with_name(f"{path.stem}-{k}{path.suffix}")
        if not os.path.lexists(numbered):
            return numbered
    raise FreeArtError(f"{path} and {MAX_FILES} numbered names beside it exist")


def write_new(path: Path, data: bytes) -> None:
    """Write a file that is not there yet, whole or not at all; also after a signal said stop. Raises FreeArtError."""
    aside = path.with_name(f".{path.name}.{os.getpid()}{atomic.ASIDE}")
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
