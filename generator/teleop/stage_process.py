"""The process that renders the live picture with SAPIEN: it reads orders as lines of JSON and answers with JPEGs.

It is a separate process because SAPIEN holds Python's lock while it draws (measured: another thread ran once in 30 ms),
and because a crash of the renderer must not cost a take.

The shader 'minimal' gives the colours of the recorder's 'default' (as a test checks) in a third of the time.
"""

from __future__ import annotations

import json
import os
import struct
import sys
from pathlib import Path
from typing import Any, BinaryIO

import cv2
import numpy as np
from numpy.typing import NDArray

from freeart21 import processes
from freeart21.camera import Camera
from freeart21.errors import FreeArtError
from generator.scene import Scene

SHADER = "minimal"
ANSWER = struct.Struct("<?I")
"""Header of an answer: whether it is an error's text, and the number of bytes that follow."""
MIDDLE, EDGE = (118, 112, 106), (27, 22, 18)
"""Blue, green and red of the background in the middle of the picture and at its border. The page has the border's
colour, so that no edge is visible; a grey middle contrasts with dark and light objects."""
FIRST: dict[str, Any] = {"T": np.eye(4).tolist(), "state": 0.0, "width": 64, "height": 36, "quality": 50}


def main() -> None:
    """Answer orders until standard input ends."""
    questions, answers = sys.stdin.buffer, os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)  # output of native libraries goes to standard error
    first = questions.readline()
    if not first:
        return
    try:
        stage = Stage(json.loads(first))
        stage.draw(FIRST)  # compiles the shaders: seconds
    except Exception as error:  # the parent process reports it
        _send(answers, True, (str(error) if isinstance(error, FreeArtError) else processes.one_line(error)).encode())
        return
    _send(answers, False, b"")
    for line in questions:
        _send(answers, False, stage.draw(json.loads(line)))


class Stage:
    """The object in front of a camera of variable size."""

    def __init__(self, setup: dict[str, Any]) -> None:
        """`setup`: URDF, link groups, the joint's name, positions of the other joints, and the camera."""
        self._fov_y, self._joint, self._held = setup["fov_y"], setup["joint"], setup["held"]
        camera = Camera.from_fov(64, 36, self._fov_y)
        self._scene = Scene(
            Path(setup["urdf"]), setup["groups"], camera, setup["near"], setup["far"], SHADER, Path(setup["root"])
        )
        self._background = background(64, 36)

    def draw(self, order: dict[str, Any]) -> bytes:
        """Render an order as JPEG."""
        width, height = order["width"], order["height"]
        self._scene.set_camera(Camera.from_fov(width, height, self._fov_y))
        self._scene.shoot(np.array(order["T"]), {**self._held, self._joint: order["state"]})
        if self._background.shape[:2] != (height, width):
            self._background = background(width, height)
        drawn = self._scene.colour_and_cover()
        colours = cv2.convertScaleAbs(cv2.cvtColor(drawn, cv2.COLOR_RGBA2BGR), alpha=255)
        picture = cv2.copyTo(colours, (drawn[..., 3] > 0).astype(np.uint8), self._background.copy())
        ok, packed = cv2.imencode(".jpg", picture, [cv2.IMWRITE_JPEG_QUALITY, order["quality"]])
        if not ok:
            raise FreeArtError("a picture cannot be packed as JPEG")
        return packed.tobytes()


def background(width: int, height: int) -> NDArray[np.uint8]:
    """(height, width, 3) blue, green, red of the background: light in the middle, `EDGE` at the border.

    Fixed random dithering avoids visible rings.
    """
    x = (np.arange(width) + 0.5) / width * 2 - 1
    y = (np.arange(height) + 0.5) / height * 2 - 1
    share = np.clip(1 - np.hypot(x[None], y[:, None]), 0, 1)
    share = share * share * (3 - 2 * share)
    colours = np.array(EDGE) + share[..., None] * (np.array(MIDDLE, float) - EDGE)
    return np.asarray(np.floor(colours + np.random.default_rng(0).random((height, width, 1))).astype(np.uint8))


def _send(answers: BinaryIO, is_fault: bool, data: bytes) -> None:
    answers.write(ANSWER.pack(is_fault, len(data)) + data)
    answers.flush()
