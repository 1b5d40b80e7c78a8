"""The live picture: a separate process draws the newest placement, one picture at a time, without a queue.

While the object moves, the resolution is as high as the machine can draw in time (`Pace`). When it rests, a sharp
picture follows, and then one with smooth edges; a move interrupts them after at most one picture.
"""

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
"""JPEG quality of moving pictures (8 kB at 640 x 360, packed in 1 ms) and of pictures at rest."""
STILL_S = 0.25
"""Time without a change after which the sharp picture is drawn."""
SHARP = 2.0
"""Resolution of the sharp picture (each side), relative to the live picture's size."""
SMOOTH = ((-0.125, -0.375), (0.375, -0.125), (0.125, 0.375), (-0.375, 0.125))
"""Shifts, in pixels, of the views whose mean has smooth edges: the rotated grid of four."""
SCALES = (1.0, 1.5, 2.0)
"""Possible resolutions of the live picture (each side), relative to its size."""
BUDGET_S = 0.022
"""Time budget of a live picture: with the transfer to the page it allows 30 a second and more."""
ASPECTS = 0.4, 16 / 9
"""Range of width over height: not wider than the recorder's picture, which must contain all that is visible here."""
END_S = 2.0
"""Longest wait for the end of a killed process: a graphics driver may delay it."""
MAX_STARTS = 3
"""Largest number of starts of a process that keeps dying."""


@dataclass(frozen=True)
class Mark:
    """The move that a picture shows."""

    by: object = None
    """The client that sent it."""
    n: int = 0
    time_ms: float = 0.0
    """Send time of the page's clock."""


@dataclass(frozen=True)
class LivePicture:
    """A finished picture."""

    jpeg: bytes
    mark: Mark
    drawn_s: float
    """Time for drawing and packing."""


class Pace:
    """Chooses the resolution of live pictures: the highest within the time budget, from the times of the last ones."""

    def __init__(self, finest: float) -> None:
        self._growths = [g for g in SCALES if g <= finest]
        self._at, self._slow, self._quick = 0, 0, 0

    @property
    def scale(self) -> float:
        """Resolution of the next live picture, relative to its size."""
        return self._growths[self._at]

    def observe(self, seconds: float) -> None:
        """Note the time for a live picture of the present scale."""
        self._slow = self._slow + 1 if seconds > BUDGET_S else 0
        finer = self._growths[min(self._at + 1, len(self._growths) - 1)]
        # drawing time grows at most in proportion to the pixels
        fits = seconds * (finer / self.scale) ** 2 < BUDGET_S
        self._quick = self._quick + 1 if fits else 0
        if self._slow >= 3 and self._at > 0:
            self._at, self._slow, self._quick = self._at - 1, 0, 0
        elif self._quick >= 20 and finer > self.scale:
            self._at, self._slow, self._quick = self._at + 1, 0, 0


def live_size(width: int, height: int, aspect: float) -> tuple[int, int]:
    """Size of a picture of this aspect ratio, limited to `ASPECTS`, with about as many pixels as `width` x `height`."""
    aspect = min(max(aspect, ASPECTS[0]), ASPECTS[1])
    if abs(aspect / (width / height) - 1) < 0.01:
        return width, height
    high = (width * height / aspect) ** 0.5
    return 2 * max(8, round(aspect * high / 2)), 2 * max(8, round(high / 2))


class Stage:
    """Draws the last requested placement and calls `show` for every picture."""

    def __init__(self, setup: dict[str, Any], size: tuple[int, int], place: Placement, finest: float = SCALES[-1]):
        """`setup` are the arguments of `stage_process.Stage`; `size` of the live picture, pixels."""
        self._setup, self.size = setup, size
        self._place, self._mark = place, Mark()
        self._changed = asyncio.Event()
        self._changed.set()
        self._pace = Pace(finest)
        self._drawn: deque[tuple[float, float]] = deque(maxlen=200)
        self.process: asyncio.subprocess.Process | None = None
        self.show: Callable[[], None] = lambda: None
        """Called after every picture."""
        self.last: LivePicture | None = None
        self.ready = False

    def request(self, place: Placement, mark: Mark) -> None:
        """Draw this placement from now on."""
        if not place.is_close(self._place):  # else the picture exists, or is being drawn, for an earlier move
            self._place, self._mark = place, mark
            self._changed.set()

    def resize(self, size: tuple[int, int]) -> None:
        """Draw pictures of this size from now on."""
        if size != self.size:
            self.size = size
            self._changed.set()

    def fps(self, now: float) -> float:
        """Number of live pictures in the last second."""
        return float(sum(now - at <= 1.0 for at, _ in self._drawn))

    def drawing_ms(self) -> float:
        """Median time for a live picture, milliseconds; 0 before the first."""
        observe = sorted(seconds for _, seconds in self._drawn)
        return 1e3 * observe[len(observe) // 2] if observe else 0.0

    async def run(self, log: Callable[[str], None]) -> None:
        """Draw until cancelled. Raises FreeArtError when the simulator cannot show the object."""
        for start in range(MAX_STARTS):
            try:
                async with self._started() as process:
                    await self._draw(process)
            except (EOFError, ConnectionError) as error:
                if start + 1 == MAX_STARTS:
                    raise FreeArtError(f"the simulator's process died {MAX_STARTS} times") from error
                log("the simulator's process died; it is started again")

    @contextlib.asynccontextmanager
    async def _started(self) -> Any:
        with stopping.block_signals():
            process = await asyncio.create_subprocess_exec(
                *child.command("generator.teleop.stage_process"),
                stdin=asyncio.subprocess.PIPE,
                stdout=asyncio.subprocess.PIPE,
                limit=1 << 26,
            )
        self.process = process
        try:
            await _query(process, self._setup)
            self.ready = True
            yield process
        finally:
            self.ready = False
            with contextlib.suppress(ProcessLookupError):
                process.kill()  # also while it compiles a shader
            with contextlib.suppress(asyncio.TimeoutError):
                await asyncio.wait_for(process.wait(), END_S)

    async def _draw(self, process: asyncio.subprocess.Process) -> None:
        """Draw live pictures while something changes, and sharp ones when it rests."""
        self._changed.set()
        while True:
            await self._changed.wait()
            while await self._changes_within(STILL_S):
                seconds = await self._picture(process, self._pace.scale, QUALITY)
                self._drawn.append((time.monotonic(), seconds))
                self._pace.observe(seconds)
            await self._picture(process, SHARP, SHARP_QUALITY)
            for k, shift in enumerate(SMOOTH):
                if self._changed.is_set():
                    break
                await self._picture(process, SHARP, SHARP_QUALITY, shift, k, show=k + 1 == len(SMOOTH))

    async def _changes_within(self, seconds: float) -> bool:
        """Wait up to `seconds` for a change; returns whether there was one, and clears it."""
        with contextlib.suppress(asyncio.TimeoutError):
            await asyncio.wait_for(self._changed.wait(), seconds)
        changed = self._changed.is_set()
        self._changed.clear()
        return changed

    async def _picture(
        self,
        process: asyncio.subprocess.Process,
        scale: float,
        quality: int,
        shift: tuple[float, float] = (0.0, 0.0),
        layer: int = 0,
        show: bool = True,
    ) -> float:
        """Draw the requested placement and show it; returns the seconds for drawing."""
        place, mark = self._place, self._mark
        order = {
            "T": place.T.tolist(),
            "state": place.state,
            "width": round(scale * self.size[0]),
            "height": round(scale * self.size[1]),
            "quality": quality,
            "shift": shift,
            "layer": layer,
        }
        seconds, jpeg = await _query(process, order)
        if show:
            self.last = LivePicture(jpeg, mark, seconds)
            self.show()
        return seconds


async def _query(process: asyncio.subprocess.Process, what: dict[str, Any]) -> tuple[float, bytes]:
    """Send an order; returns seconds and data of the answer. Raises FreeArtError, or EOFError when the process dies."""
    assert process.stdin is not None and process.stdout is not None
    process.stdin.write(json.dumps(what).encode() + b"\n")
    size, seconds = ANSWER.unpack(await process.stdout.readexactly(ANSWER.size))
    if size == FAULT:
        size, _ = ANSWER.unpack(await process.stdout.readexactly(ANSWER.size))
        raise FreeArtError((await process.stdout.readexactly(size)).decode("utf-8", "replace"))
    return seconds, await process.stdout.readexactly(size)
