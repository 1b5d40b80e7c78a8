"""One page as the server sees it: what it may say, what it is told, and which pictures are on their way to it."""

from __future__ import annotations

import asyncio
import contextlib
import time
from collections import deque
from typing import Any

from aiohttp import web

from generator.teleop import wire
from generator.teleop.clock import Clock
from generator.teleop.gate import Allowance
from generator.teleop.stage import Shown, Stage

IN_FLIGHT = 2
"""Pictures that a page may not have shown yet before it gets another: one is shown while one is on its way."""
_MOST_WORDS = 64
"""Messages that may wait for a page that takes none; then it is sent away."""


class Client:
    """A page, and the task that sends to it: words first, then the newest picture."""

    def __init__(self, socket: web.WebSocketResponse, name: str, stage: Stage) -> None:
        self.socket, self.name, self._stage = socket, name, stage
        self.clock, self.allowance = Clock(), Allowance()
        self.n = -1
        """Of the newest move heard."""
        self.heard = time.monotonic()
        """When it last said something that counts."""
        self.bad = self.late = 0
        """Messages that were none, and moves that came after newer ones."""
        self.latency_ms: tuple[float, float] | None = None
        """What the page measured: median and 95th percentile."""
        self._words: deque[dict[str, Any]] = deque()
        self._status: dict[str, Any] | None = None
        self._wake = asyncio.Event()
        self._sent = self._seen = 0
        self._tells = False

    def tell(self, message: dict[str, Any]) -> None:
        """Send a message when it can be sent; of statuses only the newest."""
        if message["type"] == "status":
            self._status = message
        else:
            self._words.append(message)
        self._wake.set()

    def look(self) -> None:
        """There may be a new picture."""
        self._wake.set()

    def has_seen(self, count: int) -> None:
        """The page has shown so many pictures."""
        self._tells, self._seen = True, min(count, self._sent)
        self._wake.set()

    async def send(self) -> None:
        """Send, until the page has gone."""
        last: Shown | None = None
        with contextlib.suppress(ConnectionError, RuntimeError):  # it has gone
            while len(self._words) <= _MOST_WORDS:
                await self._wake.wait()
                self._wake.clear()
                while self._words:
                    await self.socket.send_json(self._words.popleft())
                if self._status is not None:
                    status, self._status = self._status, None
                    await self.socket.send_json(status)
                shown = self._stage.last
                if shown is None or shown is last or (self._tells and self._sent - self._seen >= IN_FLIGHT):
                    continue
                last = shown
                self._sent += 1
                own = shown.mark.by is self
                await self.socket.send_bytes(
                    wire.picture(shown.mark.n if own else 0, shown.mark.time_ms if own else 0.0, shown.jpeg)
                )
            await self.close("it takes no messages")

    async def close(self, why: str) -> None:
        """Send the page away."""
        with contextlib.suppress(Exception):
            await asyncio.wait_for(self.socket.close(code=1001, message=why.encode()), 1.0)
