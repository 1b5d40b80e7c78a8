"""The live picture: a separate process draws the newest placement, one picture at a time, without a queue.

When the object rests, a sharp picture follows.
"""

from __future__ import annotations

import asyncio
import contextlib
import json
from collections.abc import Callable
from typing import Any

from freeart21 import processes
from freeart21.errors import FreeArtError
from generator.teleop.driving import Placement
from generator.teleop.stage_process import ANSWER

QUALITY, SHARP_QUALITY = 85, 92
"""JPEG quality of moving pictures (8 kB at 640 x 360, packed in 1 ms) and of pictures at rest."""
STILL_S = 0.25
"""Time without a change after which the sharp picture is drawn."""
SHARP = 2.0
"""Resolution of the sharp picture (each side), relative to the live picture's size."""
END_S = 2.0
"""Longest wait for the end of a killed process: a graphics driver may delay it."""
MAX_STARTS = 3
"""Largest number of starts of a process that keeps dying."""


class Stage:
    """Draws the last requested placement and calls `show` for every picture."""

    def __init__(self, setup: dict[str, Any], size: tuple[int, int], place: Placement) -> None:
        """`setup` are the arguments of `stage_process.Stage`; `size` of the live picture, pixels."""
        self._setup, self.size = setup, size
        self._place = place
        self._changed = asyncio.Event()
        self._changed.set()
        self.process: asyncio.subprocess.Process | None = None
        self.show: Callable[[], None] = lambda: None
        """Called after every picture."""
        self.last: bytes | None = None
        """The newest picture, JPEG."""
        self.ready = False

    def request(self, place: Placement) -> None:
        """Draw this placement from now on."""
        if not place.is_close(self._place):  # else the picture exists, or is being drawn, for an earlier move
            self._place = place
            self._changed.set()

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
        with processes.block_signals():
            process = await asyncio.create_subprocess_exec(
                *processes.command("generator.teleop.stage_process"),
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
                await self._picture(process, 1.0, QUALITY)
            await self._picture(process, SHARP, SHARP_QUALITY)

    async def _changes_within(self, seconds: float) -> bool:
        """Wait up to `seconds` for a change; returns whether there was one, and clears it."""
        with contextlib.suppress(asyncio.TimeoutError):
            await asyncio.wait_for(self._changed.wait(), seconds)
        changed = self._changed.is_set()
        self._changed.clear()
        return changed

    async def _picture(self, process: asyncio.subprocess.Process, scale: float, quality: int) -> None:
        """Draw the requested placement and show it."""
        order = {
            "T": self._place.T.tolist(),
            "state": self._place.state,
            "width": round(scale * self.size[0]),
            "height": round(scale * self.size[1]),
            "quality": quality,
        }
        self.last = await _query(process, order)
        self.show()


async def _query(process: asyncio.subprocess.Process, what: dict[str, Any]) -> bytes:
    """Send an order; returns the answer's data. Raises FreeArtError, or EOFError when the process dies."""
    assert process.stdin is not None and process.stdout is not None
    process.stdin.write(json.dumps(what).encode() + b"\n")
    is_fault, size = ANSWER.unpack(await process.stdout.readexactly(ANSWER.size))
    data = await process.stdout.readexactly(size)
    if is_fault:
        raise FreeArtError(data.decode("utf-8", "replace"))
    return data
