"""The process that holds SAPIEN for the live picture: asked by lines of JSON, it answers with JPEGs.

A process of its own, because SAPIEN holds Python's lock while it draws (measured: a thread beside it ran once in
30 ms), and because what happens to a renderer must not happen to a take.

The shader is 'minimal': its colours are those of the recorder's 'default' (a test holds it), in a third of the time.
"""

from __future__ import annotations

import json
import os
import struct
import sys
import time
from pathlib import Path
from typing import Any, BinaryIO

import cv2
import numba
import numpy as np
from numpy.typing import NDArray

from freeart21 import child
from freeart21.camera import Camera
from freeart21.errors import FreeArtError
from generator.scene import Scene

SHADER = "minimal"
ANSWER = struct.Struct("<Id")
"""Bytes that follow, and the seconds that drawing and packing took. No bytes after a fault: its words follow then."""
FAULT = 0xFFFFFFFF
MIDDLE, EDGE = (118, 112, 106), (27, 22, 18)
"""Blue, green and red of the ground behind the object, in the middle of the picture and along its border. The page has
the border's colour, so that no edge is seen; before a grey middle dark and light objects stand out."""


FIRST: dict[str, Any] = {
    "T": np.eye(4).tolist(),
    "state": 0.0,
    "width": 64,
    "height": 36,
    "quality": 50,
    "shift": [0.0, 0.0],
    "layer": 0,
}


def main() -> None:
    """Answer until standard input ends."""
    questions, answers = sys.stdin.buffer, os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)  # what native libraries print is no answer
    first = questions.readline()
    if not first:
        return
    try:
        stage = Stage(json.loads(first))
        stage.draw(FIRST)  # compiles the shaders: seconds
    except Exception as error:  # told to who asked, who knows what to do
        said = str(error) if isinstance(error, FreeArtError) else child.one_line(error)
        _tell(answers, FAULT, 0.0, said.encode())
        return
    _tell(answers, 0, 0.0, b"")
    for line in questions:
        begun = time.perf_counter()
        jpeg = stage.draw(json.loads(line))
        _tell(answers, len(jpeg), time.perf_counter() - begun, jpeg)


class Stage:
    """The object before a camera whose size may change."""

    def __init__(self, told: dict[str, Any]) -> None:
        """`told`: path and link groups of the URDF, the joint's name, what other joints are held at, and the camera."""
        self._fov_y, self._joint, self._held = told["fov_y"], told["joint"], told["held"]
        camera = Camera.from_fov(64, 36, self._fov_y)
        self._scene = Scene(Path(told["urdf"]), told["groups"], camera, told["near"], told["far"], SHADER)
        self._ground = ground(64, 36)
        self._sum = np.zeros((36, 64, 3), np.uint16)

    def draw(self, asked: dict[str, Any]) -> bytes:
        """The JPEG of what was asked for: the mean of this view and of those that were its layers before."""
        width, height, layer = asked["width"], asked["height"], asked["layer"]
        camera = Camera.from_fov(width, height, self._fov_y)
        K = camera.K.copy()
        K[:2, 2] += asked["shift"]
        self._scene.set_camera(Camera(K, width, height))
        self._scene.shoot(np.array(asked["T"]), {**self._held, self._joint: asked["state"]})
        if self._ground.shape[:2] != (height, width):
            self._ground = ground(width, height)
        picture = on_ground(self._scene.colour_and_cover(), self._ground)
        if layer == 0:
            self._sum = picture.astype(np.uint16)
        else:
            self._sum += picture
            picture = (self._sum // np.uint16(layer + 1)).astype(np.uint8)
        ok, packed = cv2.imencode(".jpg", picture, [cv2.IMWRITE_JPEG_QUALITY, asked["quality"]])
        if not ok:
            raise FreeArtError("a picture cannot be packed as JPEG")
        return packed.tobytes()


def ground(width: int, height: int) -> NDArray[np.uint8]:
    """(height, width, 3) blue, green, red of what is behind the object: light in the middle, `EDGE` along the border.

    Each colour is rounded up or down by a fixed grain, or the slow change would show as rings.
    """
    x = (np.arange(width) + 0.5) / width * 2 - 1
    y = (np.arange(height) + 0.5) / height * 2 - 1
    share = np.clip(1 - np.hypot(x[None], y[:, None]), 0, 1)
    share = share * share * (3 - 2 * share)
    colours = np.array(EDGE) + share[..., None] * (np.array(MIDDLE, float) - EDGE)
    return np.floor(colours + np.random.default_rng(0).random((height, width, 1))).astype(np.uint8)


@numba.njit(cache=True)
def on_ground(colours: NDArray[np.float32], ground: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """The engine's colours (h, w, 4) as bytes, blue first, before a ground."""
    picture = ground.copy()
    for v in range(colours.shape[0]):
        for u in range(colours.shape[1]):
            if colours[v, u, 3] > 0:
                for k in range(3):
                    value = colours[v, u, 2 - k] * np.float32(255) + np.float32(0.5)
                    picture[v, u, k] = np.uint8(min(max(value, np.float32(0)), np.float32(255)))
    return picture


def _tell(answers: BinaryIO, size: int, seconds: float, data: bytes) -> None:
    answers.write(ANSWER.pack(size, seconds))
    if size == FAULT:
        answers.write(ANSWER.pack(len(data), 0.0))
    answers.write(data)
    answers.flush()
