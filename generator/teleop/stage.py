"""The live picture: the newest placement is drawn, one at a time, in a process of its own; nothing queues."""

from __future__ import annotations

import asyncio
import contextlib
import json
import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from freeart21 import child, stopping
from freeart21.errors import FreeArtError
from generator.teleop.driving import Placement
from generator.teleop.stage_process import ANSWER, FAULT

QUALITY, SHARP_QUALITY = 85, 92
"""Of JPEGs while something moves (8 kB at 640 x 360, 1 ms), and when it is still."""
STILL_S = 0.25
"""After so long without a change one sharp picture is drawn."""
SHARP = 2
"""How much finer that one is."""
MOST_PIXELS = 1280 * 720 * 4
_SIDE = 8
"""Sides of pictures are multiples of it: JPEG packs blocks of as many pixels."""
ASPECTS = 0.4, 16 / 9
"""Width over height of the picture: not wider than the recorder's, which must see all that is seen here."""
MOST_STARTS = 3
"""How often a process is started that died: what dies at once would die again."""


@dataclass(frozen=True)
class Shown:
    """A picture."""

    jpeg: bytes
    n: int
    """Of the newest move in it."""
    time_ms: float
    """When the page sent that move, by its own clock."""
    sharp: bool
    drawn_s: float
    """What drawing and packing took."""


@dataclass
class _Wanted:
    place: Placement
    n: int = 0
    time_ms: float = 0.0


def live_size(width: int, height: int, aspect: float) -> tuple[int, int]:
    """The size of a picture of this aspect with as many pixels as `width` x `height`."""
    aspect = min(max(aspect, ASPECTS[0]), ASPECTS[1])
    pixels = min(width * height, MOST_PIXELS)
    if abs(aspect - width / height) < 0.01:
        return width, height
    high = (pixels / aspect) ** 0.5
    return max(_SIDE, round(aspect * high / _SIDE) * _SIDE), max(_SIDE, round(high / _SIDE) * _SIDE)


class Stage:
    """Draws what it was last told, and hands every picture to `show`."""

    def __init__(self, told: dict[str, Any], size: tuple[int, int], place: Placement, show: Callable[[Shown], None]):
        """`told` is what `stage_process.Stage` is made of; `size` of the live picture, pixels."""
        self._told, self.size, self._show = told, size, show
        self._wanted = _Wanted(place)
        self._changed = asyncio.Event()
        self._changed.set()
        self._stopped = False
        self._drawn: deque[tuple[float, float]] = deque(maxlen=100)
        self.ready = False
        self.last: Shown | None = None

    def want(self, place: Placement, n: int, time_ms: float) -> None:
        """Draw this from now on."""
        if not place.is_like(self._wanted.place):  # else the picture is there, or on its way, for an earlier move
            self._wanted = _Wanted(place, n, time_ms)
            self._changed.set()

    def resize(self, size: tuple[int, int]) -> None:
        """Draw in this size from now on."""
        if size != self.size:
            self.size = size
            self._changed.set()

    def again(self) -> None:
        """Draw once more, for somebody who has come."""
        self._changed.set()

    def fps(self, now: float) -> float:
        """Live pictures over the last second."""
        return float(sum(now - at <= 1.0 for at, _ in self._drawn))

    def drawing_ms(self) -> float:
        """Median of what drawing a live picture took, milliseconds; 0 before the first."""
        took = sorted(seconds for _, seconds in self._drawn)
        return 1e3 * took[len(took) // 2] if took else 0.0

    def stop(self) -> None:
        """Let `run` end."""
        self._stopped = True
        self._changed.set()

    async def run(self, log: Callable[[str], None]) -> None:
        """Draw until stopped. Raises FreeArtError when the simulator cannot show the object."""
        for start in range(MOST_STARTS):
            try:
                await self._one_process()
                return
            except (EOFError, ConnectionError, asyncio.IncompleteReadError) as error:
                self.ready = False
                if self._stopped:
                    return
                if start + 1 == MOST_STARTS:
                    raise FreeArtError(
                        f"the simulator's process died {MOST_STARTS} times; what is taken is kept"
                    ) from error
                log("the simulator's process died; it is started again")
                self._changed.set()

    async def _one_process(self) -> None:
        with stopping.unheard():
            process = await asyncio.create_subprocess_exec(
                *child.command("generator.teleop.stage_process"),
                stdin=asyncio.subprocess.PIPE,
                stdout=asyncio.subprocess.PIPE,
                limit=1 << 26,
            )
        try:
            await _ask(process, self._told)
            self.ready = True
            sharp = True
            while not self._stopped:
                wait = None if sharp else STILL_S
                try:
                    await asyncio.wait_for(self._changed.wait(), wait)
                    sharp = False
                except asyncio.TimeoutError:
                    sharp = True
                if self._stopped:
                    break
                self._changed.clear()
                wanted = self._wanted
                grown = SHARP if sharp else 1
                asked = {
                    "T": wanted.place.T.tolist(),
                    "state": wanted.place.state,
                    "width": grown * self.size[0],
                    "height": grown * self.size[1],
                    "quality": SHARP_QUALITY if sharp else QUALITY,
                }
                seconds, jpeg = await _ask(process, asked)
                if not sharp:
                    self._drawn.append((time.monotonic(), seconds))
                self.last = Shown(jpeg, wanted.n, wanted.time_ms, sharp, seconds)
                self._show(self.last)
        finally:
            self.ready = False
            with contextlib.suppress(ProcessLookupError):
                process.kill()
            await process.wait()


async def _ask(process: asyncio.subprocess.Process, what: dict[str, Any]) -> tuple[float, bytes]:
    """Seconds that an answer took, and the answer."""
    assert process.stdin is not None and process.stdout is not None
    process.stdin.write(json.dumps(what).encode() + b"\n")
    size, seconds = ANSWER.unpack(await process.stdout.readexactly(ANSWER.size))
    if size == FAULT:
        size, _ = ANSWER.unpack(await process.stdout.readexactly(ANSWER.size))
        raise FreeArtError((await process.stdout.readexactly(size)).decode("utf-8", "replace"))
    return seconds, await process.stdout.readexactly(size)
