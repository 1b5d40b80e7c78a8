"""Reading what a method handed in: nothing is trusted, and whatever is wrong is a `Fault` with a place and a cure.

Scoring stops at the first fault that leaves nothing to measure; `leaderboard.validate` collects all of them.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Callable, Generator, Iterator
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
from freeart21.files.result import METHOD_SCHEMA, SCHEMA, Method, lacks_of, read_appearance, read_result
from freeart21.mesh import Mesh
from freeart21.reconstruction import Failure, Reconstruction

LARGEST = 1e6
"""Metres or radians: a number beyond it is not an answer in SI units."""
FARTHEST = 100.0
"""Metres from the camera, or across a part, beyond which the unit is doubted: objects are filmed from 0.2 to 5 m."""
MAX_FACES = 4_000_000
"""Faces per part: what a scorer of 8 GB holds."""
MAX_FILES = 200_000
MAX_METHOD_BYTES = 1 << 20
LONGEST_TEXT = 300
"""Characters of a method's words that are shown."""
DEEPEST_SETTINGS = 20
"""Levels of a method's settings that are kept."""
UNREADABLE = "unreadable"
"""Name of a method whose method.json cannot be read."""
_PNG = b"\x89PNG\r\n\x1a\n"
_T = TypeVar("_T")


@dataclass(frozen=True)
class Fault:
    """One thing that is wrong with what a method handed in."""

    file: str
    """From the results folder on, such as 'SEQ/poses.npz'."""
    found: str
    """What is there, as the end of a sentence about the field or the file."""
    expected: str = ""
    field: str = ""
    """What in the file; empty for the file as a whole."""
    frame: int | None = None
    """The first frame that has the fault; None where frames do not matter."""
    mend: str = ""
    """What to do about it."""
    fatal: bool = True
    """Whether nothing of the sequence is scored; else it costs what it says (a picture), or is only doubtful."""

    def __str__(self) -> str:
        field = f": {self.field}" if self.field else ""
        frame = "" if self.frame is None or not self.field else f" (frame {self.frame})"  # a picture's name says it
        expected = f", expected {self.expected}" if self.expected else ""
        return escape_unprintable(f"{self.file}{field}{frame} {self.found}{expected}")


def escape_unprintable(text: str) -> str:
    """`text` with control characters, lone surrogates and what else does not print written as escapes."""
    return "".join(c if c.isprintable() else c.encode("unicode_escape").decode() for c in text)


def shorten(text: str, longest: int = LONGEST_TEXT) -> str:
    """`text` on one line, printable, of at most `longest` characters."""
    return escape_unprintable(" ".join(text[: 20 * longest].split()))[:longest]


def read_submission(folder: Path, frames: int, height: int, width: int) -> Reconstruction | Failure:
    """The answer in `folder` to a sequence of `frames` pictures of `width` x `height`, checked before it is unpacked.

    Raises FreeArtError when it is not one: unreadable files, links, another number of frames, masks of another size,
    numbers that are not in SI units.
    """
    return read_submission_with_notes(folder, frames, height, width)[0]


def read_submission_with_notes(
    folder: Path, frames: int, height: int, width: int
) -> tuple[Reconstruction | Failure, tuple[str, ...]]:
    """As `read_submission`, and a line about each fault that does not keep the answer from being scored."""
    looking = find_faults(Path(folder), frames, height, width)
    notes: list[str] = []
    while True:
        try:
            fault = next(looking)
        except StopIteration as end:
            assert end.value is not None  # a look without a fatal fault ends with an answer
            return end.value, tuple(notes)
        if fault.fatal:
            raise FreeArtError(str(fault))
        notes.append(str(fault))


def find_faults(
    folder: Path, frames: int, height: int, width: int
) -> Generator[Fault, None, Reconstruction | Failure | None]:
    """Every fault of the result in `folder`, fatal or not; returns the answer when none was fatal."""
    fatal = False
    masks: list[NDArray[np.uint8]] = []
    try:
        for fault in _faults(folder, frames, height, width, masks):
            fatal |= fault.fatal
            yield fault
        if fatal:
            return None
        answer = read_result(folder, masks or None, appearance=False)
    except Exception as error:  # hostile bytes reach parsers of many libraries; each has exceptions of its own
        yield _unreadable(folder.name, folder, error)
        return None
    if isinstance(answer, Failure):
        return answer
    yield from _unit_doubts(folder, answer)
    return replace(
        answer,
        Ts_camera_reference=se3.orthonormalised(answer.Ts_camera_reference),
        Ts_camera_moving=se3.orthonormalised(answer.Ts_camera_moving),
    )


def read_submitted_method(results: Path) -> tuple[Method, list[Fault]]:
    """The method of a results folder, its words printable and its settings plain, and what is wrong with method.json.

    One without the file is named after the folder; one whose file cannot be read is named UNREADABLE.
    """
    path = results / "method.json"
    if not checked.is_there(path):
        return Method(shorten(results.resolve().name)), []
    try:
        if path.is_symlink():
            return Method(UNREADABLE), [_link_fault("method.json")]
        data = checked.read_json(path, METHOD_SCHEMA, limit=MAX_METHOD_BYTES)
        settings = data.get("settings") or {}
        if not isinstance(settings, dict):
            found, mend = f"is of type {type(settings).__name__}", "leave it out or write an object"
            fault = Fault("method.json", found, "an object", "settings", mend=mend, fatal=False)
            return Method(shorten(checked.text(data, "name", path))), [fault]
        words = [shorten(str(data.get(key) or "")) for key in ("code", "hardware")]
        lacks, faults = _tried(results, path, "lacks", partial(lacks_of, data, path))
        name = shorten(checked.text(data, "name", path))
        method = Method(name, words[0], plain_json(settings), words[1], lacks or ())
        return method, [replace(fault, fatal=False) for fault in faults]
    except Exception as error:  # as above
        fault = _unreadable("method.json", path, error)
        mend = f'write {{"schema": "{METHOD_SCHEMA}", "name": "..."}}'
        return Method(UNREADABLE), [replace(fault, fatal=False, mend=mend)]


def find_link_faults(folder: Path) -> Iterator[Fault]:
    """A fault for a result folder that is a link, and for each link in it that leads out of it, or to itself."""
    if folder.is_symlink():
        yield _link_fault(folder.name)
        return
    home = folder.resolve()
    for count, path in enumerate(folder.rglob("*")):
        if count > MAX_FILES:
            yield Fault(folder.name, f"has more than {MAX_FILES} files", "one result", mend="remove what is no result")
            return
        if not path.is_symlink():
            continue
        try:
            inside = path.resolve().is_relative_to(home)
        except (OSError, RuntimeError):
            yield replace(_link_fault(_named(folder, path)), found="leads to itself")
            continue
        if not inside:
            yield replace(_link_fault(_named(folder, path)), found="leads out of the folder")


def read_render(
    folder: Path, pictures: str, index: int, height: int, width: int
) -> tuple[NDArray[np.uint8] | None, list[Fault]]:
    """The picture of held-out query `index` in the subfolder `pictures`; None when there is none, or with its fault."""
    path = folder / pictures / f"{index:05d}.png"
    if not path.is_file():
        return None, []
    file = _named(folder, path)
    fault = _png_fault(path, file, height, width)
    if fault is None:
        try:
            return checked.read_rgb(path), []
        except Exception as error:  # OpenCV's own, on hostile bytes
            fault = _unreadable(file, path, error)
    return None, [replace(fault, fatal=False)]


def find_appearance_faults(folder: Path) -> list[Fault]:
    """What is wrong with gaussians.ply, if it is there: nothing is measured of it, so it costs nothing."""
    faults = _tried(folder, folder / GAUSSIANS, "", partial(read_appearance, folder))[1]
    return [replace(fault, fatal=False) for fault in faults]


def _faults(folder: Path, frames: int, height: int, width: int, masks: list[NDArray[np.uint8]]) -> Iterator[Fault]:
    """Every fault before the answer is put together; `masks` gets what was read of part_mask/."""
    links = list(find_link_faults(folder))
    yield from links
    if links:
        return
    header = folder / "prediction.json"
    if not header.is_file():
        mend = "write the answer, or a failure with its stage and reason"
        yield Fault(folder.name, "is not a result: it has no prediction.json", mend=mend)
        return
    data, fault = _tried(folder, header, "", lambda: checked.read_json(header, SCHEMA))
    if data is None:
        yield from fault
        return
    yield from _seconds_faults(folder, header, data)
    status = data.get("status")
    if status == "failed":
        for key in ("stage", "reason"):
            yield from _tried(folder, header, key, partial(checked.text, data, key, header))[1]
        return
    if status != "ok":
        yield Fault(_named(folder, header), f"is {status!r}"[:60], "'ok' or 'failed'", "status")
        return
    yield from _joint_faults(folder, header, data, frames)
    yield from _pose_faults(folder, frames)
    yield from _mask_faults(folder, frames, height, width, masks)
    yield from _part_faults(folder)


def _joint_faults(folder: Path, header: Path, data: dict[str, Any], frames: int) -> Iterator[Fault]:
    file = _named(folder, header)
    joint, fault = _tried(folder, header, "joint", lambda: joint_from_json(data.get("joint"), header))
    yield from fault
    if joint is not None:
        yield from _range_fault(file, "pivot", joint.pivot)
    states = data.get("states")
    if not isinstance(states, list) or len(states) != frames:
        got = f"has {len(states)} states" if isinstance(states, list) else f"has states {states!r}"[:60]
        yield Fault(file, got, f"{frames}: one a frame", mend="give every frame a state, guessed where it is not seen")
        return
    numbers, fault = _tried(folder, header, "states", lambda: checked.numbers(data, "states", (frames,), header))
    yield from fault
    if numbers is not None:
        yield from _range_fault(file, "states", numbers)
    for key, shape, nullable in (("state_std", (frames,), True), ("seen", (frames, 2), False)):
        if key in data:
            yield from _tried(folder, header, key, partial(checked.numbers, data, key, shape, header, nullable))[1]


def _seconds_faults(folder: Path, header: Path, data: dict[str, Any]) -> Iterator[Fault]:
    seconds = data.get("seconds") or {}
    said = isinstance(seconds, dict) and all(isinstance(value, int | float) for value in seconds.values())
    if not said:
        mend = 'write {"stage": 1.5}, or leave it out'
        yield Fault(_named(folder, header), f"is {seconds!r}"[:60], "a number for every stage", "seconds", mend=mend)
    elif any(math.isinf(value) for value in seconds.values()):
        mend = "write seconds"
        yield Fault(_named(folder, header), "has a number beyond all floats", "seconds", "seconds", mend=mend)


def _pose_faults(folder: Path, frames: int) -> Iterator[Fault]:
    path = folder / "poses.npz"
    file = _named(folder, path)
    names = ("T_camera_reference", "T_camera_moving")
    arrays, fault = _tried(folder, path, "", lambda: checked.read_npz(path, names))
    yield from fault
    for name in names if arrays is not None else ():
        assert arrays is not None
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
            mend = "write the camera-from-part matrix [R t; 0 1], R a rotation, t in metres"
            yield Fault(file, bad[0][1] + more, "a rigid pose", name, bad[0][0], mend)
        else:
            yield from _range_fault(file, name, given)


def _mask_faults(folder: Path, frames: int, height: int, width: int, masks: list[NDArray[np.uint8]]) -> Iterator[Fault]:
    """One fault for each kind that masks have, at its first frame; what is well is added to `masks`."""
    kinds: dict[str, list[Fault]] = {}
    for i in range(frames):
        path = folder / "part_mask" / f"{i:05d}.png"
        file = _named(folder, path)
        fault = _png_fault(path, file, height, width)
        if fault is None:
            labels, read = _tried(folder, path, "", partial(checked.read_labels, path))
            if labels is None:
                fault = read[0]
            elif labels.max(initial=0) > 2:
                mend = "write 0 for neither part, 1 for the reference part, 2 for the moving part"
                fault = Fault(file, f"has labels up to {labels.max()}", "0, 1 and 2", mend=mend)
            elif labels.shape != (height, width):
                fault = Fault(file, f"is {labels.shape[1]} x {labels.shape[0]}", f"{width} x {height}")
            else:
                masks.append(labels)
        if fault is not None:
            kinds.setdefault(fault.found, []).append(replace(fault, frame=i))
    for faults in kinds.values():
        more = f"; so are {len(faults) - 1} more of {frames} frames" if len(faults) > 1 else ""
        yield replace(faults[0], expected=faults[0].expected + more)


def _part_faults(folder: Path) -> Iterator[Fault]:
    for name in PARTS:
        path = folder / "parts" / f"{name}.ply"
        read, fault = _tried(folder, path, "", partial(read_ply, path))
        yield from fault
        if read is None:
            continue
        mesh = read[0]
        yield from _range_fault(_named(folder, path), "vertices", mesh.vertices)
        if len(mesh.faces) > MAX_FACES:
            found = f"has {len(mesh.faces)} faces"
            yield Fault(_named(folder, path), found, f"at most {MAX_FACES}", mend="write a coarser mesh")


def _unit_doubts(folder: Path, answer: Reconstruction) -> Iterator[Fault]:
    """A part that stands, or is, FARTHEST metres and more away: most likely in millimetres."""
    parts = answer.articulation
    for part, Ts in ((parts.reference, answer.Ts_camera_reference), (parts.moving, answer.Ts_camera_moving)):
        if part.empty:
            continue
        centre = _centre(part)
        away = float(np.median(np.linalg.norm(se3.transform(Ts, centre[None])[..., 0, :], axis=-1)))
        if away > FARTHEST:
            found, mend = f"place a part {away:.3g} m from the camera", "write metres (are these millimetres?)"
            yield Fault(f"{folder.name}/poses.npz", found, f"less than {FARTHEST:g} m", mend=mend, fatal=False)
            return


def _centre(mesh: Mesh) -> NDArray[np.float64]:
    return mesh.vertices[mesh.faces].mean((0, 1))


def _range_fault(file: str, field: str, values: NDArray[Any]) -> Iterator[Fault]:
    largest = float(np.abs(values).max(initial=0.0))
    if largest > LARGEST:
        yield Fault(file, f"reach {largest:.3g}", f"metres or radians below {LARGEST:g}", field, mend="write SI units")


def _png_fault(path: Path, file: str, height: int, width: int) -> Fault | None:
    """What the size in a PNG's header (PNG specification, 11.2.2) says, before anything is unpacked."""
    if not path.is_file():
        return Fault(file, "is missing", f"a PNG of {width} x {height}")
    if path.stat().st_size > checked.MAX_IMAGE_BYTES:
        return Fault(file, f"has {path.stat().st_size} bytes", f"at most {checked.MAX_IMAGE_BYTES}")
    head = checked.read_head(path, 24)
    if len(head) < 24 or not head.startswith(_PNG):
        return Fault(file, "is not a PNG image", f"a PNG of {width} x {height}")
    size = struct.unpack(">II", head[16:24])
    if size != (width, height):
        mend = "write it in the size of the sequence's pictures"
        return Fault(file, f"is {size[0]} x {size[1]}", f"{width} x {height}", mend=mend)
    return None


def _tried(folder: Path, path: Path, field: str, call: Callable[[], _T]) -> tuple[_T | None, list[Fault]]:
    """What `call` returns, or None and the fault of `field` in `path` that it raises."""
    try:
        return call(), []
    except Exception as error:  # as above
        return None, [replace(_unreadable(_named(folder, path), path, error), field=field)]


def _unreadable(file: str, path: Path, error: Exception) -> Fault:
    """The fault of `file` that a reader of `path` raised."""
    lines = str(error).splitlines() or [""]
    if not isinstance(error, FreeArtError):
        return Fault(file, f"is not a readable result: {type(error).__name__}: {lines[0]}"[:LONGEST_TEXT])
    found, _, expected = lines[0].removeprefix(str(path)).lstrip(": /").partition(", expected ")
    return Fault(file, found[:LONGEST_TEXT], expected[:LONGEST_TEXT])


def _link_fault(file: str) -> Fault:
    return Fault(file, "is a link", "the file or folder itself", mend="copy it here instead")


def _named(folder: Path, path: Path) -> str:
    return f"{folder.name}/{path.relative_to(folder)}"


def plain_json(value: Any, depth: int = 0) -> Any:
    """JSON that any reader takes: printable words, finite numbers that fit a float, no more than DEEPEST_SETTINGS."""
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
