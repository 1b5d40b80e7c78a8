"""Reads submitted results without trusting them; everything that is wrong is a `Fault` with its place and a fix.

Scoring stops at the first fault that leaves nothing to measure; `leaderboard.validate` collects all of them.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from freeart21 import se3
from freeart21.articulation import PARTS
from freeart21.errors import FreeArtError
from freeart21.files import checked
from freeart21.files.gaussians import GAUSSIANS
from freeart21.files.joint_json import joint_from_json
from freeart21.files.mesh_file import read_ply
from freeart21.files.result import METHOD_SCHEMA, SCHEMA, Method, read_appearance, read_lacks, read_result
from freeart21.reconstruction import Failure, Reconstruction

LARGEST = 1e6
"""Largest number, metres or radians, that can be an answer in SI units."""
MAX_FACES = 4_000_000
"""Faces of one part that the scorer holds in 8 GB."""
MAX_FILES = 200_000
MAX_METHOD_BYTES = 1 << 20
LONGEST_TEXT = 300
"""Characters of a method's text that are shown."""
DEEPEST_SETTINGS = 20
"""Levels of a method's settings that are stored."""
MOST_IMPORT_NOTES = 8
UNREADABLE = "unreadable"
"""Name of a method whose method.json cannot be read."""
_PNG = b"\x89PNG\r\n\x1a\n"
_T = TypeVar("_T")


@dataclass(frozen=True)
class Fault:
    """One fault of a submission."""

    file: str
    """Relative to the results folder, such as 'SEQ/poses.npz'."""
    found: str
    """What is there, as the end of a sentence that begins with the field or file."""
    expected: str = ""
    field: str = ""
    """Field of the file; empty for the file as a whole."""
    frame: int | None = None
    """First frame with the fault; None where frames do not matter."""
    fix: str = ""
    """How to correct it."""
    fatal: bool = True
    """Whether it makes the whole sequence unreadable. Others cost one picture, or are doubts that cost nothing."""

    def __str__(self) -> str:
        field = f": {self.field}" if self.field else ""
        frame = "" if self.frame is None or not self.field else f" (frame {self.frame})"  # a picture's name has it
        expected = f", expected {self.expected}" if self.expected else ""
        return escape_unprintable(f"{self.file}{field}{frame} {self.found}{expected}")


def escape_unprintable(text: str) -> str:
    """`text` with control characters, lone surrogates and other unprintable characters as escapes."""
    return "".join(c if c.isprintable() else c.encode("unicode_escape").decode() for c in text)


def shorten(text: str, longest: int = LONGEST_TEXT) -> str:
    """`text` on one line, printable, of at most `longest` characters."""
    return escape_unprintable(" ".join(text[: 20 * longest].split()))[:longest]


def read_submission(
    folder: Path, frames: int, height: int, width: int
) -> tuple[Reconstruction | Failure, tuple[str, ...]]:
    """The answer in `folder` to a sequence of `frames` pictures of `width` x `height`, and a note per harmless fault.

    Files are checked before they are unpacked. Raises FreeArtError for unreadable files, links, another number of
    frames, masks of another size, and numbers that are not in SI units.
    """
    answer, faults = find_faults(Path(folder), frames, height, width)
    for fault in faults:
        if fault.fatal:
            raise FreeArtError(str(fault))
    assert answer is not None  # there was no fatal fault
    return answer, tuple(str(fault) for fault in faults)


def find_faults(
    folder: Path, frames: int, height: int, width: int
) -> tuple[Reconstruction | Failure | None, list[Fault]]:
    """The answer in `folder`, None after a fatal fault, and every fault of it."""
    masks: list[NDArray[np.uint8]] = []
    faults: list[Fault] = []
    try:
        faults.extend(_find_file_faults(folder, frames, height, width, masks))
        if any(fault.fatal for fault in faults):
            return None, faults
        answer = read_result(folder, masks or None, appearance=False)
    except Exception as error:  # parsers of many libraries read hostile bytes, each with its own exceptions
        return None, [*faults, _unreadable_fault(folder.name, folder, error)]
    if isinstance(answer, Failure):
        return answer, faults
    Ts = [se3.orthonormalised(T) for T in (answer.Ts_camera_reference, answer.Ts_camera_moving)]
    return replace(answer, Ts_camera_reference=Ts[0], Ts_camera_moving=Ts[1]), faults


def read_submitted_method(results: Path) -> tuple[Method, list[Fault]]:
    """The method of a results folder, its text printable and bounded, and the faults of method.json.

    Without the file the method has the folder's name; when it cannot be read, the name UNREADABLE.
    """
    path = results / "method.json"
    if not checked.is_there(path):
        return Method(shorten(results.resolve().name)), []
    try:
        if path.is_symlink():
            return Method(UNREADABLE), [_link_fault("method.json")]
        data = checked.read_json(path, METHOD_SCHEMA, limit=MAX_METHOD_BYTES)
        settings = data.get("settings") or {}
        name = shorten(checked.text(data, "name", path))
        if not isinstance(settings, dict):
            found, fix = f"is of type {type(settings).__name__}", "leave it out or write an object"
            fault = Fault("method.json", found, "an object", "settings", fix=fix, fatal=False)
            return Method(name), [fault]
        code, hardware = (shorten(str(data.get(key) or "")) for key in ("code", "hardware"))
        lacks, faults = _attempt(results, path, "lacks", partial(read_lacks, data, path))
        method = Method(name, code, plain_json(settings), hardware, lacks or ())
        return method, [replace(fault, fatal=False) for fault in faults]
    except Exception as error:  # as in find_faults
        fault = _unreadable_fault("method.json", path, error)
        fix = f'write {{"schema": "{METHOD_SCHEMA}", "name": "..."}}'
        return Method(UNREADABLE), [replace(fault, fatal=False, fix=fix)]


def find_link_faults(folder: Path, home: Path | None = None) -> Iterator[Fault]:
    """A fault for each link in the result folder that leads out of `home` or to itself, and if the folder itself does.

    Without `home` it is the folder, which must be no link then.
    """
    if home is None and folder.is_symlink():
        yield _link_fault(folder.name)
        return
    home = (home or folder).resolve()
    if not folder.resolve().is_relative_to(home):
        yield replace(_link_fault(folder.name), found="leads out of the folder")
        return
    for count, path in enumerate(folder.rglob("*")):
        if count > MAX_FILES:
            fix = "remove files that are not part of the result"
            yield Fault(folder.name, f"has more than {MAX_FILES} files", "one result", fix=fix)
            return
        if not path.is_symlink():
            continue
        try:
            inside = path.resolve().is_relative_to(home)
        except (OSError, RuntimeError):
            yield replace(_link_fault(_relative_name(folder, path)), found="leads to itself")
            continue
        if not inside:
            yield replace(_link_fault(_relative_name(folder, path)), found="leads out of the folder")


def read_renders(
    folder: Path, subfolder: str, count: int, height: int, width: int
) -> tuple[list[NDArray[np.uint8] | None], list[Fault], int]:
    """The renders (height, width, 3) of `count` queries, None for one without a sound file; faults; missing files."""
    renders: list[NDArray[np.uint8] | None] = []
    found: list[Fault] = []
    for path in (folder / subfolder / f"{i:05d}.png" for i in range(count)):
        renders.append(None)
        if not path.is_file():
            continue
        fault = _find_png_fault(path, _relative_name(folder, path), height, width)
        faults = [fault] if fault else []
        if fault is None:
            renders[-1], faults = _attempt(folder, path, "", partial(checked.read_rgb, path))
        found += [replace(fault, fatal=False) for fault in faults]
    return renders, found, sum(render is None for render in renders) - len(found)


def read_import_notes(folder: Path) -> tuple[str, ...]:
    """The notes that `freeart21 import` left in the result `folder`; empty for a result that was not imported."""
    try:
        settings = checked.read_json(folder / "prediction.json").get("settings")
    except FreeArtError:
        return ()
    imported = settings.get("import") if isinstance(settings, dict) else None
    notes = imported.get("notes") if isinstance(imported, dict) else None
    lines = [note for note in notes if isinstance(note, str)] if isinstance(notes, list) else []
    return tuple(f"import: {shorten(note)}" for note in lines[:MOST_IMPORT_NOTES])


def find_appearance_faults(folder: Path) -> list[Fault]:
    """The faults of gaussians.ply, if there is one; never fatal, as no metric uses it."""
    faults = _attempt(folder, folder / GAUSSIANS, "", partial(read_appearance, folder))[1]
    return [replace(fault, fatal=False) for fault in faults]


def _find_file_faults(
    folder: Path, frames: int, height: int, width: int, masks: list[NDArray[np.uint8]]
) -> Iterator[Fault]:
    """Every fault of the files; appends each sound mask of part_mask/ to `masks`."""
    links = list(find_link_faults(folder))
    yield from links
    if links:
        return
    header = folder / "prediction.json"
    if not header.is_file():
        fix = "write the answer, or a failure with its stage and reason"
        yield Fault(folder.name, "is not a result: it has no prediction.json", fix=fix)
        return
    data, fault = _attempt(folder, header, "", lambda: checked.read_json(header, SCHEMA))
    yield from fault
    if data is None or data.get("status") != "ok":
        return  # `read_result` checks the rest
    yield from _find_joint_faults(folder, header, data, frames)
    yield from _find_pose_faults(folder, frames)
    yield from _find_mask_faults(folder, frames, height, width, masks)
    yield from _find_part_faults(folder)


def _find_joint_faults(folder: Path, header: Path, data: dict[str, Any], frames: int) -> Iterator[Fault]:
    file = _relative_name(folder, header)
    joint, fault = _attempt(folder, header, "joint", lambda: joint_from_json(data.get("joint"), header))
    yield from fault
    if joint is not None:
        yield from _find_range_fault(file, "pivot", joint.pivot)
    states = data.get("states")
    if not isinstance(states, list) or len(states) != frames:
        got = f"has {len(states)} states" if isinstance(states, list) else f"has states {states!r}"[:60]
        yield Fault(file, got, f"{frames}: one a frame", fix="write a state for every frame, an estimate where unseen")
        return
    numbers, fault = _attempt(folder, header, "states", lambda: checked.numbers(data, "states", (frames,), header))
    yield from fault
    if numbers is not None:
        yield from _find_range_fault(file, "states", numbers)
    for key, shape, nullable in (("state_std", (frames,), True), ("seen", (frames, 2), False)):
        if key in data:
            yield from _attempt(folder, header, key, partial(checked.numbers, data, key, shape, header, nullable))[1]


def _find_pose_faults(folder: Path, frames: int) -> Iterator[Fault]:
    path = folder / "poses.npz"
    file = _relative_name(folder, path)
    names = ("T_camera_reference", "T_camera_moving")
    arrays, fault = _attempt(folder, path, "", lambda: checked.read_npz(path, names))
    yield from fault
    if arrays is None:
        return
    for name in names:
        given = arrays[name]
        if given.shape != (frames, 4, 4) or given.dtype.kind not in "fiu":
            yield Fault(file, f"has shape {given.shape} {given.dtype}", f"({frames}, 4, 4) numbers", name)
            continue
        bad = []
        for i, T in enumerate(given.astype(float)):
            try:
                se3.check_poses("it", T)
            except FreeArtError as error:
                bad.append((i, str(error).removeprefix("it ")))
        if bad:
            more = f"; {len(bad)} of {frames} frames are wrong" if len(bad) > 1 else ""
            fix = "write the camera-from-part matrix [R t; 0 1], R a rotation, t in metres"
            yield Fault(file, bad[0][1] + more, "a rigid pose", name, bad[0][0], fix)
        else:
            yield from _find_range_fault(file, name, given)


def _find_mask_faults(
    folder: Path, frames: int, height: int, width: int, masks: list[NDArray[np.uint8]]
) -> Iterator[Fault]:
    """One fault for each kind that masks have, at its first frame; appends sound masks to `masks`."""
    by_kind: dict[str, list[Fault]] = {}
    for i in range(frames):
        path = folder / "part_mask" / f"{i:05d}.png"
        file = _relative_name(folder, path)
        fault = _find_png_fault(path, file, height, width)
        if fault is None:
            labels, faults = _attempt(folder, path, "", partial(checked.read_labels, path))
            if labels is None:
                fault = faults[0]
            elif labels.max(initial=0) > 2:
                fix = "write 0 for neither part, 1 for the reference part, 2 for the moving part"
                fault = Fault(file, f"has labels up to {labels.max()}", "0, 1 and 2", fix=fix)
            elif labels.shape != (height, width):
                fault = Fault(file, f"is {labels.shape[1]} x {labels.shape[0]}", f"{width} x {height}")
            else:
                masks.append(labels)
        if fault is not None:
            by_kind.setdefault(fault.found, []).append(replace(fault, frame=i))
    for faults in by_kind.values():
        more = f"; so are {len(faults) - 1} more of {frames} frames" if len(faults) > 1 else ""
        yield replace(faults[0], expected=faults[0].expected + more)


def _find_part_faults(folder: Path) -> Iterator[Fault]:
    for name in PARTS:
        path = folder / "parts" / f"{name}.ply"
        read, fault = _attempt(folder, path, "", partial(read_ply, path))
        yield from fault
        if read is None:
            continue
        mesh, file = read[0], _relative_name(folder, path)
        yield from _find_range_fault(file, "vertices", mesh.vertices)
        if len(mesh.faces) > MAX_FACES:
            yield Fault(file, f"has {len(mesh.faces)} faces", f"at most {MAX_FACES}", fix="write a coarser mesh")


def _find_range_fault(file: str, field: str, values: NDArray[Any]) -> Iterator[Fault]:
    largest = float(np.abs(values).max(initial=0.0))
    if largest > LARGEST:
        yield Fault(file, f"reach {largest:.3g}", f"metres or radians below {LARGEST:g}", field, fix="write SI units")


def _find_png_fault(path: Path, file: str, height: int, width: int) -> Fault | None:
    """The fault of a PNG's header (PNG specification, 11.2.2), read before the picture is unpacked."""
    if not path.is_file():
        return Fault(file, "is missing", f"a PNG of {width} x {height}")
    if path.stat().st_size > checked.MAX_IMAGE_BYTES:
        return Fault(file, f"has {path.stat().st_size} bytes", f"at most {checked.MAX_IMAGE_BYTES}")
    head = checked.read_head(path, 24)
    if len(head) < 24 or not head.startswith(_PNG):
        return Fault(file, "is not a PNG image", f"a PNG of {width} x {height}")
    size = struct.unpack(">II", head[16:24])
    if size != (width, height):
        fix = "write it in the size of the sequence's pictures"
        return Fault(file, f"is {size[0]} x {size[1]}", f"{width} x {height}", fix=fix)
    return None


def _attempt(folder: Path, path: Path, field: str, call: Callable[[], _T]) -> tuple[_T | None, list[Fault]]:
    """The value of `call`, or None and the fault of `field` in `path` when it raises."""
    try:
        return call(), []
    except Exception as error:  # as in find_faults
        return None, [replace(_unreadable_fault(_relative_name(folder, path), path, error), field=field)]


def _unreadable_fault(file: str, path: Path, error: Exception) -> Fault:
    """The fault of `file` for the error that a reader of `path` raised."""
    first_line = (str(error).splitlines() or [""])[0]
    if not isinstance(error, FreeArtError):
        return Fault(file, f"is not a readable result: {type(error).__name__}: {first_line}"[:LONGEST_TEXT])
    found, _, expected = first_line.removeprefix(str(path)).lstrip(": /").partition(", expected ")
    return Fault(file, found[:LONGEST_TEXT], expected[:LONGEST_TEXT])


def _link_fault(file: str) -> Fault:
    return Fault(file, "is a link", "the file or folder itself", fix="copy it here instead")


def _relative_name(folder: Path, path: Path) -> str:
    return f"{folder.name}/{path.relative_to(folder)}"


def plain_json(value: Any, depth: int = 0) -> Any:
    """`value` as JSON that any reader takes: printable text, finite numbers, at most DEEPEST_SETTINGS levels."""
    if depth > DEEPEST_SETTINGS:
        return "..."
    if isinstance(value, dict):
        return {escape_unprintable(str(k)): plain_json(v, depth + 1) for k, v in value.items()}
    if isinstance(value, list):
        return [plain_json(v, depth + 1) for v in value]
    if isinstance(value, str):
        return escape_unprintable(value)
    if isinstance(value, int | float) and not math.isfinite(value):
        return str(value)[:LONGEST_TEXT]
    return value
