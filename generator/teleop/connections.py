"""Bounds the number of connections and the time until each must show the token.

When there are too many, a new connection replaces the oldest one that has not shown the token.
"""

from __future__ import annotations

import asyncio
import socket
import ssl
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from generator.teleop.gate import RateLimitedLog

MAX_CONNECTIONS, MAX_PER_ADDRESS = 96, 64
"""Connections at the same time: 16 pages have one each, and up to 6 more (the limit of browsers) while they load."""
SPEAK_S = 5.0
"""Time until a connection must have shown the token, the TLS handshake included."""
KEEP_S = 5.0
"""Time for which a connection stays open after a file."""
_FULL_S = 0.2
"""Pause when this process cannot open more files."""


@dataclass(eq=False)
class _Connection:
    host: str
    task: asyncio.Task[None] | None = None
    transport: asyncio.BaseTransport | None = None
    admitted: bool = False

    @property
    def is_over(self) -> bool:
        return self.transport is not None and self.transport.is_closing()

    def end(self) -> None:
        if isinstance(self.transport, asyncio.WriteTransport):
            self.transport.abort()
        elif self.task is not None:
            self.task.cancel()


class Connections:
    """Accepts connections of a listening socket and hands them to a server's protocol."""

    def __init__(self, protocol: Callable[[], asyncio.BaseProtocol], log: RateLimitedLog) -> None:
        """`protocol` makes the protocol of one connection, as `web.AppRunner.server` does."""
        self._protocol, self._log = protocol, log
        self._by_peer: dict[Any, _Connection] = {}
        """By address and port of the other side, oldest first."""

    @property
    def count(self) -> int:
        """Number of open connections."""
        self._by_peer = {peer: one for peer, one in self._by_peer.items() if not one.is_over}
        return len(self._by_peer)

    def admit(self, transport: asyncio.BaseTransport | None) -> None:
        """Mark the connection of this transport as admitted: its request has shown the token."""
        peer = None if transport is None else transport.get_extra_info("peername")
        if peer in self._by_peer:
            self._by_peer[peer].admitted = True

    async def accept(self, listener: socket.socket, context: ssl.SSLContext | None = None) -> None:
        """Accept connections until cancelled; with TLS where a `context` is given."""
        loop = asyncio.get_running_loop()
        listener.setblocking(False)
        try:
            while True:
                await asyncio.sleep(0)  # let other tasks run while many connections wait
                try:
                    connected, peer = await loop.sock_accept(listener)
                except OSError as error:
                    self._log.report_dropped(f"no connection can be taken: {error.strerror or error}", "somebody")
                    await asyncio.sleep(_FULL_S)
                    continue
                one = _Connection(str(peer[0]))
                if self._make_room(one.host):
                    self._by_peer[peer] = one
                    one.task = asyncio.create_task(self._serve(peer, one, connected, context))
                else:
                    connected.close()
        finally:
            for one in self._by_peer.values():
                if one.transport is None:
                    one.end()

    async def _serve(
        self, peer: Any, one: _Connection, connected: socket.socket, context: ssl.SSLContext | None
    ) -> None:
        """Hand a connection to the protocol, and end it when it does not show the token in time."""
        end = asyncio.get_running_loop().time() + SPEAK_S
        secure: dict[str, Any] = {} if context is None else {"ssl": context, "ssl_handshake_timeout": SPEAK_S}
        try:
            one.transport, _ = await asyncio.get_running_loop().connect_accepted_socket(
                self._protocol, connected, **secure
            )
        except OSError:  # disconnected, or no TLS
            pass
        finally:
            if one.transport is None:
                connected.close()
                self._by_peer.pop(peer, None)
        if one.transport is not None:
            asyncio.get_running_loop().call_at(end, self._end_silent, one)

    def _end_silent(self, one: _Connection) -> None:
        if not one.admitted and not one.is_over:
            self._log.report_dropped(f"a connection that showed no token in {SPEAK_S:g} s", one.host)
            one.end()

    def _make_room(self, host: str) -> bool:
        """Whether one more connection of `host` is accepted; the oldest without token is ended for it if needed."""
        for whose, most in ((host, MAX_PER_ADDRESS), ("", MAX_CONNECTIONS)):
            if self.count == 0:
                break
            many = [one for one in self._by_peer.values() if whose in ("", one.host)]
            if len(many) < most:
                continue
            self._log.report_dropped(f"more than {most} connections{' of an address' if whose else ''}", host)
            silent = next((one for one in many if not one.admitted), None)
            if silent is None:
                return False
            silent.end()
            self._by_peer = {peer: one for peer, one in self._by_peer.items() if one is not silent}
        return True
