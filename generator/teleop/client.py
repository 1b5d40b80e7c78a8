"""One connected page: its rate limit, its queue of messages, and the pictures that it has not acknowledged."""

from __future__ import annotations

import asyncio
import contextlib
import time
from collections import deque
from typing import Any

from aiohttp import web

from generator.teleop.gate import BURST
from generator.teleop.stage import Stage

IN_FLIGHT = 2
"""Unacknowledged pictures after which a page gets no other: one is shown while one is in transit."""
_MAX_QUEUED = 64
"""Queued messages after which a page that reads none is closed."""


class Client:
    """A page and its sending task: messages first, then the newest picture."""

    def __init__(self, socket: web.WebSocketResponse, name: str, stage: Stage) -> None:
        self.socket, self.name, self._stage = socket, name, stage
        self.allowance = BURST
        """Number of messages that it may send now."""
        self.n = -1
        """Number of the newest move."""
        self.heard_at = time.monotonic()
        """Time of its last move."""
        self.bad = 0
        """Number of invalid messages."""
        self._messages: deque[dict[str, Any]] = deque()
        self._status: dict[str, Any] | None = None
        self._wake = asyncio.Event()
        self._sent = self._seen = 0
        self._acknowledges = False

    def queue(self, message: dict[str, Any]) -> None:
        """Queue a message; of status messages only the newest is sent."""
        if message["type"] == "status":
            self._status = message
        else:
            self._messages.append(message)
        self._wake.set()

    def wake(self) -> None:
        """Wake the sending task: there may be a new picture."""
        self._wake.set()

    def acknowledge(self, count: int) -> None:
        """Note that the page has shown `count` pictures."""
        self._acknowledges, self._seen = True, min(count, self._sent)
        self._wake.set()

    async def send(self) -> None:
        """Send until the page disconnects."""
        last: bytes | None = None
        with contextlib.suppress(ConnectionError, RuntimeError):  # it has disconnected
            while len(self._messages) <= _MAX_QUEUED:
                await self._wake.wait()
                self._wake.clear()
                while self._messages:
                    await self.socket.send_json(self._messages.popleft())
                if self._status is not None:
                    status, self._status = self._status, None
                    await self.socket.send_json(status)
                shown = self._stage.last
                if shown is None or shown is last or (self._acknowledges and self._sent - self._seen >= IN_FLIGHT):
                    continue
                last = shown
                self._sent += 1
                await self.socket.send_bytes(shown)
            await self.close("it takes no messages")

    async def close(self, why: str) -> None:
        """Close the page's connection."""
        with contextlib.suppress(Exception):
            await asyncio.wait_for(self.socket.close(code=1001, message=why.encode()), 1.0)
