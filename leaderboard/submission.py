"""Reading what a method handed in: nothing is trusted, and whatever is wrong is one FreeArtError with one reason."""

from __future__ import annotations

import struct
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from freeart21 import se3
from freeart21.articulation import PARTS
from freeart21.errors import FreeArtError
from freeart21.files import checked
from freeart21.files.result import read_render, read_result
from freeart21.reconstruction import Failure, Reconstruction

LARGEST = 1e6
"""Metres or radians: a number beyond it is not an answer in SI units."""
MAX_FACES = 4_000_000
"""Faces per part: what a scorer of 8 GB holds."""
MAX_FILES = 200_000
_PNG = b"\x89PNG\r\n\x1a\n"


def read_submission(folder: Path, frames: int, height: int, width: int) -> Reconstruction | Failure:
    """The answer in `folder` to a sequence of `frames` pictures of `width` x `height`, checked before it is unpacked.

    Raises FreeArtError when it is not one: unreadable files, links that lead out of the folder, another number of
    frames, masks of another size, numbers that are not in SI units.
    """
    folder = Path(folder)
    try:
        check_links(folder)
        _check_sizes(folder, frames, height, width)
        answer = read_result(folder)
    except FreeArtError:
        raise
    except Exception as error:  # hostile bytes reach parsers of many libraries; each has exceptions of its own
        lines = str(error).splitlines() or [""]
        raise FreeArtError(f"{folder} is not a readable result: {type(error).__name__}: {lines[0]}") from error
    if isinstance(answer, Failure):
        return answer
    _check_numbers(folder, answer)
    return replace(
        answer,
        Ts_camera_reference=se3.orthonormalised(answer.Ts_camera_reference),
        Ts_camera_moving=se3.orthonormalised(answer.Ts_camera_moving),
    )


def read_submitted_render(folder: Path, index: int, height: int, width: int) -> NDArray[np.uint8] | None:
    """The picture of held-out query `index`, or None when there is none; FreeArtError when it is of another size."""
    path = folder / "renders" / f"{index:05d}.png"
    if not path.is_file():
        return None
    _check_png(path, height, width)
    try:
        return read_render(folder, index)
    except FreeArtError:
        raise
    except Exception as error:  # OpenCV's own, on hostile bytes
        raise FreeArtError(f"{path} is not a readable image") from error


def check_links(folder: Path) -> None:
    """FreeArtError when anything in `folder` leads out of it, or when there are more files than any answer needs."""
    home = folder.resolve()
    for count, path in enumerate(folder.rglob("*")):
        if count > MAX_FILES:
            raise FreeArtError(f"{folder} has more than {MAX_FILES} files")
        if path.is_symlink() and not path.resolve().is_relative_to(home):
            raise FreeArtError(f"{path} leads out of the folder")


def _check_sizes(folder: Path, frames: int, height: int, width: int) -> None:
    header = folder / "prediction.json"
    if not header.is_file():
        raise FreeArtError(f"{folder} is not a result: it has no prediction.json")
    data = checked.read_json(header)
    if data.get("status") != "ok":
        return
    states = data.get("states")
    if not isinstance(states, list) or len(states) != frames:
        got = f"{len(states)} states" if isinstance(states, list) else f"states {states!r}"[:60]
        raise FreeArtError(f"{header} has {got}, expected {frames}: one a frame")
    for i in range(frames):
        _check_png(folder / "part_mask" / f"{i:05d}.png", height, width)


def _check_png(path: Path, height: int, width: int) -> None:
    """The size in a PNG's header (PNG specification, 11.2.2), before anything is unpacked."""
    with checked.require_file(path, checked.MAX_IMAGE_BYTES).open("rb") as file:
        head = file.read(24)
    if len(head) < 24 or not head.startswith(_PNG):
        raise FreeArtError(f"{path} is not a PNG image")
    size = struct.unpack(">II", head[16:24])
    if size != (width, height):
        raise FreeArtError(f"{path} is {size[0]} x {size[1]}, expected {width} x {height}")


def _check_numbers(folder: Path, answer: Reconstruction) -> None:
    joint = answer.articulation.joint
    named = {
        "poses.npz T_camera_reference": answer.Ts_camera_reference,
        "poses.npz T_camera_moving": answer.Ts_camera_moving,
        "prediction.json states": answer.states,
        "prediction.json pivot": joint.pivot,
        **{f"parts/{name}.ply vertices": answer.articulation.part(name).vertices for name in PARTS},
    }
    for name, values in named.items():
        largest = np.abs(values).max(initial=0.0)
        if largest > LARGEST:
            raise FreeArtError(f"{folder}/{name} reach {largest:.3g}, expected metres or radians below {LARGEST:g}")
    for name in PARTS:
        faces = len(answer.articulation.part(name).faces)
        if faces > MAX_FACES:
            raise FreeArtError(f"{folder}/parts/{name}.ply has {faces} faces, at most {MAX_FACES} are scored")
