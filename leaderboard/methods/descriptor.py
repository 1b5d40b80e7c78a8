"""The descriptor of a method: how it is started, what it reads, what it writes, and its limits."""

from __future__ import annotations

import re
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from freeart21.errors import FreeArtError
from freeart21.files import checked
from freeart21.files.json_record import read_record

SCHEMA = "freeart21/method-descriptor/1"
FOLDER = Path(__file__).parent
NATIVE = "native"
"""The layout of a result folder of ours (docs/formats.md)."""
INPUTS = {
    "sequence": "the sequence folder (docs/formats.md)",
    "rgbd": "the video as rgb/, depth/ in mm, masks/ of the object, cam_K.txt",
    "part_masks": "the true part masks, 1 reference, 2 moving",
    "rgbd_reference": "as rgbd, masks of the reference part alone",
    "rgbd_moving": "as rgbd, masks of the moving part alone",
    "mesh_reference": "the true mesh of the reference part, OBJ, metres",
    "mesh_moving": "the true mesh of the moving part, OBJ, metres",
}
"""What a method can be given, by the name of its placeholder."""
PRIVILEGED = ("part_masks", "rgbd_reference", "rgbd_moving", "mesh_reference", "mesh_moving")
"""Inputs made from the truth: a method that gets them says so in its method.json."""
_OTHERS = ("out", "name", "home", "python")
_PLACEHOLDER = re.compile(r"\{(\w*)\}")


@dataclass(frozen=True)
class Limits:
    """What one sequence may take."""

    seconds: float = 3600.0
    """By the clock."""
    memory_gb: float = 16.0
    """Of resident memory of all its processes, 1e9 bytes."""


@dataclass(frozen=True)
class Descriptor:
    """A method, as its JSON file says."""

    schema: str
    name: str
    code: str
    """Address and version of its code."""
    commands: tuple[tuple[str, ...], ...]
    """Run one after another, each a program and its arguments; {placeholders} are INPUTS, {out}, the folder to write,
    {name}, the sequence, {home}, the checkout given by --home, and {python}. No shell sees them."""
    inputs: tuple[str, ...]
    layout: str = NATIVE
    """Of its results: NATIVE, or one that `freeart21 import` reads."""
    result: str = "."
    """Where in {out} they are; {name} is the sequence."""
    options: dict[str, Any] = field(default_factory=dict)
    """Of the import: frame, axes, anchor, scale, joint, object_poses."""
    image: str | None = None
    """Container image that the commands run in; None: on this machine."""
    gpu: bool = False
    """Whether a container gets the graphics cards."""
    versions: tuple[tuple[str, ...], ...] = ()
    """Commands whose first line of output is a version to be noted."""
    limits: Limits = Limits()
    about: str = ""
    """Where these facts were read, and what the method needs."""


def find_descriptor(method: str) -> Descriptor:
    """The descriptor in the file `method`, or the shipped one of that name. Raises FreeArtError."""
    path = Path(method)
    if path.suffix != ".json":
        path = FOLDER / f"{method}.json"
        if not path.is_file():
            raise FreeArtError(f"there is no method '{method}', expected a file .json or one of {', '.join(shipped())}")
    data = checked.read_json(path, SCHEMA, checked.ANYWHERE)
    found = read_record(Descriptor, data, str(path))
    _check(found, path)
    return found


def shipped() -> list[str]:
    """The names of the descriptors in FOLDER."""
    return sorted(path.stem for path in FOLDER.glob("*.json"))


def fill_words(words: Sequence[str], values: Mapping[str, Any]) -> list[str]:
    """The words with their placeholders replaced, once: what is put in is not read again."""
    return [_PLACEHOLDER.sub(lambda found: str(values[found[1]]), word) for word in words]


def known_values(**values: Any) -> dict[str, Any]:
    """`values`, and {python}: this one."""
    return {"python": sys.executable, **values}


def needs_home(method: Descriptor) -> bool:
    """Whether a command names the method's checkout."""
    return any("{home}" in word for words in (*method.commands, *method.versions) for word in words)


def _check(method: Descriptor, path: Path) -> None:
    if not method.commands or not all(words for words in (*method.commands, *method.versions)):
        raise FreeArtError(f"{path}: 'commands' needs at least one command, and each a program")
    for name in method.inputs:
        if name not in INPUTS:
            raise FreeArtError(
                f"{path}: input {checked.shorten(name)} is unknown, expected some of {', '.join(INPUTS)}"
            )
    for word in (word for words in (*method.commands, *method.versions) for word in words):
        for name in _PLACEHOLDER.findall(word):
            if name not in (*method.inputs, *_OTHERS):
                known = ", ".join((*method.inputs, *_OTHERS))
                raise FreeArtError(f"{path}: {{{name}}} in {checked.shorten(word)} is not an input, expected {known}")
    if Path(method.result).is_absolute() or ".." in Path(method.result).parts:
        raise FreeArtError(f"{path}: 'result' is {checked.shorten(method.result)}, expected a folder in {{out}}")
    if not (method.limits.seconds > 0 and method.limits.memory_gb > 0):
        raise FreeArtError(f"{path}: limits are {method.limits}, expected numbers above 0")
