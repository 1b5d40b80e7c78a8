"""The live picture: the newest placement is drawn, one at a time, in a process of its own; nothing queues.

While something moves, pictures are as fine as the machine draws them in time (`Pace`); when all is still, a sharp one
follows, and then one whose edges are smooth. A move interrupts either after a picture at most.
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
"""Of JPEGs while something moves (8 kB at 640 x 360, packed in 1 ms), and when it is still."""
STILL_S = 0.25
"""After so long without a change the sharp picture is drawn."""
SHARP = 2.0
"""How much finer that one is than the live picture's size, a side."""
SMOOTH = ((-0.125, -0.375), (0.375, -0.125), (0.125, 0.375), (-0.375, 0.125))
"""Shifts, in pixels, of the views whose mean has smooth edges: the rotated grid of four."""
GROWTHS = (1.0, 1.5, 2.0)
"""How much finer than its size the live picture may be, a side."""
BUDGET_S = 0.022
"""For a live picture: with it and the way to the page there are 30 a second and more."""
ASPECTS = 0.4, 16 / 9
"""Width over height of the picture: not wider than the recorder's, which must see all that is seen here."""
END_S = 2.0
"""How long the end of a killed process is waited for: a driver may hold it."""
MAX_STARTS = 3
"""How often a process is started that died: what dies at once would die again."""


@dataclass(frozen=True)
class Mark:
    """Which move a picture shows."""

    by: object = None
    """Whose move it is."""
    n: int = 0
    time_ms: float = 0.0
    """When its page sent it, by the page's clock."""


@dataclass(frozen=True)
class Shown:
    """A picture."""

    jpeg: bytes
    mark: Mark
    drawn_s: float
    """What drawing and packing took."""


class Pace:
    """How fine live pictures are: as fine as fits into the budget, by what the last ones took."""

    def __init__(self, finest: float) -> None:
        self._growths = [g for g in GROWTHS if g <= finest]
        self._at, self._slow, self._quick = 0, 0, 0

    @property
    def growth(self) -> float:
        """Of the next live picture."""
        return self._growths[self._at]

    def took(self, seconds: float) -> None:
        """A live picture of this growth took so long."""
        self._slow = self._slow + 1 if seconds > BUDGET_S else 0
        finer = self._growths[min(self._at + 1, len(self._growths) - 1)]
        # drawing takes as long as there are pixels, or less: a finer picture that would fit by this rule does
        fits = seconds * (finer / self.growth) ** 2 < BUDGET_S
        self._quick = self._quick + 1 if fits else 0
        if self._slow >= 3 and self._at > 0:
            self._at, self._slow, self._quick = self._at - 1, 0, 0
        elif self._quick >= 20 and finer > self.growth:
            self._at, self._slow, self._quick = self._at + 1, 0, 0


def live_size(width: int, height: int, aspect: float) -> tuple[int, int]:
    """The size of a picture of this aspect, within `ASPECTS`, with about as many pixels as `width` x `height`."""
    aspect = min(max(aspect, ASPECTS[0]), ASPECTS[1])
    if abs(aspect / (width / height) - 1) < 0.01:
        return width, height
    high = (width * height / aspect) ** 0.5
    return 2 * max(8, round(aspect * high / 2)), 2 * max(8, round(high / 2))


class Stage:
    """Draws what it was last told, and hands every picture to `show`."""

    def __init__(self, told: dict[str, Any], size: tuple[int, int], place: Placement, finest: float = GROWTHS[-1]):
        """`told` is what `stage_process.Stage` is made of; `size` of the live picture, pixels."""
        self._told, self.size = told, size
        self._wanted, self._mark = place, Mark()
        self._changed = asyncio.Event()
        self._changed.set()
        self._pace = Pace(finest)
        self._drawn: deque[tuple[float, float]] = deque(maxlen=200)
        self.process: asyncio.subprocess.Process | None = None
        self.show: Callable[[], None] = lambda: None
        """Called after every picture."""
        self.last: Shown | None = None
        self.ready = False

    def want(self, place: Placement, mark: Mark) -> None:
        """Draw this from now on."""
        if not place.is_like(self._wanted):  # else the picture is there, or on its way, for an earlier move
            self._wanted, self._mark = place, mark
            self._changed.set()

    def resize(self, size: tuple[int, int]) -> None:
        """Draw in this size from now on."""
        if size != self.size:
            self.size = size
            self._changed.set()

    def fps(self, now: float) -> float:
        """Live pictures over the last second."""
        return float(sum(now - at <= 1.0 for at, _ in self._drawn))

    def drawing_ms(self) -> float:
        """Median of what drawing a live picture took, milliseconds; 0 before the first."""
        took = sorted(seconds for _, seconds in self._drawn)
        return 1e3 * took[len(took) // 2] if took else 0.0

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
        with stopping.unheard():
            process = await asyncio.create_subprocess_exec(
                *child.command("generator.teleop.stage_process"),
                stdin=asyncio.subprocess.PIPE,
                stdout=asyncio.subprocess.PIPE,
                limit=1 << 26,
            )
        self.process = process
        try:
            await _ask(process, self._told)
            self.ready = True
            yield process
        finally:
            self.ready = False
            with contextlib.suppress(ProcessLookupError):
                process.kill()  # also while it compiles a shader
            with contextlib.suppress(asyncio.TimeoutError):
                await asyncio.wait_for(process.wait(), END_S)

    async def _draw(self, process: asyncio.subprocess.Process) -> None:
        """Draw live pictures while something changes, and finer ones when it does not."""
        self._changed.set()
        while True:
            await self._changed.wait()
            while await self._within(STILL_S):
                seconds = await self._picture(process, self._pace.growth, QUALITY)
                self._drawn.append((time.monotonic(), seconds))
                self._pace.took(seconds)
            await self._picture(process, SHARP, SHARP_QUALITY)
            for k, shift in enumerate(SMOOTH):
                if self._changed.is_set():
                    break
                await self._picture(process, SHARP, SHARP_QUALITY, shift, k, show=k + 1 == len(SMOOTH))

    async def _within(self, seconds: float) -> bool:
        """Whether something changes within so many seconds; it is then taken as seen."""
        with contextlib.suppress(asyncio.TimeoutError):
            await asyncio.wait_for(self._changed.wait(), seconds)
        changed = self._changed.is_set()
        self._changed.clear()
        return changed

    async def _picture(
        self,
        process: asyncio.subprocess.Process,
        growth: float,
        quality: int,
        shift: tuple[float, float] = (0.0, 0.0),
        layer: int = 0,
        show: bool = True,
    ) -> float:
        """Draw what is wanted, and show it; the seconds that drawing took."""
        place, mark = self._wanted, self._mark
        asked = {
            "T": place.T.tolist(),
            "state": place.state,
            "width": round(growth * self.size[0]),
            "height": round(growth * self.size[1]),
            "quality": quality,
            "shift": shift,
            "layer": layer,
        }
        seconds, jpeg = await _ask(process, asked)
        if show:
            self.last = Shown(jpeg, mark, seconds)
            self.show()
        return seconds


async def _ask(process: asyncio.subprocess.Process, what: dict[str, Any]) -> tuple[float, bytes]:
    """Seconds that an answer took, and the answer. Raises FreeArtError, or EOFError when the process dies."""
    assert process.stdin is not None and process.stdout is not None
    process.stdin.write(json.dumps(what).encode() + b"\n")
    size, seconds = ANSWER.unpack(await process.stdout.readexactly(ANSWER.size))
    if size == FAULT:
        size, _ = ANSWER.unpack(await process.stdout.readexactly(ANSWER.size))
        raise FreeArtError((await process.stdout.readexactly(size)).decode("utf-8", "replace"))
    return seconds, await process.stdout.readexactly(size)
