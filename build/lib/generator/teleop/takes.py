"""Where takes are written: beside each other, never over anything."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Iterable
from pathlib import Path

from freeart21.errors import FreeArtError
from freeart21.files import atomic
from freeart21.files.places import check_place
from freeart21.files.take import header, sample
from freeart21.joint import JointType
from freeart21.one_euro import headset
from generator.teleop.driving import Driving

MOST_FILES = 10_000


class Takes:
    """The files of one run: OUT, then OUT-2, OUT-3 and so on."""

    def __init__(
        self, out: Path, joint_type: JointType, inputs: Iterable[Path] = (), size: float | None = None
    ) -> None:
        """`size` is the object's diagonal, metres. Raises FreeArtError unless `out` is free and may be written."""
        self._out, self._joint_type, self._inputs, self._size = out, joint_type, tuple(inputs), size
        check_place(out, None, self._inputs)

    def next_name(self) -> str:
        """What the next take will be called, if nobody else takes the name."""
        return _free(self._out).name

    def save(self, driving: Driving) -> Path:
        """Write the take, whole or not at all. Raises FreeArtError."""
        path = _free(self._out)
        check_place(path, None, self._inputs)
        write_new(path, self._text(driving))
        return path

    def rescue(self, driving: Driving) -> Path:
        """Write a take that nobody saved beside, or where temporary files are; also after a signal. FreeArtError."""
        text = self._text(driving)
        for folder in (self._out.parent, Path(tempfile.gettempdir())):
            try:
                path = _free(folder / f"{self._out.stem}-unsaved{self._out.suffix}")
                write_new(path, text)
                return path
            except FreeArtError as error:
                fault = error
        raise fault

    def _text(self, driving: Driving) -> bytes:
        # controllers in hands shake, mice do not
        held = headset(self._joint_type) if "headset" in driving.devices else None
        head = header(", ".join(driving.devices) or "none", "camera", self._joint_type, held, self._size)
        return ("\n".join([head, *(sample(*s) for s in driving.take.samples())]) + "\n").encode()


def _free(path: Path) -> Path:
    """`path`, or it with a number, whichever is the first that nothing has."""
    for k in range(1, MOST_FILES):
        numbered = path if k == 1 else path.with_name(f"{path.stem}-{k}{path.suffix}")
        if not os.path.lexists(numbered):
            return numbered
    raise FreeArtError(f"{path} and {MOST_FILES} numbered names beside it exist")


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
            _named(aside, path)
        finally:
            aside.unlink(missing_ok=True)
    except FileExistsError as error:
        raise FreeArtError(f"{path} exists; choose another place or remove it first") from error
    except OSError as error:
        raise atomic.cannot_write(path, error) from error


def _named(aside: Path, path: Path) -> None:
    """Give the file `aside` the name `path`, too: unlike a rename, a link replaces nothing."""
    try:
        os.link(aside, path)
    except FileExistsError:
        raise
    except OSError:  # a file system without links
        if path.exists():
            raise FileExistsError from None
        aside.rename(path)
