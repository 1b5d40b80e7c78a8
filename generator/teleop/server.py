"""The HTTP and websocket server: one page drives, others watch. No request or message is trusted."""

from __future__ import annotations

import asyncio
import socket
import ssl
import time
from collections.abc import Callable
from importlib import resources
from typing import Any

from aiohttp import WSMessage, WSMsgType, web

from freeart21 import se3
from freeart21.errors import FreeArtError
from generator.teleop import wire
from generator.teleop.client import Client
from generator.teleop.driving import Driving, Placement
from generator.teleop.gate import BURST, MAX_BAD, PER_SECOND, Gate
from generator.teleop.stage import Stage
from generator.teleop.takes import Takes

SCRIPTS = ("main", "link", "hand", "desk", "keys", "panel", "headset", "clutch", "room")
FILES = {
    "/": ("teleop.html", "text/html"),
    "/style.css": ("style.css", "text/css"),
    **{f"/{name}.js": (f"{name}.js", "text/javascript") for name in SCRIPTS},
}
"""All files that are served; the path of a request is never a path of this machine."""
MAX_PAGES = 16
"""Pages at the same time: each gets every picture."""
STATUS_S = 0.25
"""Interval of status messages to pages."""
SILENCE_S = 1.0
"""A recording is paused after this silence of the driver; its page sends 30 messages a second."""
SPEAK_S = 5.0
"""Time until a connection must have shown the token, and for which it stays open after a file."""
MAX_CONNECTIONS = 96
"""Connections after which the oldest without the token end: 16 pages have one each, and up to 6 while they load."""
_END_S = 1.0
"""Time for connections to end when the server stops."""
_FRAME_BYTES = 1 << 16
"""Longer messages close the connection; those longer than `wire.MAX_BYTES` are dropped."""
_HEADERS = {
    "Cache-Control": "no-store",
    "Referrer-Policy": "no-referrer",
    "X-Content-Type-Options": "nosniff",
    "X-Frame-Options": "DENY",
    "Cross-Origin-Opener-Policy": "same-origin",
    "Cross-Origin-Resource-Policy": "same-origin",
}
_REFUSED = "This page opens by the address that the terminal printed, with its token. Open that address again."


class Server:
    """Serves one object to pages."""

    def __init__(
        self,
        facts: dict[str, Any],
        bounds: wire.Bounds,
        start: Placement,
        stage: Stage,
        takes: Takes,
        gate: Gate,
        log: Callable[[str], None],
    ) -> None:
        """`facts` on the object are sent to every page in its `hello`."""
        self._facts, self._bounds, self._stage, self._takes, self._gate = facts, bounds, stage, takes, gate
        self._log, self._dropped = log, set[str]()
        app = web.Application(client_max_size=1024)
        app.router.add_get("/ws", self._socket)
        for path in FILES:
            app.router.add_get(path, self._file)
        app.router.add_route("*", "/{anything:.*}", self._not_found)
        self._runner = web.AppRunner(
            app, access_log=None, handle_signals=False, shutdown_timeout=_END_S, keepalive_timeout=SPEAK_S
        )
        self._since: dict[web.RequestHandler, float] = {}
        """When each open connection was first seen."""
        self._admitted: set[web.RequestHandler] = set()
        """Connections that have shown the token."""
        self.driving = Driving(start)
        self._clients: list[Client] = []
        self._driver: Client | None = None
        self._count = 0
        self._notice, self._notices, self._alarm = "", 0, False
        self._fault = ""
        """Error of the last write of the take's file; '' for none."""
        stage.show = self._wake_clients

    async def run(self, listener: socket.socket, context: ssl.SSLContext | None = None) -> None:
        """Serve connections of `listener` and send status messages until cancelled."""
        await self._runner.setup()
        assert self._runner.server is not None
        patience = None if context is None else SPEAK_S
        accepting = await asyncio.get_running_loop().create_server(
            self._runner.server, sock=listener, ssl=context, ssl_handshake_timeout=patience
        )
        try:
            await self._tick()
        finally:
            accepting.close()
            self._write()

    async def _tick(self) -> None:
        while True:
            await asyncio.sleep(STATUS_S)
            driver, driving = self._driver, self.driving
            if driver is not None and time.monotonic() - driver.heard_at > SILENCE_S and driving.pause():
                self._notify(f"paused: the page was silent for {SILENCE_S:g} s")
            self._write()
            for client in self._clients:
                client.allowance = min(BURST, client.allowance + PER_SECOND * STATUS_S)
            self._end_silent(time.monotonic())
            self._queue_for_all(self._status())

    def _end_silent(self, now: float) -> None:
        """End connections that have not shown the token in time, and the oldest of those when there are too many."""
        assert self._runner.server is not None
        self._since = {one: self._since.get(one, now) for one in self._runner.server.connections}
        self._admitted &= set(self._since)
        silent = [one for one in self._since if one not in self._admitted]  # oldest first
        for k, one in enumerate(silent):
            if now - self._since[one] > SPEAK_S or len(self._since) - k > MAX_CONNECTIONS:
                self._report_drop("a connection that showed no token", "somebody")
                one.force_close()

    def _report_drop(self, why: str, whose: object) -> None:
        """Report the first of each kind of what is dropped; `why` is one of a few fixed texts."""
        if why not in self._dropped:
            self._dropped.add(why)
            self._log(f"dropped from {whose}: {why} (others of this kind are dropped without a line)")

    async def close(self) -> None:
        """Close all pages and connections; takes seconds at most."""
        await asyncio.gather(*(client.close("the server ends") for client in self._clients))
        await self._runner.cleanup()

    # --- requests -----------------------------------------------------------------------------------------------------

    def _refuse(self, request: web.Request, socket: bool = False) -> web.Response | None:
        """The response to a request that is refused; None for one that is admitted."""
        token, origin = request.query.get("token", ""), request.headers.get("Origin")
        why = self._gate.refusal(token, request.host or "", origin, socket)
        if not why:
            self._admitted.add(request.protocol)
            return None
        self._report_drop(why, request.remote)
        return web.Response(status=403, text=_REFUSED, headers=_HEADERS)

    async def _not_found(self, request: web.Request) -> web.Response:
        return self._refuse(request) or web.Response(status=404, text="nothing here", headers=_HEADERS)

    async def _file(self, request: web.Request) -> web.Response:
        refused = self._refuse(request)
        if refused is not None:
            return refused
        name, kind = FILES[request.path]
        text = resources.files("generator.teleop").joinpath("static", name).read_text("utf-8")
        for ending in (".js", ".css"):  # requests for files that a file names need the token, too
            text = text.replace(f'{ending}"', f'{ending}?token={self._gate.token}"')
        policy = (
            "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' data: blob:; base-uri 'none'; "
            f"connect-src 'self' ws://{request.host} wss://{request.host}; form-action 'none'; frame-ancestors 'none'"
        )
        return web.Response(text=text, content_type=kind, headers={**_HEADERS, "Content-Security-Policy": policy})

    async def _socket(self, request: web.Request) -> web.StreamResponse:
        refused = self._refuse(request, socket=True)
        if refused is not None:
            return refused
        if request.query.get("v") != wire.VERSION:
            return web.Response(status=400, text=f"expected v={wire.VERSION}", headers=_HEADERS)
        if len(self._clients) >= MAX_PAGES:
            self._report_drop(f"more than {MAX_PAGES} pages", request.remote)
            return web.Response(status=503, text="too many pages", headers=_HEADERS)
        channel = web.WebSocketResponse(max_msg_size=_FRAME_BYTES, compress=False, heartbeat=10.0)
        await channel.prepare(request)
        self._count += 1
        client = Client(channel, f"page {self._count}", self._stage)
        self._clients.append(client)
        self._log(f"{client.name} connected from {request.remote!s}")
        if self._driver is None:
            self._drive(client)
        else:
            client.queue(self._hello(client))
        client.queue(self._status())
        sending = asyncio.create_task(client.send())
        try:
            async for message in channel:
                if not self._handle_message(client, message):
                    break
        finally:
            sending.cancel()
            self._remove_client(client)
        return channel

    # --- messages of pages --------------------------------------------------------------------------------------------

    def _handle_message(self, client: Client, frame: WSMessage) -> bool:
        """Handle a message; False when its page must be closed."""
        if client.allowance < 1:
            return self._count_bad(client, "more messages than a page may send")
        client.allowance -= 1
        if frame.type != WSMsgType.TEXT:
            return self._count_bad(client, "a message that is not text")
        try:
            message = wire.read(frame.data, self._bounds)
        except wire.BadMessage as error:
            return self._count_bad(client, str(error))
        client.heard_at = time.monotonic()
        if isinstance(message, wire.Acknowledgement):
            client.acknowledge(message.count)
        elif isinstance(message, wire.Command) and message.what == "drive":
            if self._driver is None:
                self._drive(client)
        elif client is not self._driver:
            return self._count_bad(client, "a watching page tried to drive")
        elif isinstance(message, wire.Move):
            self._move(client, message)
        else:
            self._run_command(message.what)
        return True

    def _count_bad(self, client: Client, why: str) -> bool:
        client.bad += 1
        self._report_drop(why, client.name)
        if client.bad >= MAX_BAD:
            self._log(f"{client.name} is closed after {client.bad} bad messages")
            return False
        return True

    def _move(self, client: Client, move: wire.Move) -> None:
        if move.n <= client.n:
            return
        client.n = move.n
        if self.driving.move(move, 1e-3 * move.time_ms):
            self._stage.request(self.driving.place)
        if self.driving.is_full and self.driving.pause():
            self._notify("paused: a take cannot be longer; save it")

    def _write(self) -> None:
        """Update the take's file; a new error is reported once."""
        fault = ""
        try:
            self._takes.write(self.driving)
        except FreeArtError as error:
            fault = str(error)
        if fault and fault != self._fault:
            self._log(f"the take is only in memory: {fault}")
            self._notify(f"the take is only in memory: {fault}", alarm=True)
        self._fault = fault

    def _run_command(self, what: str) -> None:
        driving, epoch = self.driving, self.driving.epoch
        if what == "record":
            self._notify("recording continues from the end of the take" if driving.record() else "recording")
        elif what == "pause" and driving.pause():
            self._notify("paused: move freely; to continue, the object returns to its present place")
        elif what == "undo":
            gone = driving.undo()
            self._notify(f"the last {gone:.1f} s are undone" if gone else "nothing to undo")
        elif what == "reset":
            driving.reset()
            self._notify("the object is back at its start")
        elif what == "save":
            self._save()
        self._write()
        if driving.epoch != epoch:
            self._queue_for_all({"type": "place", "epoch": driving.epoch, **_numbers(driving.place)})
            self._stage.request(driving.place)

    def _save(self) -> None:
        driving = self.driving
        driving.pause()
        if not driving.has_take:
            self._notify("there is no take to save: record one")
            return
        try:
            path = self._takes.save(driving)
        except FreeArtError as error:
            self._log(f"not saved: {error}")
            self._notify(f"not saved: {error}. The take is kept: press save again", alarm=True)
        else:
            self._log(f"saved {path} ({driving.take.seconds:.1f} s, {len(driving.take)} samples)")
            self._notify(f"saved as {path.name}, {driving.take.seconds:.1f} s")
            driving.start_new_take()
            self._queue_for_all(self._status())

    # --- the driver ---------------------------------------------------------------------------------------------------

    def _drive(self, client: Client) -> None:
        self._driver, client.n = client, -1
        self.driving.take.cut()  # its page has a clock of its own
        client.heard_at = time.monotonic()
        self._log(f"{client.name} drives")
        client.queue(self._hello(client))

    def _remove_client(self, client: Client) -> None:
        self._clients.remove(client)
        self._log(f"{client.name} disconnected")
        if client is self._driver:
            self._driver = None
            if self.driving.pause():
                self._notify("paused: the driver's page disconnected")

    # --- messages to pages --------------------------------------------------------------------------------------------

    def _notify(self, notice: str, alarm: bool = False) -> None:
        self._notice, self._alarm = notice, alarm
        self._notices += 1
        self._queue_for_all(self._status())

    def _queue_for_all(self, message: dict[str, Any]) -> None:
        for client in self._clients:
            client.queue(message)

    def _wake_clients(self) -> None:
        for client in self._clients:
            client.wake()

    def _hello(self, client: Client) -> dict[str, Any]:
        driving = self.driving
        return {
            "type": "hello",
            "role": "driver" if client is self._driver else "watcher",
            **self._facts,
            "limits": [self._bounds.lower, self._bounds.upper],
            "epoch": driving.epoch,
            **_numbers(driving.place),
            "width": self._stage.size[0],
            "height": self._stage.size[1],
        }

    def _status(self) -> dict[str, Any]:
        driving, stage = self.driving, self._stage
        return {
            "type": "status",
            "ready": stage.ready and stage.last is not None,
            "recording": driving.phase == "recording",
            "paused": driving.phase == "paused",
            "seconds": round(driving.take.seconds, 2),
            "samples": len(driving.take),
            "state": driving.place.state,
            "driven": self._driver is not None,
            "watchers": len(self._clients) - (self._driver is not None),
            "file": self._takes.next_name(),
            "notice": self._notice or None,
            "notice_n": self._notices,
            "alarm": self._alarm,
        }


def _numbers(place: Placement) -> dict[str, Any]:
    return {"position": place.T[:3, 3].tolist(), "quaternion": se3.wxyz(place.T).tolist(), "state": place.state}
